//! What the views say of the two parts of each of several groups, in one pass over their segments.

use super::masks::Masks;
use super::merge::say;
use super::territory::{Places, covering};
use rayon::prelude::*;

/// A Gaussian of one of two parts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Own {
    pub gaussian: u32,
    /// Of the two parts the one that has more of it.
    pub side: usize,
    /// Share that this one has of the weight of all groups.
    pub share: f64,
}

/// The parts by Gaussian, in compressed rows: 16 bytes for each Gaussian of a part.
struct Index {
    offsets: Vec<usize>,
    entries: Vec<Entry>,
}

/// That a pair of parts has a Gaussian.
#[derive(Clone, Copy, Default)]
struct Entry {
    pair: u32,
    side: u32,
    share: f64,
}

/// What a view shows of a pair of parts in one place: a segment, or all pixels without one.
struct Shown {
    pair: u32,
    place: usize,
    pixels: [f64; 2],
}

/// For each pair of parts, how much the views say that they are one thing, and that they are two; see
/// [`super::merge::pairs`]. A pair is said of what it is when asked of alone, to the last bit.
pub(super) fn says(gaussians: usize, views: &[Masks], pairs: &[&[Own]]) -> Vec<(f64, f64)> {
    if pairs.is_empty() {
        return Vec::new();
    }
    let index = Index::new(gaussians, pairs);
    let sums = || vec![[0.0_f64; 2]; pairs.len()];
    let seen: Vec<Vec<(usize, [Places; 2])>> = views
        .par_iter()
        .map_init(sums, |sums, view| index.places(view, sums))
        .collect();
    let mut most = sums();
    for (pair, places) in seen.iter().flatten() {
        most[*pair]
            .iter_mut()
            .zip(places)
            .for_each(|(most, places)| *most = most.max(places.total));
    }
    let mut said = vec![(0.0, 0.0); pairs.len()];
    for (pair, [a, b]) in seen.iter().flatten() {
        let (Some(at_a), Some(at_b)) = (a.mask, b.mask) else {
            continue;
        };
        let ((one, two), most) = (&mut said[*pair], most[*pair]);
        *(if at_a == at_b { one } else { two }) += say((a.total / most[0]).min(b.total / most[1]));
    }
    said
}

impl Index {
    fn new(gaussians: usize, pairs: &[&[Own]]) -> Self {
        let mut offsets = vec![0_usize; gaussians + 1];
        pairs
            .iter()
            .copied()
            .flatten()
            .for_each(|own| offsets[own.gaussian as usize + 1] += 1);
        for g in 0..gaussians {
            offsets[g + 1] += offsets[g];
        }
        let mut next = offsets.clone();
        let mut entries = vec![Entry::default(); offsets[gaussians]];
        for (pair, parts) in (0..).zip(pairs) {
            for &Own {
                gaussian,
                side,
                share,
            } in *parts
            {
                let place = &mut next[gaussian as usize];
                entries[*place] = Entry {
                    pair,
                    side: side as u32,
                    share,
                };
                *place += 1;
            }
        }
        Self { offsets, entries }
    }

    /// The pairs of parts that have a Gaussian.
    fn of(&self, gaussian: u32) -> &[Entry] {
        &self.entries[self.offsets[gaussian as usize]..self.offsets[gaussian as usize + 1]]
    }

    /// For each pair of parts of which a view shows anything, which segment covers either, counted among those that show
    /// something of the pair. `sums` is zero before and after.
    fn places(&self, view: &Masks, sums: &mut [[f64; 2]]) -> Vec<(usize, [Places; 2])> {
        let (mut shown, mut touched) = (Vec::new(), Vec::new());
        let rest = view.segments.len();
        let weights = view
            .segments
            .iter()
            .map(|mask| &mask.weights)
            .chain([&view.rest]);
        for (place, weights) in weights.enumerate() {
            // Sums run over the Gaussians in order, whichever pairs there are beside.
            for &(gaussian, weight) in weights {
                for entry in self.of(gaussian) {
                    let sum = &mut sums[entry.pair as usize];
                    if *sum == [0.0; 2] {
                        touched.push(entry.pair);
                    }
                    sum[entry.side as usize] += f64::from(weight) * entry.share;
                }
            }
            let taken = |pair: u32| Shown {
                pair,
                place,
                pixels: std::mem::take(&mut sums[pair as usize]),
            };
            shown.extend(touched.drain(..).map(taken));
        }
        // The sort keeps the order of the places: pixels without a segment last.
        shown.sort_by_key(|shown| shown.pair);
        let places = |of_pair: &[Shown]| {
            let (labelled, without) = match of_pair {
                [labelled @ .., last] if last.place == rest => (labelled, last.pixels),
                all => (all, [0.0; 2]),
            };
            let covered = [0, 1].map(|side| {
                covering(
                    labelled.iter().map(|shown| shown.pixels[side]),
                    without[side],
                )
            });
            (of_pair[0].pair as usize, covered)
        };
        shown
            .chunk_by(|a, b| a.pair == b.pair)
            .map(places)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Segment;
    use crate::objects::association::masks::Mask;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const GAUSSIANS: usize = 90;

    /// What the views say of one pair of parts, by looking at all that every view shows.
    fn alone(views: &[Masks], parts: &[Own]) -> (f64, f64) {
        let mut owns = [None; GAUSSIANS];
        parts
            .iter()
            .for_each(|own| owns[own.gaussian as usize] = Some(own));
        let share = |weights: &[(u32, f32)]| {
            let mut shown = [0.0_f64; 2];
            for &(gaussian, weight) in weights {
                if let Some(own) = owns[gaussian as usize] {
                    shown[own.side] += f64::from(weight) * own.share;
                }
            }
            shown
        };
        let places: Vec<[Places; 2]> = views
            .iter()
            .map(|view| {
                let shown: Vec<[f64; 2]> = view
                    .segments
                    .iter()
                    .map(|mask| share(&mask.weights))
                    .collect();
                let rest = share(&view.rest);
                [0, 1].map(|side| covering(shown.iter().map(|shown| shown[side]), rest[side]))
            })
            .collect();
        let most = [0, 1].map(|side| {
            places
                .iter()
                .map(|places| places[side].total)
                .fold(0.0, f64::max)
        });
        let (mut one, mut two) = (0.0, 0.0);
        for [a, b] in places {
            let (Some(at_a), Some(at_b)) = (a.mask, b.mask) else {
                continue;
            };
            *(if at_a == at_b { &mut one } else { &mut two }) +=
                say((a.total / most[0]).min(b.total / most[1]));
        }
        (one, two)
    }

    /// Weights of some of the Gaussians of a span, which may reach beyond the last one.
    fn some(rng: &mut ChaCha8Rng, first: usize, count: usize) -> Vec<(u32, f32)> {
        let weight =
            |g: usize| (rng.random_bool(0.8)).then_some((g as u32, rng.random_range(0.01..30.0)));
        (first..(first + count).min(GAUSSIANS))
            .filter_map(weight)
            .collect()
    }

    #[test]
    fn pairs_asked_of_together_are_said_what_each_is_alone() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (mut ones, mut twos) = (0, 0);
        for _ in 0..30 {
            let mut views = vec![Masks::default()];
            for _ in 0..8 {
                let mut segments = Vec::new();
                for id in 1..rng.random_range(2..7) {
                    let (first, count) = (rng.random_range(0..GAUSSIANS), rng.random_range(0..50));
                    let weights = some(&mut rng, first, count);
                    segments.push(Mask {
                        segment: Segment {
                            id,
                            class: None,
                            thing: true,
                        },
                        weights,
                        total: 0.0,
                    });
                }
                let rest = rng.random_range(0..GAUSSIANS);
                views.push(Masks {
                    segments,
                    rest: some(&mut rng, rest, 20),
                });
            }
            // Parts lie side by side and over those of other pairs; one pair has nothing.
            let mut pairs: Vec<Vec<Own>> = vec![Vec::new()];
            for _ in 0..6 {
                let (first, border) = (rng.random_range(0..GAUSSIANS), rng.random_range(0..25));
                let parts = some(&mut rng, first, 40)
                    .into_iter()
                    .map(|(gaussian, weight)| {
                        let side = usize::from(gaussian as usize > first + border);
                        Own {
                            gaussian,
                            side,
                            share: f64::from(weight) / 31.0,
                        }
                    });
                pairs.push(parts.collect());
            }
            let slices: Vec<&[Own]> = pairs.iter().map(|parts| &**parts).collect();
            let bits = |(one, two): (f64, f64)| (one.to_bits(), two.to_bits());
            let together = says(GAUSSIANS, &views, &slices);
            let each: Vec<(f64, f64)> = pairs.iter().map(|parts| alone(&views, parts)).collect();
            assert!(
                together
                    .iter()
                    .copied()
                    .map(bits)
                    .eq(each.iter().copied().map(bits)),
                "{together:?} {each:?}"
            );
            ones += each.iter().filter(|(one, _)| *one > 0.0).count();
            twos += each.iter().filter(|(_, two)| *two > 0.0).count();
        }
        assert!(
            ones > 10 && twos > 10,
            "{ones} and {twos} of 180 pairs are one and two to some view"
        );
        assert!(says(GAUSSIANS, &[Masks::default()], &[]).is_empty());
    }
}
