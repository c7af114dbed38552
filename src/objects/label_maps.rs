//! Label maps rendered from identities.

use super::device_labels::{DeviceLabels, larger_of, largest_of};
use super::identities::largest;
use super::{Identities, hard_label_map};
use crate::backend::device::read;
use crate::config::{LabelSource, SegmentationConfig};
use crate::data::{Classes, LabelMap};
use crate::error::Result;
use crate::raster::{Projected, SplatView};
use burn::tensor::{Device, Tensor, TensorData};

/// How label maps are rendered from identities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelRule {
    /// What is blended.
    pub source: LabelSource,
    /// Pixels covered by less (1 - T) show nothing.
    pub min_coverage: f32,
}

impl From<&SegmentationConfig> for LabelRule {
    fn from(config: &SegmentationConfig) -> Self {
        Self {
            source: config.render,
            min_coverage: config.min_coverage as f32,
        }
    }
}

/// Renders identities: at each pixel the class with the largest blended score (`argmax` of Eq. 3), or by [`hard_label_map`] the
/// class whose Gaussians have the largest summed alpha' T. [`LabelMaps`] of one view.
///
/// Pixels that are barely covered, or where nothing is known (of Gaussians that have most of the pixel), take the ignored id.
pub fn label_map(
    projected: &Projected<f32>,
    identities: &Identities,
    classes: &Classes,
    rule: &LabelRule,
) -> LabelMap {
    LabelMaps::new(identities, classes, *rule).of(projected)
}

/// Identities as they are rendered by a rule, made once for any number of views.
#[derive(Clone, Debug)]
pub struct LabelMaps<'a> {
    blended: Blended<'a>,
    classes: &'a Classes,
    min_coverage: f32,
}

#[derive(Clone, Debug)]
enum Blended<'a> {
    /// 1 more than the class index of each Gaussian. 0 is what nothing is known of; it competes as in [`hard_label_map`].
    Labels(Vec<u16>),
    Scores(&'a Identities),
}

impl<'a> LabelMaps<'a> {
    /// Of `identities` over `classes` by `rule`.
    pub fn new(identities: &'a Identities, classes: &'a Classes, rule: LabelRule) -> Self {
        let blended = match rule.source {
            LabelSource::Labels => Blended::Labels(
                identities
                    .labels()
                    .into_iter()
                    .map(|class| class.map_or(0, |c| c + 1))
                    .collect(),
            ),
            LabelSource::Scores => Blended::Scores(identities),
        };
        Self {
            blended,
            classes,
            min_coverage: rule.min_coverage,
        }
    }

    /// What `projected` shows of them, as [`label_map`].
    ///
    /// # Panics
    /// If the identities are of another number of Gaussians.
    pub fn of(&self, projected: &Projected<f32>) -> LabelMap {
        let id = |class: Option<u16>| self.id(class);
        match &self.blended {
            Blended::Labels(labels) => {
                let mut map = hard_label_map(projected, labels, self.min_coverage);
                map.ids
                    .iter_mut()
                    .for_each(|label| *label = id(label.checked_sub(1)));
                map
            }
            Blended::Scores(Identities { scores, classes }) => {
                let blended = projected.blend(scores, *classes);
                let [width, height] = projected.size();
                let pixels = blended
                    .image
                    .chunks_exact((*classes).max(1))
                    .zip(&blended.transmittance);
                let class = |(row, t): (&[f32], &f32)| {
                    if 1.0 - t >= self.min_coverage {
                        largest(row)
                    } else {
                        None
                    }
                };
                LabelMap {
                    width,
                    height,
                    ids: pixels.map(|pixel| id(class(pixel))).collect(),
                }
            }
        }
    }

    /// The same on a GPU, whose memory they go to: 4 bytes a Gaussian and class of scores; of labels 4 a Gaussian, and as many for
    /// each label that is blended together with others, 1 GiB at most.
    pub fn on(&self, device: &Device) -> DeviceLabelMaps<'_> {
        let device = device.clone().inner();
        let blended = match &self.blended {
            Blended::Labels(labels) => {
                OnDevice::Labels(Box::new(DeviceLabels::new(labels, &device)))
            }
            Blended::Scores(Identities { scores, classes }) => {
                let shape = [scores.len() / (*classes).max(1), *classes];
                OnDevice::Scores(Box::new(Tensor::from_data(
                    TensorData::new(scores.clone(), shape),
                    &device,
                )))
            }
        };
        DeviceLabelMaps {
            maps: self,
            blended,
        }
    }

    fn id(&self, class: Option<u16>) -> u16 {
        class
            .and_then(|c| self.classes.entries.get(usize::from(c)))
            .map_or(self.classes.ignore, |class| class.id)
    }
}

/// [`LabelMaps`] that a GPU renders.
#[derive(Debug)]
pub struct DeviceLabelMaps<'a> {
    maps: &'a LabelMaps<'a>,
    blended: OnDevice,
}

#[derive(Debug)]
enum OnDevice {
    Labels(Box<DeviceLabels>),
    /// `[N, C]`.
    Scores(Box<Tensor<2>>),
}

impl DeviceLabelMaps<'_> {
    /// What `view` shows of them: [`LabelMaps::of`] but for pixels where rounding decides. Read back once.
    ///
    /// # Errors
    /// As [`SplatView::blend`]; [`crate::Error::Device`] when the device does not give the map back.
    pub fn of(&mut self, view: &SplatView) -> Result<LabelMap> {
        let (width, height) = (view.camera().width, view.camera().height);
        // The least and the largest blended value, and the index of the latter.
        let mut found: Option<(Tensor<3>, (Tensor<3>, Tensor<3>))> = None;
        let mut transmittance = None;
        let blocks = match &self.blended {
            OnDevice::Labels(labels) => labels.blocks(view, 0),
            OnDevice::Scores(scores) => view.channel_blocks(scores.dims()[1]).collect(),
        };
        for block in blocks {
            let first = block.start;
            let values = match &mut self.blended {
                OnDevice::Labels(labels) if first == 0 => labels.first(block),
                OnDevice::Labels(labels) => labels.one_hot(block),
                OnDevice::Scores(scores) => {
                    Tensor::clone(scores).slice([0..scores.dims()[0], block])
                }
            };
            let (image, t) = view.blend(values)?;
            transmittance.get_or_insert(t);
            let (least, largest) = (image.clone().min_dim(2), largest_of(image, first as f64));
            found = Some(match found {
                Some((other, best)) => (other.min_pair(least), larger_of(best, largest)),
                None => (least, largest),
            });
        }
        let (Some((least, (largest, index))), Some(transmittance)) = (found, transmittance) else {
            return Ok(LabelMap {
                width,
                height,
                ids: vec![self.maps.classes.ignore; width * height],
            });
        };
        let unknown = match &self.blended {
            OnDevice::Labels(_) => largest.lower_equal_elem(0.0),
            // All alike: nothing is known. A single class has nothing to be told from.
            OnDevice::Scores(scores) if scores.dims()[1] > 1 => largest.lower_equal(least),
            OnDevice::Scores(_) => largest.is_nan(),
        };
        let pixels = width * height;
        let parts = vec![
            index.mask_fill(unknown, -1.0).reshape([pixels]),
            transmittance.reshape([pixels]),
        ];
        let mut index = read("a label map", Tensor::<1>::cat(parts, 0))?;
        let transmittance = index.split_off(pixels);
        let class = |index: f32| match &self.blended {
            OnDevice::Labels(labels) => labels.ids().get(index as usize)?.checked_sub(1),
            OnDevice::Scores(_) => Some(index as u16),
        };
        let pixels = index.into_iter().zip(transmittance);
        let class = |(index, t): (f32, f32)| {
            let shown = index >= 0.0 && 1.0 - t >= self.maps.min_coverage;
            if shown { class(index) } else { None }
        };
        Ok(LabelMap {
            width,
            height,
            ids: pixels.map(|pixel| self.maps.id(class(pixel))).collect(),
        })
    }
}
