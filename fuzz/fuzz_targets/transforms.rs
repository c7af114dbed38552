//! Cameras of a transforms.json.

#![no_main]

libfuzzer_sys::fuzz_target!(
    |bytes: &[u8]| coseg_fuzz::read("transforms.json", bytes, |file| coseg::data::read_cameras(
        file, None
    ))
);
