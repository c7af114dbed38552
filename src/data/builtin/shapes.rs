//! The solids of the room and where rays meet them.

use glam::{DMat3, DVec3};
use std::ops::Range;

/// A convex solid in its local frame, bounded by the box `[-half, half]` of its [`Solid`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// The box itself.
    Box,
    /// The box with edges and corners of this radius (metres, below the smallest half extent).
    Rounded(f64),
    /// The ellipsoid that touches the box.
    Ellipsoid,
    /// A cone frustum along z; radii at the bottom and at the top as fractions of `half.x`.
    Frustum(f64, f64),
}

impl Shape {
    /// Value and gradient at `p` of a convex function that is 0 on the surface and positive outside.
    fn level(self, p: DVec3, half: DVec3) -> (f64, DVec3) {
        let beyond = p.abs() - half;
        match self {
            Self::Box => {
                let axis = beyond.max_position();
                (beyond[axis], DVec3::AXES[axis] * p[axis].signum())
            }
            Self::Rounded(radius) => {
                let beyond = (beyond + radius).max(DVec3::ZERO);
                let normal = beyond.normalize_or_zero() * p.signum();
                (beyond.length() - radius, normal)
            }
            Self::Ellipsoid => {
                let unit = p / half;
                (unit.length() - 1.0, unit.normalize_or_zero() / half)
            }
            Self::Frustum(bottom, top) => {
                let slope = half.x * (top - bottom) / (2.0 * half.z);
                let across = p.with_z(0.0);
                let outside = across.length() - half.x * bottom - slope * (p.z + half.z);
                if outside > beyond.z {
                    (outside, across.normalize_or_zero() - slope * DVec3::Z)
                } else {
                    (beyond.z, DVec3::Z * p.z.signum())
                }
            }
        }
    }
}

/// A solid placed in the room.
#[derive(Clone, Debug)]
pub(super) struct Solid {
    /// Its kind.
    pub shape: Shape,
    /// Half extents along the local axes, metres.
    pub half: DVec3,
    /// Centre in room coordinates.
    pub center: DVec3,
    /// Local to room axes.
    pub axes: DMat3,
    /// Index into the room's materials.
    pub material: usize,
    /// Which object it belongs to.
    pub instance: u16,
    /// Class id of that object.
    pub class: u16,
    /// Lamp shades and window panes let light through.
    pub casts_shadow: bool,
}

/// Distance from a surface, metres, at which a ray has reached it.
const HIT_DISTANCE: f64 = 1e-11;
/// More steps than any ray needs that is not a tangent.
const STEPS: usize = 50;

impl Solid {
    /// A room point in the local frame.
    pub fn to_local(&self, p: DVec3) -> DVec3 {
        self.axes.transpose() * (p - self.center)
    }

    /// A local point in room coordinates.
    pub fn to_room(&self, p: DVec3) -> DVec3 {
        self.axes * p + self.center
    }

    /// Where the local ray `o + t d` enters the solid, `near < t < far`, and the outward normal there. `None` where the ray misses
    /// the solid or starts inside.
    ///
    /// Newton's method on a convex function never passes the first zero when it starts before it.
    pub fn entry(&self, o: DVec3, d: DVec3, near: f64, far: f64) -> Option<(f64, DVec3)> {
        let mut t = near;
        for _ in 0..STEPS {
            let (level, gradient) = self.shape.level(o + d * t, self.half);
            if level < HIT_DISTANCE {
                return (t > near).then(|| (t, gradient.normalize_or_zero()));
            }
            let slope = gradient.dot(d);
            t -= level / slope;
            if slope >= 0.0 || t >= far {
                return None;
            }
        }
        None
    }

    /// Lower bound of the distance from a room point to the solid (exact for boxes, 0 inside the bounding box).
    pub fn clearance(&self, p: DVec3) -> f64 {
        (self.to_local(p).abs() - self.half)
            .max(DVec3::ZERO)
            .length()
    }
}

/// What a ray hit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Ray parameter.
    pub t: f64,
    /// Index of the solid.
    pub solid: usize,
    /// Outward normal in the solid's frame, unit length.
    pub normal: DVec3,
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    low: DVec3,
    high: DVec3,
}

impl Bounds {
    fn of(solid: &Solid) -> Self {
        let axis = |i: usize| solid.axes.row(i).abs().dot(solid.half);
        // A hair of slack keeps rays that lie in a face of the box.
        let reach = DVec3::new(axis(0), axis(1), axis(2)) + 1e-9;
        Self {
            low: solid.center - reach,
            high: solid.center + reach,
        }
    }

    fn union(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }

    /// Whether a ray meets the box between `near` and `far`; `inverse` is the reciprocal of its direction.
    fn meets(&self, o: DVec3, inverse: DVec3, near: f64, far: f64) -> bool {
        let (a, b) = ((self.low - o) * inverse, (self.high - o) * inverse);
        a.min(b).max_element().max(near) <= a.max(b).min_element().min(far)
    }
}

/// All solids of a room. A ray looks at the box of each object first: a room has few.
#[derive(Clone, Debug)]
pub(super) struct Solids {
    /// Solids of one object are neighbours in the list.
    pub all: Vec<Solid>,
    bounds: Vec<Bounds>,
    objects: Vec<(Bounds, Range<usize>)>,
}

impl Solids {
    pub fn new(all: Vec<Solid>) -> Self {
        let bounds: Vec<Bounds> = all.iter().map(Bounds::of).collect();
        let mut objects: Vec<(Bounds, Range<usize>)> = Vec::new();
        for (i, own) in bounds.iter().enumerate() {
            match objects.last_mut() {
                Some((around, solids)) if all[i - 1].instance == all[i].instance => {
                    *around = around.union(*own);
                    solids.end = i + 1;
                }
                _ => objects.push((*own, i..i + 1)),
            }
        }
        Self {
            all,
            bounds,
            objects,
        }
    }

    /// The solids that a ray hits with `near < t < far`, in no order.
    fn hits(&self, o: DVec3, d: DVec3, near: f64, far: f64) -> impl Iterator<Item = Hit> {
        let inverse = d.recip();
        let met = move |bounds: &Bounds| bounds.meets(o, inverse, near, far);
        let objects = self.objects.iter().filter(move |(around, _)| met(around));
        let solids = objects.flat_map(|(_, solids)| solids.clone());
        solids
            .filter(move |&i| met(&self.bounds[i]))
            .filter_map(move |i| {
                let solid = &self.all[i];
                let (t, normal) =
                    solid.entry(solid.to_local(o), solid.axes.transpose() * d, near, far)?;
                Some(Hit {
                    t,
                    solid: i,
                    normal,
                })
            })
    }

    /// The first solid that a ray hits with `near < t < far`.
    pub fn first(&self, o: DVec3, d: DVec3, near: f64, far: f64) -> Option<Hit> {
        nearest(self.hits(o, d, near, far))
    }

    /// The same among the solids that cast shadows.
    pub fn first_opaque(&self, o: DVec3, d: DVec3, far: f64) -> Option<Hit> {
        nearest(self.opaque(o, d, far))
    }

    /// Whether any solid that casts shadows lies between `o` and `o + d`.
    pub fn blocked(&self, o: DVec3, d: DVec3) -> bool {
        self.opaque(o, d, 1.0).next().is_some()
    }

    fn opaque(&self, o: DVec3, d: DVec3, far: f64) -> impl Iterator<Item = Hit> {
        self.hits(o, d, 0.0, far)
            .filter(|hit| self.all[hit.solid].casts_shadow)
    }
}

fn nearest(hits: impl Iterator<Item = Hit>) -> Option<Hit> {
    hits.min_by(|a, b| a.t.total_cmp(&b.t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    fn solid(shape: Shape, half: DVec3) -> Solid {
        let axes = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(0.3);
        let center = DVec3::new(0.2, -0.1, 0.5);
        Solid {
            shape,
            half,
            center,
            axes,
            material: 0,
            instance: 0,
            class: 1,
            casts_shadow: true,
        }
    }

    /// Signed 'is inside' of each shape, written from its definition rather than from the intersection.
    fn inside(shape: Shape, half: DVec3, p: DVec3) -> bool {
        match shape {
            Shape::Box => p.abs().cmple(half).all(),
            Shape::Rounded(r) => {
                let inner = half - DVec3::splat(r);
                (p - p.clamp(-inner, inner)).length() <= r
            }
            Shape::Ellipsoid => (p / half).length() <= 1.0,
            Shape::Frustum(b, t) => {
                let f = (p.z + half.z) / (2.0 * half.z);
                p.z.abs() <= half.z && p.truncate().length() <= half.x * (b + (t - b) * f)
            }
        }
    }

    #[test]
    fn entries_lie_on_the_surface_and_nothing_comes_before_them() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let half = DVec3::new(0.5, 0.5, 0.8);
        for shape in [
            Shape::Box,
            Shape::Rounded(0.2),
            Shape::Ellipsoid,
            Shape::Frustum(1.0, 0.3),
            Shape::Frustum(0.4, 1.0),
        ] {
            let s = solid(shape, half);
            let mut hits = 0;
            for _ in 0..4000 {
                let mut draw =
                    || DVec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - DVec3::ONE;
                let o = s.center + draw().normalize_or(DVec3::X) * 3.0;
                let d = s.center + draw() - o;
                let march = (0..3000)
                    .map(|i| i as f64 * 5e-4)
                    .find(|&t| inside(shape, half, s.to_local(o + d * t)));
                let Some((t, normal)) = s.entry(s.to_local(o), s.axes.transpose() * d, 0.0, 10.0)
                else {
                    // A grazing ray may slip between two marched samples, never the other way round.
                    assert!(march.is_none(), "{shape:?} missed");
                    continue;
                };
                hits += 1;
                let p = s.to_local(o + d * t);
                assert!(
                    inside(shape, half, p - normal * 1e-6),
                    "{shape:?} {p} {}",
                    normal
                );
                assert!(
                    !inside(shape, half, p + normal * 1e-6),
                    "{shape:?} {p} {}",
                    normal
                );
                assert!(
                    march.is_none_or(|marched| marched >= t - 1e-9),
                    "{shape:?} something before {t}"
                );
            }
            assert!(hits > 500, "{shape:?} {hits}");
        }
    }
}
