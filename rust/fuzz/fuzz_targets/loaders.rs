//! A data set with one damaged file: scenes that hold or an error, never a panic.
#![no_main]

#[path = "../../nuscenes/tests/common/mod.rs"]
mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::damage::load_damaged(input));
