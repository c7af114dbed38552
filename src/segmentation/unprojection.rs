//! Lifting 2D feature maps onto the Gaussians (Eq. 5, Algorithm 1): the adjoint of rendering them.
//!
//! ```text
//!           sum_v sum_p alpha'_i(p) T_i(p) F_n(p)
//! f_n,i  =  -------------------------------------     (Eq. 5)
//!                   sum_v |p_v| + eps
//! ```
//!
//! f_n,i is the feature of Gaussian i at scale n. The sums run over the training views v and the cells p of their feature maps
//! F_n. The camera of a view is scaled to the map, so that a cell is a pixel, and |p_v| is the number of cells within the radius of
//! the Gaussian. With the blending weights `W` of such a view, the numerator is the sum over views of `W^T F`.
//!
//! | Algorithm 1 | here |
//! |---|---|
//! | lines 2 to 11: buffer and counter over all views | [`LiftedViews::add`] |
//! | line 12: attendance pruning | [`attended`] |
//! | line 13, Eq. 5: features | [`LiftedViews::features`] |

use crate::backend::device::{read, upload};
use crate::config::{Normalisation, UnprojectionConfig};
use crate::data::View;
use crate::data::mask::Mask;
use crate::error::{Error, Result, ensure, invalid};
use crate::features::{FeatureMap, ViewFeatures};
use crate::ranks;
use crate::raster::{Projected, Settings, SplatTensors, SplatView};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::{Device, Tensor};
use std::borrow::Borrow;

/// Added to the counter before dividing (Algorithm 1).
pub const EPSILON: f32 = 1e-6;

/// Sums over views in the making, on the device that holds the Gaussians.
pub struct LiftedViews<'a> {
    gaussians: &'a Gaussians,
    splats: SplatTensors,
    normalisation: Normalisation,
    scales: Vec<Scale>,
}

/// The sums of one scale.
struct Scale {
    channels: usize,
    /// `sum_v W^T F_v` and, in a last column, `sum_v W^T 1`: `[N, channels + 1]`. None before the first view.
    sums: Option<Tensor<2>>,
    /// Algorithm 1's counter, `[N]`: cells that the masks use and whose centre lies within the radius. Empty where nothing divides by it.
    /// On the host, because f32 counts no further than 2^24.
    counts: Vec<u64>,
}

impl<'a> LiftedViews<'a> {
    /// No views yet, with one entry of `channels` for each scale.
    pub fn new(
        gaussians: &'a Gaussians,
        channels: &[usize],
        normalisation: Normalisation,
        device: &Device,
    ) -> Self {
        let counted = match normalisation {
            Normalisation::Count => gaussians.len(),
            Normalisation::Weight => 0,
        };
        let scale = |&channels| Scale {
            channels,
            sums: None,
            counts: vec![0; counted],
        };
        Self {
            gaussians,
            splats: SplatTensors::new(gaussians, device),
            normalisation,
            scales: channels.iter().map(scale).collect(),
        }
    }

    /// Adds a view with one map for each scale. `mask` has the camera's size. Only cells count whose centre is a pixel that it uses.
    ///
    /// # Errors
    /// [`Error::Argument`] when maps or mask do not match what this was made for; [`Error::NonFinite`] for maps with such
    /// values; as [`SplatView::blend_adjoint`].
    pub fn add(
        &mut self,
        camera: &Camera,
        maps: &[FeatureMap],
        mask: Option<&Mask>,
        settings: &Settings,
    ) -> Result<()> {
        self.check(maps)?;
        mask.map_or(Ok(()), |mask| {
            mask.expect_size("a view", camera.width, camera.height)
        })?;
        for (scale, map) in self.scales.iter_mut().zip(maps) {
            let cells = map.lattice().camera(camera);
            let mask = mask.map(|mask| mask_of_cells(mask, camera, &cells));
            let view = self.splats.seen_by(&cells, settings);
            let lifted = lifted(&view, map, mask.as_ref(), &self.splats.means.device())?;
            scale.sums = Some(match scale.sums.take() {
                Some(sums) => sums + lifted,
                None => lifted,
            });
            if self.normalisation == Normalisation::Count {
                let counts = disc_pixels(&view, self.gaussians, mask.as_ref(), settings)?;
                let sums = scale.counts.iter_mut().zip(counts);
                sums.for_each(|(sum, count)| *sum += u64::from(count));
            }
        }
        Ok(())
    }

    /// Checks that `maps` fit the sums.
    fn check(&self, maps: &[FeatureMap]) -> Result<()> {
        let channels: Vec<usize> = self.scales.iter().map(|scale| scale.channels).collect();
        let found: Vec<usize> = maps.iter().map(|m| m.channels).collect();
        ensure!(found == channels, argument "feature maps"; found "channels {found:?}";
            expected "{channels:?}, one map a scale"; help "reduce all views alike");
        for (scale, map) in (1..).zip(maps) {
            map.check(&format!("feature map of scale {scale}"))?;
            ensure!(map.cells() != 0, argument "feature map"; found "no cells"; expected "one or more";
                help "leave the view out");
        }
        Ok(())
    }

    /// Eq. 5 for each scale, `[N, channels]`, over the views of all [ranks]: the sums divided by the counter + [`EPSILON`] (`count`, as in
    /// the paper) or by the sum of weights (`weight`). With `weight` each feature is a weighted mean. Gaussians without any weight get
    /// zeros.
    ///
    /// # Errors
    /// [`Error::Device`] when the device does not return the sums.
    pub fn features(self) -> Result<Vec<Vec<f32>>> {
        let gaussians = self.gaussians.len();
        let scales = self.scales.into_iter();
        scales.map(|scale| scale.features(gaussians)).collect()
    }
}

impl Scale {
    fn features(mut self, gaussians: usize) -> Result<Vec<f32>> {
        let width = self.channels + 1;
        let mut sums = match self.sums {
            Some(sums) => read("unprojected features", sums)?,
            None => vec![0.0; gaussians * width],
        };
        ranks::sum(&mut sums);
        ranks::sum(&mut self.counts);
        let mut features = Vec::with_capacity(gaussians * self.channels);
        for (i, row) in sums.chunks_exact(width).enumerate() {
            let (sums, weight) = (&row[..self.channels], row[self.channels]);
            let divisor = self.counts.get(i).map_or(weight, |&n| n as f32 + EPSILON);
            let factor = if weight > 0.0 { divisor.recip() } else { 0.0 };
            features.extend(sums.iter().map(|sum| sum * factor));
        }
        Ok(features)
    }
}

/// `W^T F` and, in a last column, `W^T 1`, of the cells that `mask` uses, `[N, channels + 1]`. A block of channels at a time, so that no
/// image holds them all.
fn lifted(
    view: &SplatView,
    map: &FeatureMap,
    mask: Option<&Mask>,
    device: &Device,
) -> Result<Tensor<2>> {
    let Camera { width, height, .. } = *view.camera();
    let cells = upload(map.data.clone(), [map.cells(), map.channels], device);
    let used = |cell| mask.is_none_or(|mask| mask.uses(cell));
    let ones = (0..map.cells()).map(|cell| f32::from(u8::from(used(cell))));
    let ones: Tensor<2> = upload(ones.collect(), [map.cells(), 1], device);
    let cells = match mask {
        Some(_) => cells * ones.clone(),
        None => cells,
    };
    let cells = Tensor::cat(vec![cells, ones], 1);
    let blocks = view.channel_blocks(map.channels + 1).map(|block| {
        let channels = block.len();
        let part = cells.clone().slice([0..map.cells(), block]);
        view.blend_adjoint(part.reshape([height, width, channels]))
    });
    Ok(Tensor::cat(blocks.collect::<Result<Vec<_>>>()?, 1))
}

/// `mask`, of the pixels of `camera`, at the centres of the pixels of `cells`, the same camera at another size.
fn mask_of_cells(mask: &Mask, camera: &Camera, cells: &Camera) -> Mask {
    let axes = |c: &Camera| [(c.cx, c.fx, c.width), (c.cy, c.fy, c.height)];
    let (from, to) = (axes(cells), axes(camera));
    let pixel = |axis: usize, cell: usize| {
        let ((center, focal, _), (pixel_center, pixel_focal, pixels)) = (from[axis], to[axis]);
        let position = (cell as f64 + 0.5 - center) * pixel_focal / focal + pixel_center;
        (position.max(0.0) as usize).min(pixels.saturating_sub(1))
    };
    Mask::new(cells.width, cells.height, |i| {
        let [x, y] = [pixel(0, i % cells.width), pixel(1, i / cells.width)];
        mask.uses(y * camera.width + x)
    })
}

/// Pixels of `view` within the radius of each of `gaussians`, of those that `mask` uses, `[N]`. A device counts all pixels. With a mask
/// the CPU counts, and projects the view once more.
fn disc_pixels(
    view: &SplatView,
    gaussians: &Gaussians,
    mask: Option<&Mask>,
    settings: &Settings,
) -> Result<Vec<u32>> {
    match mask {
        Some(_) => {
            let projected = Projected::new(&gaussians.splats(), view.camera(), settings)?;
            Ok(projected.used_counts(mask))
        }
        None => view.disc_pixels(),
    }
}

/// Lifts `features` of `views` (the training views of this [rank](crate::ranks), in this order) onto `gaussians`, of the cells that
/// the views' masks use: features of each scale, `[N, D]`. The sums are made on `device`, and are those of all ranks. The features of a
/// view are dropped before the next ones are requested. Calls `advance` after each view.
///
/// # Errors
/// [`Error::Argument`] when views and features do not match, or a mask has a different size than its view; what
/// [`LiftedViews::add`] returns; those of `features` and `advance`.
pub fn unproject<'a, F: Borrow<ViewFeatures>>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    features: impl Iterator<Item = Result<F>>,
    normalisation: Normalisation,
    settings: &Settings,
    device: &Device,
    advance: &mut dyn FnMut() -> Result<()>,
) -> Result<Vec<Vec<f32>>> {
    let views: Vec<&View> = views.collect();
    let mut lifted: Option<LiftedViews<'_>> = None;
    let mut features = features;
    for (i, view) in views.iter().enumerate() {
        let Some(features) = features.next().transpose()? else {
            return Err(mismatch(format!("{} views", views.len()), i.to_string()));
        };
        let ViewFeatures { view: name, maps } = features.borrow();
        if view.name != *name {
            return Err(mismatch(view.name.clone(), name.clone()));
        }
        view.check_mask()?;
        let channels: Vec<usize> = maps.iter().map(|map| map.channels).collect();
        lifted
            .get_or_insert_with(|| LiftedViews::new(gaussians, &channels, normalisation, device))
            .add(&view.camera, maps, view.mask.as_ref(), settings)?;
        advance()?;
    }
    if features.next().is_some() {
        let expected = format!("{} or more", views.len() + 1);
        return Err(mismatch(format!("{} views", views.len()), expected));
    }
    let Some(lifted) = lifted else {
        return Err(mismatch("none".into(), "one or more".into()));
    };
    lifted.features()
}

fn mismatch(found: String, expected: String) -> Error {
    invalid!(argument "views of the unprojection"; found "{found}"; expected "{expected}";
        help "pass the views that features were extracted from")
}

/// Attendance pruning (Algorithm 1, line 12): which of `gaussians` are kept, `[N]`. A Gaussian must be counted on at least the share
/// `attendance` of all pixels of `views` that masks use, or on `attendance_pixels` where that is fewer. `views` are those of this
/// [rank](crate::ranks). The paper counts cells of the feature maps instead of pixels. Calls `advance` after each view.
///
/// # Errors
/// As [`Projected::new`]; [`Error::Config`] for a mask of a different size than its view; [`Error::Device`] where
/// a device does not return its counts; those of `advance`.
pub fn attended<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    config: &UnprojectionConfig,
    settings: &Settings,
    device: &Device,
    advance: &mut dyn FnMut() -> Result<()>,
) -> Result<Vec<bool>> {
    if gaussians.is_empty() {
        return Ok(Vec::new());
    }
    let splats = SplatTensors::new(gaussians, device);
    let mut counts = vec![0_u64; gaussians.len()];
    let mut pixels = [0_u64];
    for view in views {
        view.check_mask()?;
        let mask = view.mask.as_ref();
        let seen = splats.seen_by(&view.camera, settings);
        let counted = disc_pixels(&seen, gaussians, mask, settings)?;
        let sums = counts.iter_mut().zip(counted);
        sums.for_each(|(sum, count)| *sum += u64::from(count));
        pixels[0] += mask.map_or(view.camera.width * view.camera.height, Mask::kept) as u64;
        advance()?;
    }
    ranks::sum(&mut counts);
    ranks::sum(&mut pixels);
    let fewest = config.fewest_pixels(pixels[0]);
    Ok(counts.iter().map(|&count| count as f64 >= fewest).collect())
}
