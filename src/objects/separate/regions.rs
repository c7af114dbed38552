//! Bodies grouped by place, so that a search passes over a region all of whose bodies it need not look at.

use glam::DVec3;
use std::collections::HashSet;

/// Bodies of a region that is not divided further, at most.
const LEAF: usize = 16;
/// The chain of a region whose bodies are in several.
const SEVERAL: u32 = u32::MAX;

/// A box, and the bodies in it.
struct Region {
    low: DVec3,
    high: DVec3,
    /// Places in [`Regions::order`].
    first: usize,
    end: usize,
    /// Number of the second half; the first half comes right behind its whole. 0 where it is not divided.
    second: usize,
    /// Chain of all its bodies, or [`SEVERAL`].
    chain: u32,
}

/// Halves of halves of a set of centres. A half has a higher number than its whole.
pub(super) struct Regions {
    regions: Vec<Region>,
    /// Numbers of the bodies, those of a region side by side.
    order: Vec<u32>,
    /// Centre of each, in this order.
    centers: Vec<DVec3>,
    /// Chain of each, in this order.
    chains: Vec<u32>,
}

/// What a search asks for.
pub(super) struct Query {
    pub center: DVec3,
    /// Centres no farther than this are looked at.
    pub radius: f64,
    /// Its own chain, whose bodies are passed over.
    pub chain: u32,
}

impl Regions {
    /// Of fewer than 2^32 - 1 bodies at `centers`, each a chain of its own until [`Regions::tell`] says otherwise.
    pub fn new(centers: &[DVec3]) -> Self {
        let order: Vec<u32> = (0..centers.len() as u32).collect();
        let mut made = Self {
            regions: Vec::new(),
            order,
            centers: Vec::new(),
            chains: Vec::new(),
        };
        if !centers.is_empty() {
            made.divide(centers, 0, centers.len());
        }
        made.centers = made.order.iter().map(|&i| centers[i as usize]).collect();
        made.tell(|i| i);
        made
    }

    fn divide(&mut self, centers: &[DVec3], first: usize, end: usize) {
        let here = &mut self.order[first..end];
        let (low, high) = here
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &i| {
                (low.min(centers[i as usize]), high.max(centers[i as usize]))
            });
        let number = self.regions.len();
        self.regions.push(Region {
            low,
            high,
            first,
            end,
            second: 0,
            chain: SEVERAL,
        });
        if here.len() <= LEAF {
            return;
        }
        let axis = (high - low).max_position();
        let half = here.len() / 2;
        here.select_nth_unstable_by(half, |&a, &b| {
            centers[a as usize][axis]
                .total_cmp(&centers[b as usize][axis])
                .then(a.cmp(&b))
        });
        self.divide(centers, first, first + half);
        self.regions[number].second = self.regions.len();
        self.divide(centers, first + half, end);
    }

    /// Says which chain each body is in.
    pub fn tell(&mut self, mut chain: impl FnMut(u32) -> u32) {
        self.chains = self.order.iter().map(|&i| chain(i)).collect();
        for number in (0..self.regions.len()).rev() {
            let region = &self.regions[number];
            let shared = match region.second {
                0 => {
                    let here = &self.chains[region.first..region.end];
                    if here.iter().all(|chain| *chain == here[0]) {
                        here[0]
                    } else {
                        SEVERAL
                    }
                }
                second => {
                    let [a, b] = [number + 1, second].map(|half| self.regions[half].chain);
                    if a == b { a } else { SEVERAL }
                }
            };
            self.regions[number].chain = shared;
        }
    }

    /// One body of each other chain that `touches` says yes to, where it does for any within reach, and how many regions and
    /// bodies were looked at. Of a chain that is found no more are; the nearer half of a region comes first.
    pub fn touched(
        &self,
        query: &Query,
        mut touches: impl FnMut(u32) -> bool,
    ) -> (Vec<u32>, usize) {
        let (mut found, mut met, mut looked) = (Vec::new(), HashSet::new(), 0);
        let reach = query.radius * query.radius;
        let mut open: Vec<usize> = if self.regions.is_empty() {
            Vec::new()
        } else {
            vec![0]
        };
        while let Some(number) = open.pop() {
            let region = &self.regions[number];
            looked += 1;
            if region.chain == query.chain
                || met.contains(&region.chain)
                || self.apart(number, query) > reach
            {
                continue;
            }
            if region.second != 0 {
                let [a, b] = [number + 1, region.second];
                let a_is_nearer = self.apart(a, query) <= self.apart(b, query);
                open.extend(if a_is_nearer { [b, a] } else { [a, b] });
                continue;
            }
            looked += region.end - region.first;
            for place in region.first..region.end {
                let (chain, body) = (self.chains[place], self.order[place]);
                let near = self.centers[place].distance_squared(query.center) <= reach;
                if !near || chain == query.chain || met.contains(&chain) {
                    continue;
                }
                if touches(body) {
                    met.insert(chain);
                    found.push(body);
                }
            }
        }
        (found, looked)
    }

    /// Squared distance of a query from a region's box; rounded as that of a centre in it is, and so no larger.
    fn apart(&self, number: usize, query: &Query) -> f64 {
        let Region { low, high, .. } = &self.regions[number];
        query
            .center
            .clamp(*low, *high)
            .distance_squared(query.center)
    }
}
