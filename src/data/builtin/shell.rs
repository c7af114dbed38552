//! The building: walls, floor, ceiling, windows, pictures, rugs.

use super::build::{Light, class};
use super::layout::{Decorator, yaw};
use super::noise::rgb;
use super::patterns::Pattern;
use glam::DVec3;
use rand::Rng;

/// Thickness of walls, floor and ceiling, metres.
const THICKNESS: f64 = 0.2;

const PAINTS: [[u32; 2]; 6] = [
    [0xdcd3c2, 0xcdc2ae],
    [0xc3d0cb, 0xb0bfba],
    [0xe0c9ad, 0xd0b697],
    [0xb9c6d4, 0xa6b4c4],
    [0xd9d6d0, 0xc9c5bd],
    [0xcdd2b4, 0xbbc0a0],
];

impl Decorator<'_> {
    /// Walls with skirting, floor, ceiling with or without beams.
    pub fn shell(&mut self) {
        self.floor();
        self.walls();
        self.ceiling();
    }

    fn floor(&mut self) {
        let DVec3 { x: w, y: d, .. } = self.plan.size;
        let [light, dark] = self.style.wood_colors[self.rng.random_range(0..2)];
        let floor = match self.rng.random_range(0..4) {
            0 => Pattern::Planks(light, dark, 0.2),
            1 => Pattern::Parquet(light, dark, 0.45),
            2 => Pattern::Parquet(rgb(0xd6cbb8), rgb(0xa89a86), 0.45),
            _ => Pattern::Planks(light * 0.9, dark, 0.26),
        };
        let floor = self.builder.matt(floor);
        let mut o = self.builder.object(class::FLOOR, DVec3::ZERO, 0.0);
        let size = [w + 0.4, d + 0.4, THICKNESS];
        o.cuboid([0.0, 0.0, -THICKNESS / 2.0], size, floor);
    }

    fn walls(&mut self) {
        let h = self.plan.size.z;
        let paint = |i: usize| PAINTS[i % PAINTS.len()].map(rgb);
        let ground = self.rng.random_range(0..PAINTS.len());
        let [light, dark] = paint(ground);
        let base = self.builder.matt(Pattern::Clouds(light, dark, 0.55));
        let accent = self.rng.random_range(0..4);
        let [tone, _] = paint(ground + 2);
        let color = self.style.palette[1];
        let special = match self.rng.random_range(0..4) {
            0 => Pattern::Motif(tone, tone * 0.72, 0.42),
            1 => Pattern::Stripes(tone, tone * 0.8, 0.5),
            2 => Pattern::Clouds(rgb(0xb07a5c), rgb(0x97654a), 0.3),
            _ => Pattern::Clouds(color * 0.8, color * 0.68, 0.6),
        };
        let special = self.builder.matt(special);
        let wainscot = self.rng.random_bool(0.5);
        let panel = rgb(0xe4dfd2);
        let groove = rgb(0xb5aea0);
        let panelling = self
            .builder
            .matt(Pattern::Panels(panel, groove, panel, [6, 1]));
        let white = self.style.white;
        for k in 0..4 {
            let length = self.plan.length(k);
            let material = if k == accent { special } else { base };
            let at = self.plan.on_wall(k, 0.0, 0.0, 0.0);
            let mut o = self.builder.object(class::WALL, at, yaw(k));
            let size = [length, THICKNESS, h];
            o.cuboid([0.0, -THICKNESS / 2.0, h / 2.0], size, material);
            if wainscot && k != accent {
                o.cuboid([0.0, 0.006, 0.42], [length, 0.012, 0.84], panelling);
                o.cuboid([0.0, 0.014, 0.86], [length, 0.028, 0.05], white);
            }
            o.cuboid([0.0, 0.01, 0.05], [length, 0.02, 0.1], white);
        }
    }

    fn ceiling(&mut self) {
        let DVec3 { x: w, y: d, z: h } = self.plan.size;
        let plaster = Pattern::Clouds(rgb(0xf1eee6), rgb(0xe6e2d8), 0.7);
        let plaster = self.builder.matt(plaster);
        let beams = self.rng.random_bool(0.6);
        let mut o = self.builder.object(class::CEILING, DVec3::Z * h, 0.0);
        let size = [w + 0.4, d + 0.4, THICKNESS];
        o.cuboid([0.0, 0.0, THICKNESS / 2.0], size, plaster);
        if beams {
            let n = (w / 1.4).round();
            for i in 0..n as usize {
                let x = (i as f64 + 0.5) * w / n - w / 2.0;
                o.cuboid([x, 0.0, -0.06], [0.14, d, 0.12], self.style.woods[1]);
            }
        }
    }

    /// A window with frame, sill and curtains (all of class window); false when the wall has no room.
    pub fn window(&mut self, k: usize) -> bool {
        let w = self.rng.random_range(1.1..1.7);
        let (low, high) = (0.92, self.rng.random_range(2.1..2.25));
        let color = self.style.palette[self.rng.random_range(0..4)];
        for _ in 0..20 {
            let reach = self.plan.length(k) / 2.0 - w / 2.0 - 0.5;
            if reach <= 0.0 {
                return false;
            }
            let s = self.rng.random_range(-reach..reach);
            let (from, to) = (s - w / 2.0 - 0.36, s + w / 2.0 + 0.36);
            let area = [from, to, low - 0.1, high + 0.2];
            if self.plan.take_wall(k, area, 0.1) {
                self.build_window(k, s, [w, low, high], color);
                return true;
            }
        }
        false
    }

    fn build_window(&mut self, k: usize, s: f64, [w, low, high]: [f64; 3], color: DVec3) {
        let white = self.style.white;
        let metal = self.style.metal;
        let view = Pattern::Scenery(yaw(k) + 0.25 * s);
        let view = self.builder.add_material(view, 0.95, 0.0);
        let cloth = self.builder.matt(Pattern::Folds(color, 0.11));
        let at = self.plan.on_wall(k, s, 0.0, 0.0);
        let mut o = self.builder.object(class::WINDOW, at, yaw(k));
        let middle = (low + high) / 2.0;
        let height = high - low;
        o.cuboid([0.0, 0.004, middle], [w, 0.008, height], view);
        o.translucent();
        let light = Light::Pane {
            center: o.place([0.0, 0.05, middle]),
            across: o.direction(DVec3::X * w / 2.0),
            up: DVec3::Z * height / 2.0,
            normal: o.direction(DVec3::Y),
            color: DVec3::new(0.95, 1.0, 1.08) * 3.2,
        };
        o.builder.lights.push(light);
        for x in [-0.5, 0.5] {
            let post = [x * (w + 0.03), 0.025, middle];
            o.cuboid(post, [0.06, 0.05, height + 0.09], white);
            let curtain = [x * (w + 0.36), 0.055, middle + 0.02];
            o.cuboid(curtain, [0.3, 0.05, height + 0.22], cloth);
        }
        for z in [low, high] {
            o.cuboid([0.0, 0.025, z], [w, 0.05, 0.07], white);
        }
        o.cuboid([0.0, 0.02, middle], [0.05, 0.04, height], white);
        o.cuboid([0.0, 0.02, low + 0.68 * height], [w, 0.035, 0.04], white);
        o.cuboid([0.0, 0.05, low - 0.045], [w + 0.1, 0.1, 0.03], white);
        o.cuboid([0.0, 0.06, high + 0.15], [w + 0.8, 0.025, 0.03], metal);
    }

    /// A framed picture on a free piece of wall.
    pub fn picture(&mut self) {
        let sizes = [
            (0.6, 0.8),
            (0.95, 0.65),
            (1.25, 0.8),
            (0.5, 0.5),
            (0.75, 0.75),
        ];
        let (w, h) = sizes[self.rng.random_range(0..5)];
        let highest = self.plan.size.z - 0.3 - h / 2.0;
        let z = self.rng.random_range(1.5..1.68_f64).min(highest);
        for _ in 0..30 {
            let k = self.rng.random_range(0..4);
            let reach = self.plan.length(k) / 2.0 - w / 2.0 - 0.2;
            let s = self.rng.random_range(-reach..reach);
            let area = [s - w / 2.0, s + w / 2.0, z - h / 2.0, z + h / 2.0];
            if !self.plan.take_wall(k, area, 0.1) {
                continue;
            }
            let colors = self.style.three(self.rng);
            let painting = Pattern::Painting(self.rng.random_range(0..6), colors);
            let canvas = self.builder.matt(painting);
            let style = &self.style;
            let frames = [style.woods[0], style.woods[1], style.metal, style.white];
            let frame = frames[self.rng.random_range(0..4)];
            let at = self.plan.on_wall(k, s, 0.0, z);
            let mut o = self.builder.object(class::PICTURE, at, yaw(k));
            o.cuboid([0.0, 0.012, 0.0], [w - 0.03, 0.024, h - 0.03], canvas);
            for side in [-0.5, 0.5] {
                o.cuboid([side * (w - 0.035), 0.018, 0.0], [0.035, 0.036, h], frame);
                o.cuboid([0.0, 0.018, side * (h - 0.035)], [w, 0.036, 0.035], frame);
            }
            return;
        }
    }

    /// A rug; it counts as floor, as carpets do in indoor data sets. Cut to the room.
    pub fn rug(&mut self, at: DVec3, turn: f64, [w, d]: [f64; 2]) {
        let colors = self.style.three(self.rng);
        let spacing = [0.42, 0.5, 0.34, 0.6][self.rng.random_range(0..4)];
        let wool = self.builder.matt(Pattern::Rug(spacing, colors));
        // Half extents along room axes; rugs lie at right angles to the walls.
        let turned = turn.sin().abs() > 0.5;
        let flat = if turned {
            DVec3::new(d, w, 0.0)
        } else {
            DVec3::new(w, d, 0.0)
        } / 2.0;
        let reach = (self.plan.size / 2.0 - flat - 0.08).max(DVec3::ZERO);
        let x = at.x.clamp(-reach.x, reach.x);
        let y = at.y.clamp(-reach.y, reach.y);
        let mut o = self
            .builder
            .object(class::FLOOR, DVec3::new(x, y, 0.0), turn);
        o.cuboid([0.0, 0.0, 0.006], [w, d, 0.012], wool);
    }
}
