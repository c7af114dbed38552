//! A finished room and its ray-cast pictures.

use super::build::{Builder, Light, class};
use super::layout;
use super::light::{LightMap, Lit};
use super::patterns::{Material, Spot};
use super::shapes::{Hit, Solid, Solids};
use crate::data::LabelMap;
use crate::splat::camera::Camera;
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// What random numbers are drawn for. Each purpose has its own random stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RoomStream {
    /// The room of a scene with photos.
    Scene,
    /// A room to pretrain the point encoder on.
    Pretraining,
    /// Cameras of a scene.
    Cameras,
    /// Initial points.
    Points,
    /// Errors of raw labels.
    RawLabels,
}

/// A random stream for one purpose of one seed.
pub(super) fn stream(seed: u64, purpose: RoomStream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(1 + purpose as u64);
    rng
}

/// Everything seen from one camera.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The photo: anti-aliased, 8-bit sRGB.
    pub image: image::RgbImage,
    /// Class ids at pixel centres.
    pub labels: LabelMap,
    /// Object ids at pixel centres, `[H, W]`; 0 does not occur.
    pub instances: Vec<u16>,
    /// Depth along the camera's z axis at pixel centres, metres, `[H, W]`.
    pub depth: Vec<f32>,
}

/// Smallest number of objects of some classes in the room of a scene.
const MIN_OBJECTS: [(u16, usize); 7] = [
    (class::WINDOW, 3),
    (class::PICTURE, 5),
    (class::TABLE, 3),
    (class::CHAIR, 4),
    (class::SOFA, 2),
    (class::CABINET, 3),
    (class::LAMP, 3),
];

/// A furnished room: floor at z = 0, its centre at the origin, metres.
#[derive(Clone, Debug)]
pub struct Room {
    /// Width (x), depth (y), height (z).
    pub size: DVec3,
    pub(super) solids: Solids,
    materials: Vec<Material>,
    lights: Vec<Light>,
    /// One for each solid; empty if light is computed for each point.
    light_maps: Vec<LightMap>,
}

impl Room {
    /// The room of the scene with this seed: every class is present, most of them several times.
    pub fn of_scene(seed: u64) -> Self {
        let mut rng = stream(seed, RoomStream::Scene);
        loop {
            let (b, size) = layout::furnish(Some(DVec3::new(6.4, 5.2, 2.7)), &mut rng);
            let objects: BTreeSet<_> = b.solids.iter().map(|s| (s.class, s.instance)).collect();
            let count = |class| objects.iter().filter(|object| object.0 == class).count();
            let has = |&(class, least): &(u16, usize)| count(class) >= least;
            // A few layouts are enough.
            if MIN_OBJECTS.iter().all(has) {
                let mut room = Self::new(b, size);
                room.bake();
                return room;
            }
        }
    }

    /// A room to pretrain on, of random size and furnishing. Its random stream differs from that of scenes.
    pub(super) fn for_pretraining(seed: u64) -> Self {
        let (b, size) = layout::furnish(None, &mut stream(seed, RoomStream::Pretraining));
        Self::new(b, size)
    }

    fn new(b: Builder, size: DVec3) -> Self {
        Self {
            size,
            solids: Solids::new(b.solids),
            materials: b.materials,
            lights: b.lights,
            light_maps: Vec::new(),
        }
    }

    fn bake(&mut self) {
        let lit = self.lit((40, 3));
        let fixed = |c: u16| matches!(c, class::WALL | class::FLOOR | class::CEILING);
        let texel = |s: &Solid| if fixed(s.class) { 0.08 } else { 0.05 };
        let maps = (0..self.solids.all.len())
            .into_par_iter()
            .map(|i| LightMap::bake(&lit, i, texel(&self.solids.all[i]), self.size))
            .collect();
        self.light_maps = maps;
    }

    fn lit(&self, quality: (usize, usize)) -> Lit<'_> {
        Lit {
            solids: &self.solids,
            lights: &self.lights,
            quality,
        }
    }

    pub(super) fn cast(&self, o: DVec3, d: DVec3) -> Option<Hit> {
        self.solids.first(o, d, 1e-6, f64::INFINITY)
    }

    /// Display colour (sRGB, 0..1) of what a ray hit. `quality` is used where no light maps were baked.
    pub(super) fn shade(&self, hit: &Hit, o: DVec3, d: DVec3, quality: (usize, usize)) -> [f32; 3] {
        let solid = &self.solids.all[hit.solid];
        let room_point = o + d * hit.t;
        let p = solid.to_local(room_point);
        let material = &self.materials[solid.material];
        let mut light = DVec3::splat(material.glow);
        if material.lit > 0.0 {
            let normal = solid.axes * hit.normal;
            let arriving = match self.light_maps.get(hit.solid) {
                Some(map) => map.at(p, solid.half),
                None => self.lit(quality).arriving(room_point, normal).0,
            };
            light += arriving * material.lit;
        }
        let color = material.color(&Spot::new(solid, p, hit.normal)) * light;
        color.to_array().map(display)
    }

    /// Distance from `p` to the nearest piece of furniture or wall, metres; a lower bound for round shapes.
    pub fn clearance(&self, p: DVec3) -> f64 {
        let distances = self.solids.all.iter().map(|s| s.clearance(p));
        distances.fold(f64::INFINITY, f64::min)
    }
}

/// Tone curve (soft shoulder above 0.6) and sRGB transfer, from a table.
fn display(x: f64) -> f32 {
    static TABLE: std::sync::LazyLock<Vec<f32>> = std::sync::LazyLock::new(|| {
        (0..=4096)
            .map(|i| {
                // Square-root spacing keeps the dark end fine.
                let x = 4.0 * (f64::from(i) / 4096.0).powi(2);
                let y = if x < 0.6 {
                    x
                } else {
                    0.6 + 0.4 * (1.0 - (-(x - 0.6) / 0.4).exp())
                };
                (if y <= 0.003_130_8 {
                    12.92 * y
                } else {
                    1.055 * y.powf(1.0 / 2.4) - 0.055
                }) as f32
            })
            .collect()
    });
    let at = (x.clamp(0.0, 3.99) / 4.0).sqrt() * 4096.0;
    let i = at as usize;
    let f = (at - i as f64) as f32;
    TABLE[i] * (1.0 - f) + TABLE[i + 1] * f
}

/// Ray-casts what `camera` sees of `room`: photo, exact labels, objects and depth. Colour is sampled at pixel centres
/// (weight 1/2) and pixel corners (1/8 each), which anti-aliases for two rays a pixel. Light is the same from every
/// direction. The camera must be inside the room; pixels without a hit (outside it) are black with label and depth 0.
pub fn render_truth(room: &Room, camera: &Camera) -> Truth {
    let (w, h) = (camera.width, camera.height);
    let see = |u: f64, v: f64| {
        let d = camera.ray(u, v);
        let hit = room.cast(camera.center, d);
        let color = hit.map_or([0.0; 3], |hit| room.shade(&hit, camera.center, d, (0, 0)));
        (hit, color)
    };
    let across = w + 1;
    let corners = (0..across * (h + 1)).into_par_iter();
    let corners = corners.map(|i| see((i % across) as f64, (i / across) as f64).1);
    let corners: Vec<[f32; 3]> = corners.collect();
    let pixels = (0..w * h).into_par_iter().map(|i| {
        let (x, y) = (i % w, i / w);
        let (hit, center) = see(x as f64 + 0.5, y as f64 + 0.5);
        let corner = y * across + x;
        let around = [0, 1, across, across + 1].map(|step| corners[corner + step]);
        let color = [0, 1, 2].map(|k| {
            let c = 0.5 * center[k] + 0.125 * around.iter().map(|a| a[k]).sum::<f32>();
            (c * 255.0 + 0.5) as u8
        });
        (color, hit)
    });
    let pixels: Vec<([u8; 3], Option<Hit>)> = pixels.collect();
    let bytes = pixels.iter().flat_map(|(color, _)| *color).collect();
    let ids = |id: fn(&Solid) -> u16| -> Vec<u16> {
        let of_hit = |hit: Hit| id(&room.solids.all[hit.solid]);
        let hits = pixels.iter().map(|(_, hit)| hit);
        hits.map(|hit| hit.map_or(0, of_hit)).collect()
    };
    Truth {
        image: image::RgbImage::from_raw(w as u32, h as u32, bytes).unwrap_or_default(),
        labels: LabelMap {
            width: w,
            height: h,
            ids: ids(|solid| solid.class),
        },
        instances: ids(|solid| solid.instance),
        depth: pixels
            .iter()
            .map(|(_, hit)| hit.map_or(0.0, |hit| hit.t as f32))
            .collect(),
    }
}
