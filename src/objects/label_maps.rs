//! Label maps rendered from identities.

use super::Identities;
use crate::backend::device::{read, upload};
use crate::config::LabelSource;
use crate::data::{Classes, LabelMap};
use crate::error::Result;
use crate::raster::{GaussianLabels, Largest, SplatView};
use burn::tensor::Tensor;
use std::sync::OnceLock;

/// Identities as they are rendered, made once for any number of views.
#[derive(Clone, Debug)]
pub struct LabelMaps<'a> {
    blended: Blended<'a>,
    classes: &'a Classes,
    min_coverage: f32,
}

#[derive(Clone, Debug)]
enum Blended<'a> {
    /// 1 more than the class index of each Gaussian; 0 where nothing is known, which competes as a label of its own.
    Labels(GaussianLabels),
    /// The scores, and their tensor `[N, C]`, made at first use.
    Scores(&'a Identities, OnceLock<Tensor<2>>),
}

impl<'a> LabelMaps<'a> {
    /// The maps of `identities` over `classes`. `source` says what is blended. Pixels covered by less than `min_coverage` (1 - T)
    /// show nothing.
    pub fn new(
        identities: &'a Identities,
        classes: &'a Classes,
        source: LabelSource,
        min_coverage: f32,
    ) -> Self {
        match source {
            LabelSource::Labels => Self::of_labels(identities.labels(), classes, min_coverage),
            LabelSource::Scores => Self {
                blended: Blended::Scores(identities, OnceLock::new()),
                classes,
                min_coverage,
            },
        }
    }

    /// The maps of one class index for each Gaussian, `None` where nothing is known. The rest is as in [`Self::new`].
    pub fn of_labels(labels: Vec<Option<u16>>, classes: &'a Classes, min_coverage: f32) -> Self {
        let label = |class: Option<u16>| class.map_or(0, |c| c + 1);
        let labels = labels.into_iter().map(label).collect();
        Self {
            blended: Blended::Labels(GaussianLabels::new(labels)),
            classes,
            min_coverage,
        }
    }

    /// What `view` shows of the identities: at each pixel the class with the largest blended score (`argmax` of Eq. 3), or the
    /// class whose Gaussians have the largest summed alpha' T.
    ///
    /// Pixels that are barely covered, or where nothing is known of the Gaussians that have most of the pixel, take the ignored
    /// id. All views must be of Gaussians on one device.
    ///
    /// # Errors
    /// As [`SplatView::blend`]; [`crate::Error::Device`] when the device does not return the map.
    ///
    /// # Panics
    /// If the identities are of another number of Gaussians.
    pub fn of(&self, view: &SplatView) -> Result<LabelMap> {
        let (width, height) = (view.camera().width, view.camera().height);
        let (found, transmittance) = match &self.blended {
            Blended::Labels(labels) => {
                let pixels = view.blend_labels(None, labels)?;
                let class = |label: u16| label.checked_sub(1);
                let classes: Vec<_> = pixels.labels.into_iter().map(class).collect();
                (classes, pixels.transmittance)
            }
            Blended::Scores(identities, tensor) => largest_scores(view, identities, tensor)?,
        };
        let id = |(class, t): (Option<u16>, f32)| {
            class
                .filter(|_| 1.0 - t >= self.min_coverage)
                .and_then(|c| self.classes.entries.get(usize::from(c)))
                .map_or(self.classes.ignore, |class| class.id)
        };
        Ok(LabelMap {
            width,
            height,
            ids: found.into_iter().zip(transmittance).map(id).collect(),
        })
    }
}

/// The class with the largest blended score at each pixel, `None` where all are equal, and the transmittance.
fn largest_scores(
    view: &SplatView,
    identities: &Identities,
    tensor: &OnceLock<Tensor<2>>,
) -> Result<(Vec<Option<u16>>, Vec<f32>)> {
    let n = view.splats().len();
    let classes = identities.classes;
    let pixels = view.camera().width * view.camera().height;
    let scores =
        tensor.get_or_init(|| upload(identities.scores.clone(), [n, classes], &view.device()));
    // The least and the largest blended score.
    let mut found: Option<(Tensor<3>, Largest)> = None;
    let mut transmittance = None;
    for block in view.channel_blocks(if n > 0 { classes } else { 0 }) {
        let first = block.start as f64;
        let (image, t) = view.blend(scores.clone().slice([0..n, block]))?;
        transmittance.get_or_insert(t);
        let least = image.clone().min_dim(2);
        let largest = Largest::of(image, first);
        found = Some(match found {
            Some((other, best)) => (other.min_pair(least), best.or(largest)),
            None => (least, largest),
        });
    }
    let (Some((least, Largest { value, index })), Some(transmittance)) = (found, transmittance)
    else {
        return Ok((vec![None; pixels], vec![1.0; pixels]));
    };
    // A single class has no other to differ from.
    let index = if classes > 1 {
        index.mask_fill(value.lower_equal(least), -1.0)
    } else {
        index
    };
    let parts = vec![index.reshape([pixels]), transmittance.reshape([pixels])];
    let mut index = read("a label map", Tensor::<1>::cat(parts, 0))?;
    let transmittance = index.split_off(pixels);
    let class = |(index, &t): (f32, &f32)| (index >= 0.0 && t < 1.0).then_some(index as u16);
    let classes = index.into_iter().zip(&transmittance).map(class).collect();
    Ok((classes, transmittance))
}
