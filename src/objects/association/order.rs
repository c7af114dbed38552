//! The order of the views in the first sweep.

use super::segments::ViewSegments;

/// Views in an order of overlap. Each view has most weight on the Gaussians that the views before it show. The first view has most
/// weight in all. Ties go to the lower index. Time grows with the pairs of segments and Gaussians, not with the number of views.
pub(super) fn view_order(views: &[ViewSegments], gaussians: usize) -> Vec<usize> {
    // For each Gaussian the views that show it, with the weights of their segments.
    let mut shown: Vec<Vec<(u32, f32)>> = vec![Vec::new(); gaussians];
    for (v, view) in (0..).zip(views) {
        for &(gaussian, weight) in view.segments.iter().flat_map(|s| &s.weights) {
            shown[gaussian as usize].push((v, weight));
        }
    }
    let total = |view: &ViewSegments| view.segments.iter().map(|segment| segment.total).sum();
    let totals: Vec<f64> = views.iter().map(total).collect();
    let mut known = vec![0.0_f64; views.len()];
    let mut left: Vec<usize> = (0..views.len()).collect();
    let mut order = Vec::with_capacity(views.len());
    while !left.is_empty() {
        let mut best = 0;
        for (i, &view) in left.iter().enumerate() {
            if (known[view], totals[view]) > (known[left[best]], totals[left[best]]) {
                best = i;
            }
        }
        let view = left.remove(best);
        order.push(view);
        let weights = views[view].segments.iter().flat_map(|s| &s.weights);
        for &(gaussian, _) in weights {
            // Taken, so that each Gaussian counts once.
            for (v, weight) in std::mem::take(&mut shown[gaussian as usize]) {
                known[v as usize] += f64::from(weight);
            }
        }
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Segment;
    use crate::objects::association::segments::SegmentWeights;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const GAUSSIANS: u32 = 60;

    /// The weight of all segments of a view on a Gaussian.
    fn on(view: &ViewSegments, gaussian: u32) -> f64 {
        let weights = view.segments.iter().flat_map(|s| &s.weights);
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
                // Sums of quarters are exact in any order.
                let weight = |g| {
                    let weight = 0.25 * rng.random_range(1..9) as f32;
                    rng.random_bool(0.15).then_some((g, weight))
                };
                let weights: Vec<(u32, f32)> = (0..GAUSSIANS).filter_map(weight).collect();
                let total = weights.iter().map(|(_, weight)| f64::from(*weight)).sum();
                SegmentWeights {
                    segment: Segment {
                        id,
                        class: None,
                        thing: true,
                    },
                    weights,
                    total,
                }
            };
            let views: Vec<ViewSegments> = (0..7)
                .map(|_| ViewSegments {
                    segments: (1..4).map(&mut segment).collect(),
                    unlabelled: Vec::new(),
                })
                .collect();
            let order = view_order(&views, GAUSSIANS as usize);
            for place in 0..views.len() {
                let before = |g: &u32| order[..place].iter().any(|&v| on(&views[v], *g) > 0.0);
                let known: Vec<u32> = (0..GAUSSIANS).filter(before).collect();
                let value = |v: usize| {
                    let overlap: f64 = known.iter().map(|&g| on(&views[v], g)).sum();
                    (
                        overlap,
                        views[v].segments.iter().map(|s| s.total).sum::<f64>(),
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
