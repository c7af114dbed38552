//! What belongs to the building: walls, floor, ceiling, windows, pictures, rugs.

use super::build::{Builder, Light, Object, class};
use super::layout::{Plan, yaw};
use super::noise::rgb;
use super::patterns::Pattern;
use super::style::Style;
use glam::DVec3;
use rand::Rng;

/// Thickness of walls, floor and ceiling, metres.
const SLAB: f64 = 0.2;

const PAINTS: [[u32; 2]; 6] = [
    [0xdcd3c2, 0xcdc2ae],
    [0xc3d0cb, 0xb0bfba],
    [0xe0c9ad, 0xd0b697],
    [0xb9c6d4, 0xa6b4c4],
    [0xd9d6d0, 0xc9c5bd],
    [0xcdd2b4, 0xbbc0a0],
];

fn paint(b: &mut Builder, i: usize) -> usize {
    let [light, dark] = PAINTS[i % PAINTS.len()].map(rgb);
    b.matt(Pattern::Clouds(light, dark, 0.55))
}

/// Walls with skirting, floor, ceiling with beams or a cornice.
pub(super) fn shell(b: &mut Builder, plan: &Plan, style: &Style, rng: &mut impl Rng) {
    let DVec3 { x: w, y: d, z: h } = plan.size;
    let [light, dark] = style.wood_colors[rng.random_range(0..2)];
    let floor = match rng.random_range(0..4) {
        0 => Pattern::Planks(light, dark, 0.2),
        1 => Pattern::Parquet(light, dark, 0.45),
        2 => Pattern::Tiles(rgb(0xd6cbb8), rgb(0xa89a86), rgb(0x8b8378), 0.45),
        _ => Pattern::Planks(light * 0.9, dark, 0.26),
    };
    let floor = b.matt(floor);
    b.object(class::FLOOR, DVec3::ZERO, 0.0).cuboid(
        [0.0, 0.0, -SLAB / 2.0],
        [w + 0.4, d + 0.4, SLAB],
        floor,
    );

    let ground = rng.random_range(0..PAINTS.len());
    let base = paint(b, ground);
    let accent = rng.random_range(0..4);
    let tone = rgb(PAINTS[(ground + 2) % PAINTS.len()][0]);
    let special = match rng.random_range(0..4) {
        0 => Pattern::Motif(tone, tone * 0.72, 0.42),
        1 => Pattern::Stripes(tone, tone * 0.8, 0.5),
        2 => Pattern::Bricks(rgb(0xb07a5c), rgb(0xc9b9a4)),
        _ => Pattern::Clouds(style.palette[1] * 0.8, style.palette[1] * 0.68, 0.6),
    };
    let special = b.matt(special);
    let wainscot = rng.random_bool(0.5);
    let panelling = b.matt(Pattern::Panels(
        rgb(0xe4dfd2),
        rgb(0xb5aea0),
        rgb(0xe4dfd2),
        [6, 1],
    ));
    for k in 0..4 {
        let length = plan.length(k);
        let material = if k == accent { special } else { base };
        let mut o = b.object(class::WALL, plan.on_wall(k, 0.0, 0.0, 0.0), yaw(k));
        o.cuboid([0.0, -SLAB / 2.0, h / 2.0], [length, SLAB, h], material);
        if wainscot && k != accent {
            o.cuboid([0.0, 0.006, 0.42], [length, 0.012, 0.84], panelling);
            o.cuboid([0.0, 0.014, 0.86], [length, 0.028, 0.05], style.white);
        }
        o.cuboid([0.0, 0.01, 0.05], [length, 0.02, 0.1], style.white);
    }

    let plaster = b.matt(Pattern::Clouds(rgb(0xf1eee6), rgb(0xe6e2d8), 0.7));
    let beams = rng.random_bool(0.6);
    let mut o = b.object(class::CEILING, DVec3::Z * h, 0.0);
    o.cuboid([0.0, 0.0, SLAB / 2.0], [w + 0.4, d + 0.4, SLAB], plaster);
    if beams {
        let n = (w / 1.4).round();
        for i in 0..n as usize {
            let x = (i as f64 + 0.5) * w / n - w / 2.0;
            o.cuboid([x, 0.0, -0.06], [0.14, d, 0.12], style.woods[1]);
        }
    } else {
        for (x, y, sx, sy) in [
            (0.0, 0.5, 1.0, 0.0),
            (0.0, -0.5, 1.0, 0.0),
            (0.5, 0.0, 0.0, 1.0),
            (-0.5, 0.0, 0.0, 1.0),
        ] {
            let size = [(sx * w).max(0.12), (sy * d).max(0.12), 0.08];
            o.cuboid([x * (w - 0.12), y * (d - 0.12), -0.04], size, style.white);
        }
    }
}

/// A window with frame, sill and curtains (all of class window); false when the wall has no room.
pub(super) fn window(
    b: &mut Builder,
    plan: &mut Plan,
    style: &Style,
    k: usize,
    rng: &mut impl Rng,
) -> bool {
    let (w, low, high) = (
        rng.random_range(1.1..1.7),
        0.92,
        rng.random_range(2.1..2.25),
    );
    let color = style.palette[rng.random_range(0..4)];
    for _ in 0..20 {
        let reach = plan.length(k) / 2.0 - w / 2.0 - 0.5;
        if reach <= 0.0 {
            return false;
        }
        let s = rng.random_range(-reach..reach);
        if !plan.take_wall(
            k,
            [
                s - w / 2.0 - 0.36,
                s + w / 2.0 + 0.36,
                low - 0.1,
                high + 0.2,
            ],
            0.1,
        ) {
            continue;
        }
        let view = b.add_material(Pattern::Scenery(yaw(k) + 0.25 * s), 0.95, 0.0);
        let cloth = b.matt(Pattern::Folds(color, 0.11));
        let mut o = b.object(class::WINDOW, plan.on_wall(k, s, 0.0, 0.0), yaw(k));
        pane(&mut o, [w, low, high], view);
        for x in [-0.5, 0.5] {
            o.cuboid(
                [x * (w + 0.03), 0.025, (low + high) / 2.0],
                [0.06, 0.05, high - low + 0.09],
                style.white,
            );
            o.cuboid(
                [x * (w + 0.36), 0.055, (low + high) / 2.0 + 0.02],
                [0.3, 0.05, high - low + 0.22],
                cloth,
            );
        }
        for z in [low, high] {
            o.cuboid([0.0, 0.025, z], [w, 0.05, 0.07], style.white);
        }
        o.cuboid(
            [0.0, 0.02, (low + high) / 2.0],
            [0.05, 0.04, high - low],
            style.white,
        );
        o.cuboid(
            [0.0, 0.02, low + 0.68 * (high - low)],
            [w, 0.035, 0.04],
            style.white,
        );
        o.cuboid([0.0, 0.05, low - 0.045], [w + 0.1, 0.1, 0.03], style.white);
        o.cuboid(
            [0.0, 0.06, high + 0.15],
            [w + 0.8, 0.025, 0.03],
            style.metal,
        );
        return true;
    }
    false
}

fn pane(o: &mut Object, [w, low, high]: [f64; 3], view: usize) {
    o.cuboid(
        [0.0, 0.004, (low + high) / 2.0],
        [w, 0.008, high - low],
        view,
    );
    o.translucent();
    let light = Light::Pane {
        center: o.place([0.0, 0.05, (low + high) / 2.0]),
        across: o.direction(DVec3::X * w / 2.0),
        up: DVec3::Z * (high - low) / 2.0,
        normal: o.direction(DVec3::Y),
        color: DVec3::new(0.95, 1.0, 1.08) * 3.2,
    };
    o.builder.lights.push(light);
}

/// A framed picture on a free piece of wall.
pub(super) fn picture(b: &mut Builder, plan: &mut Plan, style: &Style, rng: &mut impl Rng) {
    let (w, h) = [
        (0.6, 0.8),
        (0.95, 0.65),
        (1.25, 0.8),
        (0.5, 0.5),
        (0.75, 0.75),
    ][rng.random_range(0..5)];
    let z = rng
        .random_range(1.5..1.68_f64)
        .min(plan.size.z - 0.3 - h / 2.0);
    for _ in 0..30 {
        let k = rng.random_range(0..4);
        let reach = plan.length(k) / 2.0 - w / 2.0 - 0.2;
        let s = rng.random_range(-reach..reach);
        if !plan.take_wall(k, [s - w / 2.0, s + w / 2.0, z - h / 2.0, z + h / 2.0], 0.1) {
            continue;
        }
        let colors = style.three(rng);
        let canvas = b.matt(Pattern::Painting(rng.random_range(0..6), colors));
        let frame =
            [style.woods[0], style.woods[1], style.metal, style.white][rng.random_range(0..4)];
        let mut o = b.object(class::PICTURE, plan.on_wall(k, s, 0.0, z), yaw(k));
        o.cuboid([0.0, 0.012, 0.0], [w - 0.03, 0.024, h - 0.03], canvas);
        for side in [-0.5, 0.5] {
            o.cuboid([side * (w - 0.035), 0.018, 0.0], [0.035, 0.036, h], frame);
            o.cuboid([0.0, 0.018, side * (h - 0.035)], [w, 0.036, 0.035], frame);
        }
        return;
    }
}

/// A rug; it counts as floor, as carpets do in indoor data sets. Cut to the room.
pub(super) fn rug(
    b: &mut Builder,
    plan: &Plan,
    style: &Style,
    at: DVec3,
    turn: f64,
    [w, d]: [f64; 2],
    rng: &mut impl Rng,
) {
    let colors = style.three(rng);
    let wool = b.matt(Pattern::Rug(rng.random_range(0..4), colors));
    // Half extents along room axes; rugs lie at right angles to the walls.
    let flat = if (turn.sin()).abs() > 0.5 {
        DVec3::new(d, w, 0.0)
    } else {
        DVec3::new(w, d, 0.0)
    } / 2.0;
    let reach = (plan.size / 2.0 - flat - 0.08).max(DVec3::ZERO);
    let center = DVec3::new(
        at.x.clamp(-reach.x, reach.x),
        at.y.clamp(-reach.y, reach.y),
        0.0,
    );
    b.object(class::FLOOR, center, turn)
        .cuboid([0.0, 0.0, 0.006], [w, d, 0.012], wool);
}
