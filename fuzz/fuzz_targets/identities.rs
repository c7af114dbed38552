//! Identities.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "identities.safetensors",
    bytes,
    coseg::objects::Identities::read
));
