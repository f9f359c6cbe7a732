//! Damaged bytes of a running world: a world that goes on or an error, never a panic.
#![no_main]

#[path = "../../nuscenes/tests/common/mod.rs"]
mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::damage::restore_damaged(input));
