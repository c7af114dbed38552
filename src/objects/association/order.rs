//! The order in which views are looked at first.

use super::masks::Masks;

/// Views, each time the one with most weight on Gaussians that the views before it show; the first is the one with most
/// weight. Ties go to the lower index. Every (view, Gaussian) pair is looked at twice, however many views there are.
pub(super) fn overlapping_order(views: &[Masks], gaussians: usize) -> Vec<usize> {
    let pairs = || views.iter().enumerate().flat_map(|(v, view)| view.segments.iter().map(move |mask| (v, mask)));
    // Views and weights of each Gaussian, in compressed rows.
    let mut offsets = vec![0_usize; gaussians + 1];
    pairs().flat_map(|(_, mask)| &mask.weights).for_each(|(g, _)| offsets[*g as usize + 1] += 1);
    for g in 0..gaussians {
        offsets[g + 1] += offsets[g];
    }
    let mut next = offsets.clone();
    let mut entries = vec![(0_u32, 0.0_f32); offsets[gaussians]];
    for (v, mask) in pairs() {
        for &(g, weight) in &mask.weights {
            let place = &mut next[g as usize];
            entries[*place] = (v as u32, weight);
            *place += 1;
        }
    }
    let totals: Vec<f64> = views.iter().map(|view| view.segments.iter().map(|mask| mask.total).sum()).collect();
    let mut known = vec![0.0_f64; views.len()];
    let mut seen = vec![false; gaussians];
    let mut left: Vec<usize> = (0..views.len()).collect();
    let mut order = Vec::with_capacity(views.len());
    while !left.is_empty() {
        let better = |a: usize, b: usize| (known[a], totals[a]) > (known[b], totals[b]);
        let best = (1..left.len()).fold(0, |best, i| if better(left[i], left[best]) { i } else { best });
        let view = left.remove(best);
        order.push(view);
        for &(g, _) in views[view].segments.iter().flat_map(|mask| &mask.weights) {
            if !std::mem::replace(&mut seen[g as usize], true) {
                let row = &entries[offsets[g as usize]..offsets[g as usize + 1]];
                row.iter().for_each(|(v, weight)| known[*v as usize] += f64::from(*weight));
            }
        }
    }
    order
}
