//! Lifting 2D feature maps onto the Gaussians (Eq. 5, Algorithm 1): the adjoint of rendering them.
//!
//! ```text
//!           sum_v sum_p alpha'_i(p) T_i(p) F_n(p)
//! f_n,i  =  -------------------------------------     (Eq. 5)
//!                   sum_v |p_v| + eps
//! ```
//!
//! f_n,i is the feature of Gaussian i at scale n. The sums run over the training views v and their pixels p; F_n is the feature map
//! of the view, and |p_v| the number of its pixels within the radius of the Gaussian. [`LiftedViews::add`] adds a view to the
//! numerator and to the denominator, and [`Sums::normalised`] divides.
//!
//! With the blending weights `W` of a view and its map `F`, the buffer is the sum over views of `W^T F`. At `feature` resolution
//! (the paper) the camera is scaled to the map. At `image` resolution `F` is read bilinearly, `U F`, and the buffer is
//! `(W U)^T F`: the exact adjoint of rendering at image resolution and comparing with `U F`.
//!
//! | Algorithm 1 | here |
//! |---|---|
//! | lines 2 to 11: buffer and counter over all views | `lift_view` ([`LiftedViews::add`], [`Sums::add`]) |
//! | line 12: attendance pruning | [`Sums::attended`] |
//! | line 13, Eq. 5: features | [`Sums::normalised`] |

mod lift_view;

pub use self::lift_view::{LiftedViews, Sums};

use crate::backend::Real;
use crate::config::{Normalisation, UnprojectionConfig};
use crate::data::View;
use crate::error::{Error, Result, invalid};
use crate::features::{SCALES, ViewFeatures};
use crate::ranks;
use crate::raster::Settings;
use crate::splat::Gaussians;
use burn::tensor::Device;
use std::borrow::Borrow;

/// Added to the counter before dividing (Algorithm 1).
pub const EPSILON: f64 = 1e-6;

impl<E: Real> Sums<E> {
    /// Eq. 5: the buffers divided by the counter + [`EPSILON`] (`count`, as in the paper) or by the sum of weights (`weight`). With
    /// `weight` each feature is a weighted mean. Gaussians without any weight get zeros.
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

    /// Attendance pruning: whether each Gaussian is kept. It must be counted on at least the share `attendance` of all used pixels
    /// of the finest scale's views (Algorithm 1), or on `attendance_pixels` where that is fewer.
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

impl Sums<f32> {
    /// Adds the views of the other ranks.
    fn add_other_ranks(&mut self) {
        let buffers = self.buffers.iter_mut().chain(&mut self.weights);
        buffers.for_each(|values| ranks::sum(values));
        self.counts.iter_mut().for_each(|counts| ranks::sum(counts));
        ranks::sum(&mut self.pixels);
    }
}

/// Features of every Gaussian.
#[derive(Clone, Debug, PartialEq)]
pub struct Unprojected {
    /// The sums of all views. The buffers are divided: they are the features, zeros for Gaussians that no view sees.
    pub sums: Sums<f32>,
    /// Whether attendance pruning keeps the Gaussian, `[N]`.
    pub keep: Vec<bool>,
}

/// Lifts `features` of `views` (the training views of this [rank](crate::ranks), in this order) onto `gaussians`, of the pixels that
/// the views' masks use. The sums are made on `device`, and are those of all ranks. The features of a view are dropped before the
/// next ones are requested. Calls `advance` after each view.
///
/// # Errors
/// [`Error::Argument`] when views and features do not match, or a mask has a different size than its view; what [`Sums::add`]
/// returns; those of `features` and `advance`.
pub fn unproject<'a, F: Borrow<ViewFeatures>>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    features: impl Iterator<Item = Result<F>>,
    config: &UnprojectionConfig,
    settings: &Settings,
    device: &Device,
    advance: &mut dyn FnMut() -> Result<()>,
) -> Result<Unprojected> {
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
        let mask = view.mask.as_ref();
        lifted
            .get_or_insert_with(|| LiftedViews::new(gaussians, &channels, device))
            .add(&view.camera, maps, mask, config.resolution, settings)?;
        advance()?;
    }
    if features.next().is_some() {
        let expected = format!("{} or more", views.len() + 1);
        return Err(mismatch(format!("{} views", views.len()), expected));
    }
    let mut sums = match lifted {
        Some(lifted) => lifted.finish()?,
        None => Sums::new(gaussians.len(), &[0; SCALES]),
    };
    sums.add_other_ranks();
    Ok(Unprojected::new(sums, config))
}

fn mismatch(found: String, expected: String) -> Error {
    invalid!(argument "views of the unprojection"; found "{found}"; expected "{expected}";
        help "pass the views that features were extracted from")
}

impl Unprojected {
    /// Attendance pruning and features (Algorithm 1, lines 12 and 13).
    fn new(sums: Sums<f32>, config: &UnprojectionConfig) -> Self {
        let keep = sums.attended(config);
        let sums = sums.normalised(config.normalisation);
        let n = keep.len();
        let pruned = keep.iter().filter(|keep| !**keep).count();
        let is_unseen = |i: &usize| sums.weights.iter().any(|weights| weights[*i] <= 0.0);
        let unseen = (0..n).filter(is_unseen).count();
        tracing::info!(
            "unprojection: attendance pruning removes {:.2} % of {n} Gaussians; {unseen} are seen by no view",
            100.0 * pruned as f64 / n.max(1) as f64,
        );
        Self { sums, keep }
    }
}

/// Attendance pruning without features: which of `gaussians` are kept, `[N]`. These are the Gaussians that [`unproject`] keeps at
/// `image` resolution, for any features of `views`, those of this [rank](crate::ranks). At `feature` resolution the counted cells
/// are those of the maps, which this does not know. Calls `advance` after each view.
///
/// # Errors
/// As [`crate::raster::Projected::new`]; [`Error::Config`] for a mask of a different size than its view; [`Error::Device`] where
/// a device does not return its counts; those of `advance`.
pub fn attended<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    config: &UnprojectionConfig,
    settings: &Settings,
    device: &Device,
    advance: &mut dyn FnMut() -> Result<()>,
) -> Result<Vec<bool>> {
    if gaussians.is_empty() || config.attendance == 0.0 {
        return Ok(vec![true; gaussians.len()]);
    }
    let lifted = LiftedViews::new(gaussians, &[], device);
    let mut sums = Sums::<f32>::new(gaussians.len(), &[0]);
    for view in views {
        view.check_mask()?;
        let (counts, pixels) = lifted.disc_pixels(&view.camera, view.mask.as_ref(), settings)?;
        sums.counts[0]
            .iter_mut()
            .zip(counts)
            .for_each(|(sum, count)| *sum += count);
        sums.pixels[0] += pixels;
        advance()?;
    }
    sums.add_other_ranks();
    Ok(sums.attended(config))
}
