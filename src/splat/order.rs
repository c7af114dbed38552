//! The order in which Gaussians are stored.

use super::{Gaussians, bounds};
use glam::DVec3;

/// Bits of a code along each axis.
const BITS: u32 = 21;

impl Gaussians {
    /// Rows along a Z-order curve through the centres (Morton 1966). Consecutive rows lie close together, so that views and
    /// Gaussians read mostly cached memory.
    ///
    /// Centres that are not finite come last. Rows of one cell keep their order.
    pub fn spatial_order(&self) -> Vec<u32> {
        let points = self.positions(DVec3::ZERO);
        let finite = points.iter().copied().filter(|p| p.is_finite());
        let (low, high) = bounds(finite).unwrap_or_default();
        let extent = (high - low).max_element();
        let cells = if extent > 0.0 {
            f64::from((1_u32 << BITS) - 1) / extent
        } else {
            0.0
        };
        let code = |p: &DVec3| {
            if !p.is_finite() {
                return u64::MAX;
            }
            let cell = (*p - low) * cells;
            (0..3).map(|a| spread(cell[a] as u64) << a).sum()
        };
        let codes: Vec<u64> = points.iter().map(code).collect();
        let mut order: Vec<u32> = (0..self.len() as u32).collect();
        order.sort_by_key(|&i| codes[i as usize]);
        order
    }
}

/// The low 21 bits of `x`, each followed by two zeros.
fn spread(x: u64) -> u64 {
    let steps = [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ];
    steps
        .iter()
        .fold(x, |x, &(shift, mask)| (x | x << shift) & mask)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread_to_every_third_place() {
        for x in [0, 1, 2, 0b1011, 0x15_5555, 0x1f_ffff] {
            let slow: u64 = (0..BITS).map(|bit| (x >> bit & 1) << (3 * bit)).sum();
            assert_eq!(spread(x), slow, "{x:#b}");
        }
    }

    #[test]
    fn neighbours_in_space_are_neighbours_in_order() {
        let side = 16;
        let point = |i: usize| [i % side, i / side % side, i / side / side].map(|v| v as f32);
        let mut means: Vec<[f32; 3]> = (0..side.pow(3))
            .map(|i| point(i * 1733 % side.pow(3)))
            .collect();
        means.push([f32::NAN, 0.0, 0.0]);
        let gaussians = Gaussians {
            means,
            ..Gaussians::default()
        };
        let order = gaussians.spatial_order();
        assert_eq!(order.last(), Some(&(side.pow(3) as u32)));
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..=side.pow(3) as u32));
        let at = |k: usize| gaussians.means[order[k] as usize];
        let far = |k: &usize| {
            (0..3)
                .map(|a| (at(*k)[a] - at(k + 1)[a]).abs())
                .sum::<f32>()
                > 3.0
        };
        let jumps = (0..side.pow(3) - 1).filter(far).count();
        assert!(jumps < side.pow(3) / 10, "{jumps} jumps");
    }

    #[test]
    fn one_place_or_none_keeps_the_order() {
        let means = vec![[0.5, 1.0, 2.0]; 4];
        assert_eq!(
            Gaussians {
                means,
                ..Gaussians::default()
            }
            .spatial_order(),
            [0, 1, 2, 3]
        );
        assert!(Gaussians::default().spatial_order().is_empty());
    }
}
