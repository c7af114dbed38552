//! The vote: each Gaussian takes the class with the largest summed alpha' T over the raw labels of the training views.
//!
//! This is the closed-form baseline that a trained decoder has to beat (FlashSplat solves the same table as a linear
//! programme). The table itself also says how contested a Gaussian is.

mod device;

use super::Identities;
use crate::backend::device::renders_on;
use crate::data::{Classes, View};
use crate::error::Result;
use crate::metrics::Agreement;
use crate::raster::{Projected, Settings};
use crate::splat::Gaussians;
use burn::tensor::Device;
use device::DeviceVotes;
use rayon::prelude::*;

/// Classes of one view that are lifted together on the host: the image of 1600 x 1200 pixels takes 246 MB then.
const CLASSES_AT_ONCE: usize = 32;

/// Summed weights of each class on each Gaussian.
#[derive(Clone, Debug, PartialEq)]
pub struct Votes {
    /// `[N, C]` row-major: sum over labelled training pixels of alpha' T where the label is class c.
    pub table: Vec<f32>,
    /// C.
    pub classes: usize,
}

/// Collects the votes of all `views` that have raw labels. Where `device` is a GPU, which holds the table then, they are lifted on it.
///
/// # Errors
/// [`crate::Error::NonFinite`] when a Gaussian's parameters are not finite; on a GPU those of
/// [`crate::raster::SplatView::blend_adjoint`].
pub fn vote<'a>(
    gaussians: &Gaussians,
    views: impl Iterator<Item = &'a View>,
    classes: &Classes,
    settings: &Settings,
    device: &Device,
) -> Result<Votes> {
    let (n, c) = (gaussians.len(), classes.len());
    let lookup = classes.lookup();
    let mut on_device = match n * c > 0 && renders_on(device) {
        true => Some(DeviceVotes::new(gaussians, c, settings, device)),
        false => None,
    };
    let mut table = vec![0.0_f32; if on_device.is_some() { 0 } else { n * c }];
    for view in views {
        let Some(raw) = &view.raw else { continue };
        let mut labels = raw.map();
        labels
            .ids
            .iter_mut()
            .for_each(|id| *id = lookup[usize::from(*id)]);
        // Of the classes that the view shows alone, so that neither time nor memory grows with those of the whole scene.
        let mut shown: Vec<u16> = labels.ids.clone();
        shown.sort_unstable();
        shown.dedup();
        shown.retain(|&class| usize::from(class) < c);
        if let Some(votes) = &mut on_device {
            votes.add(&view.camera, &labels.ids, &shown)?;
            continue;
        }
        let projected = Projected::new(&gaussians.splats(), &view.camera, settings)?;
        for block in shown.chunks(CLASSES_AT_ONCE) {
            let weights = projected.blend_adjoint(&one_hot(&labels.ids, block), block.len());
            let rows = table
                .par_chunks_exact_mut(c)
                .zip(weights.par_chunks_exact(block.len()));
            rows.for_each(|(row, weights)| {
                block
                    .iter()
                    .zip(weights)
                    .for_each(|(&class, weight)| row[usize::from(class)] += weight);
            });
        }
    }
    match on_device {
        Some(votes) => votes.read(),
        None => Ok(Votes { table, classes: c }),
    }
}

/// 1 where the pixel's label is the class of the channel, 0 elsewhere, `[pixels, classes]`.
fn one_hot(labels: &[u16], classes: &[u16]) -> Vec<f32> {
    let width = classes.len();
    let mut image = vec![0.0; labels.len() * width];
    image
        .par_chunks_exact_mut(width.max(1))
        .zip(labels)
        .for_each(|(pixel, label)| {
            if let Ok(channel) = classes.binary_search(label) {
                pixel[channel] = 1.0;
            }
        });
    image
}

impl Votes {
    /// Class index of each Gaussian's largest vote; `None` where nothing was voted. Ties go to the lower index.
    pub fn winners(&self) -> Vec<Option<u16>> {
        self.table
            .chunks_exact(self.classes.max(1))
            .map(|row| {
                let mut best = (0, 0.0);
                for (c, &v) in row.iter().enumerate() {
                    if v > best.1 {
                        best = (c, v);
                    }
                }
                (best.1 > 0.0).then_some(best.0 as u16)
            })
            .collect()
    }

    /// One-hot identities of the winners; zero where nothing was voted.
    pub fn identities(&self) -> Identities {
        let mut scores = vec![0.0; self.table.len()];
        for (row, winner) in scores
            .chunks_exact_mut(self.classes.max(1))
            .zip(self.winners())
        {
            if let Some(c) = winner {
                row[usize::from(c)] = 1.0;
            }
        }
        Identities {
            scores,
            classes: self.classes,
        }
    }

    /// Logarithms of the shares of each Gaussian's votes, `[N, C]`, every share raised by `floor`: what the votes say to a
    /// softmax. Equal in all classes where nothing was voted.
    pub fn log_shares(&self, floor: f32) -> Vec<f32> {
        let rows = self.table.chunks_exact(self.classes.max(1));
        let shares = rows.flat_map(|row| {
            let total = row.iter().sum::<f32>().max(f32::MIN_POSITIVE);
            row.iter().map(move |v| (v / total + floor).ln())
        });
        shares.collect()
    }

    /// How far the views agree, over all Gaussians with votes; zeros when there are none.
    pub fn agreement(&self) -> Agreement {
        let rows = self
            .table
            .chunks_exact(self.classes.max(1))
            .zip(self.entropy());
        let (mut voted, mut entropy, mut contested) = (0_u64, 0.0, 0_u64);
        for (row, of_row) in rows {
            let (sum, most) = row
                .iter()
                .fold((0.0, 0.0_f32), |(sum, most), &v| (sum + v, most.max(v)));
            if sum > 0.0 {
                voted += 1;
                entropy += f64::from(of_row);
                contested += u64::from(3.0 * most < 2.0 * sum);
            }
        }
        let count = voted.max(1) as f64;
        Agreement {
            entropy: entropy / count,
            contested: contested as f64 / count,
        }
    }

    /// Shannon entropy (nats) of each Gaussian's votes: 0 where all views agree or nothing was voted.
    pub fn entropy(&self) -> Vec<f32> {
        self.table
            .chunks_exact(self.classes.max(1))
            .map(|row| {
                let sum: f32 = row.iter().sum();
                row.iter()
                    .filter(|v| **v > 0.0)
                    .map(|v| -(v / sum) * (v / sum).ln())
                    .sum()
            })
            .collect()
    }
}
