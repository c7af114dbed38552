//! A checkpoint.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "building.safetensors",
    bytes,
    |file| coseg::checkpoint::Checkpoint::load(file, "building")
));
