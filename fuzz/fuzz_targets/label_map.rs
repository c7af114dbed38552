//! A label map.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "labels.png",
    bytes,
    coseg::data::LabelMap::read
));
