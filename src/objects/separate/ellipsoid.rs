//! A Gaussian as the ellipsoid within which it is more opaque than some level.

use crate::splat::{Gaussians, rotation};
use glam::{DMat3, DVec3};

/// The least squared thickness of an ellipsoid, as a share of its squared size.
const FLATNESS: f64 = 1e-10;
/// Golden section.
const GOLDEN: f64 = 0.618_033_988_749_894_8;
/// Divisions of an interval by the golden section: to 1e-4 of its length.
const SECTIONS: usize = 20;

/// Where a Gaussian is more opaque than some level.
pub(super) struct Ellipsoid {
    pub center: DVec3,
    /// A of x^T A^-1 x <= 1, x from the centre.
    shape: DMat3,
    /// Longest half-axis.
    pub longest: f64,
    /// Opacity times the two larger standard deviations.
    pub area: f64,
}

impl Ellipsoid {
    /// `None` for a Gaussian less opaque than `level`.
    pub fn new(gaussians: &Gaussians, row: usize, level: f64) -> Option<Self> {
        let opacity = 1.0 / (1.0 + (-f64::from(gaussians.opacity_logits[row])).exp());
        let radius = (2.0 * (opacity / level).ln()).max(0.0).sqrt();
        let [a, b, c] = gaussians.log_scales[row].map(|s| f64::from(s).exp());
        let half = DVec3::new(a, b, c) * radius;
        let turned = DMat3::from_quat(rotation(&gaussians.rotations[row]));
        // A thickness far below what is visible keeps sums of two shapes invertible.
        let squares = half * half + FLATNESS * half.length_squared();
        let shape = turned * DMat3::from_diagonal(squares) * turned.transpose();
        let area = opacity * (a * b).max(b * c).max(a * c);
        let solid = opacity >= level
            && shape.is_finite()
            && area.is_finite()
            && squares.min_element() > 0.0;
        let center = DVec3::from(gaussians.means[row].map(f64::from));
        solid.then(|| Self {
            center,
            shape,
            longest: half.max_element(),
            area,
        })
    }

    /// Whether the ellipsoids overlap: the maximum of K(s) = s (1 - s) d^T ((1 - s) A + s B)^-1 d over 0 < s < 1 is no more than
    /// 1 (Perram and Wertheim 1985). K is concave.
    pub fn touches(&self, other: &Self) -> bool {
        let apart = other.center - self.center;
        let shadow = |ellipsoid: &Self| apart.dot(ellipsoid.shape * apart).sqrt();
        // A cheap test first: their projections on the line between the centres must overlap.
        if apart.length_squared() > shadow(self) + shadow(other) {
            return false;
        }
        let k = |s: f64| {
            let sum = self.shape * (1.0 - s) + other.shape * s;
            s * (1.0 - s) * apart.dot(sum.inverse() * apart)
        };
        let [mut low, mut high] = [0.0, 1.0];
        let [mut left, mut right] = [1.0 - GOLDEN, GOLDEN];
        let [mut at_left, mut at_right] = [k(left), k(right)];
        for _ in 0..SECTIONS {
            if at_left > 1.0 || at_right > 1.0 {
                return false;
            }
            if at_left < at_right {
                (low, left, at_left) = (left, right, at_right);
                right = low + GOLDEN * (high - low);
                at_right = k(right);
            } else {
                (high, right, at_right) = (right, left, at_left);
                left = high - GOLDEN * (high - low);
                at_left = k(left);
            }
        }
        at_left.max(at_right) <= 1.0
    }
}
