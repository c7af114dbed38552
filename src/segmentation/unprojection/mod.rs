//! Lifting 2D feature maps onto the Gaussians (Eq. 5, Algorithm 1): the adjoint of rendering them.
//!
//! With the blending weights `W` of a view and its map `F`, the buffer is the sum over views of `W^T F`. At `image`
//! resolution `F` is read bilinearly, `U F`, and the buffer is `(W U)^T F`: the exact adjoint of rendering at image
//! resolution and comparing with `U F`. At `feature` resolution (the paper) the camera is scaled to the map, and `U` is
//! the identity.

mod attendance;
mod device;
mod fold;
mod view;

pub use self::attendance::attended;

use crate::backend::Real;
use crate::backend::device::in_host_memory;
use crate::config::{Normalisation, Resolution, UnprojectionConfig};
use crate::data::View;
use crate::data::mask::Mask;
use crate::error::{Error, Result};
use crate::features::{FeatureMap, FeatureSet, Lattice, SCALES, ViewFeatures};
use crate::raster::{Settings, SplatTensors, Splats};
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::Device;
use device::DeviceSums;
use std::borrow::Borrow;
use std::convert::Infallible;
use std::ops::ControlFlow;

/// Added to the counter before dividing (Algorithm 1).
pub const EPSILON: f64 = 1e-6;

/// Sums over the views added so far, per Gaussian and scale.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sums<E> {
    /// `sum_v (W U)^T F_v` per scale, `[N, channels]`.
    pub buffers: Vec<Vec<E>>,
    /// Channels per scale.
    pub channels: Vec<usize>,
    /// `sum_v W^T 1` per scale, `[N]`: at `image` resolution the same at every scale.
    pub weights: Vec<Vec<E>>,
    /// Algorithm 1's counter per scale, `[N]`: pixels (at `feature` resolution: cells) whose centre lies within the radius,
    /// those that masks leave out not counted: they add nothing to the buffers either.
    pub counts: Vec<Vec<u64>>,
    /// Pixels (cells) of all views per scale that masks do not leave out, without masks `sum_v H_v W_v`.
    pub pixels: Vec<u64>,
}

impl<E: Real> Sums<E> {
    /// Of no views yet, for `n` Gaussians and one entry of `channels` per scale.
    pub fn new(n: usize, channels: &[usize]) -> Self {
        Self {
            buffers: channels.iter().map(|c| vec![E::zero(); n * c]).collect(),
            channels: channels.to_vec(),
            weights: vec![vec![E::zero(); n]; channels.len()],
            counts: vec![vec![0; n]; channels.len()],
            pixels: vec![0; channels.len()],
        }
    }

    /// Adds a view with one map per scale.
    ///
    /// Results do not depend on the number of threads. Memory beside the sums: the view's contributing pairs folded to
    /// (Gaussian, cell) weights, and nothing per pixel and channel.
    ///
    /// # Errors
    /// [`Error::Argument`] when maps or Gaussians do not match what this was made for; [`Error::NonFinite`] for maps with
    /// such values; what [`crate::raster::Projected::new`] returns.
    pub fn add(
        &mut self,
        splats: &Splats<'_, E>,
        camera: &Camera,
        maps: &[FeatureMap],
        resolution: Resolution,
        settings: &Settings,
    ) -> Result<()> {
        self.add_used(splats, camera, maps, None, resolution, settings)
    }

    /// [`Sums::add`] of the pixels that `mask`, of the camera's size, uses; at `feature` resolution of the cells whose centre
    /// is such a pixel. Counts are of these pixels, or cells, too.
    ///
    /// # Errors
    /// As [`Sums::add`]; [`Error::Argument`] for a mask of another size.
    pub fn add_used(
        &mut self,
        splats: &Splats<'_, E>,
        camera: &Camera,
        maps: &[FeatureMap],
        mask: Option<&Mask>,
        resolution: Resolution,
        settings: &Settings,
    ) -> Result<()> {
        check(
            self.counts.first().map_or(splats.len(), Vec::len),
            &self.channels,
            splats.len(),
            maps,
        )?;
        mask.map_or(Ok(()), |mask| {
            mask.expect_size("a view", camera.width, camera.height)
        })?;
        // Scales on one grid share the projection and the scalar weights.
        let mut grids: Vec<(Lattice, Vec<usize>)> = Vec::new();
        for (scale, map) in maps.iter().enumerate() {
            let lattice = map.lattice();
            match grids.iter_mut().find(|(of, _)| *of == lattice) {
                Some((_, scales)) => scales.push(scale),
                None => grids.push((lattice, vec![scale])),
            }
        }
        match resolution {
            Resolution::Image => view::add(self, splats, camera, maps, mask, &grids, settings),
            Resolution::Feature => grids.iter().try_for_each(|grid| {
                // Cells are the pixels of the scaled camera.
                let pixels = (
                    Lattice {
                        steps: None,
                        ..grid.0
                    },
                    grid.1.clone(),
                );
                let cells = grid.0.camera(camera);
                let mask = mask.map(|mask| of_cells(mask, camera, &cells));
                view::add(
                    self,
                    splats,
                    &cells,
                    maps,
                    mask.as_ref(),
                    &[pixels],
                    settings,
                )
            }),
        }
    }

    /// The buffers divided: by the counter + [`EPSILON`] (Eq. 5) or by the sum of weights, which makes each feature a
    /// weighted mean. Gaussians without any weight get zeros.
    pub fn normalised(mut self, normalisation: Normalisation) -> Self {
        for (scale, buffer) in self.buffers.iter_mut().enumerate() {
            let divisors = self.weights[scale].iter().zip(&self.counts[scale]);
            for (row, (&weight, &count)) in buffer
                .chunks_exact_mut(self.channels[scale].max(1))
                .zip(divisors)
            {
                let divisor = match normalisation {
                    Normalisation::Count => E::of(count as f64 + EPSILON),
                    Normalisation::Weight => weight,
                };
                let factor = if weight > E::zero() {
                    divisor.recip()
                } else {
                    E::zero()
                };
                for x in row {
                    *x *= factor;
                }
            }
        }
        self
    }

    /// Gaussians counted on at least the share `attendance` of all used pixels of the finest scale's views (Algorithm 1), or
    /// on `attendance_pixels` where that is fewer.
    pub fn attended(&self, config: &UnprojectionConfig) -> Vec<bool> {
        match (self.counts.first(), self.pixels.first()) {
            (Some(counts), Some(&pixels)) => {
                let fewest = config.fewest_pixels(pixels);
                counts.iter().map(|&c| c as f64 >= fewest).collect()
            }
            _ => Vec::new(),
        }
    }
}

/// `mask` of the pixels of `camera` for those of `cells`, the same camera with other pixels: what holds at their centres.
fn of_cells(mask: &Mask, camera: &Camera, cells: &Camera) -> Mask {
    let pixel = |cell: usize,
                 [center, focal]: [f64; 2],
                 [pixel_center, pixel_focal]: [f64; 2],
                 pixels: usize| {
        let place = (cell as f64 + 0.5 - center) * pixel_focal / focal + pixel_center;
        (place.max(0.0) as usize).min(pixels.saturating_sub(1))
    };
    Mask::new(cells.width, cells.height, |i| {
        let (x, y) = (i % cells.width, i / cells.width);
        let x = pixel(
            x,
            [cells.cx, cells.fx],
            [camera.cx, camera.fx],
            camera.width,
        );
        let y = pixel(
            y,
            [cells.cy, cells.fy],
            [camera.cy, camera.fy],
            camera.height,
        );
        mask.uses(y * camera.width + x)
    })
}

/// Whether sums over `n` Gaussians and maps of `channels` can take up `maps` of `gaussians`.
fn check(n: usize, channels: &[usize], gaussians: usize, maps: &[FeatureMap]) -> Result<()> {
    let found: Vec<usize> = maps.iter().map(|m| m.channels).collect();
    if found != channels {
        return Err(Error::argument(
            "feature maps",
            format!("channels {found:?}"),
            format!("{channels:?}, one map a scale"),
            "reduce all views alike",
        ));
    }
    if gaussians != n {
        let (found, expected) = (format!("{gaussians} Gaussians"), format!("{n}"));
        return Err(Error::argument(
            "unprojection",
            found,
            expected,
            "make new sums for another scene",
        ));
    }
    for (scale, map) in maps.iter().enumerate() {
        map.check(&format!("feature map of scale {}", scale + 1))?;
        if map.cells() == 0 {
            return Err(Error::argument(
                "feature map",
                "no cells",
                "one or more",
                "leave the view out",
            ));
        }
    }
    Ok(())
}

/// [`Sums`] in the making, on the host or on a GPU.
pub struct Lifting<'a> {
    gaussians: &'a Gaussians,
    place: Place,
}

enum Place {
    Host(Sums<f32>),
    Device(Box<DeviceSums>),
}

impl<'a> Lifting<'a> {
    /// Of no views yet, for one entry of `channels` per scale, where `device` says.
    pub fn new(gaussians: &'a Gaussians, channels: &[usize], device: &Device) -> Self {
        // Without a Gaussian there is nothing for a device to do.
        let place = if in_host_memory(device) || gaussians.is_empty() {
            Place::Host(Sums::new(gaussians.len(), channels))
        } else {
            Place::Device(Box::new(DeviceSums::new(
                SplatTensors::new(gaussians, device),
                channels,
            )))
        };
        Self { gaussians, place }
    }

    /// Adds a view with one map per scale, of the pixels that `mask` uses, as [`Sums::add_used`] does.
    ///
    /// # Errors
    /// As [`Sums::add`]; on a GPU as [`crate::raster::SplatView::blend_adjoint`].
    pub fn add(
        &mut self,
        camera: &Camera,
        maps: &[FeatureMap],
        mask: Option<&Mask>,
        resolution: Resolution,
        settings: &Settings,
    ) -> Result<()> {
        match &mut self.place {
            Place::Host(sums) => sums.add_used(
                &self.gaussians.splats(),
                camera,
                maps,
                mask,
                resolution,
                settings,
            ),
            Place::Device(sums) => sums.add(
                &self.gaussians.splats(),
                camera,
                maps,
                mask,
                resolution,
                settings,
            ),
        }
    }

    /// The sums, on the host.
    ///
    /// # Errors
    /// [`Error::Device`] when a device does not give them back.
    pub fn finish(self) -> Result<Sums<f32>> {
        match self.place {
            Place::Host(sums) => Ok(sums),
            Place::Device(sums) => sums.into_sums(),
        }
    }
}

/// Features of every Gaussian.
#[derive(Clone, Debug, PartialEq)]
pub struct Unprojected {
    /// Per scale `[N, channels]`; zeros for Gaussians that no view sees.
    pub features: [Vec<f32>; SCALES],
    /// Sum of alpha' T over all views per scale, `[N]`.
    pub weights: [Vec<f32>; SCALES],
    /// Algorithm 1's counter per scale, `[N]`.
    pub counts: [Vec<u64>; SCALES],
    /// Whether attendance pruning keeps the Gaussian, `[N]`.
    pub keep: Vec<bool>,
    /// Whether the Gaussian has weight in some view at every scale, `[N]`.
    pub seen: Vec<bool>,
}

impl Unprojected {
    /// Share of the Gaussians that attendance pruning removes, 0..1.
    pub fn pruned_share(&self) -> f64 {
        self.keep.iter().filter(|k| !**k).count() as f64 / self.keep.len().max(1) as f64
    }
}

/// Lifts the features `set` of `views` (the training views, in the order of the set) onto `gaussians`, of the pixels that the
/// views' masks use. Where `device` is a GPU, the sums are made on it.
///
/// # Errors
/// [`Error::Argument`] when views and features do not match, or a mask has another size than its view; what [`Sums::add`]
/// returns.
pub fn unproject<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    set: &FeatureSet,
    config: &UnprojectionConfig,
    settings: &Settings,
    device: &Device,
) -> Result<Unprojected> {
    let features = set.views.iter().map(Ok);
    let go_on = &mut || ControlFlow::<Infallible>::Continue(());
    let ControlFlow::Continue(lifted) =
        unproject_each(gaussians, views, features, config, settings, device, go_on)?;
    Ok(lifted)
}

/// [`unproject`] with features that need not be in memory together: each view's are let go before the next are asked for.
/// Calls `looked` after each view, and stops where that breaks.
///
/// # Errors
/// As [`unproject`]; those of `features`.
pub fn unproject_each<'a, F: Borrow<ViewFeatures>, B>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    features: impl Iterator<Item = Result<F>>,
    config: &UnprojectionConfig,
    settings: &Settings,
    device: &Device,
    looked: &mut dyn FnMut() -> ControlFlow<B>,
) -> Result<ControlFlow<B, Unprojected>> {
    let (views, mut features): (Vec<&View>, _) = (views.collect(), features);
    let mismatch = |found: String, expected: String| {
        Error::argument(
            "views of the unprojection",
            found,
            expected,
            "pass the views that features were extracted from",
        )
    };
    let mut sums: Option<Lifting<'_>> = None;
    for (i, view) in views.iter().enumerate() {
        let Some(features) = features.next().transpose()? else {
            return Err(mismatch(format!("{} views", views.len()), i.to_string()));
        };
        let ViewFeatures { view: name, maps } = features.borrow();
        if view.name != *name {
            return Err(mismatch(view.name.clone(), name.clone()));
        }
        let (width, height) = (view.camera.width, view.camera.height);
        view.mask
            .iter()
            .try_for_each(|mask| mask.expect_size(&format!("view {name}"), width, height))?;
        let channels = maps.each_ref().map(|m| m.channels);
        let sums = sums.get_or_insert_with(|| Lifting::new(gaussians, &channels, device));
        sums.add(
            &view.camera,
            maps,
            view.mask.as_ref(),
            config.resolution,
            settings,
        )?;
        if let ControlFlow::Break(told) = looked() {
            return Ok(ControlFlow::Break(told));
        }
    }
    if features.next().is_some() {
        return Err(mismatch(
            format!("{} views", views.len()),
            format!("{} or more", views.len() + 1),
        ));
    }
    let sums = sums.map_or_else(
        || Ok(Sums::new(gaussians.len(), &[0; SCALES])),
        Lifting::finish,
    )?;
    let keep = sums.attended(config);
    let sums = sums.normalised(config.normalisation);
    let seen = (0..gaussians.len())
        .map(|i| sums.weights.iter().all(|w| w[i] > 0.0))
        .collect();
    let scales = |all: Vec<Vec<f32>>| -> [Vec<f32>; SCALES] {
        let mut all = all.into_iter();
        std::array::from_fn(|_| all.next().unwrap_or_default()) // there are SCALES of them
    };
    let mut counts = sums.counts.into_iter();
    let unprojected = Unprojected {
        features: scales(sums.buffers),
        weights: scales(sums.weights),
        counts: std::array::from_fn(|_| counts.next().unwrap_or_default()),
        keep,
        seen,
    };
    let unseen = unprojected.seen.iter().filter(|s| !**s).count();
    tracing::info!(
        "unprojection: attendance pruning removes {:.2} % of {} Gaussians; {unseen} are seen by no view",
        100.0 * unprojected.pruned_share(),
        gaussians.len()
    );
    Ok(ControlFlow::Continue(unprojected))
}
