//! The rasterizer in plain tensor operations, differentiated by burn: the reference of the kernels and of their handwritten
//! backward pass.
//!
//! It evaluates each Gaussian at each pixel, `[P, N]` at once, so it is for small scenes. [`crate::ops::with_references`]
//! switches to it.

use super::input::{RasterInput, RasterOutput};
use super::splats::SplatTensors;
use crate::backend::device::read_wide;
use crate::error::Result;
use crate::ops::SparseMatrix;
use crate::raster::settings::Settings;
use crate::splat::ZERO_QUATERNION;
use crate::splat::camera::Camera;
use crate::splat::sh::{C0, C1, C2, C3};
use burn::tensor::{Int, Tensor, TensorData};

/// The frozen blending weights of a view.
pub(super) struct ReferenceView {
    /// alpha' T, `[P, N]`, columns front to back.
    weights: Tensor<2>,
    /// `[P]`.
    transmittance: Tensor<1>,
    /// Indices of the Gaussians front to back, and where each Gaussian of the scene is among them.
    order: Vec<i64>,
    rank: Vec<i64>,
    /// `[N]`; 0 = not visible.
    radii: Tensor<1>,
    /// Pixels within the radius of each Gaussian, `[N]`.
    counts: Tensor<1>,
    camera: Camera,
}

/// Projected Gaussians; all are `[1, N]`.
struct Footprints {
    depth: Tensor<2>,
    /// Centre, pixels.
    center: [Tensor<2>; 2],
    /// `[[X, B], [B, Y]]`, the 2D covariance, and its determinant.
    covariance: [Tensor<2>; 3],
    determinant: Tensor<2>,
    /// 1 for Gaussians in front of the near plane, else 0.
    front: Tensor<2>,
}

/// [`crate::raster::rasterize`] of a valid input.
pub(super) fn rasterize(
    input: RasterInput,
    camera: &Camera,
    settings: &Settings,
    background: [f32; 3],
) -> Result<RasterOutput> {
    settings.check()?;
    camera.check()?;
    let splats = input.splats();
    let of_sh = |sh| colours(&splats.means, sh, input.active_sh_degree, camera);
    let colours = input.sh.map(of_sh);
    let with_colours = colours.is_some();
    let values: Vec<Tensor<2>> = colours.into_iter().chain(input.features).collect();
    let view = ReferenceView::new(&splats, input.screen, camera, settings);
    let (mut image, transmittance) = view.blend(Tensor::cat(values, 1));
    if with_colours {
        let [height, width, channels] = image.dims();
        let mut behind = background.map(f64::from).to_vec();
        behind.resize(channels, 0.0);
        let behind = TensorData::new(behind, [1, 1, channels]);
        let behind = Tensor::<3>::from_data(behind, (&image.device(), image.dtype()));
        image = image + transmittance.clone().reshape([height, width, 1]) * behind;
    }
    Ok(RasterOutput {
        radii: view.radii,
        image,
        transmittance,
    })
}

impl ReferenceView {
    /// A view of `splats`. `screen` is that of [`RasterInput`]; its gradient has no sums of absolute values.
    pub fn new(
        splats: &SplatTensors,
        screen: Option<Tensor<2>>,
        camera: &Camera,
        settings: &Settings,
    ) -> Self {
        let projected = project(splats, screen, camera, settings);
        let depths = projected.depth.clone().inner().into_data();
        let depths: Vec<f64> = depths.iter::<f64>().collect();
        let mut order: Vec<i64> = (0..depths.len() as i64).collect();
        order.sort_by(|&a, &b| depths[a as usize].total_cmp(&depths[b as usize]));
        let mut rank = vec![0; order.len()];
        for (place, &id) in (0..).zip(&order) {
            rank[id as usize] = place;
        }
        let logits = splats.opacity_logits.clone().unsqueeze::<2>();
        let offsets = [0, 1].map(|axis| {
            let pixels = pixel_centres(camera, axis, &projected.center[axis]);
            pixels - projected.center[axis].clone()
        });
        let radii = radii(&projected, &logits, camera, settings);
        let squares = offsets.clone().map(|offset| offset.inner().square());
        let within = (squares[0].clone() + squares[1].clone())
            .lower_equal(radii.clone().square().expand(squares[0].dims()));
        let counts = within.float().cast(radii.dtype()).sum_dim(0)
            * radii.clone().greater_elem(0.0).float().cast(radii.dtype());
        let alpha = alphas(&projected, &logits, offsets, settings);
        let indices = index(&order, &alpha);
        let (weights, transmittance) = absorb(alpha.select(1, indices), settings);
        let n = order.len();
        Self {
            weights,
            transmittance,
            order,
            rank,
            radii: radii.reshape([n]),
            counts: counts.reshape([n]),
            camera: camera.clone(),
        }
    }

    /// `W s` of `values` `[N, C]`: the image `[H, W, C]`; and the transmittance `[H, W]`.
    pub fn blend(&self, values: Tensor<2>) -> (Tensor<3>, Tensor<2>) {
        let height = self.camera.height;
        let width = self.camera.width;
        let channels = values.dims()[1];
        let order = index(&self.order, &values);
        let image = self.weights.clone().matmul(values.select(0, order));
        (
            image.reshape([height, width, channels]),
            self.transmittance.clone().reshape([height, width]),
        )
    }

    /// `W^T y` of an image `[H, W, C]`, `[N, C]`.
    pub fn blend_adjoint(&self, image: Tensor<3>) -> Tensor<2> {
        let [height, width, channels] = image.dims();
        let image = image.reshape([height * width, channels]);
        let rank = index(&self.rank, &image);
        let sums = self.weights.clone().transpose().matmul(image);
        sums.select(0, rank)
    }

    /// Pixels within the radius of each Gaussian.
    pub fn disc_pixels(self) -> Result<Vec<u32>> {
        let counts = read_wide("disc pixels", self.counts)?;
        Ok(counts.into_iter().map(|count| count as u32).collect())
    }

    /// The rows `pixels` of `W`.
    pub fn weights(&self, pixels: &[u32]) -> SparseMatrix {
        let n = self.order.len();
        let all = self.weights.clone().inner().into_data();
        let all: Vec<f32> = all.iter::<f32>().collect();
        let mut offsets = vec![0];
        let mut indices = Vec::new();
        let mut values = Vec::new();
        for &pixel in pixels {
            let row = &all[pixel as usize * n..][..n];
            for (&id, &weight) in self.order.iter().zip(row).filter(|(_, w)| **w > 0.0) {
                indices.push(id as u32);
                values.push(weight);
            }
            offsets.push(indices.len() as u32);
        }
        SparseMatrix::new(n, offsets, indices, values)
    }
}

/// Indices on the device of `beside`, without autodiff.
fn index<const D: usize>(indices: &[i64], beside: &Tensor<D>) -> Tensor<1, Int> {
    let data = TensorData::new(indices.to_vec(), [indices.len()]);
    Tensor::from_data(data, &beside.device().inner())
}

/// A constant `[rows, columns]` beside `beside`.
fn constant(values: &[f64], shape: [usize; 2], beside: &Tensor<2>) -> Tensor<2> {
    let data = TensorData::new(values.to_vec(), shape);
    Tensor::from_data(data, (&beside.device().inner(), beside.dtype()))
}

/// x or y of the centre of each pixel, `[P, 1]`.
fn pixel_centres(camera: &Camera, axis: usize, beside: &Tensor<2>) -> Tensor<2> {
    let pixels = 0..camera.width * camera.height;
    let centre = |pixel: usize| [pixel % camera.width, pixel / camera.width][axis] as f64 + 0.5;
    let centres: Vec<f64> = pixels.map(centre).collect();
    constant(&centres, [centres.len(), 1], beside)
}

/// Row `k` of a `[K, N]` tensor, `[1, N]`.
fn row(tensor: &Tensor<2>, k: usize) -> Tensor<2> {
    tensor.clone().narrow(0, k, 1)
}

/// Dot products of the columns of `[3, N]` tensors, `[1, N]`.
fn dot(a: &Tensor<2>, b: &Tensor<2>) -> Tensor<2> {
    (a.clone() * b.clone()).sum_dim(0)
}

/// `a x b` of the columns of `[3, N]` tensors, `[3, N]`.
fn cross(a: &Tensor<2>, b: &Tensor<2>) -> Tensor<2> {
    let part = |i: usize, j: usize| row(a, i) * row(b, j) - row(a, j) * row(b, i);
    Tensor::cat(vec![part(1, 2), part(2, 0), part(0, 1)], 0)
}

/// Columns of the rotation matrices of the quaternions `[4, N]`, each `[3, N]`. Zero quaternions are the identity.
fn rotation_columns(rotations: Tensor<2>) -> [Tensor<2>; 3] {
    let largest = rotations.clone().inner().abs().max_dim(0);
    let scale = largest
        .clone()
        .mask_fill(largest.clone().equal_elem(0.0), 1.0);
    let scaled = rotations / scale;
    let length = scaled.clone().inner().square().sum_dim(0).sqrt() * largest;
    let zero = length
        .lower_elem(ZERO_QUATERNION.sqrt())
        .expand(scaled.dims());
    let identity = constant(&[1.0, 0.0, 0.0, 0.0], [4, 1], &scaled).expand(scaled.dims());
    let q = scaled.mask_where(zero, identity);
    let q = q.clone() / q.square().sum_dim(0).sqrt();
    let [w, x, y, z] = [0, 1, 2, 3].map(|k| row(&q, k));
    let twice = |a: &Tensor<2>, b: &Tensor<2>| a.clone() * b.clone() * 2.0;
    let (xx, yy, zz) = (twice(&x, &x), twice(&y, &y), twice(&z, &z));
    let (xy, xz, yz) = (twice(&x, &y), twice(&x, &z), twice(&y, &z));
    let (wx, wy, wz) = (twice(&w, &x), twice(&w, &y), twice(&w, &z));
    let one_minus = |a: &Tensor<2>, b: &Tensor<2>| (a.clone() + b.clone()).neg() + 1.0;
    let column = |rows: [Tensor<2>; 3]| Tensor::cat(rows.to_vec(), 0);
    [
        column([
            one_minus(&yy, &zz),
            xy.clone() + wz.clone(),
            xz.clone() - wy.clone(),
        ]),
        column([xy - wz, one_minus(&xx, &zz), yz.clone() + wx.clone()]),
        column([xz + wy, yz - wx, one_minus(&xx, &yy)]),
    ]
}

/// The EWA projection (Eq. 1-2): `M = J W R S` with rows `m1`, `m2`, covariance `M M^T + low_pass I`.
fn project(
    splats: &SplatTensors,
    screen: Option<Tensor<2>>,
    camera: &Camera,
    settings: &Settings,
) -> Footprints {
    let means = splats.means.clone().transpose();
    let scales = splats.log_scales.clone().transpose().exp();
    let axes = camera.rotation.transpose().to_cols_array();
    let camera_center = constant(&camera.center.to_array(), [3, 1], &means);
    let position = constant(&axes, [3, 3], &means).matmul(means.clone() - camera_center);
    let depth = row(&position, 2);
    let behind = depth.clone().inner().lower_equal_elem(settings.near);
    let front = behind.clone().bool_not().float().cast(depth.dtype());
    // Culled Gaussians get a depth that divides well. Their alpha' is 0.
    let z = depth.clone().mask_fill(behind, 1.0);
    let columns = rotation_columns(splats.rotations.clone().transpose());
    let focal = [camera.fx, camera.fy];
    let principal = [camera.cx, camera.cy];
    let size = [camera.width as f64, camera.height as f64];
    let axis = |a: usize| constant(&axes[3 * a..3 * a + 3], [3, 1], &means);
    let ratio = |a: usize| row(&position, a) / z.clone();
    // Rows of M.
    let m = [0, 1].map(|a| {
        let low = -(0.15 * size[a] + principal[a]) / focal[a];
        let high = (1.15 * size[a] - principal[a]) / focal[a];
        let tangent = ratio(a).clamp(low, high);
        let jw = (axis(a) - tangent * axis(2)) * (z.clone().recip() * focal[a]);
        let rows = columns.each_ref().map(|column| dot(&jw, column));
        Tensor::cat(rows.to_vec(), 0) * scales.clone()
    });
    let center = [0, 1].map(|a| {
        let center = ratio(a) * focal[a] + principal[a];
        match &screen {
            // Any value of `screen` renders the same; only its gradient counts.
            Some(screen) => {
                let shift = screen.clone().narrow(1, a, 1).transpose();
                center + (shift.clone() - shift.inner()) * (size[a] / 2.0)
            }
            None => center,
        }
    });
    let low = settings.low_pass;
    let [n1, n2] = m.each_ref().map(|m| dot(m, m));
    let area = cross(&m[0], &m[1]);
    Footprints {
        depth,
        center,
        determinant: dot(&area, &area) + (n1.clone() + n2.clone()) * low + low * low,
        covariance: [n1 + low, dot(&m[0], &m[1]), n2 + low],
        front,
    }
}

/// `1 / (1 + e^-x)`: burn's own sigmoid rounds to f32.
fn opacities(logits: &Tensor<2>) -> Tensor<2> {
    (logits.clone().neg().exp() + 1.0).recip()
}

/// `ceil(3 sqrt(lambda_max))`, `[1, N]` without autodiff; 0 where the ellipse of `alpha_min` is empty or off-screen.
fn radii(
    projected: &Footprints,
    logits: &Tensor<2>,
    camera: &Camera,
    settings: &Settings,
) -> Tensor<2> {
    let [xx, b, yy] = projected.covariance.clone().map(Tensor::inner);
    let half = (xx.clone() - yy.clone()) * 0.5;
    let lambda = (xx.clone() + yy.clone()) * 0.5 + (half.square() + b.square()).sqrt();
    let tau = opacities(logits).inner().log() - settings.alpha_min.ln();
    let mut hidden = tau.clone().lower_elem(0.0);
    let edges = [camera.width, camera.height].map(|edge| edge as f64);
    for (axis, variance) in [xx, yy].into_iter().enumerate() {
        let center = projected.center[axis].clone().inner();
        let reach = (variance * tau.clone() * 2.0).sqrt();
        let before = (center.clone() + reach.clone()).lower_elem(0.0);
        let after = (center - reach).greater_elem(edges[axis]);
        hidden = hidden.bool_or(before).bool_or(after);
    }
    let radius = (lambda.sqrt() * 3.0).ceil() * projected.front.clone();
    radius.mask_fill(hidden, 0.0)
}

/// alpha' of Eq. 2 with cap and cut-off, `[P, N]`, from the `offsets` of pixels from centres.
fn alphas(
    projected: &Footprints,
    logits: &Tensor<2>,
    [dx, dy]: [Tensor<2>; 2],
    settings: &Settings,
) -> Tensor<2> {
    let [_, b, yy] = projected.covariance.clone();
    let across = yy.clone() * dx - b * dy.clone();
    let distance =
        across.square() / (yy.clone() * projected.determinant.clone()) + dy.square() / yy;
    let alpha = opacities(logits) * (distance * -0.5).exp() * projected.front.clone();
    let alpha = alpha.clamp_max(settings.alpha_max);
    let faint = alpha.clone().inner().lower_elem(settings.alpha_min);
    alpha.mask_fill(faint, 0.0)
}

/// Weights `alpha' T` (Eq. 3), `[P, N]`, and the final transmittance `[P]` of `alpha` front to back.
fn absorb(alpha: Tensor<2>, settings: &Settings) -> (Tensor<2>, Tensor<1>) {
    let [pixels, n] = alpha.dims();
    // A Gaussian that would bring T to t_min or below is not added, nor is any behind it.
    let after = (alpha.clone().inner().neg() + 1.0).cumprod(1);
    let alpha = alpha.mask_fill(after.lower_equal_elem(settings.t_min), 0.0);
    let logs = (alpha.clone().neg() + 1.0).log();
    let sums = logs.clone().cumsum(1);
    let weights = alpha * (sums.clone() - logs).exp();
    let transmittance = sums.narrow(1, n.saturating_sub(1), 1).exp();
    (weights, transmittance.reshape([pixels]))
}

/// Colours `max(0, SH(direction) + 0.5)`, `[N, 3]`, from `sh` `[N, K, 3]`.
pub(super) fn colours(
    means: &Tensor<2>,
    sh: Tensor<3>,
    active_degree: usize,
    camera: &Camera,
) -> Tensor<2> {
    let center = constant(&camera.center.to_array(), [1, 3], means);
    let offset = means.clone() - center;
    let direction = offset.clone() / offset.square().sum_dim(1).sqrt();
    let [n, stored, _] = sh.dims();
    let terms = stored.min((active_degree + 1).pow(2));
    let basis = basis(&direction).into_iter().take(terms).collect();
    let basis = Tensor::cat(basis, 1).reshape([n, terms, 1]);
    let sum = (sh.narrow(1, 0, terms) * basis).sum_dim(1);
    (sum.reshape([n, 3]) + 0.5).clamp_min(0.0)
}

/// The 16 spherical harmonics of the unit directions `[N, 3]`, each `[N, 1]`.
fn basis(direction: &Tensor<2>) -> [Tensor<2>; 16] {
    let [x, y, z] = [0, 1, 2].map(|k| direction.clone().narrow(1, k, 1));
    let [xx, yy, zz] = [&x, &y, &z].map(|v| v.clone().square());
    let product = |a: &Tensor<2>, b: &Tensor<2>, factor: f64| a.clone() * b.clone() * factor;
    let four_zz = zz.clone() * 4.0 - xx.clone() - yy.clone();
    [
        x.ones_like() * C0,
        y.clone() * -C1,
        z.clone() * C1,
        x.clone() * -C1,
        product(&x, &y, C2[0]),
        product(&y, &z, C2[1]),
        (zz.clone() * 2.0 - xx.clone() - yy.clone()) * C2[2],
        product(&x, &z, C2[3]),
        (xx.clone() - yy.clone()) * C2[4],
        product(&y, &(xx.clone() * 3.0 - yy.clone()), C3[0]),
        product(&product(&x, &y, 1.0), &z, C3[1]),
        product(&y, &four_zz, C3[2]),
        product(&z, &(zz * 2.0 - (xx.clone() + yy.clone()) * 3.0), C3[3]),
        product(&x, &four_zz, C3[4]),
        product(&z, &(xx.clone() - yy.clone()), C3[5]),
        product(&x, &(xx - yy * 3.0), C3[6]),
    ]
}
