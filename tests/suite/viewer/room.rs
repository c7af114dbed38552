//! The built-in room's rug, which is called wall, made right in the viewer's page.

use crate::support::browser::browser;
use crate::support::devtools::{CTRL, Tab};
use crate::support::edited_plates::{assert_applied_to, selected, state};
use coseg::data::builtin::{
    BuiltinOptions, EVALUATED_SEED, Room, Truth, classes, render_truth, scene_with,
};
use coseg::data::{Classes, NamedCamera, Split};
use coseg::files::sha256;
use coseg::splat::camera::Camera;
use coseg::splat::{Gaussians, ply};
use coseg::viewer::Viewer;
use glam::DVec3;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const SIZE: [usize; 2] = [160, 120];

/// A photo of the room, and the pixels of the rug in it.
struct Photo {
    camera: Camera,
    truth: Truth,
    rug: Vec<[usize; 2]>,
}

impl Photo {
    /// The one that shows most of the rug.
    fn of_the_rug() -> Self {
        let options = BuiltinOptions {
            width: SIZE[0],
            height: SIZE[1],
            train_views: 12,
            test_views: 0,
            points: 100,
            ..BuiltinOptions::default()
        };
        let room = Room::of_scene(EVALUATED_SEED);
        let photos = scene_with(&options).unwrap().views;
        let photos = photos.into_iter().map(|view| {
            let truth = render_truth(&room, &view.camera);
            let rug = rug(&view.camera, &truth);
            Self {
                camera: view.camera,
                truth,
                rug,
            }
        });
        photos.max_by_key(|photo| photo.rug.len()).unwrap()
    }

    /// A Gaussian for each pixel, as wide as it.
    fn gaussians(&self) -> Gaussians {
        let pixels = || (0..SIZE[0] * SIZE[1]).map(|i| [i % SIZE[0], i / SIZE[0]]);
        let places = pixels().map(|pixel| place(&self.camera, &self.truth, pixel));
        let width = |i: usize| {
            (0.6 * f64::from(self.truth.depth[i]).max(0.01) / self.camera.fx).ln() as f32
        };
        let colors = pixels().flat_map(|[x, y]| self.truth.image.get_pixel(x as u32, y as u32).0);
        let n = SIZE[0] * SIZE[1];
        Gaussians {
            means: places.map(|place| place.as_vec3().to_array()).collect(),
            log_scales: (0..n).map(|i| [width(i); 3]).collect(),
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![3.0; n],
            sh: colors
                .map(|v| (f32::from(v) / 255.0 - 0.5) / 0.282_094_8)
                .collect(),
            sh_degree: 0,
        }
    }

    /// A line around the rug, pixels: down its left side and up its right.
    fn outline(&self) -> Vec<[f64; 2]> {
        let mut ends = BTreeMap::new();
        for &[x, y] in &self.rug {
            let [left, right] = ends.entry(y).or_insert([x, x]);
            (*left, *right) = (x.min(*left), x.max(*right));
        }
        let side = |end: usize, by: f64| {
            ends.iter()
                .map(move |(&y, ends)| [ends[end] as f64 + by, y as f64 + 0.5])
        };
        let mut left: Vec<_> = side(0, -0.2).collect();
        let mut right: Vec<_> = side(1, 1.2).collect();
        // Beyond the first and the last row, which would lie on the line.
        for line in [&mut left, &mut right] {
            let ([x, top], [u, bottom]) = (line[0], line[line.len() - 1]);
            line.insert(0, [x, top - 0.3]);
            line.push([u, bottom + 0.3]);
        }
        left.into_iter().chain(right.into_iter().rev()).collect()
    }

    /// A pixel of the rug with nothing else near it.
    fn inside(&self) -> [f64; 2] {
        let rug: BTreeSet<_> = self.rug.iter().copied().collect();
        let is_inner = |[x, y]: &&[usize; 2]| {
            let around = (0..9).flat_map(|i| (0..9).map(move |j| [x + i, y + j]));
            around
                .map(|[x, y]| [x.wrapping_sub(4), y.wrapping_sub(4)])
                .all(|pixel| rug.contains(&pixel))
        };
        let inner: Vec<_> = self.rug.iter().filter(is_inner).collect();
        inner[inner.len() / 2].map(|v| v as f64 + 0.5)
    }
}

/// Where the surface at a pixel is.
fn place(camera: &Camera, truth: &Truth, [x, y]: [usize; 2]) -> DVec3 {
    let depth = f64::from(truth.depth[y * SIZE[0] + x]);
    camera.center + camera.ray(x as f64 + 0.5, y as f64 + 0.5) * depth
}

/// The pixels of the rug, which lies on the floor and is 12 mm high.
fn rug(camera: &Camera, truth: &Truth) -> Vec<[usize; 2]> {
    let mut objects: BTreeMap<u16, Vec<[usize; 2]>> = BTreeMap::new();
    for (i, &object) in truth.instances.iter().enumerate() {
        let pixel = [i % SIZE[0], i / SIZE[0]];
        let is_rug = (place(camera, truth, pixel).z - 0.012).abs() < 1e-3;
        if truth.labels.ids[i] == id("floor") && is_rug {
            objects.entry(object).or_default().push(pixel);
        }
    }
    objects
        .into_values()
        .max_by_key(Vec::len)
        .unwrap_or_default()
}

fn id(name: &str) -> u16 {
    let entries = classes().entries;
    entries.iter().find(|class| class.name == name).unwrap().id
}

/// Writes scene and page.
fn write(dir: &Path, photo: &Photo, labels: &[u16], classes: &Classes) {
    let gaussians = photo.gaussians();
    let scene = dir.join("room.ply");
    ply::write(&scene, &gaussians, DVec3::ZERO, Some(labels)).unwrap();
    classes.write(&dir.join("classes.json")).unwrap();
    let cameras = [NamedCamera {
        name: "rug".into(),
        split: Split::Test,
        camera: photo.camera.clone(),
    }];
    Viewer {
        title: "room",
        scene: "room.ply",
        names: None,
        sha256: &sha256(&scene).unwrap(),
        gaussians: &gaussians,
        features: &[],
        origin: DVec3::ZERO,
        labels: Some(labels),
        classes,
        cameras: &cameras,
        up: Some(DVec3::Z),
        alpha_max: 0.999,
    }
    .write(&dir.join("page.html"))
    .unwrap();
}

#[test]
fn a_rug_that_is_called_wall_is_put_right() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let photo = Photo::of_the_rug();
    let classes = classes();
    let truth = &photo.truth.labels.ids;
    assert!(photo.rug.len() > 500, "{}", photo.rug.len());
    let mut wrong = truth.clone();
    for [x, y] in &photo.rug {
        wrong[y * SIZE[0] + x] = id("wall");
    }
    write(dir.path(), &photo, &wrong, &classes);

    let mut tab = Tab::open(&browser, &dir.path().join("page.html"), [720, 420]);
    let start = state(&mut tab);
    assert_eq!(tab.value("Array.from(page.state.labels())"), json!(wrong));
    let fitted = "(() => { const s = page.fitted.fx / page.source.fx;         return [s, page.fitted.cx - s * page.source.cx, page.fitted.cy - s * page.source.cy]; })()";
    let [scale, left, top]: [f64; 3] = serde_json::from_value(tab.value(fitted)).unwrap();
    let spot = |[x, y]: [f64; 2]| [scale * x + left, scale * y + top];

    // The rug is taken for wall; within that the lasso takes it.
    tab.drag(&[spot(photo.inside())], 0);
    assert_eq!(tab.value("[...page.chosen]"), json!([id("wall")]));
    tab.key("KeyO", 0);
    tab.value("page.tools.slider = 100");
    let line: Vec<_> = photo.outline().into_iter().map(spot).collect();
    tab.drag(&line, 0);
    assert_eq!(selected(&mut tab), json!([photo.rug.len(), "wall"]));
    tab.key("KeyT", 0);
    tab.value(&format!("page.details.target.value = '{}'", id("floor")));
    tab.key("Enter", 0);
    assert_eq!(tab.value("Array.from(page.state.labels())"), json!(truth));
    assert_applied_to(&mut tab, &dir.path().join("room.ply"), dir.path());

    tab.key("KeyZ", CTRL);
    assert_eq!(state(&mut tab), start);
    assert_eq!(tab.value("page.edits.operations"), Value::Array(Vec::new()));
}
