//! Builds objects from solids.

use super::patterns::{Material, Pattern};
use super::shapes::{Shape, Solid};
use glam::{DMat3, DVec3};

/// Class ids of the built-in scene; 0 is 'unlabelled' and occurs in raw labels only.
pub(super) mod class {
    pub const WALL: u16 = 1;
    pub const FLOOR: u16 = 2;
    pub const CEILING: u16 = 3;
    pub const WINDOW: u16 = 4;
    pub const PICTURE: u16 = 5;
    pub const TABLE: u16 = 6;
    pub const CHAIR: u16 = 7;
    pub const SOFA: u16 = 8;
    pub const CABINET: u16 = 9;
    pub const LAMP: u16 = 10;
}

/// A light of the room.
#[derive(Clone, Debug)]
pub(super) enum Light {
    /// A small glowing ball.
    Lamp { center: DVec3, color: DVec3 },
    /// A window pane: centre, half side vectors, inward normal.
    Pane {
        center: DVec3,
        across: DVec3,
        up: DVec3,
        normal: DVec3,
        color: DVec3,
    },
}

/// Solids, materials and lights under construction.
#[derive(Clone, Debug, Default)]
pub(super) struct Builder {
    pub solids: Vec<Solid>,
    pub materials: Vec<Material>,
    pub lights: Vec<Light>,
    /// Instances so far; ids start at 1.
    pub instances: u16,
}

impl Builder {
    /// A matt material; returns its index.
    pub fn matt(&mut self, pattern: Pattern) -> usize {
        self.add_material(pattern, 0.0, 1.0)
    }

    /// A material that glows: emitted and reflected share.
    pub fn add_material(&mut self, pattern: Pattern, glow: f64, lit: f64) -> usize {
        let seed = self.materials.len() as u64 + 1;
        self.materials.push(Material {
            pattern,
            seed,
            glow,
            lit,
        });
        self.materials.len() - 1
    }

    /// Starts a new object whose frame has its origin at `origin` and is turned by `yaw` about z.
    pub fn object(&mut self, class: u16, origin: DVec3, yaw: f64) -> Object<'_> {
        self.instances += 1;
        let instance = self.instances;
        Object {
            builder: self,
            class,
            instance,
            origin,
            axes: DMat3::from_rotation_z(yaw),
        }
    }
}

/// One object being built. Its front looks along +y, z is up.
pub(super) struct Object<'a> {
    pub builder: &'a mut Builder,
    class: u16,
    instance: u16,
    origin: DVec3,
    axes: DMat3,
}

impl Object<'_> {
    /// Adds a solid of `size` (full extents) centred at `center`, turned by `turn` in the object's frame.
    pub fn solid(
        &mut self,
        shape: Shape,
        center: [f64; 3],
        size: [f64; 3],
        turn: DMat3,
        material: usize,
    ) {
        self.builder.solids.push(Solid {
            shape,
            half: DVec3::from(size) * 0.5,
            center: self.origin + self.axes * DVec3::from(center),
            axes: self.axes * turn,
            material,
            instance: self.instance,
            class: self.class,
            casts_shadow: true,
        });
    }

    /// An upright box.
    pub fn cuboid(&mut self, center: [f64; 3], size: [f64; 3], material: usize) {
        self.solid(Shape::Box, center, size, DMat3::IDENTITY, material);
    }

    /// An upright box with rounded edges.
    pub fn cushion(&mut self, center: [f64; 3], size: [f64; 3], radius: f64, material: usize) {
        let shape = Shape::Rounded(radius);
        self.solid(shape, center, size, DMat3::IDENTITY, material);
    }

    /// An upright cylinder or cone: centre, height, radius at the bottom and at the top.
    pub fn turned(
        &mut self,
        center: [f64; 3],
        height: f64,
        bottom: f64,
        top: f64,
        material: usize,
    ) {
        let r = bottom.max(top);
        let shape = Shape::Frustum(bottom / r, top / r);
        let size = [2.0 * r, 2.0 * r, height];
        self.solid(shape, center, size, DMat3::IDENTITY, material);
    }

    /// An ellipsoid.
    pub fn ball(&mut self, center: [f64; 3], size: [f64; 3], material: usize) {
        self.solid(Shape::Ellipsoid, center, size, DMat3::IDENTITY, material);
    }

    /// Lets light through the solid added last.
    pub fn translucent(&mut self) {
        if let Some(s) = self.builder.solids.last_mut() {
            s.casts_shadow = false;
        }
    }

    /// A point of the object's frame in room coordinates.
    pub fn place(&self, p: [f64; 3]) -> DVec3 {
        self.origin + self.axes * DVec3::from(p)
    }

    /// A direction of the object's frame in room coordinates.
    pub fn direction(&self, d: DVec3) -> DVec3 {
        self.axes * d
    }
}
