//! A .splat.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "scene.splat",
    bytes,
    coseg::splat::formats::read
));
