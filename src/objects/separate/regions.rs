//! A bounding volume hierarchy over centres whose searches skip regions of one component.

use glam::DVec3;
use std::collections::HashSet;

/// Most ellipsoids of a region that is not divided further.
const LEAF: usize = 16;
/// The component of a region whose ellipsoids belong to several.
const SEVERAL: u32 = u32::MAX;

/// A box and the ellipsoids with centres in it.
struct Region {
    low: DVec3,
    high: DVec3,
    /// Places in [`Regions::order`].
    first: usize,
    end: usize,
    /// Number of the second half. The first half follows its whole. 0 for a leaf.
    second: usize,
    /// Component of all its ellipsoids, or [`SEVERAL`].
    component: u32,
}

/// The hierarchy. A half has a higher number than its whole.
pub(super) struct Regions {
    regions: Vec<Region>,
    /// Numbers of the ellipsoids, those of a region side by side.
    order: Vec<u32>,
    /// Centre of each, in this order.
    centers: Vec<DVec3>,
    /// Component of each, in this order.
    components: Vec<u32>,
}

/// A search for ellipsoids that touch one.
pub(super) struct Query {
    pub center: DVec3,
    /// The search visits centres no farther than this.
    pub radius: f64,
    /// Its own component, which the search skips.
    pub component: u32,
}

impl Regions {
    /// Of fewer than 2^32 - 1 ellipsoids at `centers`, each a component of its own until [`Regions::set_components`].
    pub fn new(centers: &[DVec3]) -> Self {
        let order: Vec<u32> = (0..centers.len() as u32).collect();
        let mut regions = Self {
            regions: Vec::new(),
            order,
            centers: Vec::new(),
            components: Vec::new(),
        };
        if !centers.is_empty() {
            regions.divide(centers, 0, centers.len());
        }
        regions.centers = regions.order.iter().map(|&i| centers[i as usize]).collect();
        regions.set_components(|i| i);
        regions
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
            component: SEVERAL,
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

    /// Sets the component of each ellipsoid.
    pub fn set_components(&mut self, mut component: impl FnMut(u32) -> u32) {
        self.components = self.order.iter().map(|&i| component(i)).collect();
        for number in (0..self.regions.len()).rev() {
            let region = &self.regions[number];
            let shared = match region.second {
                0 => {
                    let here = &self.components[region.first..region.end];
                    if here.iter().all(|component| *component == here[0]) {
                        here[0]
                    } else {
                        SEVERAL
                    }
                }
                second => {
                    let [a, b] = [number + 1, second].map(|half| self.regions[half].component);
                    if a == b { a } else { SEVERAL }
                }
            };
            self.regions[number].component = shared;
        }
    }

    /// One ellipsoid of each other component that `touches` accepts within reach, and how many regions and ellipsoids the search
    /// visited. It skips a component once it has found one of it, and visits the nearer half of a region first.
    pub fn touched(
        &self,
        query: &Query,
        mut touches: impl FnMut(u32) -> bool,
    ) -> (Vec<u32>, usize) {
        let mut found = Vec::new();
        let mut met = HashSet::new();
        let mut visited = 0;
        let reach = query.radius * query.radius;
        let mut open: Vec<usize> = if self.regions.is_empty() {
            Vec::new()
        } else {
            vec![0]
        };
        while let Some(number) = open.pop() {
            let region = &self.regions[number];
            visited += 1;
            if region.component == query.component
                || met.contains(&region.component)
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
            visited += region.end - region.first;
            for place in region.first..region.end {
                let (component, ellipsoid) = (self.components[place], self.order[place]);
                let near = self.centers[place].distance_squared(query.center) <= reach;
                if !near || component == query.component || met.contains(&component) {
                    continue;
                }
                if touches(ellipsoid) {
                    met.insert(component);
                    found.push(ellipsoid);
                }
            }
        }
        (found, visited)
    }

    /// Squared distance of a query from a region's box. It rounds as that of a centre in the box does, so it is no larger.
    fn apart(&self, number: usize, query: &Query) -> f64 {
        let Region { low, high, .. } = &self.regions[number];
        query
            .center
            .clamp(*low, *high)
            .distance_squared(query.center)
    }
}
