//! A class table.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "classes.json",
    bytes,
    coseg::data::Classes::read
));
