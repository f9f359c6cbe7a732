//! Policies on libtorch: the one crate that links it.
use tch as _;
use torch_sys as _;
