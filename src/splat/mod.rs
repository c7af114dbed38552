//! The scene as 3D Gaussians: parameters on the host, spherical harmonics, their files, cameras and camera paths.

pub mod camera;
pub mod camera_path;

pub mod formats;
mod motion;
mod order;
pub(crate) mod sh;

pub use self::formats::ply;
pub use self::motion::Motion;
pub use self::sh::SH_0;
use crate::backend::check_finite;
use crate::error::{Result, bail, ensure};
use glam::{DQuat, DVec3};

/// A quaternion of a smaller squared length stands for no rotation.
pub(crate) const ZERO_QUATERNION: f64 = 1e-12;

/// N Gaussians in host memory, structure of arrays.
///
/// Row `i` of every field belongs to the same Gaussian. Values are unactivated, as the 3DGS PLY stores them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Centres, `[N, 3]`, world units relative to the scene origin.
    pub means: Vec<[f32; 3]>,
    /// Natural logarithm of the three standard deviations, `[N, 3]`.
    pub log_scales: Vec<[f32; 3]>,
    /// Rotation quaternions (w, x, y, z), not normalised, `[N, 4]`.
    pub rotations: Vec<[f32; 4]>,
    /// Logit of the opacity, `[N]`.
    pub opacity_logits: Vec<f32>,
    /// Real SH coefficients in the 3DGS sign and order, `[N, K, 3]` row-major, `K = (sh_degree + 1)^2`.
    pub sh: Vec<f32>,
    /// Degree of [`Gaussians::sh`], 0 to 3.
    pub sh_degree: usize,
}

impl Gaussians {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// World positions of the centres, `[N]`, where they are relative to `origin`.
    pub(crate) fn positions(&self, origin: DVec3) -> Vec<DVec3> {
        let world = |mean: &[f32; 3]| DVec3::from(mean.map(f64::from)) + origin;
        self.means.iter().map(world).collect()
    }

    /// Median of the centres along each axis, relative to the scene origin; `None` without Gaussians. Outliers do not move it.
    pub fn median_center(&self) -> Option<[f32; 3]> {
        let along = |axis: usize| self.means.iter().map(move |mean| f64::from(mean[axis]));
        let median = |axis| median(along(axis)) as f32;
        (!self.is_empty()).then(|| [0, 1, 2].map(median))
    }

    /// The Gaussians `rows`, in that order.
    ///
    /// # Panics
    /// If a row is not below [`Gaussians::len`].
    #[must_use]
    pub fn select(&self, rows: &[u32]) -> Self {
        fn pick<T: Copy>(values: &[T], rows: &[u32]) -> Vec<T> {
            rows.iter().map(|&i| values[i as usize]).collect()
        }
        let width = 3 * self.sh_len();
        Self {
            means: pick(&self.means, rows),
            log_scales: pick(&self.log_scales, rows),
            rotations: pick(&self.rotations, rows),
            opacity_logits: pick(&self.opacity_logits, rows),
            sh: rows
                .iter()
                .flat_map(|&i| &self.sh[i as usize * width..][..width])
                .copied()
                .collect(),
            sh_degree: self.sh_degree,
        }
    }

    /// View-independent colours from the constant SH term, `[N, 3]` sRGB in 0..1.
    pub fn base_colors(&self) -> Vec<[f32; 3]> {
        let colour = |dc: &[f32]| [0, 1, 2].map(|c| (dc[c] * SH_0 + 0.5).clamp(0.0, 1.0));
        let rows = self.sh.chunks_exact(3 * self.sh_len());
        rows.map(colour).collect()
    }

    /// The same Gaussians in these view-independent colours, sRGB in 0..1, one per Gaussian.
    ///
    /// # Panics
    /// If there are not as many colours as Gaussians.
    #[must_use]
    pub fn painted(self, colors: &[[f32; 3]]) -> Self {
        assert_eq!(colors.len(), self.len(), "one colour per Gaussian");
        let values = colors.as_flattened().iter();
        let sh = values.map(|c| (c - 0.5) / SH_0).collect();
        Self {
            sh,
            sh_degree: 0,
            ..self
        }
    }

    /// The same Gaussians with SH of `degree`: missing coefficients are zero, higher ones are dropped.
    #[must_use]
    pub fn with_sh_degree(self, degree: usize) -> Self {
        if degree == self.sh_degree {
            return self;
        }
        let (old, new) = (3 * self.sh_len(), 3 * (degree + 1).pow(2));
        let shared = old.min(new);
        let mut sh = vec![0.0; self.len() * new];
        for (to, from) in sh.chunks_exact_mut(new).zip(self.sh.chunks_exact(old)) {
            to[..shared].copy_from_slice(&from[..shared]);
        }
        Self {
            sh,
            sh_degree: degree,
            ..self
        }
    }

    /// SH coefficients per colour channel, `(sh_degree + 1)^2`.
    pub fn sh_len(&self) -> usize {
        (self.sh_degree + 1).pow(2)
    }

    /// Checks that all lengths agree (`labels` included), that the degree is at most 3, and that every value is finite.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for a length or degree; [`crate::Error::NonFinite`] naming tensor and row.
    pub fn check(&self, labels: Option<&[u16]>) -> Result<()> {
        if self.sh_degree > 3 {
            bail!(argument "gaussians.sh_degree"; found "{}", self.sh_degree;
                expected "0 to 3"; help "lower the degree");
        }
        let n = self.len();
        let lengths = [
            ("log_scales", self.log_scales.len(), n),
            ("rotations", self.rotations.len(), n),
            ("opacity_logits", self.opacity_logits.len(), n),
            ("sh", self.sh.len(), n * self.sh_len() * 3),
            ("labels", labels.map_or(n, <[u16]>::len), n),
        ];
        for (name, found, expected) in lengths {
            ensure!(found == expected, argument "gaussians.{name}"; found "{found}"; expected "{expected}";
                help "make all fields agree on the number of Gaussians");
        }
        let tensors: [(&str, &[f32], usize); 5] = [
            ("means", self.means.as_flattened(), 3),
            ("log_scales", self.log_scales.as_flattened(), 3),
            ("rotations", self.rotations.as_flattened(), 4),
            ("opacity_logits", &self.opacity_logits, 1),
            ("sh", &self.sh, 3 * self.sh_len()),
        ];
        for (name, values, width) in tensors {
            check_finite(name, values, width)?;
        }
        Ok(())
    }
}

/// Lower and upper corner of the box around `points`; `None` without any.
pub(crate) fn bounds(points: impl Iterator<Item = DVec3>) -> Option<(DVec3, DVec3)> {
    let corners = points.map(|p| (p, p));
    corners.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Moves `positions` by `offset`, in f64.
pub(crate) fn shift(positions: &mut [[f32; 3]], offset: DVec3) {
    for position in positions {
        let moved = DVec3::from(position.map(f64::from)) + offset;
        *position = moved.as_vec3().to_array();
    }
}

/// The numbers of the rows whose value `is_wanted` accepts, ascending.
pub(crate) fn rows_where<T>(
    values: impl IntoIterator<Item = T>,
    is_wanted: impl Fn(T) -> bool,
) -> Vec<u32> {
    let rows = (0..).zip(values);
    rows.filter_map(|(row, value)| is_wanted(value).then_some(row))
        .collect()
}

/// The middle one of `values` in ascending order, the upper of two; 0 without any.
pub(crate) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The rotation of a quaternion (w, x, y, z) of any length. A quaternion of length 0 gives the identity, as in the rasterizer.
pub(crate) fn rotation(quaternion: &[f32; 4]) -> DQuat {
    scaled_rotation(quaternion).normalize()
}

/// The [`rotation`] of a quaternion, times its length; the identity where that is 0.
fn scaled_rotation(quaternion: &[f32; 4]) -> DQuat {
    let [w, x, y, z] = quaternion.map(f64::from);
    let q = DQuat::from_xyzw(x, y, z, w);
    if q.length_squared() < ZERO_QUATERNION {
        DQuat::IDENTITY
    } else {
        q
    }
}
