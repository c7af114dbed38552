//! Drawing a furnished room: walls with windows and pictures, a seating group, a dining group, cabinets and lamps.

use super::build::{Builder, class};
use super::furniture::{Kind, Place, pendant, table_lamp};
use super::shell;
use super::style::Style;
use glam::{DMat2, DVec2, DVec3};
use rand::Rng;
use std::f64::consts::{FRAC_PI_2, PI};

/// A room while it is being furnished: what is taken on the floor and on the walls.
pub(super) struct Plan {
    /// Width (x), depth (y), height (z), metres; the floor's centre is the origin.
    pub size: DVec3,
    /// Taken rectangles of the floor.
    floor: Vec<(DVec2, DVec2)>,
    /// Taken rectangles of each wall: from, to along the wall; from, to in height.
    walls: [Vec<[f64; 4]>; 4],
}

impl Plan {
    /// Length of wall `k` (0 south, 1 east, 2 north, 3 west).
    pub fn length(&self, k: usize) -> f64 {
        if k.is_multiple_of(2) {
            self.size.x
        } else {
            self.size.y
        }
    }

    /// Point of wall `k` at `s` along it from its middle, `out` into the room, height `z`.
    pub fn on_wall(&self, k: usize, s: f64, out: f64, z: f64) -> DVec3 {
        let across = if k.is_multiple_of(2) {
            self.size.y
        } else {
            self.size.x
        };
        let flat = DMat2::from_angle(yaw(k)) * DVec2::new(s, out - across / 2.0);
        flat.extend(z)
    }

    /// Whether a rectangle lies in the room, `gap` off everything on the floor.
    fn fits(&self, low: DVec2, high: DVec2, gap: f64) -> bool {
        let reach = self.size.truncate() / 2.0 + 1e-9;
        low.cmpge(-reach).all()
            && high.cmple(reach).all()
            && self
                .floor
                .iter()
                .all(|&(l, h)| (low - gap).cmpge(h).any() || (high + gap).cmple(l).any())
    }

    /// Takes the floor under a `w` x `d` piece at `at`, turned by `yaw`, if it is free.
    fn take_floor(&mut self, at: DVec3, yaw: f64, w: f64, d: f64, gap: f64) -> bool {
        let r = DMat2::from_angle(yaw);
        let reach = r.x_axis.abs() * w / 2.0 + r.y_axis.abs() * d / 2.0;
        let (low, high) = (at.truncate() - reach, at.truncate() + reach);
        let free = self.fits(low, high, gap);
        if free {
            self.floor.push((low, high));
        }
        free
    }

    /// Takes a rectangle of wall `k` if it is free.
    pub fn take_wall(&mut self, k: usize, [s0, s1, z0, z1]: [f64; 4], gap: f64) -> bool {
        let inside = s0 >= -self.length(k) / 2.0 + 0.1 && s1 <= self.length(k) / 2.0 - 0.1;
        let free = inside
            && self.walls[k].iter().all(|&[a, b, c, d]| {
                s0 - gap >= b || s1 + gap <= a || z0 - gap >= d || z1 + gap <= c
            });
        if free {
            self.walls[k].push([s0, s1, z0, z1]);
        }
        free
    }

    /// Finds room for a piece with its back to a wall; tries `walls` in turn at random places.
    fn place_at_wall(
        &mut self,
        walls: &[usize],
        [w, d, h]: [f64; 3],
        rng: &mut impl Rng,
    ) -> Option<(usize, f64)> {
        for attempt in 0..40 {
            let k = walls[attempt % walls.len()];
            let room = self.length(k) / 2.0 - w / 2.0 - 0.12;
            if room <= 0.0 {
                continue;
            }
            let s = rng.random_range(-room..room);
            let before = self.floor.len();
            if !self.take_floor(self.on_wall(k, s, d / 2.0, 0.0), yaw(k), w, d, 0.12) {
                continue;
            }
            if self.take_wall(k, [s - w / 2.0, s + w / 2.0, 0.0, h], 0.04) {
                return Some((k, s));
            }
            self.floor.truncate(before);
        }
        None
    }
}

/// Direction a piece at wall `k` looks, as a turn about z.
pub(super) fn yaw(k: usize) -> f64 {
    k as f64 * FRAC_PI_2
}

/// Draws a room. `size` overrides its extents.
pub(super) fn furnish(b: &mut Builder, size: Option<DVec3>, rng: &mut impl Rng) -> DVec3 {
    let drawn = DVec3::new(
        rng.random_range(4.6..6.8),
        rng.random_range(4.2..5.8),
        rng.random_range(2.5..2.9),
    );
    let size = size.unwrap_or(drawn);
    let plan = &mut Plan {
        size,
        floor: Vec::new(),
        walls: Default::default(),
    };
    let style = &Style::draw(b, rng);
    shell::shell(b, plan, style, rng);
    let sunny = rng.random_range(0..4);
    let mut windows = 0;
    for k in [sunny, (sunny + 1) % 4, sunny] {
        windows += usize::from(shell::window(b, plan, style, k, rng));
    }
    if windows == 0 {
        shell::window(b, plan, style, (sunny + 2) % 4, rng);
    }
    let lounge = seating(
        b,
        plan,
        style,
        [0, 1, 2, 3].map(|i| (sunny + 2 + i) % 4),
        rng,
    );
    let dining = dining_group(b, plan, style, rng);
    cabinets(b, plan, style, rng);
    if !dining || rng.random_bool(0.4) {
        desk_corner(b, plan, style, rng);
    }
    for _ in 0..1 + usize::from(!lounge) {
        let piece = Kind::FloorLamp.size(rng);
        if let Some((k, s)) = plan.place_at_wall(&shuffled(rng), piece, rng) {
            let at = plan.on_wall(k, s, piece[1] / 2.0 + 0.03, 0.0);
            Kind::FloorLamp.build(
                b,
                style,
                Place {
                    at,
                    yaw: 0.0,
                    size: piece,
                    variant: 0,
                },
                rng,
            );
        }
    }
    let wanted = rng.random_range(5..9);
    for _ in 0..wanted {
        shell::picture(b, plan, style, rng);
    }
    size
}

fn shuffled(rng: &mut impl Rng) -> [usize; 4] {
    let mut order = [0, 1, 2, 3];
    for i in (1..4).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    order
}

/// Sofa at a wall, a rug, a low table before it, armchairs and a side table with a lamp.
fn seating(
    b: &mut Builder,
    plan: &mut Plan,
    style: &Style,
    walls: [usize; 4],
    rng: &mut impl Rng,
) -> bool {
    let size = Kind::Sofa.size(rng);
    let Some((k, s)) = plan.place_at_wall(&walls, size, rng) else {
        return false;
    };
    let variant = rng.random_range(0..12);
    let at = plan.on_wall(k, s, size[1] / 2.0 + 0.02, 0.0);
    Kind::Sofa.build(
        b,
        style,
        Place {
            at,
            yaw: yaw(k),
            size,
            variant,
        },
        rng,
    );
    let low = Kind::CoffeeTable.size(rng);
    let front = size[1] + 0.42 + low[1] / 2.0;
    let middle = plan.on_wall(k, s, front, 0.0);
    shell::rug(
        b,
        plan,
        style,
        middle,
        yaw(k),
        [size[0] + 0.5, low[1] + 1.3],
        rng,
    );
    if plan.take_floor(middle, yaw(k), low[0], low[1], 0.1) {
        let variant = rng.random_range(0..4);
        Kind::CoffeeTable.build(
            b,
            style,
            Place {
                at: middle,
                yaw: yaw(k),
                size: low,
                variant,
            },
            rng,
        );
    }
    let across = rng.random_range(0..3);
    for side in [-1.0, 1.0] {
        let chair = Kind::Armchair.size(rng);
        // Facing the low table from its side, or from across.
        let (ds, dy, turn) = if across == 2 {
            (
                side * (chair[0] / 2.0 + 0.12),
                front + low[1] / 2.0 + 0.4 + chair[1] / 2.0,
                PI,
            )
        } else {
            (
                side * (low[0] / 2.0 + 0.4 + chair[1] / 2.0),
                front + 0.1,
                side * FRAC_PI_2,
            )
        };
        let turn = turn + rng.random_range(-0.25..0.25);
        let at = plan.on_wall(k, s + ds, dy, 0.0);
        if plan.take_floor(at, yaw(k) + turn, chair[0], chair[1], 0.08) {
            let place = Place {
                at,
                yaw: yaw(k) + turn,
                size: chair,
                variant: variant + 1,
            };
            Kind::Armchair.build(b, style, place, rng);
        }
    }
    let table = Kind::SideTable.size(rng);
    for side in [-1.0, 1.0] {
        let ds = side * (size[0] / 2.0 + table[0] / 2.0 + 0.1);
        let at = plan.on_wall(k, s + ds, 0.3, 0.0);
        let free = plan.take_floor(at, 0.0, table[0], table[0], 0.02);
        if free && plan.take_wall(k, [s + ds - 0.24, s + ds + 0.24, 0.0, 1.15], 0.02) {
            let variant = rng.random_range(0..2);
            Kind::SideTable.build(
                b,
                style,
                Place {
                    at,
                    yaw: 0.0,
                    size: table,
                    variant,
                },
                rng,
            );
            table_lamp(b, style, at + DVec3::Z * table[2], rng);
        }
    }
    true
}

/// Table with chairs around it, a rug below and a lamp above.
fn dining_group(b: &mut Builder, plan: &mut Plan, style: &Style, rng: &mut impl Rng) -> bool {
    let size = Kind::DiningTable.size(rng);
    for _ in 0..60 {
        let reach = plan.size.truncate() / 2.0 - 1.15;
        let x = rng.random_range(-1.0..1.0) * reach.x;
        let y = rng.random_range(-1.0..1.0) * reach.y;
        let turn = yaw(rng.random_range(0..2)) + rng.random_range(-0.12..0.12);
        let at = DVec3::new(x, y, 0.0);
        if !plan.take_floor(at, turn, size[0] + 0.7, size[1] + 1.0, 0.15) {
            continue;
        }
        let look = rng.random_range(0..4);
        Kind::DiningTable.build(
            b,
            style,
            Place {
                at,
                yaw: turn,
                size,
                variant: look,
            },
            rng,
        );
        let variant = rng.random_range(0..12);
        let r = glam::DMat3::from_rotation_z(turn);
        let (w, d) = (size[0] / 2.0, size[1] / 2.0);
        let mut seats = vec![(-w * 0.5, -d - 0.12, 0.0), (w * 0.5, -d - 0.12, 0.0)];
        seats.extend([(-w * 0.5, d + 0.12, PI), (w * 0.5, d + 0.12, PI)]);
        if rng.random_bool(0.6) {
            seats.push((w + 0.1, 0.0, FRAC_PI_2));
        }
        for (i, (sx, sy, facing)) in seats.into_iter().enumerate() {
            let jitter = rng.random_range(-0.2..0.2);
            let chair = Kind::Chair.size(rng);
            let at = at + r * DVec3::new(sx, sy, 0.0);
            let yaw = turn + facing + jitter;
            let place = Place {
                at,
                yaw,
                size: chair,
                variant: variant + i % 2 * 7,
            };
            Kind::Chair.build(b, style, place, rng);
        }
        let drop = plan.size.z - rng.random_range(1.75..1.85);
        pendant(b, style, at + DVec3::Z * plan.size.z, drop, rng);
        return true;
    }
    false
}

/// Two to four cabinets along the walls.
fn cabinets(b: &mut Builder, plan: &mut Plan, style: &Style, rng: &mut impl Rng) {
    let mut kinds = vec![Kind::Bookcase, Kind::Sideboard];
    kinds.extend(
        [Kind::Chest, Kind::Wardrobe, Kind::Bookcase]
            .iter()
            .filter(|_| rng.random_bool(0.55)),
    );
    for kind in kinds {
        let size = kind.size(rng);
        let Some((k, s)) = plan.place_at_wall(&shuffled(rng), size, rng) else {
            continue;
        };
        let at = plan.on_wall(k, s, size[1] / 2.0 + 0.02, 0.0);
        let variant = rng.random_range(0..12);
        kind.build(
            b,
            style,
            Place {
                at,
                yaw: yaw(k),
                size,
                variant,
            },
            rng,
        );
        let top = matches!(kind, Kind::Sideboard | Kind::Chest);
        // Something tall on a low cabinet needs free wall behind it.
        if top
            && plan.take_wall(
                k,
                [
                    s - size[0] / 2.0,
                    s + size[0] / 2.0,
                    size[2] + 0.05,
                    size[2] + 0.5,
                ],
                0.0,
            )
        {
            let x = if kind == Kind::Sideboard {
                size[0] * 0.34
            } else {
                0.0
            };
            let out = plan.on_wall(k, s + x, size[1] / 2.0, size[2]);
            table_lamp(b, style, out, rng);
        }
    }
}

/// A desk at a wall with its chair.
fn desk_corner(b: &mut Builder, plan: &mut Plan, style: &Style, rng: &mut impl Rng) {
    let size = Kind::Desk.size(rng);
    // The chair's place counts, so that nothing else stands there.
    let Some((k, s)) = plan.place_at_wall(&shuffled(rng), [size[0], size[1] + 0.5, 1.0], rng)
    else {
        return;
    };
    let variant = rng.random_range(0..12);
    let at = plan.on_wall(k, s, size[1] / 2.0 + 0.02, 0.0);
    Kind::Desk.build(
        b,
        style,
        Place {
            at,
            yaw: yaw(k),
            size,
            variant,
        },
        rng,
    );
    let turn = yaw(k) + PI + rng.random_range(-0.3..0.3);
    let at = plan.on_wall(k, s - 0.15, size[1] + 0.18, 0.0);
    let size = Kind::Chair.size(rng);
    Kind::Chair.build(
        b,
        style,
        Place {
            at,
            yaw: turn,
            size,
            variant: variant + 1,
        },
        rng,
    );
}

/// How many objects of each class id (0..=10) a room holds.
pub(super) fn census(b: &Builder) -> [usize; 11] {
    let mut seen = std::collections::BTreeSet::new();
    let mut count = [0; 11];
    for s in &b.solids {
        if seen.insert(s.instance) {
            count[usize::from(s.class.min(class::LAMP))] += 1;
        }
    }
    count
}
