//! Lens distortion (Brown-Conrady, as in OpenCV and COLMAP) and its removal from photos and label maps.
//!
//! A distorted photo becomes a pinhole of its size and principal point, with the focal lengths times one factor. The factor is the
//! smallest at which every pixel lies within the photo, which gives the widest view. So no pixel is made up, and none has to be
//! masked. Barrel distortion loses the corners of the photo, pincushion distortion its rims.

use crate::data::LabelMap;
use crate::data::bilinear::{among, beside};
use crate::splat::camera::Camera;
use image::{Rgb, RgbImage};

/// Coefficients of the distortion of normalised image coordinates `(x, y)`, `r2 = x^2 + y^2`:
///
/// `x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x^2)`,
/// `y' = y (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p2 x y + p1 (r2 + 2 y^2)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Lens {
    /// Radial: k1, k2, k3.
    pub k: [f64; 3],
    /// Tangential: p1, p2.
    pub p: [f64; 2],
}

/// Factors of the focal length among which [`Undistortion::new`] searches.
const FACTORS: [f64; 2] = [0.25, 4.0];
/// Bisections of that range: 2^-40 of it is far below a pixel.
const BISECTIONS: usize = 40;
/// Points along each side of the image, and of a grid within it, at which a factor is tried.
const POINTS_PER_SIDE: usize = 128;
const GRID: usize = 17;

impl Lens {
    /// Whether there is no distortion.
    pub fn is_pinhole(&self) -> bool {
        *self == Self::default()
    }

    /// Distorted normalised coordinates.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let ([k1, k2, k3], [p1, p2]) = (self.k, self.p);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
        )
    }

    /// Determinant of the derivative of [`Lens::distort`]; where it is not positive the image folds over.
    fn determinant(&self, x: f64, y: f64) -> f64 {
        let ([k1, k2, k3], [p1, p2]) = (self.k, self.p);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        // Twice the derivative of the radial factor by r2.
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
        let xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x;
        let xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        let yy = radial + slope * y * y + 2.0 * p2 * x + 6.0 * p1 * y;
        xx * yy - xy * xy
    }
}

/// From a distorted photo to a pinhole's.
#[derive(Clone, Debug)]
pub(crate) struct Undistortion {
    photo: Camera,
    lens: Lens,
    /// The pinhole: pose, size and principal point of the photo's camera.
    pub pinhole: Camera,
}

impl Undistortion {
    /// `None` when no factor from 0.25 to 4 gives a whole image: the coefficients are beyond what the model is made
    /// for.
    pub fn new(photo: &Camera, lens: Lens) -> Option<Self> {
        let zoomed = |s: f64| Self {
            photo: photo.clone(),
            lens,
            pinhole: Camera {
                fx: photo.fx * s,
                fy: photo.fy * s,
                ..photo.clone()
            },
        };
        let [mut low, mut high] = FACTORS;
        if !zoomed(high).is_whole() {
            return None;
        }
        if zoomed(low).is_whole() {
            return Some(zoomed(low));
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if zoomed(middle).is_whole() {
                high = middle
            } else {
                low = middle
            }
        }
        // Only rounding lies between 1 and the true bound.
        Some(zoomed(if (high - 1.0).abs() < 1e-9 { 1.0 } else { high }))
    }

    /// All numbers that determine it, except sizes: intrinsics of the photo and of the pinhole, and the lens.
    pub fn numbers(&self) -> impl Iterator<Item = f64> {
        let intrinsics = |camera: &Camera| [camera.fx, camera.fy, camera.cx, camera.cy];
        let cameras = [&self.photo, &self.pinhole].map(intrinsics).into_iter();
        let numbers = cameras.flatten();
        numbers.chain(self.lens.k).chain(self.lens.p)
    }

    /// Where the pinhole's pixel coordinates lie in the photo.
    pub fn source(&self, u: f64, v: f64) -> (f64, f64) {
        let (x, y) = self.normalised(u, v);
        let (x, y) = self.lens.distort(x, y);
        (
            self.photo.fx * x + self.photo.cx,
            self.photo.fy * y + self.photo.cy,
        )
    }

    fn normalised(&self, u: f64, v: f64) -> (f64, f64) {
        (
            (u - self.pinhole.cx) / self.pinhole.fx,
            (v - self.pinhole.cy) / self.pinhole.fy,
        )
    }

    /// Whether all pixels lie within the centres of the photo's outermost ones, and none folds over.
    fn is_whole(&self) -> bool {
        let (w, h) = (self.photo.width as f64, self.photo.height as f64);
        let at = |i: usize, n: usize, length: f64| 0.5 + (length - 1.0) * i as f64 / (n - 1) as f64;
        let slack = 1e-9;
        let within = |(u, v): (f64, f64)| {
            let (x, y) = self.source(u, v);
            x >= 0.5 - slack && x <= w - 0.5 + slack && y >= 0.5 - slack && y <= h - 0.5 + slack
        };
        let unfolded = |(u, v): (f64, f64)| {
            let (x, y) = self.normalised(u, v);
            self.lens.determinant(x, y) > 1e-3
        };
        let border = (0..POINTS_PER_SIDE).flat_map(|i| {
            let (u, v) = (at(i, POINTS_PER_SIDE, w), at(i, POINTS_PER_SIDE, h));
            [(u, 0.5), (u, h - 0.5), (0.5, v), (w - 0.5, v)]
        });
        let grid = (0..GRID * GRID).map(|i| (at(i % GRID, GRID, w), at(i / GRID, GRID, h)));
        border.into_iter().all(|p| within(p) && unfolded(p)) && grid.into_iter().all(unfolded)
    }

    /// The photo as the pinhole sees it, bilinear. `photo` has the size of the photo's camera.
    pub fn photo(&self, photo: &RgbImage) -> RgbImage {
        let (w, h) = photo.dimensions();
        RgbImage::from_fn(w, h, |column, row| {
            let (u, v) = self.source(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let (left, right, fx) = beside(u - 0.5, w as usize);
            let (top, bottom, fy) = beside(v - 0.5, h as usize);
            let corners = [(left, top), (right, top), (left, bottom), (right, bottom)]
                .map(|(x, y)| photo.get_pixel(x as u32, y as u32).0.map(f64::from));
            Rgb(std::array::from_fn(|i| {
                among(corners.map(|corner| corner[i]), fx, fy).round() as u8
            }))
        })
    }

    /// The photo's label map as the pinhole sees it, nearest. `labels` may have a different size than the photo.
    pub fn labels(&self, labels: &LabelMap) -> LabelMap {
        let (width, height) = (self.photo.width, self.photo.height);
        labels.sampled(width, height, |u, v| {
            let (x, y) = self.source(u, v);
            (x / width as f64, y / height as f64)
        })
    }
}
