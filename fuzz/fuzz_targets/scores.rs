//! Scores of a segmenter.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read(
    "a.scores",
    bytes,
    coseg::data::ScoreMap::read
));
