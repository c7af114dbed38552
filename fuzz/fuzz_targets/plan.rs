//! The plan of a comparison.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read("plan.toml", bytes, |file| {
    coseg::compare::Plan::read(file, None)
}));
