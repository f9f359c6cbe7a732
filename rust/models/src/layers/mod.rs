//! Parts of networks that are made of tensors; the others stand in [`ccdiff_nets::compute::layers`].

pub(crate) mod inputs;
pub(crate) mod social;
