//! A compressed PLY, or another PLY of Gaussians.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "scene.ply",
    bytes,
    coseg::splat::formats::read
));
