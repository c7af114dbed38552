//! The contract of a segmenter.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "net.toml",
    bytes,
    coseg::segmenter::Contract::read
));
