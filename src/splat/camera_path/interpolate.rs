//! A smooth path through given cameras.

use super::check;
use crate::error::{Result, ensure};
use crate::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3, DVec4};

/// Parts of each segment whose lengths are summed.
const PARTS: usize = 32;
/// A key repeats the key before it when their distance is below this share of [`spread`].
const MIN_DISTANCE: f64 = 1e-9;

/// A smooth path through cameras, the keys, in their order.
///
/// Centres follow a centripetal Catmull-Rom spline (Yuksel, Schaefer, Keyser 2011), camera-to-world rotations follow Bézier curves
/// of unit quaternions (Shoemake 1985). Their angular velocities at the keys follow the same rule. From key to key, the shorter
/// rotation is taken. Velocity and angular velocity are continuous. Focal lengths and principal points are linear between keys.
/// Images have the size of the first key; [`Camera::with_size`] resizes the other keys.
///
/// Lengths are in world units and include rotation: `sqrt(|dc|^2 + (r da)^2)` for a step by `dc` with a rotation by `da` radians,
/// where `r` is the root mean square distance of the keys from their mean, or 1 where they share a centre.
#[derive(Clone, Debug)]
pub struct CameraPath {
    size: [usize; 2],
    start: Key,
    /// Control points of a cubic Bézier curve from each key to the next.
    segments: Vec<[Key; 4]>,
    /// Length from the start to the end of each part, `PARTS` per segment, after a leading 0.
    lengths: Vec<f64>,
}

/// A camera of the path, or a control point of it.
#[derive(Clone, Copy, Debug)]
struct Key {
    center: DVec3,
    /// Camera to world, OpenCV axes.
    rotation: DQuat,
    /// fx, fy, cx, cy.
    intrinsics: DVec4,
}

impl CameraPath {
    /// A path through `cameras`. A camera with the pose of the one before it is left out.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] without cameras, or naming the first that is unusable.
    pub fn through(cameras: &[Camera]) -> Result<Self> {
        check(cameras)?;
        let [width, height] = [cameras[0].width, cameras[0].height];
        let mut keys = cameras
            .iter()
            .map(|camera| Key::new(&camera.with_size(width, height)))
            .collect::<Vec<_>>();
        let per_radian = spread(&keys);
        keys.dedup_by(|key, before| distance(before, key, per_radian) <= MIN_DISTANCE * per_radian);
        // Again, so that repeated keys have no more weight than the others.
        let per_radian = spread(&keys);

        let pairs = keys.windows(2);
        let steps: Vec<Step> = pairs
            .map(|pair| Step::new(&pair[0], &pair[1], per_radian))
            .collect();
        let segment = |(i, pair): (usize, &[Key])| {
            let third = steps[i].knots / 3.0;
            let [start, end] = [velocities(&steps, i), velocities(&steps, i + 1)];
            let [a, b] = [pair[0], pair[1]];
            let intrinsics = |t: f64| a.intrinsics + t * (b.intrinsics - a.intrinsics);
            let after = a.moved(start.map(|v| third * v), intrinsics(1.0 / 3.0));
            let before = b.moved(end.map(|v| -third * v), intrinsics(2.0 / 3.0));
            [a, after, before, b]
        };
        let mut path = Self {
            size: [width, height],
            start: keys[0],
            segments: keys.windows(2).enumerate().map(segment).collect(),
            lengths: vec![0.0],
        };
        let mut length = 0.0;
        let mut before = path.start;
        for part in 0..PARTS * path.segments.len() {
            let key = path.key(part, 1.0);
            length += distance(&before, &key, per_radian);
            path.lengths.push(length);
            before = key;
        }
        ensure!(length.is_finite(), argument "cameras"; found "centres further apart than numbers reach";
            expected "a finite path"; help "give cameras in one place");
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
        let end = self.lengths.partition_point(|&l| l < length);
        let key = match end.min(self.lengths.len() - 1).checked_sub(1) {
            None => self.start,
            Some(part) => {
                let [start, end] = [self.lengths[part], self.lengths[part + 1]];
                self.key(part, ((length - start) / (end - start)).min(1.0))
            }
        };
        let [fx, fy, cx, cy] = key.intrinsics.to_array();
        Camera {
            rotation: DMat3::from_quat(key.rotation).transpose(),
            center: key.center,
            cx,
            cy,
            ..Camera::centred([fx, fy], self.size)
        }
    }

    /// `count` cameras at equal distances along the path, from its start to its end; a single one is the start.
    pub fn frames(&self, count: usize) -> Vec<Camera> {
        let step = self.length() / count.saturating_sub(1).max(1) as f64;
        (0..count).map(|i| self.at(step * i as f64)).collect()
    }

    /// The camera at `within` of a part, from 0 at its start to 1 at its end, by de Casteljau's algorithm.
    fn key(&self, part: usize, within: f64) -> Key {
        let t = ((part % PARTS) as f64 + within) / PARTS as f64;
        let [a, b, c, d] = self.segments[part / PARTS];
        let [ab, bc, cd] = [a.mix(b, t), b.mix(c, t), c.mix(d, t)];
        ab.mix(bc, t).mix(bc.mix(cd, t), t)
    }
}

impl Key {
    fn new(camera: &Camera) -> Self {
        Self {
            center: camera.center,
            rotation: DQuat::from_mat3(&camera.rotation.transpose()).normalize(),
            intrinsics: DVec4::new(camera.fx, camera.fy, camera.cx, camera.cy),
        }
    }

    /// The pose after a shift and a rotation by a vector in the key's axes, with these intrinsics.
    fn moved(self, [shift, turn]: [DVec3; 2], intrinsics: DVec4) -> Self {
        Self {
            center: self.center + shift,
            rotation: (self.rotation * DQuat::from_scaled_axis(turn)).normalize(),
            intrinsics,
        }
    }

    /// The key at `t` on the way to another one, from 0 to 1.
    fn mix(self, other: Self, t: f64) -> Self {
        let shift = t * (other.center - self.center);
        let turn = t * turn(self.rotation, other.rotation);
        // In this form equal intrinsics stay the same to the last bit.
        let intrinsics = self.intrinsics + t * (other.intrinsics - self.intrinsics);
        self.moved([shift, turn], intrinsics)
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
    fn new(a: &Key, b: &Key, per_radian: f64) -> Self {
        let knots = distance(a, b, per_radian).sqrt();
        Self {
            knots,
            velocity: [
                (b.center - a.center) / knots,
                turn(a.rotation, b.rotation) / knots,
            ],
        }
    }
}

/// Velocities at a key: the slope of the parabola through the key and its neighbours. At an end, the slope of the chord.
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
    q.to_scaled_axis()
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
