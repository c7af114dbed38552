//! The scene as 3D Gaussians: parameters on the host, initialisation, densification, spherical harmonics, PLY.

pub mod densify;
pub mod init;
pub mod ply;

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

    /// SH coefficients per colour channel, `(sh_degree + 1)^2`.
    pub fn sh_len(&self) -> usize {
        (self.sh_degree + 1).pow(2)
    }
}
