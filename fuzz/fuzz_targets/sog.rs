//! A SOG.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "scene.sog",
    bytes,
    coseg::splat::formats::read
));
