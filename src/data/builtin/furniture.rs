//! Furniture. Every piece is centred on its frame's origin, stands on z = 0 and looks along +y.

use super::build::{Light, Object, class};
use super::noise::rgb;
use super::patterns::Pattern;
use super::shapes::Shape;
use super::style::Style;
use glam::{DMat3, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// What stands on the floor or on other furniture, and what hangs from the ceiling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Furniture {
    Sofa,
    Armchair,
    CoffeeTable,
    SideTable,
    DiningTable,
    Desk,
    Chair,
    Bookcase,
    Sideboard,
    Wardrobe,
    Chest,
    FloorLamp,
    TableLamp,
    Pendant,
}

impl Furniture {
    /// Width, depth and height, metres.
    pub fn size(self, rng: &mut ChaCha8Rng) -> [f64; 3] {
        let mut between = |a: f64, b: f64| rng.random_range(a..b);
        match self {
            Self::Sofa => [between(1.8, 2.3), between(0.85, 0.95), between(0.78, 0.9)],
            Self::Armchair => [between(0.8, 0.95), between(0.78, 0.88), between(0.78, 0.9)],
            Self::CoffeeTable => [between(0.9, 1.2), between(0.55, 0.7), between(0.38, 0.46)],
            Self::SideTable => [0.48, 0.48, between(0.5, 0.6)],
            Self::DiningTable => [between(1.3, 1.8), between(0.8, 0.95), between(0.72, 0.77)],
            Self::Desk => [between(1.1, 1.5), between(0.55, 0.68), between(0.72, 0.77)],
            Self::Chair => [0.45, 0.47, between(0.86, 0.98)],
            Self::Bookcase => [between(0.9, 1.5), 0.34, between(1.7, 2.1)],
            Self::Sideboard => [between(1.3, 1.9), 0.46, between(0.7, 0.85)],
            Self::Wardrobe => [between(1.0, 1.5), 0.58, between(1.95, 2.15)],
            Self::Chest => [between(0.75, 1.0), 0.48, between(0.85, 1.05)],
            Self::FloorLamp => [0.44, 0.44, between(1.5, 1.7)],
            Self::TableLamp => [0.32, 0.32, 0.47],
            Self::Pendant => [0.46, 0.46, 0.9],
        }
    }

    /// Class id.
    pub fn class(self) -> u16 {
        match self {
            Self::Sofa | Self::Armchair => class::SOFA,
            Self::CoffeeTable | Self::SideTable | Self::DiningTable | Self::Desk => class::TABLE,
            Self::Chair => class::CHAIR,
            Self::Bookcase | Self::Sideboard | Self::Wardrobe | Self::Chest => class::CABINET,
            Self::FloorLamp | Self::TableLamp | Self::Pendant => class::LAMP,
        }
    }

    /// Adds the solids of a piece of this kind; `variant` picks among its looks.
    pub fn build(
        self,
        o: &mut Object,
        s: &Style,
        size: [f64; 3],
        variant: usize,
        rng: &mut ChaCha8Rng,
    ) {
        match self {
            Self::Sofa | Self::Armchair => sofa(o, s, size, variant, rng),
            Self::CoffeeTable => coffee_table(o, s, size, variant),
            Self::SideTable => side_table(o, s, size, variant),
            Self::DiningTable => dining_table(o, s, size, variant),
            Self::Desk => desk(o, s, size, variant),
            Self::Chair => chair(o, s, size, variant),
            Self::Bookcase => bookcase(o, s, size, variant, rng),
            Self::Sideboard => sideboard(o, s, size, variant),
            Self::Wardrobe => wardrobe(o, s, size, variant),
            Self::Chest => chest(o, s, size, variant),
            Self::FloorLamp => floor_lamp(o, s, size, rng),
            Self::TableLamp => table_lamp(o, s, rng),
            Self::Pendant => pendant(o, s, size, rng),
        }
    }
}

/// The four corners of a unit square about the origin.
const CORNERS: [(f64, f64); 4] = [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)];

/// Four legs of square section at the corners of a `width` x `depth` rectangle.
fn legs(o: &mut Object, [width, depth]: [f64; 2], height: f64, thickness: f64, material: usize) {
    for (x, y) in CORNERS {
        let (x, y) = (x * (width - thickness), y * (depth - thickness));
        let size = [thickness, thickness, height];
        o.cuboid([x, y, height / 2.0], size, material);
    }
}

fn sofa(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize, rng: &mut ChaCha8Rng) {
    let cloth = s.cloths[variant % 2];
    let arm = 0.2_f64.min(w * 0.2);
    let seat = 0.42;
    let back = 0.24;
    let inner = w - 2.0 * arm;
    let behind = -d / 2.0 + back;
    legs(o, [w - 0.08, d - 0.1], 0.1, 0.06, s.woods[1]);
    o.cushion([0.0, 0.0, 0.2], [w - 0.02, d - 0.02, 0.22], 0.05, cloth);
    let center = [0.0, -d / 2.0 + back / 2.0, (h + 0.12) / 2.0];
    o.cushion(center, [w - 0.02, back, h - 0.12], 0.09, cloth);
    for side in [-0.5, 0.5] {
        o.cushion([side * (w - arm), 0.01, 0.36], [arm, d, 0.5], 0.08, cloth);
    }
    let seats = (inner / 0.62).round().max(1.0);
    for i in 0..seats as usize {
        let x = (i as f64 + 0.5) * inner / seats - inner / 2.0;
        let size = [inner / seats - 0.015, d - back - 0.02, 0.17];
        o.cushion([x, back / 2.0, seat - 0.06], size, 0.06, cloth);
        let tilt = DMat3::from_rotation_x(0.16);
        let size = [inner / seats - 0.03, 0.17, h - seat];
        let at = [x, behind + 0.04, h / 2.0 + 0.22];
        o.solid(Shape::Rounded(0.07), at, size, tilt, cloth);
    }
    let throws = if seats > 1.0 { 2 } else { 1 };
    for i in 0..throws {
        let place = if throws == 1 { 0.0 } else { i as f64 - 0.5 };
        let turn = DMat3::from_rotation_y(rng.random_range(-0.25..0.25));
        let turn = DMat3::from_rotation_x(0.35) * turn;
        let at = [place * (inner - 0.42), behind + 0.2, seat + 0.22];
        let accent = s.accents[(variant + i) % 3];
        o.solid(Shape::Rounded(0.06), at, [0.42, 0.14, 0.4], turn, accent);
    }
}

fn coffee_table(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize) {
    let wood = s.woods[variant % 2];
    if (variant / 2).is_multiple_of(2) {
        o.cushion([0.0, 0.0, h - 0.025], [w, d, 0.05], 0.02, wood);
        o.cuboid([0.0, 0.0, 0.14], [w - 0.12, d - 0.12, 0.025], wood);
        legs(o, [w - 0.04, d - 0.04], h - 0.05, 0.06, wood);
    } else {
        o.turned([0.0, 0.0, h - 0.025], 0.05, d * 0.62, d * 0.62, wood);
        o.turned([0.0, 0.0, h / 2.0], h - 0.05, d * 0.4, d * 0.22, s.white);
    }
    let covers = [s.palette[0], s.palette[1]].map(|c| o.builder.matt(Pattern::Plain(c)));
    o.cuboid([-0.14, 0.04, h + 0.015], [0.26, 0.2, 0.03], covers[0]);
    o.cuboid([-0.13, 0.05, h + 0.042], [0.22, 0.17, 0.024], covers[1]);
    bowl(o, [0.16, -0.02, h]);
}

/// A bowl of fruit; small things count as the piece they stand on.
fn bowl(o: &mut Object, [x, y, z]: [f64; 3]) {
    let clay = o.builder.matt(Pattern::Plain(rgb(0xdcd6c8)));
    o.turned([x, y, z + 0.035], 0.07, 0.06, 0.13, clay);
    let colors = [0xe08a2c, 0xc8402f, 0x9bb044].map(rgb);
    let fruit = colors.map(|c| o.builder.matt(Pattern::Gradient(c * 0.75, c)));
    let places = [(-0.05, 0.03), (0.05, 0.02), (0.0, -0.055)];
    for ((dx, dy), fruit) in places.into_iter().zip(fruit) {
        o.ball([x + dx, y + dy, z + 0.09], [0.085; 3], fruit);
    }
}

/// A vase with leaves.
fn vase(o: &mut Object, [x, y, z]: [f64; 3], color: DVec3) {
    let clay = o.builder.matt(Pattern::Gradient(color * 0.7, color));
    let leaf = Pattern::Gradient(rgb(0x3a6b3c), rgb(0x86ad5a));
    let leaf = o.builder.matt(leaf);
    o.turned([x, y, z + 0.06], 0.12, 0.05, 0.085, clay);
    o.turned([x, y, z + 0.16], 0.08, 0.085, 0.04, clay);
    for i in 0..7 {
        let tilt = DMat3::from_rotation_x(-0.55 - 0.1 * f64::from(i % 3));
        let turn = DMat3::from_rotation_z(f64::from(i) * 0.9) * tilt;
        let at = turn * DVec3::new(0.0, 0.0, 0.15) + DVec3::new(x, y, z + 0.2);
        let size = [0.1, 0.035, 0.28];
        o.solid(Shape::Ellipsoid, at.to_array(), size, turn, leaf);
    }
}

fn side_table(o: &mut Object, s: &Style, [w, _, h]: [f64; 3], variant: usize) {
    let wood = s.woods[variant % 2];
    o.turned([0.0, 0.0, h - 0.02], 0.04, w / 2.0, w / 2.0, wood);
    o.turned([0.0, 0.0, h / 2.0], h - 0.04, 0.05, 0.03, wood);
    o.turned([0.0, 0.0, 0.02], 0.04, w * 0.36, w * 0.28, wood);
}

fn dining_table(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize) {
    let wood = s.woods[variant % 2];
    o.cushion([0.0, 0.0, h - 0.025], [w, d, 0.05], 0.015, wood);
    o.cuboid([0.0, 0.0, h - 0.09], [w - 0.16, d - 0.16, 0.08], wood);
    let painted = !(variant / 2).is_multiple_of(2);
    let leg = if painted { s.white } else { wood };
    legs(o, [w - 0.08, d - 0.08], h - 0.05, 0.08, leg);
    let cloth = Pattern::Checks(s.palette[4], s.palette[variant % 3], 0.24);
    let cloth = o.builder.matt(cloth);
    o.cuboid([0.0, 0.0, h + 0.004], [w * 0.36, d - 0.01, 0.008], cloth);
    vase(o, [0.05, 0.0, h], s.palette[(variant + 1) % 4]);
    let plate = o.builder.matt(Pattern::Plain(rgb(0xe8e6df)));
    for (x, y) in CORNERS {
        let at = [0.54 * x * w, 0.54 * y * d, h + 0.008];
        o.turned(at, 0.016, 0.08, 0.12, plate);
    }
}

fn desk(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize) {
    let wood = s.woods[variant % 2];
    o.cuboid([0.0, 0.0, h - 0.02], [w, d, 0.04], wood);
    let front = Pattern::Panels(rgb(0xe9e4d8), rgb(0x9d978a), rgb(0x55504a), [1, 3]);
    let front = o.builder.matt(front);
    let middle = h / 2.0 - 0.02;
    let at = [w / 2.0 - 0.24, 0.0, middle];
    o.cuboid(at, [0.42, d - 0.04, h - 0.04], front);
    for y in [-0.5, 0.5] {
        let at = [-w / 2.0 + 0.04, y * (d - 0.08), middle];
        o.cuboid(at, [0.06, 0.06, h - 0.04], s.metal);
    }
    // A closed laptop, papers and books.
    let grey = o.builder.matt(Pattern::Plain(rgb(0x9aa0a6)));
    o.cuboid([-0.12, 0.02, h + 0.012], [0.34, 0.24, 0.024], grey);
    let books = o.builder.matt(Pattern::Books);
    let at = [w / 2.0 - 0.26, -d / 2.0 + 0.12, h + 0.11];
    o.cuboid(at, [0.36, 0.18, 0.22], books);
}

fn chair(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize) {
    let wood = [s.woods[0], s.woods[1], s.white][variant % 3];
    let seat = o.builder.matt(Pattern::Plain(s.palette[variant % 4]));
    o.cuboid([0.0, 0.0, 0.43], [w, d, 0.04], wood);
    o.cushion([0.0, 0.01, 0.465], [w - 0.03, d - 0.04, 0.05], 0.02, seat);
    legs(o, [w, d], 0.42, 0.045, wood);
    let lean = DMat3::from_rotation_x(0.12);
    for x in [-0.5, 0.5] {
        let at = [x * (w - 0.05), -d / 2.0, (h + 0.42) / 2.0];
        o.solid(Shape::Box, at, [0.045, 0.04, h - 0.42], lean, wood);
    }
    let back = -d / 2.0 - 0.008;
    if (variant / 3).is_multiple_of(2) {
        let at = [0.0, back - 0.01, h - 0.16];
        let size = [w - 0.04, 0.035, 0.3];
        o.solid(Shape::Rounded(0.015), at, size, lean, wood);
        return;
    }
    for i in [0.0, 1.0, 2.0] {
        let at = [0.0, back + 0.017 * i - 0.02, h - 0.06 - 0.14 * i];
        o.solid(Shape::Box, at, [w - 0.08, 0.03, 0.08], lean, wood);
    }
}

fn bookcase(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize, rng: &mut ChaCha8Rng) {
    let wood = [s.woods[0], s.white, s.woods[1]][variant % 3];
    let [light, dark] = s.wood_colors[variant % 2];
    let inside = o.builder.matt(Pattern::Wood(light * 0.9, dark * 0.8));
    o.cuboid([0.0, -d / 2.0 + 0.01, h / 2.0], [w, 0.02, h], inside);
    for x in [-0.5, 0.5] {
        o.cuboid([x * (w - 0.035), 0.0, h / 2.0], [0.035, d, h], wood);
    }
    let rows = (h / 0.38).round();
    let spacing = |i: usize| i as f64 * (h - 0.04) / rows;
    for i in 0..=rows as usize {
        let at = [0.0, 0.0, 0.02 + spacing(i)];
        o.cuboid(at, [w - 0.03, d - 0.01, 0.035], wood);
    }
    for i in 0..rows as usize {
        let z = 0.04 + spacing(i);
        let mut x = -w / 2.0 + 0.05;
        while x < w / 2.0 - 0.3 {
            let run = rng.random_range(0.22..0.6_f64).min(w / 2.0 - 0.05 - x);
            let highest = (h - 0.04) / rows - 0.06;
            let height = rng.random_range(0.2..0.29_f64).min(highest);
            if rng.random_bool(0.78) {
                let books = o.builder.matt(Pattern::Books);
                let at = [x + run / 2.0, -0.02, z + height / 2.0];
                o.cuboid(at, [run, d - 0.12, height], books);
            } else {
                let color = s.palette[rng.random_range(0..6)];
                let pot = o.builder.matt(Pattern::Gradient(color * 0.7, color));
                o.turned([x + run / 2.0, 0.0, z + 0.08], 0.16, 0.05, 0.085, pot);
            }
            x += run + rng.random_range(0.02..0.14);
        }
    }
}

fn sideboard(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize) {
    let [light, dark] = s.wood_colors[variant % 2];
    let front = Pattern::Panels(light, dark * 0.5, rgb(0xd8c28a), [3, 1]);
    let front = o.builder.matt(front);
    let feet = s.woods[(variant + 1) % 2];
    legs(o, [w - 0.1, d - 0.08], 0.16, 0.045, feet);
    o.cuboid([0.0, 0.0, h / 2.0 + 0.07], [w, d, h - 0.14], front);
    let top = s.woods[variant % 2];
    o.cuboid([0.0, 0.0, h - 0.015], [w + 0.03, d + 0.02, 0.03], top);
    vase(o, [-w * 0.34, 0.0, h], s.palette[variant % 4]);
    let books = o.builder.matt(Pattern::Books);
    o.cuboid([0.08, -0.04, h + 0.12], [0.34, 0.2, 0.24], books);
}

fn wardrobe(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize) {
    let [mut panel, dark] = s.wood_colors[variant % 2];
    let mut groove = dark * 0.6;
    if !(variant / 2).is_multiple_of(2) {
        panel = rgb(0xdfe3dc);
        groove = rgb(0x8f968d);
    }
    let doors = if w > 1.3 { 3 } else { 2 };
    let doors = Pattern::Panels(panel, groove, rgb(0x3d3a36), [doors, 1]);
    let doors = o.builder.matt(doors);
    o.cuboid([0.0, 0.0, h / 2.0 + 0.04], [w, d, h - 0.08], doors);
    o.cuboid([0.0, 0.0, 0.04], [w - 0.06, d - 0.06, 0.08], s.woods[1]);
    let top = s.woods[variant % 2];
    o.cuboid([0.0, 0.01, h - 0.02], [w + 0.06, d + 0.04, 0.05], top);
}

fn chest(o: &mut Object, s: &Style, [w, d, h]: [f64; 3], variant: usize) {
    let color = s.palette[variant % 4].lerp(rgb(0xd8d2c4), 0.35);
    let front = Pattern::Panels(color, color * 0.45, rgb(0xe6d9b0), [1, 4]);
    let front = o.builder.matt(front);
    let wood = s.woods[variant % 2];
    o.cuboid([0.0, 0.0, h / 2.0 + 0.03], [w, d, h - 0.06], front);
    o.cuboid([0.0, 0.0, h - 0.012], [w + 0.03, d + 0.03, 0.03], wood);
    legs(o, [w - 0.04, d - 0.04], 0.07, 0.06, wood);
}

/// A glowing shade around `at` and its light; `radii` are those at the bottom and at the top.
fn shade(o: &mut Object, at: [f64; 3], height: f64, radii: [f64; 2], color: DVec3, power: f64) {
    let cloth = Pattern::Gradient(color, color.lerp(rgb(0xfff4d8), 0.35));
    let cloth = o.builder.add_material(cloth, 0.75, 0.3);
    o.turned(at, height, radii[0], radii[1], cloth);
    o.translucent();
    let light = Light::Lamp {
        center: o.place(at),
        color: DVec3::new(1.0, 0.8, 0.55) * power,
    };
    o.builder.lights.push(light);
}

fn floor_lamp(o: &mut Object, s: &Style, [w, _, h]: [f64; 3], rng: &mut ChaCha8Rng) {
    o.turned([0.0, 0.0, 0.015], 0.03, 0.15, 0.14, s.metal);
    o.turned([0.0, 0.0, h / 2.0 - 0.1], h - 0.2, 0.02, 0.02, s.metal);
    let tone = [0xf0d9a8, 0xe8c79a, 0xd98f5c][rng.random_range(0..3)];
    let radii = [w / 2.0, w * 0.36];
    shade(o, [0.0, 0.0, h - 0.17], 0.34, radii, rgb(tone), 0.42);
}

/// For a table top or cabinet.
fn table_lamp(o: &mut Object, s: &Style, rng: &mut ChaCha8Rng) {
    let color = s.palette[rng.random_range(0..4)];
    let clay = o.builder.matt(Pattern::Gradient(color * 0.7, color));
    o.turned([0.0, 0.0, 0.01], 0.02, 0.08, 0.075, clay);
    o.ball([0.0, 0.0, 0.12], [0.17, 0.17, 0.22], clay);
    o.turned([0.0, 0.0, 0.25], 0.08, 0.02, 0.02, s.metal);
    shade(o, [0.0, 0.0, 0.37], 0.2, [0.16, 0.11], rgb(0xf2e2bd), 0.22);
}

/// Hangs from z = 0.
fn pendant(o: &mut Object, s: &Style, [.., drop]: [f64; 3], rng: &mut ChaCha8Rng) {
    let color = s.palette[rng.random_range(0..4)];
    let color = color.lerp(rgb(0xf2e2bd), 0.3);
    o.turned([0.0, 0.0, -0.015], 0.03, 0.05, 0.06, s.metal);
    o.turned([0.0, 0.0, -drop / 2.0], drop, 0.012, 0.012, s.metal);
    shade(o, [0.0, 0.0, -drop], 0.22, [0.23, 0.09], color, 0.42);
}
