//! A slow, plain rasterizer in f64 that shares no code with the crate: textbook EWA with a 2x2 covariance, its inverse,
//! and one loop over all Gaussians for every pixel. Also scenes to render.

use coseg::raster::{Settings, Splats};
use coseg::splat::Gaussians;
use coseg::splat::camera::Camera;
use glam::{DMat3, DQuat, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The pixels of an image of `width` and `height`, row by row.
pub fn all_pixels([width, height]: [usize; 2]) -> Vec<u32> {
    (0..(width * height) as u32).collect()
}

/// Geometry in f64; f32 copies are made from it.
#[derive(Clone, Debug, Default)]
pub struct Cloud {
    pub means: Vec<f64>,
    pub log_scales: Vec<f64>,
    pub rotations: Vec<f64>,
    pub opacity_logits: Vec<f64>,
}

impl Cloud {
    pub fn splats(&self) -> Splats<'_, f64> {
        Splats {
            means: &self.means,
            log_scales: &self.log_scales,
            rotations: &self.rotations,
            opacity_logits: &self.opacity_logits,
        }
    }

    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    pub fn push(&mut self, mean: [f64; 3], scale: [f64; 3], rotation: [f64; 4], logit: f64) {
        self.means.extend(mean);
        self.log_scales.extend(scale.map(f64::ln));
        self.rotations.extend(rotation);
        self.opacity_logits.push(logit);
    }

    /// Rounds every number to f32.
    pub fn rounded(mut self) -> Self {
        for v in [
            &mut self.means,
            &mut self.log_scales,
            &mut self.rotations,
            &mut self.opacity_logits,
        ] {
            v.iter_mut().for_each(|x| *x = f64::from(*x as f32));
        }
        self
    }

    /// The numbers as f32.
    pub fn single(&self) -> [Vec<f32>; 4] {
        [
            &self.means,
            &self.log_scales,
            &self.rotations,
            &self.opacity_logits,
        ]
        .map(|v| v.iter().map(|&x| x as f32).collect())
    }
}

/// A camera at the origin, turned a little.
pub fn camera(width: usize, height: usize) -> Camera {
    let rotation = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.1, -0.2, 0.05));
    Camera {
        rotation,
        center: DVec3::new(0.3, -0.1, 0.2),
        fx: 0.9 * width as f64,
        fy: 0.8 * width as f64,
        cx: 0.52 * width as f64,
        cy: 0.47 * height as f64,
        width,
        height,
    }
}

/// `n` Gaussians in front of `camera`, scales around `scale`, opacities 0.1 to 0.9.
pub fn cloud(n: usize, scale: f64, camera: &Camera, seed: u64) -> Cloud {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Cloud::default();
    for _ in 0..n {
        let depth = rng.random_range(1.5..6.0);
        let u = rng.random_range(-0.1..1.1) * camera.width as f64;
        let v = rng.random_range(-0.1..1.1) * camera.height as f64;
        let mean = camera.center + camera.ray(u, v) * depth;
        let s = std::array::from_fn(|_| scale * depth * rng.random_range(0.3..2.0));
        let q = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        out.push(mean.to_array(), s, q, rng.random_range(-2.2..2.2));
    }
    out
}

/// Uniform numbers in -1..1.
pub fn numbers(n: usize, seed: u64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// What the reference makes of a view.
pub struct Reference {
    pub image: Vec<f64>,
    pub transmittance: Vec<f64>,
    /// `(pixel, Gaussian, weight)`, pixel by pixel, front to back.
    pub weights: Vec<(usize, usize, f64)>,
    /// Decisions of each pixel that rounding may turn.
    pub doubts: Vec<Vec<Doubt>>,
    /// `3 sqrt(lambda_max)` of each Gaussian in pixels, before it is rounded up; 0 behind the near plane.
    pub reaches: Vec<f64>,
}

impl Reference {
    /// The smallest distance of a pair from a cut-off.
    pub fn margin(&self) -> f64 {
        let doubts = self.doubts.iter().flatten();
        let cuts = doubts.filter(|doubt| doubt.decision != Decision::Order);
        cuts.map(|doubt| doubt.distance)
            .fold(f64::INFINITY, f64::min)
    }
}

/// A decision of the blending loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Whether alpha' is below `alpha_min`, or the transmittance at or below `t_min`.
    Cut,
    /// Whether alpha' is capped. The picture does not jump there, only its gradient does.
    Cap,
    /// Which of two Gaussians that a pixel blends one after the other, at unequal depths, comes first.
    Order,
}

/// A decision that rounding may turn.
#[derive(Clone, Copy, Debug)]
pub struct Doubt {
    pub decision: Decision,
    /// Distance of the number that is compared from its threshold, relative to the threshold.
    pub distance: f64,
    /// Largest change of the blending weights if the decision turns.
    pub jump: f64,
}

/// A decision farther than this from its threshold is not recorded; nor is one that a pixel would take only if another had turned.
pub const DOUBTFUL: f64 = 0.02;

/// Renders `values` `[N, channels]`.
pub fn render(
    cloud: &Cloud,
    values: &[f64],
    channels: usize,
    camera: &Camera,
    s: &Settings,
) -> Reference {
    render_shifted(
        cloud,
        values,
        channels,
        camera,
        s,
        &vec![0.0; 2 * cloud.len()],
    )
}

/// [`render`] with the projected centres moved by `shifts` pixels, `[N, 2]`.
pub fn render_shifted(
    cloud: &Cloud,
    values: &[f64],
    channels: usize,
    camera: &Camera,
    s: &Settings,
    shifts: &[f64],
) -> Reference {
    struct Flat {
        id: usize,
        z: f64,
        mean: [f64; 2],
        inverse: [f64; 3],
        opacity: f64,
    }
    let mut flat = Vec::new();
    let mut reaches = vec![0.0; cloud.len()];
    for id in 0..cloud.len() {
        let at = |v: &[f64], w: usize| v[id * w..(id + 1) * w].to_vec();
        let (m, l, q) = (
            at(&cloud.means, 3),
            at(&cloud.log_scales, 3),
            at(&cloud.rotations, 4),
        );
        let p = camera.rotation * (DVec3::new(m[0], m[1], m[2]) - camera.center);
        if p.z <= s.near {
            continue;
        }
        let quat = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
        let quat = if quat.length_squared() < 1e-12 {
            DQuat::IDENTITY
        } else {
            quat.normalize()
        };
        let scale = DMat3::from_diagonal(DVec3::new(l[0].exp(), l[1].exp(), l[2].exp()));
        let m3 = camera.rotation * DMat3::from_quat(quat) * scale;
        let sigma = m3 * m3.transpose();
        let (w, h) = (camera.width as f64, camera.height as f64);
        let tx = (p.x / p.z).clamp(
            -(0.15 * w + camera.cx) / camera.fx,
            (1.15 * w - camera.cx) / camera.fx,
        );
        let ty = (p.y / p.z).clamp(
            -(0.15 * h + camera.cy) / camera.fy,
            (1.15 * h - camera.cy) / camera.fy,
        );
        let j1 = DVec3::new(camera.fx / p.z, 0.0, -camera.fx * tx / p.z);
        let j2 = DVec3::new(0.0, camera.fy / p.z, -camera.fy * ty / p.z);
        let (a, b, c) = (
            j1.dot(sigma * j1) + s.low_pass,
            j1.dot(sigma * j2),
            j2.dot(sigma * j2) + s.low_pass,
        );
        let det = a * c - b * b;
        let middle = 0.5 * (a + c);
        reaches[id] = 3.0 * (middle + (0.25 * (a - c).powi(2) + b * b).sqrt()).sqrt();
        flat.push(Flat {
            id,
            z: p.z,
            mean: [
                camera.fx * p.x / p.z + camera.cx + shifts[2 * id],
                camera.fy * p.y / p.z + camera.cy + shifts[2 * id + 1],
            ],
            inverse: [c / det, -b / det, a / det],
            opacity: 1.0 / (1.0 + (-cloud.opacity_logits[id]).exp()),
        });
    }
    flat.sort_by(|a, b| a.z.total_cmp(&b.z).then(a.id.cmp(&b.id)));
    let pixels = camera.width * camera.height;
    let mut out = Reference {
        image: vec![0.0; pixels * channels],
        transmittance: vec![1.0; pixels],
        weights: Vec::new(),
        doubts: vec![Vec::new(); pixels],
        reaches,
    };
    for pixel in 0..pixels {
        let (px, py) = (
            (pixel % camera.width) as f64 + 0.5,
            (pixel / camera.width) as f64 + 0.5,
        );
        let mut t = 1.0;
        // Depth and weight of the Gaussian that was blended last.
        let mut last: Option<(f64, f64)> = None;
        for g in &flat {
            let (dx, dy) = (px - g.mean[0], py - g.mean[1]);
            let power = -0.5
                * (g.inverse[0] * dx * dx + 2.0 * g.inverse[1] * dx * dy + g.inverse[2] * dy * dy);
            let raw = g.opacity * power.exp();
            let alpha = raw.min(s.alpha_max);
            let mut decide = |decision: Decision, x: f64, cut: f64, jump: f64| {
                let distance = (x - cut).abs() / cut;
                if cut > 0.0 && distance < DOUBTFUL {
                    out.doubts[pixel].push(Doubt {
                        decision,
                        distance,
                        jump,
                    });
                }
            };
            decide(Decision::Cut, raw, s.alpha_min, alpha * t);
            if alpha < s.alpha_min {
                continue;
            }
            decide(Decision::Cap, raw, s.alpha_max, 0.0);
            decide(Decision::Cut, t * (1.0 - alpha), s.t_min, t);
            if let Some((depth, before)) = last
                && g.z > depth
            {
                decide(Decision::Order, g.z, depth, before * alpha);
            }
            last = Some((g.z, alpha * t));
            if t * (1.0 - alpha) <= s.t_min {
                break;
            }
            for c in 0..channels {
                out.image[pixel * channels + c] += alpha * t * values[g.id * channels + c];
            }
            out.weights.push((pixel, g.id, alpha * t));
            t *= 1.0 - alpha;
        }
        out.transmittance[pixel] = t;
    }
    out
}

/// The first cloud of `n` Gaussians, numbers of f32, in which no pair is as close as `margin` to a cut-off, so that neither rounding
/// nor a small step crosses one.
pub fn cloud_far_from_cuts(n: usize, camera: &Camera, settings: &Settings, margin: f64) -> Cloud {
    let far = |c: &Cloud| render(c, &vec![0.0; n], 1, camera, settings).margin() > margin;
    (0..1000)
        .map(|seed| cloud(n, 0.06, camera, seed).rounded())
        .find(far)
        .expect("such a scene")
}

/// 400 random Gaussians with view-dependent colours.
pub fn colored_gaussians(camera: &Camera, scale: f64) -> Gaussians {
    let cloud = cloud(400, scale, camera, 21);
    let [means, log_scales, rotations, opacity_logits] = cloud.single();
    let triples = |v: &[f32]| v.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    let sh = numbers(12 * cloud.len(), 8)
        .into_iter()
        .map(|v| v as f32)
        .collect();
    Gaussians {
        means: triples(&means),
        log_scales: triples(&log_scales),
        rotations: rotations
            .chunks_exact(4)
            .map(|c| [c[0], c[1], c[2], c[3]])
            .collect(),
        opacity_logits,
        sh,
        sh_degree: 1,
    }
}
