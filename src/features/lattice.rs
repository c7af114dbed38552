//! How the cells of a map lie on the image. Image coordinates are pixels, pixel centres at +0.5.

use crate::data::bilinear::beside;
use crate::splat::camera::Camera;

/// Cells at fixed steps of pixels: cell `i` of either axis is centred on `offset + stride * i`.
///
/// Convolutions with padding leave such a grid: it need not end where the image ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Pixels from one cell centre to the next.
    pub stride: f64,
    /// Centre of the first cell, pixels from the image border.
    pub offset: f64,
}

impl Steps {
    /// Both in pixels.
    pub const fn new(stride: f64, offset: f64) -> Self {
        Self { stride, offset }
    }
}

/// The cells of a map.
///
/// Without [`Steps`] they divide the image evenly: cell `(x, y)` is centred on `((x + 0.5) W / width, (y + 0.5) H / height)`
/// of a `W` x `H` image, so the grid's outer border is the image's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Cells across.
    pub width: usize,
    /// Cells down.
    pub height: usize,
    /// Where the cells are, when they do not divide the image evenly.
    pub steps: Option<Steps>,
}

impl Lattice {
    /// The columns of cells over an image `width` pixels wide.
    pub(super) fn columns(&self, width: usize) -> Axis {
        self.axis(self.width, width)
    }

    /// The rows of cells over an image `height` pixels high.
    pub(super) fn rows(&self, height: usize) -> Axis {
        self.axis(self.height, height)
    }

    fn axis(&self, cells: usize, pixels: usize) -> Axis {
        match self.steps {
            Some(Steps { stride, offset }) => Axis {
                cells,
                stride,
                offset,
            },
            None => Axis::even(cells, pixels),
        }
    }

    /// Image point of the centre of cell `(x, y)`, for an image of `width` x `height` pixels.
    pub fn center(&self, x: usize, y: usize, width: usize, height: usize) -> (f64, f64) {
        (self.columns(width).center(x), self.rows(height).center(y))
    }

    /// `camera` with the cells for its pixels.
    pub fn camera(&self, camera: &Camera) -> Camera {
        if self.steps.is_none() {
            return camera.resized(self.width, self.height);
        }
        let (x, y) = (self.columns(camera.width), self.rows(camera.height));
        Camera {
            fx: camera.fx / x.stride,
            fy: camera.fy / y.stride,
            cx: x.cell(camera.cx) + 0.5,
            cy: y.cell(camera.cy) + 0.5,
            width: self.width,
            height: self.height,
            ..camera.clone()
        }
    }
}

/// One axis of a [`Lattice`] over an image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axis {
    cells: usize,
    stride: f64,
    offset: f64,
}

impl Axis {
    /// `cells` that divide `pixels` evenly.
    pub fn even(cells: usize, pixels: usize) -> Self {
        let stride = pixels as f64 / cells as f64;
        Self {
            cells,
            stride,
            offset: 0.5 * stride,
        }
    }

    fn center(&self, cell: usize) -> f64 {
        self.offset + self.stride * cell as f64
    }

    /// Cell number at an image coordinate, fractional: whole at cell centres.
    fn cell(&self, at: f64) -> f64 {
        (at - self.offset) / self.stride
    }

    /// The cells before and after an image coordinate, and the weight of the cell after it. Beyond the outermost centres both are
    /// the border cell.
    pub fn taps(&self, at: f64) -> (usize, usize, f32) {
        let (before, after, share) = beside(self.cell(at), self.cells);
        (before, after, share as f32)
    }
}
