//! Bodies that hang together: disjoint sets, joined where two touch.

use super::body::Body;
use super::regions::{Query, Regions};
use crate::error::Result;
use crate::segmentation::neighbours::PointIndex;
use rayon::prelude::*;

/// Bodies whose touching pairs are in memory at once.
const BLOCK: usize = 1 << 16;
/// Large bodies that are looked at before the first that know what these have joined.
const FIRST: usize = 16;

/// Disjoint sets, each named by its smallest member.
pub(super) struct Chains(Vec<u32>);

impl Chains {
    /// Which of `bodies`, centred at `points`, hang together: each is compared with its `neighbours` nearest, and one whose
    /// longest half-axis reaches beyond these with all centres within it.
    pub fn of(bodies: &[Body], points: &[[f32; 3]], neighbours: usize) -> Result<Self> {
        Ok(Self::counted(bodies, points, neighbours)?.0)
    }

    /// These, and how many regions and bodies were looked at for the large ones.
    fn counted(bodies: &[Body], points: &[[f32; 3]], neighbours: usize) -> Result<(Self, usize)> {
        let near =
            PointIndex::new(points)?.neighbours(neighbours.saturating_add(1).min(points.len()));
        let mut chains = Self((0..bodies.len() as u32).collect());
        let touching = |k: usize, others: &[u32]| -> Vec<(u32, u32)> {
            let touched = others
                .iter()
                .filter(|&&j| bodies[k].touches(&bodies[j as usize]));
            touched.map(|&j| (k as u32, j)).collect()
        };
        // Block by block, so that not all pairs of a large label are in memory.
        for block in (0..bodies.len()).step_by(BLOCK) {
            let block = block..(block + BLOCK).min(bodies.len());
            let pairs: Vec<_> = block
                .into_par_iter()
                .map(|k| touching(k, &near.row(k)[1..]))
                .collect();
            pairs
                .into_iter()
                .flatten()
                .for_each(|(a, b)| chains.join(a, b));
        }
        // A large one may touch more than its nearest, which can all lie at one of its sides.
        let reaches_on = |k: &u32| {
            let body = &bodies[*k as usize];
            let farthest = near
                .row(*k as usize)
                .last()
                .map_or(0.0, |&j| bodies[j as usize].center.distance(body.center));
            body.longest > farthest
        };
        let mut large: Vec<u32> = (0..bodies.len() as u32)
            .into_par_iter()
            .filter(reaches_on)
            .collect();
        // From the largest on, in blocks that double: what the first join is one chain to those after them, and passed over.
        large.par_sort_unstable_by(|&a, &b| {
            bodies[b as usize]
                .longest
                .total_cmp(&bodies[a as usize].longest)
                .then(a.cmp(&b))
        });
        let centers: Vec<_> = if large.is_empty() {
            Vec::new()
        } else {
            bodies.iter().map(|b| b.center).collect()
        };
        let mut regions = Regions::new(&centers);
        let (mut rest, mut size, mut looked) = (&large[..], FIRST, 0);
        while !rest.is_empty() {
            let (block, after) = rest.split_at(size.min(rest.len()));
            regions.tell(|i| chains.first(i));
            let block: Vec<(u32, u32)> = block.iter().map(|&k| (k, chains.first(k))).collect();
            let touched: Vec<_> = block
                .par_iter()
                .map(|&(k, chain)| {
                    let body = &bodies[k as usize];
                    let query = Query {
                        center: body.center,
                        radius: body.longest,
                        chain,
                    };
                    (
                        k,
                        regions.touched(&query, |j| body.touches(&bodies[j as usize])),
                    )
                })
                .collect();
            for (k, (others, cost)) in touched {
                others.into_iter().for_each(|j| chains.join(k, j));
                looked += cost;
            }
            (rest, size) = (after, BLOCK.min(2 * size));
        }
        Ok((chains, looked))
    }

    /// The smallest member of the set that `i` is in.
    pub fn first(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.first(a), self.first(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::Gaussians;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Random ellipsoids in a room of side 1, the first `huge` of them as large as it.
    fn random(count: usize, spread: f32, huge: usize, seed: u64) -> (Vec<Body>, Vec<[f32; 3]>) {
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
        let bodies = (0..count)
            .map(|i| Body::new(&gaussians, i, 0.1).expect("solid"))
            .collect();
        (bodies, means)
    }

    /// The first member of each body's chain, by comparing every pair that the rule names.
    fn plain(bodies: &[Body], neighbours: usize) -> Vec<u32> {
        let mut chains = Chains((0..bodies.len() as u32).collect());
        for (k, body) in bodies.iter().enumerate() {
            let mut others: Vec<(f64, usize)> = bodies
                .iter()
                .map(|b| b.center.distance_squared(body.center))
                .zip(0..)
                .filter(|o| o.1 != k)
                .collect();
            others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let farthest = others[neighbours - 1].0.sqrt();
            for (rank, &(squared, j)) in others.iter().enumerate() {
                let named = rank < neighbours
                    || (body.longest > farthest && squared <= body.longest * body.longest);
                if named && body.touches(&bodies[j]) {
                    chains.join(k as u32, j as u32);
                }
            }
        }
        firsts(&mut chains)
    }

    fn firsts(chains: &mut Chains) -> Vec<u32> {
        (0..chains.0.len() as u32)
            .map(|i| chains.first(i))
            .collect()
    }

    #[test]
    fn chains_are_those_of_all_pairs_at_any_thread_count() {
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
            let (bodies, points) = random(1_200, spread, huge, huge as u64);
            let want = plain(&bodies, neighbours);
            for threads in [1, 2, 5] {
                let pool = rayon::ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .build()
                    .expect("threads");
                let mut found = pool
                    .install(|| Chains::of(&bodies, &points, neighbours))
                    .expect("chains");
                assert_eq!(
                    firsts(&mut found),
                    want,
                    "{spread} {huge} {neighbours}, {threads} threads"
                );
            }
        }
    }

    #[test]
    fn equal_centres_are_told_apart() {
        let (mut bodies, _) = random(300, 0.05, 4, 1);
        bodies
            .iter_mut()
            .enumerate()
            .for_each(|(i, body)| body.center = glam::DVec3::splat((i % 3) as f64));
        let points: Vec<[f32; 3]> = bodies
            .iter()
            .map(|body| body.center.as_vec3().to_array())
            .collect();
        let mut found = Chains::of(&bodies, &points, 24).expect("chains");
        assert_eq!(firsts(&mut found), plain(&bodies, 24));
    }

    #[test]
    fn large_ones_pass_over_what_they_are_joined_to() {
        // All as large as the room; and 500 such ones among small ones that touch nothing else.
        for (huge, most) in [(30_000, 40_000), (500, 1_500_000)] {
            let (bodies, points) = random(30_000, 0.004, huge, 5);
            let (_, looked) = Chains::counted(&bodies, &points, 24).expect("chains");
            let in_reach = |body: &Body| {
                let reaches = |other: &&Body| other.center.distance(body.center) <= body.longest;
                bodies.iter().filter(reaches).count()
            };
            let all = bodies[..100].iter().map(in_reach).sum::<usize>() / 100 * huge;
            assert!(
                looked < most && all > 5 * most,
                "{looked} of {all} for {huge} large ones"
            );
        }
    }
}
