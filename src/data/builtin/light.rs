//! View-independent light: soft daylight from windows, lamps with shadows, and ambient occlusion, stored in light maps.

use super::build::Light;
use super::shapes::Solids;
use crate::data::bilinear::among;
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Reach of ambient occlusion, metres.
const OCCLUSION_REACH: f64 = 1.5;
/// Distance of shadow rays from their surface, metres.
const SHADOW_OFFSET: f64 = 2e-3;

/// Solids and lights: all that light depends on.
#[derive(Clone, Debug)]
pub(super) struct Lit<'a> {
    pub solids: &'a Solids,
    pub lights: &'a [Light],
    /// Ambient rays a point, and samples along each side of a window.
    pub quality: (usize, usize),
}

impl Lit<'_> {
    /// Light that arrives at room point `p` with unit normal `n` (linear, white is about 1), and the share of open directions.
    /// Points inside furniture have no open direction.
    pub fn arriving(&self, p: DVec3, n: DVec3) -> (DVec3, f64) {
        let o = p + n * SHADOW_OFFSET;
        let (open, ambient) = self.ambient(o, n);
        if open <= 0.02 {
            return (DVec3::ZERO, 0.0);
        }
        // A little more light from above, a little warmth from the floor.
        let tint = DVec3::new(0.50, 0.50, 0.51).lerp(DVec3::new(0.44, 0.41, 0.37), 0.5 - 0.5 * n.z);
        let direct: DVec3 = self.lights.iter().map(|l| self.direct(l, o, n)).sum();
        (tint * ambient + direct, open)
    }

    /// Share of open directions and occlusion-weighted share, over fixed cosine-weighted rays.
    fn ambient(&self, o: DVec3, n: DVec3) -> (f64, f64) {
        let (t, b) = n.any_orthonormal_pair();
        let count = self.quality.0;
        let mut open = 0.0;
        let mut sum = 0.0;
        for i in 0..count {
            // Vogel spiral, lifted to the hemisphere: the same rays for every point, so light maps stay smooth.
            let r2 = (i as f64 + 0.5) / count as f64;
            let angle = i as f64 * 2.399_963_229_728_653;
            let r = r2.sqrt();
            let d = t * (r * angle.cos()) + b * (r * angle.sin()) + n * (1.0 - r2).sqrt();
            let hit = self.solids.first_opaque(o, d, OCCLUSION_REACH);
            open += hit.map_or(1.0, |hit| if hit.t > 0.02 { 1.0 } else { 0.0 });
            sum += hit.map_or(1.0, |hit| 0.18 + 0.82 * (hit.t / OCCLUSION_REACH).powf(0.6));
        }
        (open / count as f64, sum / count as f64)
    }

    fn direct(&self, light: &Light, o: DVec3, n: DVec3) -> DVec3 {
        match *light {
            Light::Lamp { center, color } => {
                // Too far or behind the surface to matter.
                let to = center - o;
                let d2 = to.length_squared();
                if n.dot(to) < -0.1
                    || color.max_element() * n.dot(to).max(0.1) / (d2.sqrt() * (d2 + 0.25)) < 0.004
                {
                    return DVec3::ZERO;
                }
                let mut sum = 0.0;
                for corner in [
                    [1.0, 1.0, 1.0],
                    [1.0, -1.0, -1.0],
                    [-1.0, 1.0, -1.0],
                    [-1.0, -1.0, 1.0],
                ] {
                    let to = center + DVec3::from(corner) * 0.06 - o;
                    let d2 = to.length_squared();
                    let cos = n.dot(to) / d2.sqrt();
                    if cos > 0.0 && !self.solids.blocked(o, to) {
                        sum += cos / (d2 + 0.25);
                    }
                }
                color * (sum / 4.0)
            }
            Light::Pane {
                center,
                across,
                up,
                normal,
                color,
            } => {
                let k = self.quality.1;
                let mut sum = 0.0;
                for i in 0..k * k {
                    let at = |j: usize| (2.0 * j as f64 + 1.0) / k as f64 - 1.0;
                    let to = center + across * at(i % k) + up * at(i / k) - o;
                    let d2 = to.length_squared().max(0.05);
                    let (here, there) = (n.dot(to) / d2.sqrt(), -normal.dot(to) / d2.sqrt());
                    if here > 0.0 && there > 0.0 && !self.solids.blocked(o, to) {
                        sum += here * there / (PI * d2);
                    }
                }
                let area = 4.0 * across.length() * up.length();
                color * (sum * area / (k * k) as f64)
            }
        }
    }
}

/// Light over the six sides of a solid's bounding cube, projected from its centre.
#[derive(Clone, Debug)]
pub(super) struct LightMap {
    sides: [Side; 6],
}

#[derive(Clone, Debug)]
struct Side {
    columns: usize,
    rows: usize,
    texels: Vec<[f32; 3]>,
}

impl LightMap {
    /// Bakes solid `index` with texels of about `texel` metres; `interior` is the room's size, points outside stay dark.
    pub fn bake(lit: &Lit, index: usize, texel: f64, interior: DVec3) -> Self {
        let solid = &lit.solids.all[index];
        let sides = [0, 1, 2, 3, 4, 5].map(|side| {
            let axis = side / 2;
            let sign = if side % 2 == 0 { -1.0 } else { 1.0 };
            let (ua, va) = ((axis + 1) % 3, (axis + 2) % 3);
            let cells = |half: f64| ((2.0 * half / texel).round() as usize).clamp(2, 160);
            let (columns, rows) = (cells(solid.half[ua]), cells(solid.half[va]));
            let raw: Vec<(DVec3, f64)> = (0..columns * rows)
                .into_par_iter()
                .map(|i| {
                    let mut q = DVec3::ZERO;
                    q[axis] = sign;
                    q[ua] = (2 * (i % columns) + 1) as f64 / columns as f64 - 1.0;
                    q[va] = (2 * (i / columns) + 1) as f64 / rows as f64 - 1.0;
                    let o = q * solid.half * 2.0;
                    let Some((t, normal)) = solid.entry(o, -o, 0.0, 1.0) else {
                        return (DVec3::ZERO, 0.0);
                    };
                    let p = solid.to_room(o - o * t);
                    let outside = (p.truncate().abs() - interior.truncate() / 2.0)
                        .max_element()
                        .max(p.z - interior.z)
                        .max(-p.z);
                    if outside > 1e-6 {
                        return (DVec3::ZERO, 0.0);
                    }
                    lit.arriving(p, solid.axes * normal)
                })
                .collect();
            Side {
                columns,
                rows,
                texels: smooth(&raw, columns, rows),
            }
        });
        Self { sides }
    }

    /// Light at local point `p` of a solid with half extents `half`.
    pub fn at(&self, p: DVec3, half: DVec3) -> DVec3 {
        let q = p / half;
        let a = q.abs();
        let axis = a.max_position();
        let side = &self.sides[2 * axis + usize::from(q[axis] > 0.0)];
        let scale = 1.0 / a[axis];
        let cell = |v: f64, n: usize| {
            let x = ((v * scale + 1.0) * 0.5 * n as f64 - 0.5).clamp(0.0, (n - 1) as f64);
            let i = (x as usize).min(n - 2);
            (i, (x - i as f64) as f32)
        };
        let ((i, u), (j, v)) = (
            cell(q[(axis + 1) % 3], side.columns),
            cell(q[(axis + 2) % 3], side.rows),
        );
        let at = j * side.columns + i;
        let corners = [at, at + 1, at + side.columns, at + side.columns + 1];
        let mix = |k: usize| f64::from(among(corners.map(|i| side.texels[i][k]), u, v));
        DVec3::new(mix(0), mix(1), mix(2))
    }
}

/// 3x3 mean over texels that receive light. Buried texels take the mean of their neighbours, which avoids dark fringes.
fn smooth(raw: &[(DVec3, f64)], columns: usize, rows: usize) -> Vec<[f32; 3]> {
    let mean = |i: usize, reach: usize| {
        let (x, y) = (i % columns, i / columns);
        let mut sum = DVec3::ZERO;
        let mut weight = 0.0;
        for v in y.saturating_sub(reach)..(y + reach + 1).min(rows) {
            for u in x.saturating_sub(reach)..(x + reach + 1).min(columns) {
                let (value, open) = raw[v * columns + u];
                if open > 0.0 {
                    sum += value;
                    weight += 1.0;
                }
            }
        }
        (weight > 0.0).then(|| sum / weight)
    };
    let texel = |i| mean(i, 1).or_else(|| mean(i, 3)).unwrap_or_default();
    (0..raw.len())
        .map(|i| texel(i).as_vec3().to_array())
        .collect()
}
