//! What a view votes for: the labels of its pixels or their scores, and how much each Gaussian counts in it.

use crate::backend::device::upload;
use crate::data::{Classes, View};
use crate::error::Result;
use crate::splat::Gaussians;
use crate::splat::camera::Camera;
use burn::tensor::{Device, Tensor};
use glam::Vec3;

/// What a view votes for.
pub(super) struct ViewVotes {
    /// Class index and share of each vote, pixel by pixel in row order.
    pub votes: Vec<(u16, f32)>,
    /// End of the votes of each pixel.
    pub ends: Vec<usize>,
    /// Factor of the votes on each Gaussian, `[N, 1]`.
    pub weights: Option<Tensor<2>>,
}

impl ViewVotes {
    /// The raw label of each pixel.
    pub fn of_labels(view: &View, classes: &Classes) -> Self {
        Self::of_pixels(view, classes, |_, class, votes| votes.push((class, 1.0)))
    }

    /// The scores of each pixel that has a raw label, or the label itself where the view or the pixel has no scores; times the
    /// distances of the Gaussians `weighted` from the camera, if any.
    pub fn of_scores(
        view: &View,
        classes: &Classes,
        weighted: Option<&Gaussians>,
        device: &Device,
    ) -> Result<Self> {
        let scores = view.scores.as_ref().map(|scores| scores.read(classes));
        let scores = scores.transpose()?;
        let width = view.camera.width;
        let mut found = Vec::new();
        let cast = Self::of_pixels(view, classes, |pixel, class, votes| {
            found.clear();
            if let Some(scores) = &scores {
                scores.at(pixel % width, pixel / width, &mut found);
            }
            if found.is_empty() {
                found.push((class, 1.0));
            }
            votes.extend_from_slice(&found);
        });
        Ok(Self {
            weights: weighted.map(|gaussians| distances(gaussians, &view.camera, device)),
            ..cast
        })
    }

    /// `add` adds the votes of a labelled pixel, given its number and class, to the list of all.
    fn of_pixels(
        view: &View,
        classes: &Classes,
        mut add: impl FnMut(usize, u16, &mut Vec<(u16, f32)>),
    ) -> Self {
        let lookup = classes.lookup();
        let ids = view.raw.as_ref().map_or_else(Vec::new, |raw| raw.map().ids);
        let mut votes = Vec::new();
        let mut ends = Vec::with_capacity(ids.len());
        for (pixel, id) in ids.into_iter().enumerate() {
            let class = lookup[usize::from(id)];
            if usize::from(class) < classes.len() {
                add(pixel, class, &mut votes);
            }
            ends.push(votes.len());
        }
        Self {
            votes,
            ends,
            weights: None,
        }
    }

    /// The classes that any pixel votes for, ascending.
    pub fn shown(&self) -> Vec<u16> {
        let mut shown = vec![false; 1 << 16];
        for (class, _) in &self.votes {
            shown[usize::from(*class)] = true;
        }
        (0..=u16::MAX)
            .filter(|&class| shown[usize::from(class)])
            .collect()
    }

    /// The votes of each pixel for the classes `part`, ascending: `[P, len]`.
    pub fn image(&self, part: &[u16], device: &Device) -> Tensor<2> {
        let mut values = vec![0.0; self.ends.len() * part.len()];
        let mut first = 0;
        for (row, &end) in values.chunks_exact_mut(part.len()).zip(&self.ends) {
            for (class, weight) in &self.votes[first..end] {
                if let Ok(column) = part.binary_search(class) {
                    row[column] += weight;
                }
            }
            first = end;
        }
        upload(values, [self.ends.len(), part.len()], device)
    }
}

/// The distance of each Gaussian from the camera, `[N, 1]`.
fn distances(gaussians: &Gaussians, camera: &Camera, device: &Device) -> Tensor<2> {
    let distance = |mean: &[f32; 3]| (Vec3::from(*mean).as_dvec3() - camera.center).length() as f32;
    let distances: Vec<f32> = gaussians.means.iter().map(distance).collect();
    upload(distances, [gaussians.len(), 1], device)
}
