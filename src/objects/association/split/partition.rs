//! A group in two parts, grown from two segments of one view.

use super::candidates::{Candidate, Piece, Seed, SmallerPart, weights};
use crate::objects::association::groups::{Assigned, Groups};
use crate::objects::association::part_evidence::PartGaussian;
use crate::objects::association::segments::SegmentWeights;

/// A segment belongs to both parts when the part with the smaller claim has more than this share of the larger claim.
const MAX_SMALLER_CLAIM: f64 = 0.25;
/// A part of lower purity is a piece of another object.
pub(super) const MIN_PURITY: f64 = 0.5;
/// Passes over the segments of a group, after which its two parts no longer change much.
const PASSES: usize = 4;

/// Weights of the two parts of a group on each Gaussian, pixels.
pub(super) type Parts = [[f32; 2]];

/// A group in two parts.
pub(super) struct Partition {
    pub smaller: SmallerPart,
    pub parts: Vec<PartGaussian>,
}

/// The partition of a group that grows from `seed`. `None` unless its smaller part is larger than that of the best partition so far
/// and both parts have most of their Gaussians. `parts` are zero before and after.
pub(super) fn partition(
    groups: &Groups,
    assigned: &[Assigned<'_>],
    candidate: &Candidate,
    seed: Seed,
    parts: &mut Parts,
) -> Option<Partition> {
    let pieces = &candidate.pieces;
    let sides = grow(parts, assigned, pieces, seed);
    let of_side = |side| {
        let sided = pieces.iter().zip(&sides);
        sided
            .filter(move |(_, s)| **s == side)
            .map(|(piece, _)| *piece)
    };
    let weight = |side| {
        of_side(side)
            .map(|piece| weights(assigned, piece).total)
            .sum()
    };
    let [first, second]: [f64; 2] = [weight(0), weight(1)];
    let smaller = usize::from(first >= second);
    let smaller = SmallerPart {
        weight: first.min(second),
        pieces: of_side(smaller).collect(),
    };
    let best = candidate.best.as_ref();
    let improves = best.is_none_or(|best| smaller.weight > best.weight);
    let is_object = |side| purity(groups, &candidate.gaussians, parts, side) > MIN_PURITY;
    let found = (improves && is_object(0) && is_object(1)).then(|| Partition {
        smaller,
        parts: part_gaussians(groups, &candidate.gaussians, parts),
    });
    for &piece in pieces {
        for (gaussian, _) in &weights(assigned, piece).weights {
            parts[*gaussian as usize] = [0.0; 2];
        }
    }
    found
}

/// The mean of a part's share of all weight on the Gaussians that it covers, some of `gaussians`.
pub(super) fn purity(groups: &Groups, gaussians: &[u32], parts: &Parts, side: usize) -> f64 {
    let mut sum = 0.0;
    let mut pure = 0.0;
    for &gaussian in gaussians {
        let weight = f64::from(parts[gaussian as usize][side]);
        if weight > 0.0 {
            sum += weight;
            pure += weight * weight / groups.total(gaussian).max(weight);
        }
    }
    if sum > 0.0 { pure / sum } else { 0.0 }
}

/// The Gaussians of the parts, among those of a group. Where both parts have a Gaussian, the one with more weight has it.
pub(super) fn part_gaussians(
    groups: &Groups,
    gaussians: &[u32],
    parts: &Parts,
) -> Vec<PartGaussian> {
    let part_gaussian = |&gaussian: &u32| {
        let [a, b] = parts[gaussian as usize];
        let weight = f64::from(a.max(b));
        (weight > 0.0).then(|| PartGaussian {
            gaussian,
            side: u32::from(b > a),
            share: weight / groups.total(gaussian).max(weight),
        })
    };
    gaussians.iter().filter_map(part_gaussian).collect()
}

/// Grows two parts from a pair of segments into `parts`, which are zero before. The pair stays in its parts. Each other piece goes
/// to the part that claims it, and to neither while both claim some of it. In the end the part with the larger claim takes it.
/// Returns the part of each piece.
pub(super) fn grow(
    parts: &mut Parts,
    assigned: &[Assigned<'_>],
    pieces: &[Piece],
    seed: Seed,
) -> Vec<usize> {
    let add = |parts: &mut Parts, piece: Piece, side: Option<usize>, sign: f32| {
        let Some(side) = side else { return };
        for (gaussian, weight) in &weights(assigned, piece).weights {
            parts[*gaussian as usize][side] += sign * weight;
        }
    };
    let seeded = |piece: Piece| seed.iter().position(|s| *s == piece);
    let mut sides: Vec<Option<usize>> = pieces.iter().map(|piece| seeded(*piece)).collect();
    for (piece, side) in pieces.iter().zip(&sides) {
        add(parts, *piece, *side, 1.0);
    }
    let mut larger = vec![0; pieces.len()];
    for _ in 0..PASSES {
        for ((&piece, side), larger) in pieces.iter().zip(&mut sides).zip(&mut larger) {
            if let Some(seeded) = seeded(piece) {
                *larger = seeded;
                continue;
            }
            add(parts, piece, *side, -1.0);
            let claims = claims(parts, weights(assigned, piece));
            *larger = usize::from(claims[1] > claims[0]);
            let clear = claims[1 - *larger] < MAX_SMALLER_CLAIM * claims[*larger];
            *side = clear.then_some(*larger);
            add(parts, piece, *side, 1.0);
        }
    }
    larger
}

/// What each part claims of a piece, pixels.
fn claims(parts: &Parts, piece: &SegmentWeights) -> [f64; 2] {
    let mut claims = [0.0; 2];
    for &(gaussian, weight) in &piece.weights {
        let [a, b] = parts[gaussian as usize].map(|w| f64::from(w.max(0.0)));
        let share = f64::from(weight) / (a + b + 1.0);
        claims[0] += share * a;
        claims[1] += share * b;
    }
    claims
}
