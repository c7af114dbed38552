//! A smooth path through given cameras.

use super::check;
use crate::error::{Error, Result};
use crate::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3};

/// Parts of each segment whose lengths are summed.
const PARTS: usize = 32;
/// A key closer to the one before it than this share of [`spread`] repeats it.
const SAME: f64 = 1e-9;

/// A smooth path through cameras, the keys, in their order.
///
/// Centres follow a centripetal Catmull-Rom spline (Yuksel, Schaefer, Keyser 2011), camera-to-world rotations Bézier curves
/// of unit quaternions (Shoemake 1985) whose angular velocities at the keys follow the same rule, from key to key the
/// shorter rotation. Velocity and angular velocity are continuous. Focal lengths and principal points are linear between
/// keys. Images have the size of the first key; [`Camera::with_size`] resizes the other keys.
///
/// Lengths are in world units and include rotation: `sqrt(|dc|^2 + (r da)^2)` for a step by `dc` with a rotation by `da` radians,
/// where `r` is the root mean square distance of the keys from their mean, or 1 where they share a centre.
#[derive(Clone, Debug)]
pub struct CameraPath {
    size: [usize; 2],
    keys: Vec<Key>,
    segments: Vec<Segment>,
    /// Length from the start to the end of each part, `PARTS` per segment, after a leading 0.
    lengths: Vec<f64>,
}

/// A camera of the path.
#[derive(Clone, Copy, Debug)]
struct Key {
    center: DVec3,
    /// Camera to world, OpenCV axes.
    rotation: DQuat,
    /// fx, fy, cx, cy.
    intrinsics: [f64; 4],
}

/// Control points of cubic Bézier curves between two keys.
#[derive(Clone, Copy, Debug)]
struct Segment {
    centers: [DVec3; 4],
    rotations: [DQuat; 4],
}

impl CameraPath {
    /// A path through `cameras`. A camera with the pose of the one before it is left out.
    ///
    /// # Errors
    /// [`Error::Argument`] without cameras, or naming the first that is unusable.
    pub fn through(cameras: &[Camera]) -> Result<Self> {
        check(cameras)?;
        let [width, height] = [cameras[0].width, cameras[0].height];
        let mut keys = cameras
            .iter()
            .map(|camera| Key::new(&camera.with_size(width, height)))
            .collect::<Vec<_>>();
        let per_radian = spread(&keys);
        keys.dedup_by(|key, before| distance(before, key, per_radian) <= SAME * per_radian);
        // Again, so that repeated keys have no more weight than the others.
        let per_radian = spread(&keys);

        let step =
            |pair: &[Key]| Step::new(&pair[0], &pair[1], distance(&pair[0], &pair[1], per_radian));
        let steps: Vec<Step> = keys.windows(2).map(step).collect();
        let segment = |(i, pair): (usize, &[Key])| {
            let third = steps[i].knots / 3.0;
            let [start, end] = [velocities(&steps, i), velocities(&steps, i + 1)];
            let [a, b] = [&pair[0], &pair[1]];
            let turned = |q: DQuat, by: DVec3| q * DQuat::from_scaled_axis(by);
            Segment {
                centers: [
                    a.center,
                    a.center + third * start[0],
                    b.center - third * end[0],
                    b.center,
                ],
                rotations: [
                    a.rotation,
                    turned(a.rotation, third * start[1]),
                    turned(b.rotation, -third * end[1]),
                    b.rotation,
                ],
            }
        };
        let segments = keys.windows(2).enumerate().map(segment).collect();
        let mut path = Self {
            size: [width, height],
            keys,
            segments,
            lengths: vec![0.0],
        };
        let (mut length, mut before) = (0.0, path.keys[0]);
        for part in 1..=PARTS * path.segments.len() {
            let key = path.key(
                (part - 1) / PARTS,
                ((part - 1) % PARTS + 1) as f64 / PARTS as f64,
            );
            length += distance(&before, &key, per_radian);
            path.lengths.push(length);
            before = key;
        }
        if !length.is_finite() {
            let help = "give cameras in one place";
            return Err(Error::argument(
                "cameras",
                "centres further apart than numbers reach",
                "a finite path",
                help,
            ));
        }
        Ok(path)
    }

    /// Length of the whole path; 0 for one camera.
    pub fn length(&self) -> f64 {
        self.lengths.last().copied().unwrap_or(0.0)
    }

    /// Position of each key along the path, without repeated ones.
    pub fn key_lengths(&self) -> Vec<f64> {
        self.lengths.iter().step_by(PARTS).copied().collect()
    }

    /// The camera at `length` along the path, clamped to its start and end.
    pub fn at(&self, length: f64) -> Camera {
        let part = self
            .lengths
            .partition_point(|&l| l < length)
            .clamp(1, self.lengths.len().max(2) - 1);
        let key = match self.lengths.get(part) {
            None => self.keys[0],
            Some(&end) => {
                let start = self.lengths[part - 1];
                let within = ((length - start) / (end - start)).clamp(0.0, 1.0);
                // The start, for a part without length and for a length that is not a number.
                let within = if within.is_nan() { 0.0 } else { within };
                let (segment, before) = ((part - 1) / PARTS, (part - 1) % PARTS);
                self.key(segment, (before as f64 + within) / PARTS as f64)
            }
        };
        let [fx, fy, cx, cy] = key.intrinsics;
        let [width, height] = self.size;
        let rotation = DMat3::from_quat(key.rotation).transpose();
        Camera {
            rotation,
            center: key.center,
            fx,
            fy,
            cx,
            cy,
            width,
            height,
        }
    }

    /// `count` cameras at equal distances along the path, from its start to its end; a single one is the start.
    pub fn frames(&self, count: usize) -> Vec<Camera> {
        let step = self.length() / count.saturating_sub(1).max(1) as f64;
        (0..count).map(|i| self.at(step * i as f64)).collect()
    }

    /// The key at `t` in 0..1 of a segment.
    fn key(&self, segment: usize, t: f64) -> Key {
        let Segment { centers, rotations } = &self.segments[segment];
        let [a, b] = [
            self.keys[segment].intrinsics,
            self.keys[segment + 1].intrinsics,
        ];
        Key {
            center: de_casteljau(*centers, |a, b| a.lerp(b, t)),
            rotation: de_casteljau(*rotations, |a, b| {
                a * DQuat::from_scaled_axis(t * turn(a, b))
            })
            .normalize(),
            intrinsics: [0, 1, 2, 3].map(|i| (1.0 - t) * a[i] + t * b[i]),
        }
    }
}

impl Key {
    fn new(camera: &Camera) -> Self {
        let &Camera {
            rotation,
            center,
            fx,
            fy,
            cx,
            cy,
            ..
        } = camera;
        Self {
            center,
            rotation: DQuat::from_mat3(&rotation.transpose()).normalize(),
            intrinsics: [fx, fy, cx, cy],
        }
    }
}

/// Distance of two keys, where a rotation by one radian counts as `per_radian` world units.
fn distance(a: &Key, b: &Key, per_radian: f64) -> f64 {
    a.center
        .distance(b.center)
        .hypot(per_radian * turn(a.rotation, b.rotation).length())
}

/// From one key to the next.
struct Step {
    /// Interval of the spline's parameter. For a centripetal spline, the square root of the distance.
    knots: f64,
    /// Centre and rotation vector per unit of the parameter.
    velocity: [DVec3; 2],
}

impl Step {
    fn new(a: &Key, b: &Key, distance: f64) -> Self {
        let knots = distance.sqrt();
        Self {
            knots,
            velocity: [
                (b.center - a.center) / knots,
                turn(a.rotation, b.rotation) / knots,
            ],
        }
    }
}

/// Velocities at a key: the slope of the parabola through it and its neighbours; at an end the slope of the chord.
fn velocities(steps: &[Step], key: usize) -> [DVec3; 2] {
    match (
        key.checked_sub(1).and_then(|i| steps.get(i)),
        steps.get(key),
    ) {
        (Some(a), Some(b)) => [0, 1]
            .map(|i| (b.knots * a.velocity[i] + a.knots * b.velocity[i]) / (a.knots + b.knots)),
        (Some(one), None) | (None, Some(one)) => one.velocity,
        (None, None) => [DVec3::ZERO; 2],
    }
}

/// The rotation vector that leads from `a` to `b`, in the axes of `a`, at most pi long.
fn turn(a: DQuat, b: DQuat) -> DVec3 {
    let q = a.conjugate() * b;
    // q and -q are one rotation.
    let q = if q.w < 0.0 { -q } else { q };
    let sine = q.xyz().length();
    // sin x = x for the smallest angles.
    let angle_by_sine = if sine < 1e-150 {
        2.0
    } else {
        2.0 * sine.atan2(q.w) / sine
    };
    angle_by_sine * q.xyz()
}

fn de_casteljau<T: Copy>([a, b, c, d]: [T; 4], mix: impl Fn(T, T) -> T) -> T {
    let [ab, bc, cd] = [mix(a, b), mix(b, c), mix(c, d)];
    mix(mix(ab, bc), mix(bc, cd))
}

/// Root mean square distance of the keys from their mean; 1 where that is 0.
fn spread(keys: &[Key]) -> f64 {
    let count = keys.len() as f64;
    let mean = keys.iter().map(|key| key.center / count).sum::<DVec3>();
    let spread = (keys
        .iter()
        .map(|key| key.center.distance_squared(mean))
        .sum::<f64>()
        / count)
        .sqrt();
    // Rounding moves a mean of equal centres.
    if spread > 1e-12 * mean.length() {
        spread
    } else {
        1.0
    }
}
