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
}

/// Binary tree, split at the median of the widest axis.
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
            let Entry { t, normal } = solids[i].hit(o, d, near, far).filter(|_| keep(&solids[i]))?;
            best = Some(Hit { t, solid: i, normal });
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
    fn walk(&self, o: DVec3, d: DVec3, near: f64, mut far: f64, mut visit: impl FnMut(usize, f64) -> Option<f64>) {
        let inv = d.recip();
        let mut stack = [0_usize; 64];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let at = stack[top];
            let node = &self.nodes[at];
            let (a, b) = ((node.low - o) * inv, (node.high - o) * inv);
            let (enter, leave) = (a.min(b).max_element().max(near), a.max(b).min_element().min(far));
            if !(enter <= leave) {
                continue;
            }
            if node.count == 0 {
                stack[top] = node.link;
                stack[top + 1] = at + 1;
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

/// Appends the subtree over `order` (whose first entry is number `first` of the whole order).
fn build(nodes: &mut Vec<Node>, order: &mut [usize], first: usize, bounds: &[(DVec3, DVec3)]) {
    let (low, high) = order
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), &i| (l.min(bounds[i].0), h.max(bounds[i].1)));
    // A hair of slack keeps rays that lie in a face of the box.
    let slack = DVec3::splat(1e-9);
    let at = nodes.len();
    nodes.push(Node { low: low - slack, high: high + slack, link: first, count: order.len() });
    if order.len() <= 2 {
        return;
    }
    let size = high - low;
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let key = |i: usize| bounds[i].0[axis] + bounds[i].1[axis];
    order.sort_by(|&i, &j| key(i).total_cmp(&key(j)).then(i.cmp(&j)));
    let half = order.len() / 2;
    let (left, right) = order.split_at_mut(half);
    build(nodes, left, first, bounds);
    nodes[at].count = 0;
    nodes[at].link = nodes.len();
    build(nodes, right, first + half, bounds);
}
