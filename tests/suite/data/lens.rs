//! Lens distortion: photos drawn through a known lens come back as a pinhole's.

use coseg::data::formats::transforms::load_cameras;
use coseg::data::{LabelMap, LoadOptions, Scene, View, load};
use coseg::splat::camera::Camera;
use serde_json::json;
use std::fs;
use std::path::Path;

const WIDTH: u32 = 96;
const HEIGHT: u32 = 64;
const FOCAL: [f64; 2] = [70.0, 72.0];
const CENTER: [f64; 2] = [46.5, 33.25];

/// k1, k2, k3, p1, p2.
type Coefficients = [f64; 5];

fn distort([k1, k2, k3, p1, p2]: Coefficients, [x, y]: [f64; 2]) -> [f64; 2] {
    let r2 = x * x + y * y;
    let radial = 1.0 + k1 * r2 + k2 * r2.powi(2) + k3 * r2.powi(3);
    [
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    ]
}

/// The inverse, by a fixed point.
fn undistort(lens: Coefficients, seen: [f64; 2]) -> [f64; 2] {
    let mut p = seen;
    for _ in 0..200 {
        let q = distort(lens, p);
        p = [p[0] + 0.7 * (seen[0] - q[0]), p[1] + 0.7 * (seen[1] - q[1])];
    }
    p
}

/// What the world looks like in the direction `(x, y, 1)`: smooth colours.
fn color([x, y]: [f64; 2]) -> [f64; 3] {
    [
        127.5 + 100.0 * (5.0 * x + 2.0 * y).sin(),
        127.5 + 100.0 * (4.0 * y - x).cos(),
        100.0 + 60.0 * (x * y).sin(),
    ]
}

/// And which class it has: two halves along a slanted line.
fn class([x, y]: [f64; 2]) -> u16 {
    if 0.3 * y + x < 0.05 { 1 } else { 2 }
}

fn direction(focal: [f64; 2], center: [f64; 2], column: u32, row: u32) -> [f64; 2] {
    [
        (f64::from(column) + 0.5 - center[0]) / focal[0],
        (f64::from(row) + 0.5 - center[1]) / focal[1],
    ]
}

/// Photo and label map through the lens.
fn write_photo(dir: &Path, lens: Coefficients) {
    let seen = |x, y| undistort(lens, direction(FOCAL, CENTER, x, y));
    let photo = image::RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        image::Rgb(color(seen(x, y)).map(|v| v.round() as u8))
    });
    let ids = (0..WIDTH * HEIGHT)
        .map(|i| class(seen(i % WIDTH, i / WIDTH)))
        .collect();
    for folder in ["images", "labels"] {
        fs::create_dir_all(dir.join(folder)).expect("folder");
    }
    photo.save(dir.join("images/v.png")).expect("photo");
    photo.save(dir.join("images/w.png")).expect("photo");
    let map = LabelMap {
        width: WIDTH as usize,
        height: HEIGHT as usize,
        ids,
    };
    map.write(&dir.join("labels/v.png")).expect("labels");
    map.write(&dir.join("labels/w.png")).expect("labels");
    fs::write(dir.join("classes.json"), r#"{"1": "left", "2": "right"}"#).expect("classes");
}

fn transforms(dir: &Path, [k1, k2, k3, p1, p2]: Coefficients) -> Scene {
    let pose = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]);
    let frame = |name: &str| json!({"file_path": format!("images/{name}.png"), "label_path": format!("labels/{name}.png"), "transform_matrix": pose});
    let file = json!({
        "camera_model": "OPENCV", "w": WIDTH, "h": HEIGHT, "fl_x": FOCAL[0], "fl_y": FOCAL[1], "cx": CENTER[0], "cy": CENTER[1],
        "k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2, "frames": [frame("v"), frame("w")],
    });
    fs::write(dir.join("transforms.json"), file.to_string()).expect("write");
    load(dir, &LoadOptions::default()).expect("scene")
}

/// Largest colour error and share of wrong labels against what a pinhole would see.
fn compare(view: &View) -> (f64, f64) {
    let Camera { fx, fy, cx, cy, .. } = view.camera;
    let seen = |x, y| direction([fx, fy], [cx, cy], x, y);
    let mut worst = 0.0_f64;
    for (x, y, pixel) in view.image.pixels().expect("photo").enumerate_pixels() {
        for (found, want) in pixel.0.iter().zip(color(seen(x, y))) {
            worst = worst.max((f64::from(*found) - want).abs());
        }
    }
    let truth = view.truth.as_ref().expect("labels").map();
    let wrong = (0..WIDTH * HEIGHT)
        .filter(|&i| truth.ids[i as usize] != class(seen(i % WIDTH, i / WIDTH)))
        .count();
    (worst, wrong as f64 / f64::from(WIDTH * HEIGHT))
}

#[test]
fn undistorted_photos_are_those_of_a_pinhole() {
    // Barrel, pincushion, tangential, all at once.
    for lens in [
        [-0.25, 0.05, 0.0, 0.0, 0.0],
        [0.2, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.01, -0.02],
        [-0.2, 0.08, -0.02, 3e-3, 2e-3],
    ] {
        let dir = tempfile::tempdir().expect("folder");
        write_photo(dir.path(), lens);
        let scene = transforms(dir.path(), lens);
        let view = &scene.views[0];
        let (worst, wrong) = compare(view);
        let zoom = view.camera.fx / FOCAL[0];
        eprintln!(
            "{lens:?}: zoom {zoom:.4}, worst colour {worst:.2} of 255, wrong labels {:.3} %",
            100.0 * wrong
        );
        assert!(worst < 3.0, "{lens:?}: {worst}");
        assert!(wrong < 0.02, "{lens:?}: {wrong}");
        let Camera {
            fx,
            fy,
            cx,
            cy,
            width,
            height,
            ..
        } = view.camera;
        assert!((fx / fy - FOCAL[0] / FOCAL[1]).abs() < 1e-12 && [cx, cy] == CENTER);
        assert_eq!((width, height), (WIDTH as usize, HEIGHT as usize));
        // The rim of the new image touches that of the photo: nothing is made up and no more is lost than must be.
        let rim = |s: f64| {
            let edge = (0..WIDTH).flat_map(|x| [(x, 0), (x, HEIGHT - 1)]);
            let edge = edge.chain((0..HEIGHT).flat_map(|y| [(0, y), (WIDTH - 1, y)]));
            let places = edge.map(|(x, y)| {
                let [x, y] = distort(lens, direction([fx * s, fy * s], [cx, cy], x, y));
                [FOCAL[0] * x + cx, FOCAL[1] * y + cy]
            });
            let outside = |[u, v]: [f64; 2]| {
                [
                    0.5 - u,
                    u + 0.5 - f64::from(WIDTH),
                    0.5 - v,
                    v + 0.5 - f64::from(HEIGHT),
                ]
                .into_iter()
                .fold(f64::MIN, f64::max)
            };
            places.map(outside).fold(f64::MIN, f64::max)
        };
        assert!(rim(1.0) < 0.01, "{lens:?}: pixels {} outside", rim(1.0));
        assert!(rim(0.99) > 0.0, "{lens:?}: a wider view was possible");
        // Cameras without photos are the same ones.
        let cameras = load_cameras(&dir.path().join("transforms.json"), None).expect("cameras");
        assert_eq!((cameras[0].camera.fx, cameras[0].camera.cy), (fx, cy));
        // Distortion that is not taken out is visible: the test can fail.
        let plain = transforms(dir.path(), [0.0; 5]);
        assert_eq!(
            (plain.views[0].camera.fx, plain.views[0].camera.fy),
            (FOCAL[0], FOCAL[1])
        );
        assert!(compare(&plain.views[0]).0 > 6.0, "{lens:?}");
    }
}

#[test]
fn colmap_lenses_are_those_of_transforms() {
    for (model, params, lens) in [
        (
            "SIMPLE_RADIAL",
            "70 46.5 33.25 -0.2",
            [-0.2, 0.0, 0.0, 0.0, 0.0],
        ),
        (
            "RADIAL",
            "70 46.5 33.25 -0.2 0.04",
            [-0.2, 0.04, 0.0, 0.0, 0.0],
        ),
        (
            "OPENCV",
            "70 70 46.5 33.25 -0.2 0.04 0.003 -0.002",
            [-0.2, 0.04, 0.0, 0.003, -0.002],
        ),
    ] {
        let dir = tempfile::tempdir().expect("folder");
        write_photo(dir.path(), lens);
        fs::create_dir_all(dir.path().join("sparse")).expect("folder");
        fs::write(
            dir.path().join("sparse/cameras.txt"),
            format!("1 {model} {WIDTH} {HEIGHT} {params}\n"),
        )
        .expect("write");
        let images = "1 1 0 0 0 0 0 0 1 v.png\n\n2 1 0 0 0 0 0 0 1 w.png\n\n";
        fs::write(dir.path().join("sparse/images.txt"), images).expect("write");
        let scene = load(dir.path(), &LoadOptions::default()).expect("scene");
        let view = &scene.views[1];
        // The photo has FOCAL's y; only x agrees, so compare along the middle row.
        let row = 33;
        for x in 0..WIDTH {
            let [dx, _] = direction([view.camera.fx; 2], CENTER, x, row);
            let want = color([dx, 0.0]);
            let found = view.image.pixels().expect("photo").get_pixel(x, row).0;
            assert!(
                (f64::from(found[0]) - want[0]).abs() < 8.0,
                "{model} {x}: {found:?} {want:?}"
            );
        }
        assert!(view.camera.fx != 70.0 && view.camera.fx == view.camera.fy);
        assert_eq!(scene.classes.len(), 2);
    }
}
