//! Pinhole cameras: world-to-camera, OpenCV axes (x right, y down, z forward), pixel centres at +0.5.

mod level;

pub use self::level::level_up;

use crate::error::{Result, ensure};
use glam::{DMat3, DMat4, DVec3};

/// A posed pinhole camera.
///
/// The view transform of a world point `x` is `rotation * (x - center)`. The centre is subtracted first, which keeps precision when
/// a scene lies far from the origin.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Camera {
    /// World-to-camera rotation, OpenCV axes.
    pub rotation: DMat3,
    /// Camera centre in world units.
    pub center: DVec3,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels from the left image border.
    pub cx: f64,
    /// Principal point y, pixels from the top image border.
    pub cy: f64,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
}

/// The mean of camera centres, and the largest distance from it; zeros if there are none.
pub(crate) fn spread(centers: impl Iterator<Item = DVec3> + Clone) -> (DVec3, f64) {
    let count = centers.clone().count().max(1);
    let mean = centers.clone().sum::<DVec3>() / count as f64;
    let distances = centers.map(|center| center.distance(mean));
    (mean, distances.fold(0.0, f64::max))
}

/// Whether `m` is a rotation without a mirror, within 1e-3.
pub(crate) fn is_rotation(m: &DMat3) -> bool {
    let off = (m.transpose() * *m - DMat3::IDENTITY).to_cols_array();
    off.iter().all(|v| v.abs() < 1e-3) && m.determinant() > 0.0
}

impl Camera {
    /// A camera at the origin that looks along +z, with focal lengths along x and y and an image size, in pixels. The principal
    /// point is in the middle.
    pub fn centred([fx, fy]: [f64; 2], [width, height]: [usize; 2]) -> Self {
        Self {
            rotation: DMat3::IDENTITY,
            center: DVec3::ZERO,
            fx,
            fy,
            cx: 0.5 * width as f64,
            cy: 0.5 * height as f64,
            width,
            height,
        }
    }

    /// This camera with the pose of an OpenGL camera-to-world matrix (x right, y up, looking along -z), as `transforms.json` has
    /// it.
    ///
    /// Returns `None` when the matrix is not finite or its rotation part is not a proper rotation within 1e-3.
    pub fn with_opengl_pose(self, c2w: &DMat4) -> Option<Self> {
        // Camera axes in OpenCV order: x stays, y and z flip.
        let flipped = DMat4::from_cols(c2w.x_axis, -c2w.y_axis, -c2w.z_axis, c2w.w_axis);
        self.with_opencv_pose(&flipped)
    }

    /// This camera with the pose of an OpenCV camera-to-world matrix (x right, y down, looking along +z).
    ///
    /// Returns `None` when the matrix is not finite or its rotation part is not a proper rotation within 1e-3.
    pub fn with_opencv_pose(self, c2w: &DMat4) -> Option<Self> {
        let m = DMat3::from_mat4(*c2w);
        let center = c2w.w_axis.truncate();
        let rotation = m.transpose();
        (is_rotation(&m) && center.is_finite()).then_some(Self {
            rotation,
            center,
            ..self
        })
    }

    /// A camera of this image size at the origin, for files whose pose cannot be read.
    pub(crate) fn unposed((width, height): (usize, usize)) -> Self {
        Self::centred([(width as f64 / 2.0).max(1.0); 2], [width, height])
    }

    /// Checks that the camera can be rendered from: a finite pose, positive focal lengths, 1 to 2^32 - 1 pixels.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] naming the field.
    pub fn check(&self) -> Result<()> {
        const HELP: &str = "pass a usable camera";
        let rotation = &self.rotation;
        let center = self.center;
        ensure!(rotation.is_finite() && center.is_finite(),
            argument "camera.pose"; found "{rotation} {center}"; expected "finite numbers"; help "{HELP}");
        let focals = [self.fx, self.fy];
        ensure!(focals.iter().all(|f| f.is_finite() && *f > 0.0),
            argument "camera.fx, fy"; found "{focals:?}"; expected "positive numbers"; help "{HELP}");
        let center = [self.cx, self.cy];
        ensure!(center.iter().all(|c| c.is_finite()),
            argument "camera.cx, cy"; found "{center:?}"; expected "finite numbers"; help "{HELP}");
        let (width, height) = (self.width, self.height);
        ensure!((1..=u32::MAX as usize).contains(&width.saturating_mul(height)),
            argument "camera.width, height"; found "{width} x {height}"; expected "1 to 2^32 - 1 pixels";
            help "{HELP}");
        Ok(())
    }

    /// The OpenGL camera-to-world matrix; the inverse of [`Camera::with_opengl_pose`].
    pub fn to_opengl(&self) -> DMat4 {
        let r = self.rotation.transpose();
        let gl = DMat3::from_cols(r.x_axis, -r.y_axis, -r.z_axis);
        let mut m = DMat4::from_mat3(gl);
        m.w_axis = self.center.extend(1.0);
        m
    }

    /// The same camera elsewhere, by `offset` in world units.
    pub fn moved(&self, offset: DVec3) -> Self {
        let center = self.center + offset;
        Self {
            center,
            ..self.clone()
        }
    }

    /// `world` in camera axes (x right, y down, z forward).
    pub fn to_camera(&self, world: DVec3) -> DVec3 {
        self.rotation * (world - self.center)
    }

    /// Pixel coordinates and depth of a world point, or `None` when it is not in front of the camera.
    pub fn project(&self, world: DVec3) -> Option<(f64, f64, f64)> {
        let p = self.to_camera(world);
        let u = self.fx * p.x / p.z + self.cx;
        let v = self.fy * p.y / p.z + self.cy;
        (p.z > 0.0).then_some((u, v, p.z))
    }

    /// World direction (not normalised, z = 1 in camera axes) through pixel coordinates `(u, v)`.
    pub fn ray(&self, u: f64, v: f64) -> DVec3 {
        self.rotation.transpose()
            * DVec3::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// The same camera with its image resampled to `width` x `height` pixels.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let sx = width as f64 / self.width as f64;
        let sy = height as f64 / self.height as f64;
        Self {
            fx: self.fx * sx,
            cx: self.cx * sx,
            fy: self.fy * sy,
            cy: self.cy * sy,
            width,
            height,
            ..self.clone()
        }
    }

    /// The same view as an image of `width` x `height` pixels, scaled by the height. Where the aspect differs, both sides show
    /// more or less; otherwise it equals [`Camera::resized`].
    pub fn with_size(&self, width: usize, height: usize) -> Self {
        let scale = height as f64 / self.height as f64;
        let sides = 0.5 * (width as f64 - scale * self.width as f64);
        let [fx, fy, cx, cy] = [self.fx, self.fy, self.cx, self.cy].map(|v| scale * v);
        Self {
            fx,
            fy,
            cx: cx + sides,
            cy,
            width,
            height,
            ..self.clone()
        }
    }
}
