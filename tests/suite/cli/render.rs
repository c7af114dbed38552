//! `coseg render` and `coseg vote`: the files that they write.

use crate::support::plates::{HEIGHT, WIDTH, camera, plates, scene};
use crate::support::program::{cpu_backend, listed, read_json, read_npy, succeeds, utf8};
use coseg::data::Classes;
use coseg::raster::{Projected, Settings, render};
use coseg::splat::camera::Camera;
use coseg::splat::ply;
use glam::DVec3;

#[test]
fn render_writes_arrays_labels_and_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let out = folder.path().join("out");
    let cameras = folder.path().join("transforms.json");
    let render_args = [
        "render",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(&cameras),
        "--out",
        utf8(&out),
    ];
    let more = [
        "--format",
        "npy",
        "--labels",
        "--split",
        "test",
        "--background",
        "1,0.5,0",
        "--alpha-max",
        "0.9",
    ];
    let cpu = cpu_backend();
    succeeds(&[&render_args[..], &more, &["--backend", &cpu]].concat());
    let files = listed(&out);
    let of_view = |view: &str| {
        ["alpha.npy", "label.png", "label_color.png", "rgb.npy"]
            .map(|kind| format!("{view}.{kind}"))
    };
    let expected = [of_view("v2"), of_view("v5")].concat();
    assert_eq!(files, expected);

    let read = ply::read(&scene).unwrap();
    let camera = Camera {
        center: camera(5).center - read.origin,
        ..camera(5)
    };
    let settings = Settings {
        alpha_max: 0.9,
        ..Settings::default()
    };
    let expected = render(&read.gaussians, &camera, &settings, [1.0, 0.5, 0.0]).unwrap();
    let (shape, rgb) = read_npy(&out.join("v5.rgb.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64, 3]);
    assert_eq!(rgb, expected.rgb);
    let (shape, alpha) = read_npy(&out.join("v5.alpha.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64]);
    assert!(
        alpha
            .iter()
            .zip(&expected.transmittance)
            .all(|(a, t)| *a == 1.0 - t)
    );

    let labels = image::open(out.join("v5.label.png")).unwrap().into_luma8();
    assert_eq!(
        (labels.width() as usize, labels.height() as usize),
        (WIDTH, HEIGHT)
    );
    let mut seen: Vec<u8> = labels.as_raw().clone();
    for (id, a) in seen.iter().zip(&alpha) {
        assert_eq!(
            *id == 0,
            *a < 0.5,
            "no label exactly where the scene covers less than half"
        );
    }
    seen.sort_unstable();
    seen.dedup();
    assert!([1, 2, 3, 4].iter().all(|id| seen.contains(id)), "{seen:?}");
    #[cfg(feature = "wgpu")]
    if crate::support::gpu().is_some() {
        succeeds(&[&render_args[..], &more, &["--backend", "wgpu"]].concat());
        let (_, on_gpu) = read_npy(&out.join("v5.rgb.npy"));
        let differ = on_gpu
            .iter()
            .zip(&rgb)
            .filter(|(a, b)| (*a - *b).abs() > 1e-4)
            .count();
        assert!(
            on_gpu.len() == rgb.len() && differ * 1000 < rgb.len(),
            "{differ} of {}",
            rgb.len()
        );
        assert_eq!(
            image::open(out.join("v5.label.png")).unwrap().into_luma8(),
            labels
        );
    }

    succeeds(&[&render_args[..], &["--split", "train"]].concat());
    let picture = image::open(out.join("v0.rgb.png")).unwrap().into_rgb8();
    let photo = image::open(folder.path().join("images/v0.png"))
        .unwrap()
        .into_rgb8();
    let largest = picture
        .iter()
        .zip(photo.iter())
        .map(|(a, b)| a.abs_diff(*b))
        .max()
        .unwrap();
    assert!(
        largest <= 1,
        "a render of the scene that made the photo differs by {largest}"
    );
    assert!(out.join("v0.alpha.png").is_file() && !out.join("v0.label.png").exists());
}

#[test]
fn vote_outvotes_wrong_views() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let out = folder.path().join("voted");
    // Without the label column: labels come from the raw maps alone.
    let (gaussians, truth) = plates();
    ply::write(&scene, &gaussians, DVec3::ZERO, None).unwrap();
    let said = succeeds(&[
        "vote",
        "--scene",
        utf8(&scene),
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&out),
    ]);
    assert!(
        said.contains("mIoU") && said.contains("2 held-out views"),
        "{said}"
    );
    let voted = ply::read(&out.join("scene.ply")).unwrap();
    // Red is called green in one training view of four. The outermost Gaussians of a plate reach over its border.
    let labels = voted.labels.unwrap();
    let right = labels.iter().zip(&truth).filter(|(a, b)| a == b).count();
    assert!(
        right * 10 >= truth.len() * 9,
        "{right} of {}: {labels:?}",
        truth.len()
    );
    for middle in [12, 37, 62] {
        assert_eq!(labels[middle], truth[middle]);
    }
    assert_eq!(Classes::read(&out.join("classes.json")).unwrap().len(), 4);
    let again = folder.path().join("again");
    succeeds(&["render", "--scene", utf8(&out), "--out", utf8(&again)]);
    assert!((0..6).all(|i| again.join(format!("v{i}.rgb.png")).is_file()));
}

#[test]
fn annotations_and_depth_are_those_of_the_views() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let render = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let arguments = [
            "render",
            "--scene",
            utf8(&scene),
            "--cameras",
            utf8(folder.path()),
            "--split",
            "test",
            "--out",
            utf8(&out),
        ];
        succeeds(
            &[
                &arguments[..],
                &[
                    "--labels",
                    "--depth",
                    "--normals",
                    "--backend",
                    &cpu_backend(),
                ],
                more,
            ]
            .concat(),
        );
        out
    };
    let out = render("out", &["--annotations", "coco,yolo,index"]);
    let names = listed(&out);
    for name in [
        "instances.json",
        "data.yaml",
        "val.txt",
        "images",
        "labels",
        "v5.index.png",
        "v5.depth.png",
        "v5.normal.png",
    ] {
        assert!(names.iter().any(|file| file == name), "{name}: {names:?}");
    }
    let grey = image::open(out.join("v5.label.png")).unwrap().into_luma8();
    let file = read_json(&out.join("instances.json"));
    let images: Vec<_> = file["images"]
        .as_array()
        .unwrap()
        .iter()
        .map(|image| &image["file_name"])
        .collect();
    assert_eq!(images, ["v2.png", "v5.png"]);
    let classes = Classes::read(&folder.path().join("classes.json")).unwrap();
    for annotation in file["annotations"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|a| a["image_id"] == 2)
    {
        let id = annotation["label"].as_u64().unwrap();
        assert_eq!(annotation["category_id"], id);
        assert_eq!(
            annotation["area"],
            grey.iter().filter(|v| u64::from(**v) == id).count()
        );
    }
    let indexed = image::open(out.join("v5.index.png")).unwrap().into_rgb8();
    for (color, id) in indexed.pixels().zip(grey.iter()) {
        assert_eq!(color.0, classes.legend_color((*id).into()));
    }
    let arrays = render("arrays", &["--format", "npy"]);
    let (shape, depth) = read_npy(&arrays.join("v5.depth.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64]);
    let (shape, normals) = read_npy(&arrays.join("v5.normal.npy"));
    assert_eq!(shape, [HEIGHT as u64, WIDTH as u64, 3]);
    let colors = image::open(out.join("v5.normal.png")).unwrap().into_rgb8();
    for (color, n) in colors.iter().zip(&normals) {
        assert!((f32::from(*color) - 127.5 * (n + 1.0)).abs() < 0.51);
    }
    let millimetres = image::open(out.join("v5.depth.png")).unwrap().into_luma16();
    let gaussians = plates().0;
    let camera = camera(5);
    let of_center = |mean: &[f32; 3]| {
        let offset = DVec3::from(mean.map(f64::from)) - camera.center;
        (camera.rotation * offset).z as f32
    };
    let depths: Vec<f32> = gaussians.means.iter().map(of_center).collect();
    let projected = Projected::new(&gaussians.splats(), &camera, &Settings::default()).unwrap();
    let blended = projected.blend(&depths, 1);
    let expected = blended.image.iter().zip(&blended.transmittance);
    for (i, (sum, t)) in expected.enumerate() {
        assert_eq!((1000.0 * depth[i]).round() as u16, millimetres.as_raw()[i]);
        assert_eq!(grey.as_raw()[i] == 0, depth[i] == 0.0);
        assert!(
            depth[i] == 0.0 || (depth[i] - sum / (1.0 - t)).abs() < 1e-4,
            "pixel {i}"
        );
    }
}
