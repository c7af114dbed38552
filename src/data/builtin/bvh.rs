//! Bounding-volume hierarchy over the solids of a room.

use super::shapes::{Entry, Solid};
use glam::DVec3;

/// What a ray hit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Ray parameter.
    pub t: f64,
    /// Index of the solid.
    pub solid: usize,
    /// Outward normal in the solid's frame.
    pub normal: DVec3,
}

#[derive(Clone, Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// Leaf: first entry of `order`. Inner node: index of the right child (the left one follows the node).
    link: usize,
    /// Solids of a leaf; 0 for inner nodes.
    count: usize,
    /// Axis an inner node is split along; the left child lies lower.
    axis: usize,
}

/// Binary tree, split where the surface-area estimate of the cost of a ray is least.
#[derive(Clone, Debug)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    order: Vec<usize>,
}

impl Bvh {
    /// Builds the tree; `solids` may be empty.
    pub fn new(solids: &[Solid]) -> Self {
        let bounds: Vec<_> = solids.iter().map(Solid::bounds).collect();
        let mut order: Vec<usize> = (0..solids.len()).collect();
        let mut nodes = Vec::with_capacity(2 * solids.len());
        if !order.is_empty() {
            build(&mut nodes, &mut order, 0, &bounds);
        }
        Self { nodes, order }
    }

    /// First hit with `near < t < far` among solids for which `keep` holds.
    pub fn first(
        &self,
        solids: &[Solid],
        o: DVec3,
        d: DVec3,
        (near, far): (f64, f64),
        keep: impl Fn(&Solid) -> bool,
    ) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        self.walk(o, d, near, far, |i, far| {
            let Entry { t, normal } = solids[i]
                .hit(o, d, near, far)
                .filter(|_| keep(&solids[i]))?;
            best = Some(Hit {
                t,
                solid: i,
                normal,
            });
            Some(t)
        });
        best
    }

    /// Whether any shadow-casting solid lies on `o + t d`, `near < t < far`.
    pub fn blocked(&self, solids: &[Solid], o: DVec3, d: DVec3, near: f64, far: f64) -> bool {
        let mut found = false;
        self.walk(o, d, near, far, |i, far| {
            found |= solids[i].casts_shadow && solids[i].hit(o, d, near, far).is_some();
            found.then_some(f64::NEG_INFINITY)
        });
        found
    }

    /// Visits the solids whose boxes the ray meets; `visit` returns the new far end when it shortens the ray.
    fn walk(
        &self,
        o: DVec3,
        d: DVec3,
        near: f64,
        mut far: f64,
        mut visit: impl FnMut(usize, f64) -> Option<f64>,
    ) {
        let inv = d.recip();
        let mut stack = [0_usize; 64];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let at = stack[top];
            let node = &self.nodes[at];
            let (a, b) = ((node.low - o) * inv, (node.high - o) * inv);
            let (enter, leave) = (
                a.min(b).max_element().max(near),
                a.max(b).min_element().min(far),
            );
            if enter > leave {
                continue;
            }
            if node.count == 0 {
                // The nearer child is visited first.
                let (first, second) = if d[node.axis] < 0.0 {
                    (node.link, at + 1)
                } else {
                    (at + 1, node.link)
                };
                stack[top] = second;
                stack[top + 1] = first;
                top += 2;
                continue;
            }
            for &i in &self.order[node.link..node.link + node.count] {
                if let Some(t) = visit(i, far) {
                    far = t;
                }
            }
        }
    }
}

/// Smallest box around some solids.
fn hull(order: &[usize], bounds: &[(DVec3, DVec3)]) -> (DVec3, DVec3) {
    let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    order
        .iter()
        .fold(empty, |(l, h), &i| (l.min(bounds[i].0), h.max(bounds[i].1)))
}

fn area((low, high): (DVec3, DVec3)) -> f64 {
    let s = high - low;
    s.x * s.y + s.y * s.z + s.z * s.x
}

/// Appends the subtree over `order` (whose first entry is number `first` of the whole order).
fn build(nodes: &mut Vec<Node>, order: &mut [usize], first: usize, bounds: &[(DVec3, DVec3)]) {
    let whole = hull(order, bounds);
    // A hair of slack keeps rays that lie in a face of the box.
    let slack = DVec3::splat(1e-9);
    let at = nodes.len();
    nodes.push(Node {
        low: whole.0 - slack,
        high: whole.1 + slack,
        link: first,
        count: order.len(),
        axis: 0,
    });
    let count = order.len();
    let sort = |order: &mut [usize], axis: usize| {
        let key = |i: usize| bounds[i].0[axis] + bounds[i].1[axis];
        order.sort_by(|&i, &j| key(i).total_cmp(&key(j)).then(i.cmp(&j)));
    };
    // Cost of a leaf, in solid tests; two box tests cost about as much as one solid.
    let (mut best, mut choice) = (count as f64 * area(whole), None);
    for axis in 0..3 {
        sort(order, axis);
        let mut box_so_far = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut right = vec![0.0; count];
        for k in (1..count).rev() {
            let (l, h) = bounds[order[k]];
            box_so_far = (box_so_far.0.min(l), box_so_far.1.max(h));
            right[k] = area(box_so_far);
        }
        box_so_far = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for k in 1..count {
            let (l, h) = bounds[order[k - 1]];
            box_so_far = (box_so_far.0.min(l), box_so_far.1.max(h));
            let cost =
                0.7 * area(whole) + area(box_so_far) * k as f64 + right[k] * (count - k) as f64;
            if cost < best {
                (best, choice) = (cost, Some((axis, k)));
            }
        }
    }
    let Some((axis, half)) = choice.or((count > 8).then_some((0, count / 2))) else {
        return;
    };
    sort(order, axis);
    let (left, right) = order.split_at_mut(half);
    build(nodes, left, first, bounds);
    nodes[at].count = 0;
    nodes[at].axis = axis;
    nodes[at].link = nodes.len();
    build(nodes, right, first + half, bounds);
}
