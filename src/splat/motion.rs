//! Rigid motions of Gaussians: centres, axes and view-dependent colours.

use super::sh::basis;
use super::{Gaussians, scaled_rotation};
use glam::{DQuat, DVec3};

/// `x -> rotation (x - pivot) + pivot + translation`, in the axes of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Unit quaternion; right-handed, about axes through the pivot.
    pub rotation: DQuat,
    /// The fixed point of the rotation, in the coordinates of [`Gaussians::means`].
    pub pivot: DVec3,
    /// World units.
    pub translation: DVec3,
}

/// Largest number of SH coefficients a channel.
const TERMS: usize = 16;
/// Nodes and weights of Gauss-Legendre quadrature with 4 points, exact up to degree 7.
const LEGENDRE: [[f64; 2]; 4] = [
    [-0.861_136_311_594_052_6, 0.347_854_845_137_453_85],
    [-0.339_981_043_584_856_26, 0.652_145_154_862_546_1],
    [0.339_981_043_584_856_26, 0.652_145_154_862_546_1],
    [0.861_136_311_594_052_6, 0.347_854_845_137_453_85],
];
/// Equally spaced longitudes, exact for trigonometric polynomials up to degree 7.
const LONGITUDES: usize = 8;

impl Motion {
    /// A shift without a turn.
    pub fn shift(translation: DVec3) -> Self {
        Self {
            rotation: DQuat::IDENTITY,
            pivot: DVec3::ZERO,
            translation,
        }
    }

    /// Moves the Gaussians `rows`. A camera that moves along sees the same image.
    ///
    /// # Panics
    /// If a row is not below [`Gaussians::len`].
    pub fn apply(&self, gaussians: &mut Gaussians, rows: &[u32]) {
        let width = gaussians.sh_len();
        let turns = self.rotation != DQuat::IDENTITY;
        let sh = self.sh_rotation(gaussians.sh_degree);
        for &row in rows {
            let i = row as usize;
            let mean = DVec3::from(gaussians.means[i].map(f64::from));
            let moved = self.rotation * (mean - self.pivot) + self.pivot + self.translation;
            gaussians.means[i] = moved.as_vec3().to_array();
            if !turns {
                continue;
            }
            // The raw quaternion keeps its length.
            let q = self.rotation * scaled_rotation(&gaussians.rotations[i]);
            gaussians.rotations[i] = [q.w, q.x, q.y, q.z].map(|v| v as f32);
            let own = &mut gaussians.sh[3 * width * i..][..3 * width];
            let before: [[f64; 3]; TERMS] = std::array::from_fn(|k| {
                std::array::from_fn(|c| own.get(3 * k + c).map_or(0.0, |&v| f64::from(v)))
            });
            for (k, coefficients) in own.chunks_exact_mut(3).enumerate() {
                for (c, out) in coefficients.iter_mut().enumerate() {
                    *out = sh[k]
                        .iter()
                        .zip(&before)
                        .map(|(d, b)| d * b[c])
                        .sum::<f64>() as f32;
                }
            }
        }
    }

    /// `D` with `Y(R d) D c = Y(d) c` for all directions `d` and coefficients `c`: the integral of `Y(R d)^T Y(d)` over the
    /// sphere, by a quadrature that is exact for products of such functions.
    fn sh_rotation(&self, degree: usize) -> [[f64; TERMS]; TERMS] {
        let mut matrix = [[0.0; TERMS]; TERMS];
        for [z, weight] in LEGENDRE {
            for longitude in 0..LONGITUDES {
                let (sin, cos) =
                    (longitude as f64 * std::f64::consts::TAU / LONGITUDES as f64).sin_cos();
                let across = (1.0 - z * z).sqrt();
                let direction = DVec3::new(across * cos, across * sin, z);
                let share = weight * std::f64::consts::TAU / LONGITUDES as f64;
                let turned = basis((self.rotation * direction).to_array(), degree);
                let base = basis(direction.to_array(), degree);
                for (row, t) in matrix.iter_mut().zip(turned) {
                    for (m, b) in row.iter_mut().zip(base) {
                        *m += share * t * b;
                    }
                }
            }
        }
        matrix
    }
}
