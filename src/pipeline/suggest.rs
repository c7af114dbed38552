//! Which photos to label by hand: those that together show most of the scene.

use crate::config::Config;
use crate::data::{Scene, Split, View};
use crate::error::Result;
use crate::raster::{Projected, Settings};
use crate::reconstruction::initialization::{initial_gaussians, logit};
use crate::splat::{Gaussians, rows_where};
use serde::Serialize;
use std::borrow::Cow;

/// Longer side of the pictures in which Gaussians are counted, in pixels.
const PICTURE_SIDE: usize = 240;
/// Blending weight, summed over these pixels, from which on a photo shows a Gaussian.
const MIN_SHOWN_WEIGHT: f32 = 0.25;
/// Opacity of Gaussians at points: those in front hide those behind.
const OPACITY: f32 = 0.95;

/// A photo to label.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Suggestion {
    /// File name of the photo, or the name of its view where it lies in no file.
    pub photo: String,
    /// Share of the scene that this photo shows and those before it do not, 0 to 1.
    pub adds: f64,
    /// Share of the scene that this photo and those before it show.
    pub together: f64,
}

/// Names up to `count` training photos of `scene`, each the one that adds most to those before it. This greedy choice covers at least
/// 63 % of what the best choice would. The list ends early once no other photo adds anything.
///
/// The photos cover `gaussians`, relative to the origin of the scene. Without them, an opaque Gaussian stands at each initial
/// point, or at points that photos agree on where the scene has none. A photo shows a Gaussian where the sum of alpha' T reaches
/// a quarter of a pixel, in pictures of 240 pixels across. A Gaussian counts by this sum over all training photos, so that a share
/// of the scene is a share of the pixels of all photos.
///
/// # Errors
/// Those of [`Projected::new`], and of [`crate::data::Photo::pixels`] where points are looked for in the photos.
pub fn suggest(
    scene: &Scene,
    gaussians: Option<&Gaussians>,
    count: usize,
    config: &Config,
) -> Result<Vec<Suggestion>> {
    let views: Vec<&View> = scene.split(Split::Train).collect();
    let gaussians = match gaussians {
        Some(gaussians) => Cow::Borrowed(gaussians),
        None => {
            let mut points = initial_gaussians(scene, &views, config)?;
            points.opacity_logits.fill(logit(OPACITY));
            Cow::Owned(points)
        }
    };
    let settings = Settings::from(&config.raster);
    let mut worth = vec![0.0; gaussians.len()];
    let mut shown: Vec<Vec<u32>> = Vec::with_capacity(views.len());
    for view in &views {
        let weights = weights(&gaussians, view, &settings)?;
        shown.push(rows_where(&weights, |weight| *weight >= MIN_SHOWN_WEIGHT));
        for (worth, weight) in worth.iter_mut().zip(weights) {
            *worth += f64::from(weight);
        }
    }
    let chosen = greedy(&shown, worth, count);
    let mut together = 0.0;
    let suggestions = chosen.into_iter().map(|(view, adds)| {
        together += adds;
        Suggestion {
            photo: views[view].file_name(),
            adds,
            together,
        }
    });
    Ok(suggestions.collect())
}

/// The blending weights of each Gaussian, summed over a small picture of the view.
fn weights(gaussians: &Gaussians, view: &View, settings: &Settings) -> Result<Vec<f32>> {
    let camera = &view.camera;
    let scale = PICTURE_SIDE as f64 / camera.width.max(camera.height).max(PICTURE_SIDE) as f64;
    let side = |pixels: usize| ((pixels as f64 * scale).round() as usize).max(1);
    let camera = camera.resized(side(camera.width), side(camera.height));
    Ok(Projected::<f32>::new(&gaussians.splats(), &camera, settings)?.weight_sums())
}

/// Up to `count` sets of `shown`: index, and the share of `worth` that the set adds. Each set adds most to those before it; among
/// equal sets the first is taken.
fn greedy(shown: &[Vec<u32>], mut worth: Vec<f64>, count: usize) -> Vec<(usize, f64)> {
    let all: f64 = worth.iter().sum();
    let mut chosen = Vec::new();
    while chosen.len() < count {
        let gain = |set: &Vec<u32>| set.iter().map(|&i| worth[i as usize]).sum::<f64>();
        let gains = shown.iter().map(gain).enumerate();
        let best = gains.reduce(|a, b| if b.1 > a.1 { b } else { a });
        let Some((set, gain)) = best.filter(|best| best.1 > 0.0) else {
            break;
        };
        // What is covered is worth nothing more.
        shown[set].iter().for_each(|&i| worth[i as usize] = 0.0);
        chosen.push((set, gain / all));
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn each_set_adds_most_to_those_before_it() {
        let shown = [vec![0, 1], vec![1, 2, 3], vec![4], vec![0, 4], vec![]];
        let worth = vec![2.0, 1.0, 1.0, 1.0, 3.0, 2.0];
        let chosen = greedy(&shown, worth, 9);
        assert_eq!(chosen, [(3, 0.5), (1, 0.3)]);
    }

    proptest! {
        #[test]
        fn greedy_choices_reach_their_bound(
            sets in prop::collection::vec(prop::collection::vec(0_u32..12, 0..7), 1..7),
            worth in prop::collection::vec(0.1..5.0_f64, 12),
        ) {
            let all: f64 = worth.iter().sum();
            let pairs = (0..sets.len()).flat_map(|a| (0..sets.len()).map(move |b| [a, b]));
            let covered = |pair: [usize; 2]| -> f64 {
                let holds = |i: u32| pair.iter().any(|&set| sets[set].contains(&i));
                (0..12).filter(|&i| holds(i)).map(|i| worth[i as usize]).sum()
            };
            let best = pairs.map(covered).fold(0.0, f64::max);
            let mut unique = sets.clone();
            for set in &mut unique {
                set.sort_unstable();
                set.dedup();
            }
            let found: f64 = greedy(&unique, worth.clone(), 2).iter().map(|c| c.1 * all).sum();
            prop_assert!(found >= 0.75 * best - 1e-9 && found <= best + 1e-9, "{} of {}", found, best);
        }
    }
}
