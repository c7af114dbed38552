//! Surface patterns: wood, tiles, cloth, wallpaper, books, rugs. Edges are soft over about a centimetre and fine grain
//! is faint, so that photos at 320x240 do not alias.

use super::noise::{band, cloud, fold, hash, noise, rgb, step};
use super::paintings::{painting, scenery};
use super::shapes::{Shape, Solid};
use glam::DVec3;

/// A colour pattern in linear light; lengths in metres.
#[derive(Clone, Debug)]
pub(super) enum Pattern {
    /// One colour with faint large mottling.
    Plain(DVec3),
    /// Soft clouds between two colours, of this size.
    Clouds(DVec3, DVec3, f64),
    /// Wood with grain along the longest axis of the solid: light, dark.
    Wood(DVec3, DVec3),
    /// Floor boards along u: light, dark, board width.
    Planks(DVec3, DVec3, f64),
    /// Parquet of square blocks whose grain turns from block to block: light, dark, block size.
    Parquet(DVec3, DVec3, f64),
    /// Upright stripes: two colours, period.
    Stripes(DVec3, DVec3, f64),
    /// Wallpaper with a lattice of soft round motifs: ground, motif, spacing.
    Motif(DVec3, DVec3, f64),
    /// Wide woven checks (gingham): ground, thread, period.
    Checks(DVec3, DVec3, f64),
    /// Hanging cloth with folds: colour, period of folds.
    Folds(DVec3, f64),
    /// Cabinet front of columns x rows panels with knobs: panel, groove, knob.
    Panels(DVec3, DVec3, DVec3, [u32; 2]),
    /// Spines of books.
    Books,
    /// Rug with rows of diamonds: spacing; colours of field, figure and border.
    Rug(f64, [DVec3; 3]),
    /// A painted picture of this style within a mat.
    Painting(u32, [DVec3; 3]),
    /// The view out of a window; the panorama is continuous over windows.
    Scenery(f64),
    /// Round fruit or leaves: colour from base to tip along z.
    Gradient(DVec3, DVec3),
}

/// A pattern, and how it reflects and emits light.
#[derive(Clone, Debug)]
pub(super) struct Material {
    /// Colour pattern.
    pub pattern: Pattern,
    /// Varies noise and small choices between objects of one material.
    pub seed: u64,
    /// Light given off, as a multiple of the pattern.
    pub glow: f64,
    /// Share of the room's light that is reflected (0 for window panes).
    pub lit: f64,
}

/// A surface point in the coordinates that patterns use.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// Local point.
    pub p: DVec3,
    /// Half extents of the solid.
    pub half: DVec3,
    /// Axis of the face (0 x, 1 y, 2 z).
    pub axis: usize,
    /// Across the face, metres from its centre.
    pub u: f64,
    /// Up (or along) the face, metres from its centre.
    pub v: f64,
    /// Half extents of the face along u and v.
    pub face: (f64, f64),
}

impl Spot {
    /// The spot of local point `p` with local `normal`.
    pub fn new(solid: &Solid, p: DVec3, normal: DVec3) -> Self {
        let half = solid.half;
        let n = normal.abs();
        let axis = n.max_position();
        let round = matches!(solid.shape, Shape::Ellipsoid | Shape::Frustum(..)) && axis < 2;
        let (u, v, face) = match axis {
            _ if round => (
                p.y.atan2(p.x) * half.x,
                p.z,
                (std::f64::consts::PI * half.x, half.z),
            ),
            0 => (p.y, p.z, (half.y, half.z)),
            1 => (p.x, p.z, (half.x, half.z)),
            _ => (p.x, p.y, (half.x, half.y)),
        };
        Self {
            p,
            half,
            axis,
            u,
            v,
            face,
        }
    }
}

impl Material {
    /// Reflected colour at `spot`, linear light.
    pub fn color(&self, spot: &Spot) -> DVec3 {
        let Spot { p, u, v, face, .. } = *spot;
        let seed = self.seed;
        match self.pattern {
            Pattern::Plain(c) => c * (0.94 + 0.12 * noise(u / 0.35, v / 0.35, seed)),
            Pattern::Clouds(a, b, size) => {
                a.lerp(b, step(0.2, 0.8, cloud(u / size, v / size, seed)))
            }
            Pattern::Wood(light, dark) => wood([light, dark], spot, seed),
            Pattern::Planks(light, dark, width) => planks([light, dark], width, spot, seed),
            Pattern::Parquet(light, dark, size) => parquet([light, dark], size, spot, seed),
            Pattern::Stripes(a, b, period) => {
                // Upright on side faces, along x on top.
                let x = if spot.axis == 2 { p.y } else { u };
                a.lerp(b, step(-0.012, 0.012, fold(x, period).abs() - period / 4.0))
            }
            Pattern::Motif(ground, drawn, spacing) => motif([ground, drawn], spacing, spot),
            Pattern::Checks(ground, thread, period) => {
                let line = |x: f64| step(-0.015, 0.015, period / 4.0 - fold(x, period).abs());
                let (x, y) = if spot.axis == 2 { (p.x, p.y) } else { (u, v) };
                ground.lerp(thread, 0.5 * line(x) + 0.5 * line(y))
            }
            Pattern::Folds(c, period) => {
                let wave =
                    (u / period * std::f64::consts::TAU + 1.3 * noise(u / 0.4, 0.0, seed)).cos();
                c * (0.86 + 0.2 * wave)
            }
            Pattern::Panels(panel, groove, knob, counts) => {
                panels([panel, groove, knob], counts, spot, seed)
            }
            Pattern::Books => books(spot, seed),
            Pattern::Rug(spacing, colors) => rug(spacing, colors, u, v, face),
            Pattern::Painting(style, colors) => {
                painting(style, colors, u / face.0, v / face.1, face, seed)
            }
            Pattern::Scenery(azimuth) => scenery(azimuth + 0.25 * u, v / face.1),
            Pattern::Gradient(a, b) => a.lerp(b, 0.5 + 0.5 * p.z / spot.half.z),
        }
    }
}

fn wood([light, dark]: [DVec3; 2], spot: &Spot, seed: u64) -> DVec3 {
    let Spot { p, half: h, .. } = *spot;
    // Grain runs along the longest side; the two others make the rings.
    let (along, across) = if h.x >= h.y && h.x >= h.z {
        (p.x, p.y + 0.7 * p.z)
    } else if h.y >= h.z {
        (p.y, p.x + 0.7 * p.z)
    } else {
        (p.z, p.x + 0.7 * p.y)
    };
    grain(light, dark, along, across, seed)
}

fn planks([light, dark]: [DVec3; 2], width: f64, spot: &Spot, seed: u64) -> DVec3 {
    let Spot { u, v, .. } = *spot;
    let row = (v / width).floor();
    let shift = hash(row as i64, 7, seed) * 1.3;
    let length = 1.3;
    let column = ((u + shift) / length).floor();
    let tone = hash(row as i64, column as i64, seed);
    let c = grain(light, dark, u, v + 3.0 * tone, seed ^ row as i64 as u64);
    let seam = band(fold(v, width), 0.003, 0.012).max(band(fold(u + shift, length), 0.003, 0.012));
    c * (0.84 + 0.26 * tone) * (1.0 - 0.35 * seam)
}

fn parquet([light, dark]: [DVec3; 2], size: f64, spot: &Spot, seed: u64) -> DVec3 {
    let Spot { u, v, .. } = *spot;
    let (i, j) = ((u / size).floor() as i64, (v / size).floor() as i64);
    let turned = (i + j).rem_euclid(2) == 0;
    let (along, across) = if turned { (u, v) } else { (v, u) };
    let tone = if turned { 1.04 } else { 0.92 } * (0.95 + 0.1 * hash(i, j, seed));
    let strips = band(fold(across, size / 3.0), 0.002, 0.012);
    grain(light, dark, along, across, seed) * tone * (1.0 - 0.12 * strips)
}

fn motif([ground, drawn]: [DVec3; 2], spacing: f64, spot: &Spot) -> DVec3 {
    let Spot { u, v, .. } = *spot;
    let row = (v / (spacing * 0.866)).round();
    let shift = if row as i64 % 2 == 0 {
        0.0
    } else {
        spacing / 2.0
    };
    let (x, y) = (fold(u + shift, spacing), v - row * spacing * 0.866);
    let r = x.hypot(y) / spacing;
    let petals = 0.27 + 0.06 * (5.0 * y.atan2(x)).cos();
    let flower = 1.0 - step(petals - 0.08, petals + 0.08, r);
    let inside = 0.8 * flower * (1.0 - 0.5 * (1.0 - step(0.05, 0.14, r)));
    ground.lerp(drawn, inside)
}

fn panels(
    [panel, groove, knob]: [DVec3; 3],
    [columns, rows]: [u32; 2],
    spot: &Spot,
    seed: u64,
) -> DVec3 {
    let Spot { u, v, face, .. } = *spot;
    if spot.axis != 1 {
        return grain(panel, panel * 0.86, v, u, seed);
    }
    let w = 2.0 * face.0 / f64::from(columns);
    let h = 2.0 * face.1 / f64::from(rows);
    let (x, y) = (fold(u + face.0 - w / 2.0, w), fold(v + face.1 - h / 2.0, h));
    let edge = (w / 2.0 - x.abs()).min(h / 2.0 - y.abs());
    let inset = band(edge - 0.07, 0.008, 0.012) * 0.25 + band(edge, 0.008, 0.012) * 0.8;
    // Doors (taller than wide) have their knob at one side, drawers in the middle.
    let k = if h > w { x.abs() - w / 2.0 + 0.05 } else { x };
    let round = 1.0 - step(0.018, 0.03, k.hypot(y));
    grain(panel, panel * 0.86, v, u, seed)
        .lerp(groove, inset)
        .lerp(knob, round)
}

fn books(spot: &Spot, seed: u64) -> DVec3 {
    let Spot { u, v, face, .. } = *spot;
    let width = 0.07;
    let i = (u / width).floor() as i64;
    let hue = hash(i, 1, seed);
    let palette = [
        0x7a2e2a, 0x2e4a6b, 0x3f6b4f, 0xb58a3c, 0x6b4f7a, 0xd8cdb4, 0x444444, 0xa3553a,
    ];
    let c = rgb(palette[(hue * 8.0) as usize % 8]) * (0.9 + 0.2 * hash(i, 2, seed));
    let label = band(v - face.1 * (0.2 + 0.4 * hash(i, 3, seed)), 0.02, 0.015);
    let gap = band(fold(u, width), 0.002, 0.012);
    c.lerp(DVec3::splat(0.5), 0.3 * label) * (1.0 - 0.35 * gap)
}

/// Wood grain: long soft streaks and wavy rings.
fn grain(light: DVec3, dark: DVec3, along: f64, across: f64, seed: u64) -> DVec3 {
    let wave = 0.05 * noise(along / 0.5, across / 0.25, seed);
    let rings = 0.5 + 0.5 * ((across + wave) / 0.075 * std::f64::consts::TAU).sin();
    let streak = noise(along / 0.6, across / 0.05, seed ^ 0x77);
    light.lerp(dark, 0.2 * rings + 0.1 + 0.4 * streak)
}

fn rug(s: f64, [field, figure, border]: [DVec3; 3], u: f64, v: f64, face: (f64, f64)) -> DVec3 {
    let edge = (face.0 - u.abs()).min(face.1 - v.abs());
    let d = (fold(u, s).abs() + fold(v, s).abs()) / s;
    let inside = field
        .lerp(figure, step(0.39, 0.465, d) * 0.85)
        .lerp(border, 1.0 - step(0.14, 0.2, d));
    let frame = 1.0 - step(0.10, 0.12, edge);
    let line = band(edge - 0.15, 0.015, 0.012);
    inside.lerp(border, frame).lerp(figure, 0.9 * line)
}
