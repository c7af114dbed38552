//! The point cloud of a scene.

#![no_main]

libfuzzer_sys::fuzz_target!(
    |bytes: &[u8]| coseg_fuzz::read("points.ply", bytes, |file| coseg::data::Points::read(
        file,
        glam::DVec3::ZERO
    ))
);
