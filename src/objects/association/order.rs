//! The order in which views are looked at first.

use super::masks::{Mask, Masks};

/// Views, each time the one with most weight on Gaussians that the views before it show; the first is the one with most
/// weight. Ties go to the lower index. Every pair of a segment and a Gaussian is looked at twice, however many views there are;
/// meanwhile it takes up 4 bytes beside its own 8.
pub(super) fn overlapping_order(views: &[Masks], gaussians: usize) -> Vec<usize> {
    let segments: Vec<(usize, &Mask)> = views
        .iter()
        .enumerate()
        .flat_map(|(v, view)| view.segments.iter().map(move |mask| (v, mask)))
        .collect();
    // Segments of each Gaussian, in compressed rows.
    let mut offsets = vec![0_usize; gaussians + 1];
    segments
        .iter()
        .flat_map(|(_, mask)| &mask.weights)
        .for_each(|(g, _)| offsets[*g as usize + 1] += 1);
    for g in 0..gaussians {
        offsets[g + 1] += offsets[g];
    }
    let mut next = offsets.clone();
    let mut entries = vec![0_u32; offsets[gaussians]];
    for (s, (_, mask)) in (0..).zip(&segments) {
        for &(g, _) in &mask.weights {
            let place = &mut next[g as usize];
            entries[*place] = s;
            *place += 1;
        }
    }
    drop(next);
    let totals: Vec<f64> = views
        .iter()
        .map(|view| view.segments.iter().map(|mask| mask.total).sum())
        .collect();
    let mut known = vec![0.0_f64; views.len()];
    let mut seen = vec![false; gaussians];
    let mut left: Vec<usize> = (0..views.len()).collect();
    let mut order = Vec::with_capacity(views.len());
    while !left.is_empty() {
        let better = |a: usize, b: usize| (known[a], totals[a]) > (known[b], totals[b]);
        let best = (1..left.len()).fold(
            0,
            |best, i| if better(left[i], left[best]) { i } else { best },
        );
        let view = left.remove(best);
        order.push(view);
        for &(g, _) in views[view].segments.iter().flat_map(|mask| &mask.weights) {
            if !std::mem::replace(&mut seen[g as usize], true) {
                for &s in &entries[offsets[g as usize]..offsets[g as usize + 1]] {
                    let (v, mask) = segments[s as usize];
                    // It is there: the row is of segments that cover the Gaussian.
                    let place = mask
                        .weights
                        .binary_search_by_key(&g, |(gaussian, _)| *gaussian);
                    known[v] += place.map_or(0.0, |i| f64::from(mask.weights[i].1));
                }
            }
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Segment;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const GAUSSIANS: u32 = 60;

    /// The weight of all segments of a view on a Gaussian.
    fn on(view: &Masks, gaussian: u32) -> f64 {
        let weights = view.segments.iter().flat_map(|mask| &mask.weights);
        weights
            .filter(|(g, _)| *g == gaussian)
            .map(|(_, weight)| f64::from(*weight))
            .sum()
    }

    #[test]
    fn each_view_overlaps_most_with_those_before() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..20 {
            let mut segment = |id| {
                // Quarters, of which sums are exact in any order.
                let weight = |g| {
                    let weight = 0.25 * rng.random_range(1..9) as f32;
                    rng.random_bool(0.15).then_some((g, weight))
                };
                let weights: Vec<(u32, f32)> = (0..GAUSSIANS).filter_map(weight).collect();
                let total = weights.iter().map(|(_, weight)| f64::from(*weight)).sum();
                Mask {
                    segment: Segment {
                        id,
                        class: None,
                        thing: true,
                    },
                    weights,
                    total,
                }
            };
            let views: Vec<Masks> = (0..7)
                .map(|_| Masks {
                    segments: (1..4).map(&mut segment).collect(),
                    rest: Vec::new(),
                })
                .collect();
            let order = overlapping_order(&views, GAUSSIANS as usize);
            for place in 0..views.len() {
                let before = |g: &u32| order[..place].iter().any(|&v| on(&views[v], *g) > 0.0);
                let known: Vec<u32> = (0..GAUSSIANS).filter(before).collect();
                let value = |v: usize| {
                    let overlap: f64 = known.iter().map(|&g| on(&views[v], g)).sum();
                    (
                        overlap,
                        views[v].segments.iter().map(|mask| mask.total).sum::<f64>(),
                    )
                };
                let chosen = order[place];
                for &other in &order[place..] {
                    let tie = value(other) == value(chosen) && chosen <= other;
                    assert!(
                        value(chosen) > value(other) || tie,
                        "{chosen} before {other} in {order:?}"
                    );
                }
            }
        }
    }
}
