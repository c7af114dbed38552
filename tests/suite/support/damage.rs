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

    /// A damaged copy of `whole`.
    pub fn of(&mut self, whole: &[u8]) -> Vec<u8> {
        let mut damaged = whole.to_vec();
        for _ in 0..self.changes {
            self.state = self
                .state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let at = (self.state >> 33) as usize % damaged.len();
            damaged[at] = (self.state >> 25) as u8;
        }
        damaged
    }
}
