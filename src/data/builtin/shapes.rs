//! The solids the room is made of and where rays meet them. All are convex and star-shaped about their centre.

use glam::{DMat3, DVec3};

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

/// Where a ray enters a solid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    /// Ray parameter.
    pub t: f64,
    /// Outward normal in the local frame, unit length.
    pub normal: DVec3,
}

impl Solid {
    /// A room point in the local frame.
    pub fn to_local(&self, p: DVec3) -> DVec3 {
        self.axes.transpose() * (p - self.center)
    }

    /// A local point in room coordinates.
    pub fn to_room(&self, p: DVec3) -> DVec3 {
        self.axes * p + self.center
    }

    /// Corners of the axis-aligned bounding box in room coordinates.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let reach = DVec3::new(
            self.axes.row(0).abs().dot(self.half),
            self.axes.row(1).abs().dot(self.half),
            self.axes.row(2).abs().dot(self.half),
        );
        (self.center - reach, self.center + reach)
    }

    /// First entry of the room-space ray `o + t d` with `near < t < far`; `None` also when `o` is inside.
    pub fn hit(&self, o: DVec3, d: DVec3, near: f64, far: f64) -> Option<Entry> {
        let inverse = self.axes.transpose();
        self.hit_local(inverse * (o - self.center), inverse * d)
            .filter(|e| e.t > near && e.t < far)
    }

    /// First entry of a local ray, at any parameter.
    pub fn hit_local(&self, o: DVec3, d: DVec3) -> Option<Entry> {
        match self.shape {
            Shape::Box => enter_box(o, d, self.half),
            Shape::Rounded(radius) => enter_rounded(o, d, self.half, radius),
            Shape::Ellipsoid => enter_ellipsoid(o, d, self.half),
            Shape::Frustum(bottom, top) => {
                enter_frustum(o, d, self.half, bottom * self.half.x, top * self.half.x)
            }
        }
    }

    /// Lower bound of the distance from a room point to the solid (exact for boxes, 0 inside the bounding box).
    pub fn clearance(&self, p: DVec3) -> f64 {
        (self.to_local(p).abs() - self.half)
            .max(DVec3::ZERO)
            .length()
    }
}

/// Slab test.
fn enter_box(o: DVec3, d: DVec3, half: DVec3) -> Option<Entry> {
    let inv = d.recip();
    let (a, b) = ((-half - o) * inv, (half - o) * inv);
    let (near, far) = (a.min(b), a.max(b));
    let t = near.max_element();
    if t > far.min_element() {
        return None;
    }
    let axis = if near.x == t {
        DVec3::X
    } else if near.y == t {
        DVec3::Y
    } else {
        DVec3::Z
    };
    Some(Entry {
        t,
        normal: axis * -axis.dot(d).signum(),
    })
}

/// Entry of a sphere of `radius` about `c`.
fn enter_sphere(o: DVec3, d: DVec3, c: DVec3, radius: f64) -> Option<f64> {
    let oc = o - c;
    smaller_root(
        d.length_squared(),
        oc.dot(d),
        oc.length_squared() - radius * radius,
    )
}

/// Smaller root of `a t^2 + 2 b t + c`, in the form that does not cancel.
fn smaller_root(a: f64, b: f64, c: f64) -> Option<f64> {
    let disc = b * b - a * c;
    if !(disc > 0.0 && a > 0.0) {
        return None;
    }
    let root = disc.sqrt();
    Some(if b > 0.0 {
        (-b - root) / a
    } else {
        c / (-b + root)
    })
}

fn enter_ellipsoid(o: DVec3, d: DVec3, half: DVec3) -> Option<Entry> {
    let t = enter_sphere(o / half, d / half, DVec3::ZERO, 1.0)?;
    Some(Entry {
        t,
        normal: ((o + d * t) / (half * half)).normalize(),
    })
}

fn enter_frustum(o: DVec3, d: DVec3, half: DVec3, bottom: f64, top: f64) -> Option<Entry> {
    let slope = (top - bottom) / (2.0 * half.z);
    // Radius along the ray: r(t) = r0 + r1 t.
    let (r0, r1) = (bottom + slope * (o.z + half.z), slope * d.z);
    let mut best: Option<Entry> = None;
    let a = d.x * d.x + d.y * d.y - r1 * r1;
    let b = o.x * d.x + o.y * d.y - r0 * r1;
    let c = o.x * o.x + o.y * o.y - r0 * r0;
    if a.abs() > 1e-14 {
        let disc = b * b - a * c;
        if disc > 0.0 {
            let root = disc.sqrt();
            for t in [(-b - root) / a, (-b + root) / a] {
                let p = o + d * t;
                let normal = DVec3::new(p.x, p.y, -slope * (r0 + r1 * t)).normalize_or_zero();
                // Keeps the nearer sheet that lies between the caps and faces the ray.
                if p.z.abs() <= half.z
                    && r0 + r1 * t >= 0.0
                    && normal.dot(d) < 0.0
                    && best.is_none_or(|e| t < e.t)
                {
                    best = Some(Entry { t, normal });
                }
            }
        }
    }
    if d.z != 0.0 {
        let side = -d.z.signum();
        let t = (side * half.z - o.z) / d.z;
        let p = o + d * t;
        let radius = if side > 0.0 { top } else { bottom };
        if p.x * p.x + p.y * p.y <= radius * radius && best.is_none_or(|e| t < e.t) {
            best = Some(Entry {
                t,
                normal: DVec3::Z * side,
            });
        }
    }
    best
}

/// Box swept by a sphere: flat faces first, then the twelve edge cylinders and eight corner spheres. The solid is
/// convex, so its entry is the first entry of any of these parts.
fn enter_rounded(o: DVec3, d: DVec3, half: DVec3, radius: f64) -> Option<Entry> {
    let outer = enter_box(o, d, half)?;
    let inner = half - DVec3::splat(radius);
    let on_face = (o + d * outer.t) * (DVec3::ONE - outer.normal.abs());
    if on_face.abs().cmple(inner).all() {
        return Some(outer);
    }
    let mut t = f64::INFINITY;
    for axis in 0..3 {
        let mut part = inner;
        part[axis] = half[axis];
        if let Some(e) = enter_box(o, d, part) {
            t = t.min(e.t);
        }
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (su, sv) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let (ou, ov) = (o[u] - su * inner[u], o[v] - sv * inner[v]);
            let root = smaller_root(
                d[u] * d[u] + d[v] * d[v],
                ou * d[u] + ov * d[v],
                ou * ou + ov * ov - radius * radius,
            );
            if let Some(s) = root.filter(|s| (o[axis] + d[axis] * s).abs() <= inner[axis]) {
                t = t.min(s);
            }
        }
    }
    for corner in 0..8 {
        let sign = |bit: usize| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let c = inner * DVec3::new(sign(0), sign(1), sign(2));
        if let Some(s) = enter_sphere(o, d, c, radius) {
            t = t.min(s);
        }
    }
    let p = o + d * t;
    t.is_finite().then(|| Entry {
        t,
        normal: (p - p.clamp(-inner, inner)).normalize_or_zero(),
    })
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
                let Some(e) = s.hit(o, d, 0.0, 10.0) else {
                    // A grazing ray may slip between two marched samples, never the other way round.
                    assert!(march.is_none(), "{shape:?} missed");
                    continue;
                };
                hits += 1;
                let p = s.to_local(o + d * e.t);
                assert!(
                    inside(shape, half, p - e.normal * 1e-6),
                    "{shape:?} {p} {}",
                    e.normal
                );
                assert!(
                    !inside(shape, half, p + e.normal * 1e-6),
                    "{shape:?} {p} {}",
                    e.normal
                );
                assert!(
                    march.is_none_or(|t| t >= e.t - 1e-9),
                    "{shape:?} something before {}",
                    e.t
                );
            }
            assert!(hits > 500, "{shape:?} {hits}");
        }
    }
}
