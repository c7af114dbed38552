//! Draws a furnished room: walls with windows and pictures, a seating group, a dining group, cabinets and lamps.

use super::build::Builder;
use super::furniture::Furniture;
use super::style::Style;
use glam::{DMat2, DMat3, DVec2, DVec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, PI};

/// The occupied places of a room, on the floor and on the walls.
pub(super) struct Plan {
    /// Width (x), depth (y), height (z), metres; the floor's centre is the origin.
    pub size: DVec3,
    /// Occupied rectangles of the floor.
    floor: Vec<(DVec2, DVec2)>,
    /// Occupied rectangles of each wall: from, to along the wall; from, to in height.
    walls: [Vec<[f64; 4]>; 4],
}

impl Plan {
    fn new(size: DVec3) -> Self {
        Self {
            size,
            floor: Vec::new(),
            walls: Default::default(),
        }
    }

    /// Length of wall `k` (0 south, 1 east, 2 north, 3 west).
    pub fn length(&self, k: usize) -> f64 {
        self.size[k % 2]
    }

    /// Point of wall `k` at `s` along it from its middle, `out` into the room, height `z`.
    pub fn on_wall(&self, k: usize, s: f64, out: f64, z: f64) -> DVec3 {
        let across = self.size[(k + 1) % 2];
        let flat = DMat2::from_angle(yaw(k)) * DVec2::new(s, out - across / 2.0);
        flat.extend(z)
    }

    /// Whether a rectangle lies in the room, at least `gap` from everything on the floor.
    fn fits(&self, low: DVec2, high: DVec2, gap: f64) -> bool {
        let reach = self.size.truncate() / 2.0 + 1e-9;
        low.cmpge(-reach).all()
            && high.cmple(reach).all()
            && self
                .floor
                .iter()
                .all(|&(l, h)| (low - gap).cmpge(h).any() || (high + gap).cmple(l).any())
    }

    /// Occupies the floor under a `w` x `d` piece at `at`, turned by `yaw`, if it is free.
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

    /// Occupies a rectangle of wall `k` if it is free.
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

    /// Finds a place for a piece with its back to a wall. Tries random places on each of `walls` in turn.
    fn place_at_wall(
        &mut self,
        walls: &[usize],
        [w, d, h]: [f64; 3],
        rng: &mut ChaCha8Rng,
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

/// A room while it is being drawn.
pub(super) struct Decorator<'a> {
    pub builder: Builder,
    pub plan: Plan,
    pub style: Style,
    pub rng: &'a mut ChaCha8Rng,
}

/// Draws a room; returns its parts and its extents. `size` replaces the random extents.
pub(super) fn furnish(size: Option<DVec3>, rng: &mut ChaCha8Rng) -> (Builder, DVec3) {
    let width = rng.random_range(4.6..6.8);
    let depth = rng.random_range(4.2..5.8);
    let drawn = DVec3::new(width, depth, rng.random_range(2.5..2.9));
    let size = size.unwrap_or(drawn);
    let mut builder = Builder::default();
    let style = Style::draw(&mut builder, rng);
    let mut room = Decorator {
        builder,
        plan: Plan::new(size),
        style,
        rng,
    };
    room.shell();
    let sunny = room.rng.random_range(0..4);
    let walls = [sunny, (sunny + 1) % 4, sunny];
    let windows = walls.map(|k| room.window(k));
    if !windows.contains(&true) {
        room.window((sunny + 2) % 4);
    }
    let lounge = room.seating([0, 1, 2, 3].map(|i| (sunny + 2 + i) % 4));
    let dining = room.dining_group();
    room.cabinets();
    if !dining || room.rng.random_bool(0.4) {
        room.desk_corner();
    }
    for _ in 0..1 + usize::from(!lounge) {
        room.floor_lamp();
    }
    for _ in 0..room.rng.random_range(5..9) {
        room.picture();
    }
    (room.builder, size)
}

impl Decorator<'_> {
    fn shuffled_walls(&mut self) -> [usize; 4] {
        let mut order = [0, 1, 2, 3];
        for i in (1..4).rev() {
            order.swap(i, self.rng.random_range(0..=i));
        }
        order
    }

    /// Adds a piece that stands at `at`, turned by `yaw`; `variant` picks among its looks.
    fn put(&mut self, kind: Furniture, at: DVec3, yaw: f64, size: [f64; 3], variant: usize) {
        let object = &mut self.builder.object(kind.class(), at, yaw);
        kind.build(object, &self.style, size, variant, self.rng);
    }

    fn table_lamp(&mut self, at: DVec3) {
        let size = Furniture::TableLamp.size(self.rng);
        self.put(Furniture::TableLamp, at, 0.0, size, 0);
    }

    /// Sofa at a wall, a rug, a low table before it, armchairs and a side table with a lamp.
    fn seating(&mut self, walls: [usize; 4]) -> bool {
        let size = Furniture::Sofa.size(self.rng);
        let Some((k, s)) = self.plan.place_at_wall(&walls, size, self.rng) else {
            return false;
        };
        let variant = self.rng.random_range(0..12);
        let at = self.plan.on_wall(k, s, size[1] / 2.0 + 0.02, 0.0);
        self.put(Furniture::Sofa, at, yaw(k), size, variant);
        let low = Furniture::CoffeeTable.size(self.rng);
        let front = size[1] + 0.42 + low[1] / 2.0;
        let middle = self.plan.on_wall(k, s, front, 0.0);
        self.rug(middle, yaw(k), [size[0] + 0.5, low[1] + 1.3]);
        if self.plan.take_floor(middle, yaw(k), low[0], low[1], 0.1) {
            let variant = self.rng.random_range(0..4);
            self.put(Furniture::CoffeeTable, middle, yaw(k), low, variant);
        }
        let across = self.rng.random_range(0..3);
        for side in [-1.0, 1.0] {
            let chair = Furniture::Armchair.size(self.rng);
            // Facing the low table from its side, or from across.
            let mut ds = side * (low[0] / 2.0 + 0.4 + chair[1] / 2.0);
            let mut dy = front + 0.1;
            let mut turn = side * FRAC_PI_2;
            if across == 2 {
                ds = side * (chair[0] / 2.0 + 0.12);
                dy = front + low[1] / 2.0 + 0.4 + chair[1] / 2.0;
                turn = PI;
            }
            let turn = turn + self.rng.random_range(-0.25..0.25);
            let at = self.plan.on_wall(k, s + ds, dy, 0.0);
            let yaw = yaw(k) + turn;
            if self.plan.take_floor(at, yaw, chair[0], chair[1], 0.08) {
                self.put(Furniture::Armchair, at, yaw, chair, variant + 1);
            }
        }
        let table = Furniture::SideTable.size(self.rng);
        for side in [-1.0, 1.0] {
            let s = s + side * (size[0] / 2.0 + table[0] / 2.0 + 0.1);
            let at = self.plan.on_wall(k, s, 0.3, 0.0);
            let free = self.plan.take_floor(at, 0.0, table[0], table[0], 0.02);
            let behind = [s - 0.24, s + 0.24, 0.0, 1.15];
            if free && self.plan.take_wall(k, behind, 0.02) {
                let variant = self.rng.random_range(0..2);
                self.put(Furniture::SideTable, at, 0.0, table, variant);
                self.table_lamp(at + DVec3::Z * table[2]);
            }
        }
        true
    }

    /// Table with chairs around it and a lamp above.
    fn dining_group(&mut self) -> bool {
        let size = Furniture::DiningTable.size(self.rng);
        for _ in 0..60 {
            let reach = self.plan.size.truncate() / 2.0 - 1.15;
            let x = self.rng.random_range(-1.0..1.0) * reach.x;
            let y = self.rng.random_range(-1.0..1.0) * reach.y;
            let turn = yaw(self.rng.random_range(0..2)) + self.rng.random_range(-0.12..0.12);
            let at = DVec3::new(x, y, 0.0);
            // With room for the chairs.
            let [w, d] = [size[0] + 0.7, size[1] + 1.0];
            if self.plan.take_floor(at, turn, w, d, 0.15) {
                self.set_table(at, turn, size);
                return true;
            }
        }
        false
    }

    fn set_table(&mut self, at: DVec3, turn: f64, size: [f64; 3]) {
        let look = self.rng.random_range(0..4);
        self.put(Furniture::DiningTable, at, turn, size, look);
        let variant = self.rng.random_range(0..12);
        let axes = DMat3::from_rotation_z(turn);
        let w = size[0] / 2.0;
        let d = size[1] / 2.0;
        let mut seats = vec![(-w * 0.5, -d - 0.12, 0.0), (w * 0.5, -d - 0.12, 0.0)];
        seats.extend([(-w * 0.5, d + 0.12, PI), (w * 0.5, d + 0.12, PI)]);
        if self.rng.random_bool(0.6) {
            seats.push((w + 0.1, 0.0, FRAC_PI_2));
        }
        for (i, (x, y, facing)) in seats.into_iter().enumerate() {
            let jitter = self.rng.random_range(-0.2..0.2);
            let chair = Furniture::Chair.size(self.rng);
            let seat = at + axes * DVec3::new(x, y, 0.0);
            let yaw = turn + facing + jitter;
            self.put(Furniture::Chair, seat, yaw, chair, variant + i % 2 * 7);
        }
        let ceiling = self.plan.size.z;
        // How far the shade hangs below the ceiling.
        let drop = ceiling - self.rng.random_range(1.75..1.85);
        let at = at + DVec3::Z * ceiling;
        self.put(Furniture::Pendant, at, 0.0, [0.46, 0.46, drop], 0);
    }

    /// Two to five cabinets along the walls.
    fn cabinets(&mut self) {
        let mut kinds = vec![Furniture::Bookcase, Furniture::Sideboard];
        let more = [Furniture::Chest, Furniture::Wardrobe, Furniture::Bookcase];
        kinds.extend(more.iter().filter(|_| self.rng.random_bool(0.55)));
        for kind in kinds {
            let size = kind.size(self.rng);
            let walls = self.shuffled_walls();
            let Some((k, s)) = self.plan.place_at_wall(&walls, size, self.rng) else {
                continue;
            };
            let at = self.plan.on_wall(k, s, size[1] / 2.0 + 0.02, 0.0);
            let variant = self.rng.random_range(0..12);
            self.put(kind, at, yaw(k), size, variant);
            // A lamp on a low cabinet needs free wall behind it.
            let low = matches!(kind, Furniture::Sideboard | Furniture::Chest);
            let (from, to) = (s - size[0] / 2.0, s + size[0] / 2.0);
            let above = [from, to, size[2] + 0.05, size[2] + 0.5];
            if low && self.plan.take_wall(k, above, 0.0) {
                let x = if kind == Furniture::Sideboard {
                    size[0] * 0.34
                } else {
                    0.0
                };
                self.table_lamp(self.plan.on_wall(k, s + x, size[1] / 2.0, size[2]));
            }
        }
    }

    /// A desk at a wall with its chair.
    fn desk_corner(&mut self) {
        let size = Furniture::Desk.size(self.rng);
        let walls = self.shuffled_walls();
        // The chair's place counts, so that nothing else stands there.
        let room = [size[0], size[1] + 0.5, 1.0];
        let Some((k, s)) = self.plan.place_at_wall(&walls, room, self.rng) else {
            return;
        };
        let variant = self.rng.random_range(0..12);
        let at = self.plan.on_wall(k, s, size[1] / 2.0 + 0.02, 0.0);
        self.put(Furniture::Desk, at, yaw(k), size, variant);
        let turn = yaw(k) + PI + self.rng.random_range(-0.3..0.3);
        let at = self.plan.on_wall(k, s - 0.15, size[1] + 0.18, 0.0);
        let chair = Furniture::Chair.size(self.rng);
        self.put(Furniture::Chair, at, turn, chair, variant + 1);
    }

    fn floor_lamp(&mut self) {
        let size = Furniture::FloorLamp.size(self.rng);
        let walls = self.shuffled_walls();
        if let Some((k, s)) = self.plan.place_at_wall(&walls, size, self.rng) {
            let at = self.plan.on_wall(k, s, size[1] / 2.0 + 0.03, 0.0);
            self.put(Furniture::FloorLamp, at, 0.0, size, 0);
        }
    }
}
