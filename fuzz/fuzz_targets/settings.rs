//! Settings.

#![no_main]

libfuzzer_sys::fuzz_target!(
    |bytes: &[u8]| coseg_fuzz::read("config.toml", bytes, |file| coseg::config::Config::load(
        Some(file),
        &[]
    ))
);
