//! Connected components of ellipsoids that touch.

use super::ellipsoid::Ellipsoid;
use crate::error::Result;
use crate::segmentation::neighbours::{Neighbours, PointIndex};
use rayon::prelude::*;
use union_find::{QuickUnionUf, UnionBySize, UnionFind};

/// Ellipsoids whose touching pairs are in memory at once.
const BLOCK: usize = 1 << 16;

type DisjointSets = QuickUnionUf<UnionBySize>;

/// For each of `ellipsoids`, centred at `points`, the first member of its component. Each is compared with its `neighbours`
/// nearest. One whose longest half-axis reaches beyond these is compared with all whose centres lie within it.
pub(super) fn connected_components(
    ellipsoids: &[Ellipsoid],
    points: &[[f32; 3]],
    neighbours: usize,
) -> Result<Vec<u32>> {
    let count = neighbours.saturating_add(1).min(points.len());
    let index = PointIndex::new(points)?;
    let near = index.neighbours(count);
    let mut sets = DisjointSets::new(ellipsoids.len());
    join_neighbours(ellipsoids, &near, &mut sets);
    join_large(ellipsoids, &index, &near, &mut sets);
    Ok(first_members(&mut sets, ellipsoids.len()))
}

/// Joins each ellipsoid with those of its nearest that it touches.
fn join_neighbours(ellipsoids: &[Ellipsoid], near: &Neighbours, sets: &mut DisjointSets) {
    let all: Vec<usize> = (0..ellipsoids.len()).collect();
    // Block by block, so that not all pairs of a large label are in memory.
    for block in all.chunks(BLOCK) {
        let touched: Vec<Vec<u32>> = block
            .par_iter()
            .map(|&k| {
                let touches = |j: &u32| ellipsoids[k].touches(&ellipsoids[*j as usize]);
                near.row(k)[1..].iter().copied().filter(touches).collect()
            })
            .collect();
        for (&k, touched) in block.iter().zip(touched) {
            for j in touched {
                sets.union(k, j as usize);
            }
        }
    }
}

/// Joins the large ellipsoids with all that they touch: the nearest can all lie at one side. The largest come first, so that
/// later ones find most of what they reach in their own set, until there is one set.
fn join_large(
    ellipsoids: &[Ellipsoid],
    index: &PointIndex,
    near: &Neighbours,
    sets: &mut DisjointSets,
) {
    let reaches_on = |k: &usize| {
        let ellipsoid = &ellipsoids[*k];
        let distance = |j: &u32| ellipsoids[*j as usize].center.distance(ellipsoid.center);
        ellipsoid.longest > near.row(*k).last().map_or(0.0, distance)
    };
    let mut large: Vec<usize> = (0..ellipsoids.len())
        .into_par_iter()
        .filter(reaches_on)
        .collect();
    large.sort_unstable_by(|&a, &b| {
        let sizes = ellipsoids[b].longest.total_cmp(&ellipsoids[a].longest);
        sizes.then(a.cmp(&b))
    });
    let mut left = (0..ellipsoids.len()).filter(|&k| sets.find(k) == k).count();
    for k in large {
        if left == 1 {
            return;
        }
        let Ellipsoid {
            center, longest, ..
        } = ellipsoids[k];
        for j in index.within(center.to_array(), longest) {
            let other = j as usize;
            if sets.find(k) != sets.find(other) && ellipsoids[k].touches(&ellipsoids[other]) {
                sets.union(k, other);
                left -= 1;
            }
        }
    }
}

/// The first member of the set of each of `count` keys.
fn first_members(sets: &mut DisjointSets, count: usize) -> Vec<u32> {
    let mut first = vec![u32::MAX; count];
    (0..count)
        .map(|key| {
            let first = &mut first[sets.find(key)];
            *first = (*first).min(key as u32);
            *first
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::Gaussians;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Random ellipsoids in a room of side 1, the first `huge` of them as large as it.
    fn random(
        count: usize,
        spread: f32,
        huge: usize,
        seed: u64,
    ) -> (Vec<Ellipsoid>, Vec<[f32; 3]>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let means: Vec<[f32; 3]> = (0..count).map(|_| [0; 3].map(|_| rng.random())).collect();
        let size = |i: usize| if i < huge { 0.4 } else { spread };
        let axes = |i: usize, rng: &mut ChaCha8Rng| {
            [0; 3].map(|_| (size(i) * rng.random_range(0.02_f32..1.0)).ln())
        };
        let gaussians = Gaussians {
            log_scales: (0..count).map(|i| axes(i, &mut rng)).collect(),
            rotations: (0..count)
                .map(|_| [0; 4].map(|_| rng.random_range(-1.0..1.0)))
                .collect(),
            opacity_logits: vec![2.944; count],
            sh: vec![0.0; 3 * count],
            sh_degree: 0,
            means: means.clone(),
        };
        let ellipsoids = (0..count)
            .map(|i| Ellipsoid::new(&gaussians, i, 0.1).expect("solid"))
            .collect();
        (ellipsoids, means)
    }

    /// The first member of each ellipsoid's component, by comparing every pair that the rule names.
    fn plain(ellipsoids: &[Ellipsoid], neighbours: usize) -> Vec<u32> {
        let mut sets = DisjointSets::new(ellipsoids.len());
        for (k, ellipsoid) in ellipsoids.iter().enumerate() {
            let mut others: Vec<(f64, usize)> = ellipsoids
                .iter()
                .map(|b| b.center.distance_squared(ellipsoid.center))
                .zip(0..)
                .filter(|o| o.1 != k)
                .collect();
            others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let farthest = others[neighbours - 1].0.sqrt();
            for (rank, &(squared, j)) in others.iter().enumerate() {
                let named = rank < neighbours
                    || (ellipsoid.longest > farthest
                        && squared <= ellipsoid.longest * ellipsoid.longest);
                if named && ellipsoid.touches(&ellipsoids[j]) {
                    sets.union(k, j);
                }
            }
        }
        first_members(&mut sets, ellipsoids.len())
    }

    #[test]
    fn components_are_those_of_all_pairs_at_any_thread_count() {
        // Sparse, half joined and dense; few and many as large as the room.
        for (spread, huge, neighbours) in [
            (0.004, 0, 24),
            (0.01, 3, 24),
            (0.01, 40, 4),
            (0.02, 0, 2),
            (0.02, 2, 24),
            (0.08, 5, 24),
            (0.08, 400, 6),
        ] {
            let (ellipsoids, points) = random(1_200, spread, huge, huge as u64);
            let want = plain(&ellipsoids, neighbours);
            for threads in [1, 2, 5] {
                let pool = rayon::ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .build()
                    .expect("threads");
                let found = pool
                    .install(|| connected_components(&ellipsoids, &points, neighbours))
                    .expect("components");
                assert_eq!(
                    found, want,
                    "{spread} {huge} {neighbours}, {threads} threads"
                );
            }
        }
    }

    #[test]
    fn equal_centres_are_told_apart() {
        let (mut ellipsoids, _) = random(300, 0.05, 4, 1);
        ellipsoids
            .iter_mut()
            .enumerate()
            .for_each(|(i, ellipsoid)| ellipsoid.center = glam::DVec3::splat((i % 3) as f64));
        let points: Vec<[f32; 3]> = ellipsoids
            .iter()
            .map(|ellipsoid| ellipsoid.center.as_vec3().to_array())
            .collect();
        let found = connected_components(&ellipsoids, &points, 24).expect("components");
        assert_eq!(found, plain(&ellipsoids, 24));
    }

    #[test]
    fn many_as_large_as_the_room_end_soon() {
        let (ellipsoids, points) = random(30_000, 0.004, 30_000, 5);
        let found = connected_components(&ellipsoids, &points, 24).expect("components");
        assert!(found.iter().all(|first| *first == 0));
    }
}
