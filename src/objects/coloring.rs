//! Colours of objects: those that lie side by side do not look alike.

use crate::data::labels::palette::{PALETTE_LENGTH, difference};
use crate::data::{Classes, class_color};
use crate::error::Result;
use crate::segmentation::neighbours::without_self;
use crate::splat::Gaussians;
use std::collections::{BTreeMap, BTreeSet};

/// Nearest neighbours of each Gaussian whose objects lie beside its own.
const NEIGHBOURS: usize = 8;
/// Distance in OKLab from which two colours are told apart at a glance.
const APART: f64 = 0.2;

/// Gives the objects `recolored` a colour, in ascending order of their ids, that differs from those of their neighbours by 0.2 in
/// OKLab, and as much as possible from all others. An object whose colour does that already keeps it. Colours come from
/// [`class_color`].
///
/// # Errors
/// [`crate::Error::NonFinite`] when a centre is not finite.
///
/// # Panics
/// If `labels` does not have one id for each Gaussian.
pub fn color_apart(
    gaussians: &Gaussians,
    labels: &[u16],
    classes: &mut Classes,
    recolored: &BTreeSet<u16>,
) -> Result<()> {
    assert_eq!(labels.len(), gaussians.len(), "one label for each Gaussian");
    let beside = neighbours(gaussians, labels, classes.ignore)?;
    // Colours that others have, and then those that were given.
    let others = classes
        .entries
        .iter()
        .filter(|c| !recolored.contains(&c.id));
    let mut colors: BTreeMap<u16, [u8; 3]> = others.map(|c| (c.id, c.color)).collect();
    for class in classes
        .entries
        .iter_mut()
        .filter(|c| recolored.contains(&c.id))
    {
        let near: Vec<[u8; 3]> = beside
            .get(&class.id)
            .into_iter()
            .flatten()
            .filter_map(|id| colors.get(id).copied())
            .collect();
        let all: Vec<[u8; 3]> = colors.values().copied().collect();
        if least(class.color, &near) < APART {
            class.color = best(&near, &all);
        }
        colors.insert(class.id, class.color);
    }
    Ok(())
}

/// As [`color_apart`], for all objects.
///
/// # Errors
/// As [`color_apart`].
///
/// # Panics
/// As [`color_apart`].
pub fn color_all_apart(gaussians: &Gaussians, labels: &[u16], classes: &mut Classes) -> Result<()> {
    let all = classes.entries.iter().map(|class| class.id).collect();
    color_apart(gaussians, labels, classes, &all)
}

/// The colour that is far from those near by, and then from all. Ties go to the first of the palette.
fn best(near: &[[u8; 3]], all: &[[u8; 3]]) -> [u8; 3] {
    let score = |color| (least(color, near).min(APART), least(color, all));
    let palette = (0..PALETTE_LENGTH as u16).map(class_color);
    let scored = palette.map(|color| (score(color), color));
    let best = scored.reduce(|best, next| if next.0 > best.0 { next } else { best });
    best.map_or([0; 3], |(_, color)| color)
}

fn least(color: [u8; 3], others: &[[u8; 3]]) -> f64 {
    let distances = others.iter().map(|other| difference(color, *other));
    distances.fold(f64::INFINITY, f64::min)
}

/// Objects that have Gaussians among the nearest neighbours of those of each object, or the other way round.
fn neighbours(
    gaussians: &Gaussians,
    labels: &[u16],
    ignore: u16,
) -> Result<BTreeMap<u16, BTreeSet<u16>>> {
    let mut beside: BTreeMap<u16, BTreeSet<u16>> = BTreeMap::new();
    if gaussians.is_empty() {
        return Ok(beside);
    }
    let near = without_self(&gaussians.means, NEIGHBOURS)?;
    for (&own, row) in labels.iter().zip(near.chunks_exact(NEIGHBOURS)) {
        for &other in row.iter().map(|&j| &labels[j as usize]) {
            if other != own && other != ignore && own != ignore {
                beside.entry(own).or_default().insert(other);
                beside.entry(other).or_default().insert(own);
            }
        }
    }
    Ok(beside)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Balls in a row, an object each.
    fn row(count: u16) -> (Gaussians, Vec<u16>) {
        let n = 9 * usize::from(count);
        let gaussians = Gaussians {
            means: (0..n).map(|i| [0.1 * i as f32, 0.0, 0.0]).collect(),
            log_scales: vec![[-2.0; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![1.0; n],
            sh: vec![0.0; 3 * n],
            sh_degree: 0,
        };
        (gaussians, (0..n).map(|i| (i / 9) as u16 + 1).collect())
    }

    #[test]
    fn neighbours_do_not_look_alike() {
        let (gaussians, labels) = row(300);
        let mut classes = Classes::from_names(0, (1..=300).map(|id| (id, format!("ball {id}"))));
        // A colour that somebody chose stays.
        classes.entries[1].color = class_color(1);
        let all: BTreeSet<u16> = (1..=300).filter(|id| *id != 2).collect();
        let before = classes.clone();
        color_apart(&gaussians, &labels, &mut classes, &all).unwrap();
        assert_eq!(classes.entries[1].color, class_color(1));
        for pair in classes.entries.windows(2) {
            let apart = difference(pair[0].color, pair[1].color);
            assert!(apart >= APART, "{apart}: {pair:?}");
        }
        let mut again = before;
        color_apart(&gaussians, &labels, &mut again, &all).unwrap();
        assert_eq!(again, classes);
    }

    #[test]
    fn colours_that_differ_stay() {
        let (gaussians, labels) = row(3);
        let mut classes = Classes::from_names(0, [(1, "a"), (2, "b"), (3, "c")]);
        let before = classes.clone();
        let all = [1, 2, 3].into();
        color_apart(&gaussians, &labels, &mut classes, &all).unwrap();
        assert_eq!(classes, before);
        color_apart(&gaussians.select(&[]), &[], &mut classes, &all).unwrap();
        assert_eq!(classes, before);
    }
}
