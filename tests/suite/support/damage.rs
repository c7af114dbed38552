//! Files with random changes.

/// Sets `changes` random bytes of files to random values, the same ones in every run of a test.
pub struct Damage {
    state: u64,
    changes: usize,
}

impl Damage {
    pub fn new(changes: usize) -> Self {
        Self { state: 1, changes }
    }

    /// A random number below `end`.
    fn below(&mut self, end: usize) -> usize {
        self.state = self
            .state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.state >> 33) as usize % end.max(1)
    }

    /// A damaged copy of `whole`.
    pub fn of(&mut self, whole: &[u8]) -> Vec<u8> {
        let mut damaged = whole.to_vec();
        for _ in 0..self.changes {
            let at = self.below(damaged.len());
            damaged[at] = (self.state >> 25) as u8;
        }
        damaged
    }

    /// A copy of `whole` with random bytes, a bit flipped, an end cut off, a part repeated, a run of large bytes, or another
    /// number in its text.
    pub fn mutated(&mut self, whole: &[u8]) -> Vec<u8> {
        const NUMBERS: [&str; 8] = [
            "0",
            "-1",
            "1e30",
            "1e999",
            "NaN",
            "4294967296",
            "18446744073709551615",
            "{{{{",
        ];
        let mut mutated = whole.to_vec();
        let at = self.below(whole.len());
        match self.below(6) {
            0 => return self.of(whole),
            1 => mutated[at] ^= 1 << self.below(8),
            2 => mutated.truncate(at),
            3 => {
                let end = (at + 1 + self.below(64)).min(whole.len());
                mutated.splice(at..at, whole[at..end].iter().copied());
            }
            4 => mutated
                .iter_mut()
                .skip(at)
                .take(4)
                .for_each(|byte| *byte = 0xFF),
            _ => {
                let is_digit = |i: &usize| whole[*i].is_ascii_digit();
                let start = (at..whole.len()).find(is_digit).unwrap_or(at);
                let end = (start..whole.len())
                    .find(|i| !is_digit(i))
                    .unwrap_or(whole.len());
                let number = NUMBERS[self.below(NUMBERS.len())];
                mutated.splice(start..end, number.bytes());
            }
        }
        mutated
    }
}
