//! Damaged bytes of a scene: a scene that holds or an error, never a panic.
#![no_main]

#[path = "../../nuscenes/tests/common/mod.rs"]
mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::damage::decode_damaged(input));
