//! Made-up numbers that scripts in Python make too.

/// A linear congruential generator, as in `scripts/reference_boundary_iou.py`.
pub struct Generator(pub u32);

impl Generator {
    pub fn below(&mut self, n: u32) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 16) % n
    }
}
