//! A damaged Waymo scene in GPUDrive's JSON: a scene that holds or an error, never a panic.
#![no_main]

#[path = "../../nuscenes/tests/common/mod.rs"]
mod common;

libfuzzer_sys::fuzz_target!(|input: &[u8]| common::damage::load_damaged_gpudrive(input));
