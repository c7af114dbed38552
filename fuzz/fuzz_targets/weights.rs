//! Weights of PyTorch.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| coseg_fuzz::read("net.pth", bytes, |file| {
    coseg::weights::WeightFile::open(file)
}));
