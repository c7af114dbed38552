//! An SPZ.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "scene.spz",
    bytes,
    coseg::splat::formats::read
));
