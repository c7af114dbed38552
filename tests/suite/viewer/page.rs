//! The page that shows a scene in a browser: what it carries, what it never does, and how its pictures compare.

use crate::support::assert_names;
use crate::support::browser::{inside, psnr};
use base64::Engine;
use coseg::data::{Classes, NamedCamera, Split};
use coseg::raster::{Settings, render};
use coseg::splat::Gaussians;
use coseg::splat::camera::Camera;
use coseg::viewer::Viewer;
use glam::{DMat4, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const ORIGIN: DVec3 = DVec3::new(1000.0, -20.0, 3.0);

/// Gaussians of degree 3 in a box of two units, long and flat ones and faint ones among them.
pub(super) fn cloud(count: usize) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut some = |low: f32, high: f32| rng.random_range(low..high);
    let mut g = Gaussians {
        sh_degree: 3,
        ..Gaussians::default()
    };
    for _ in 0..count {
        g.means.push([(); 3].map(|()| some(-1.0, 1.0)));
        g.log_scales.push([(); 3].map(|()| some(-5.0, -1.8)));
        g.rotations.push([(); 4].map(|()| some(-2.0, 2.0)));
        g.opacity_logits.push(some(-4.0, 6.0));
        g.sh.extend((0..3).map(|_| some(-1.7, 1.7)));
        g.sh.extend((3..48).map(|_| some(-0.2, 0.2)));
    }
    g
}

fn camera() -> Camera {
    let pose = DMat4::look_at_rh(ORIGIN + DVec3::new(1.5, 1.0, 3.5), ORIGIN, DVec3::Y).inverse();
    let lens = Camera {
        cx: 158.0,
        cy: 123.0,
        ..Camera::centred([300.0, 310.0], [320, 240])
    };
    lens.with_opengl_pose(&pose).unwrap()
}

pub(crate) fn viewer<'a>(
    gaussians: &'a Gaussians,
    labels: Option<&'a [u16]>,
    classes: &'a Classes,
) -> Viewer<'a> {
    Viewer {
        title: "a </script><b>bold</b> title {{script}}",
        scene: "it's",
        names: None,
        sha256: "00ff",
        gaussians,
        features: &[],
        origin: ORIGIN,
        labels,
        classes,
        cameras: &[],
        up: None,
        alpha_max: Settings::default().alpha_max,
    }
}

pub(super) fn page_of(gaussians: &Gaussians, labels: Option<&[u16]>, classes: &Classes) -> String {
    let cameras = [NamedCamera {
        name: "held".into(),
        split: Split::Test,
        camera: camera(),
    }];
    Viewer {
        cameras: &cameras,
        ..viewer(gaussians, labels, classes)
    }
    .page()
    .unwrap()
}

fn columns(page: &str) -> Vec<u8> {
    let parts = page
        .split("class=\"columns\">")
        .skip(1)
        .map(|part| part.split_once("</script>").unwrap().0);
    parts
        .flat_map(|part| {
            base64::engine::general_purpose::STANDARD
                .decode(part)
                .unwrap()
        })
        .collect()
}

/// The Gaussians that the page carries, read as the page reads them, and each one's place in the list of objects.
fn unpacked(page: &str) -> (Gaussians, Vec<u16>) {
    let header: serde_json::Value = serde_json::from_str(inside(page, "header")).unwrap();
    let n = header["gaussians"].as_u64().unwrap() as usize;
    let degree = header["degree"].as_u64().unwrap() as usize;
    let labelled = !header["objects"][0]["id"].is_null();
    let regions = header["regions"].as_u64().unwrap() as usize;
    let bytes = columns(page);
    assert_eq!(header["bytes"], bytes.len());
    let rest = 3 * ((degree + 1).pow(2) - 1);
    assert_eq!(
        bytes.len(),
        n * (38 + rest) + if labelled { 4 * n + 12 * regions } else { 0 },
        "83 bytes a Gaussian of degree 3, its superpoint, and regions"
    );
    let mut left = bytes.as_slice();
    let mut bytes = |count: usize| left.split_off(..count).unwrap();
    bytes(if labelled { 4 * n + 12 * regions } else { 0 });
    let floats: Vec<f32> = bytes(12 * n)
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect();
    let mut shorts = |width: usize| -> Vec<i16> {
        bytes(2 * width * n)
            .chunks_exact(2)
            .map(|b| i16::from_le_bytes(b.try_into().unwrap()))
            .collect()
    };
    let [places, scales, base, turns, opacities, spread] = [1, 3, 3, 4, 1, 1].map(&mut shorts);
    let scaled =
        |v: &[i16], step: f32| v.iter().map(|&v| f32::from(v) * step).collect::<Vec<f32>>();
    let mut sh = Vec::new();
    for (i, (base, &spread)) in base.chunks_exact(3).zip(&spread).enumerate() {
        sh.extend(scaled(base, 1.0 / 1024.0));
        let step = (f32::from(spread) / 1024.0).exp() / 127.0;
        sh.extend(
            left[rest * i..][..rest]
                .iter()
                .map(|&v| f32::from(v as i8) * step),
        );
    }
    let logit = |v: &i16| {
        let opacity = f64::from(*v as u16) / 65535.0;
        (opacity / (1.0 - opacity)).ln() as f32
    };
    let gaussians = Gaussians {
        means: floats.as_chunks().0.to_vec(),
        log_scales: scaled(&scales, 1.0 / 1024.0).as_chunks().0.to_vec(),
        rotations: scaled(&turns, 1.0 / 32767.0).as_chunks().0.to_vec(),
        opacity_logits: opacities.iter().map(logit).collect(),
        sh,
        sh_degree: degree,
    };
    (gaussians, places.iter().map(|&v| v as u16).collect())
}

pub(super) fn picture(gaussians: &Gaussians) -> Vec<f32> {
    let camera = Camera {
        center: camera().center - ORIGIN,
        ..camera()
    };
    render(gaussians, &camera, &Settings::default(), [0.0; 3])
        .unwrap()
        .rgb
}

#[test]
fn the_page_carries_the_scene_to_the_eye_exactly() {
    let cloud = cloud(2000);
    let labels: Vec<u16> = (0..2000).map(|i| [3, 900, 0][i % 3]).collect();
    let classes = Classes::from_names(0, [(3, "wall"), (900, "chair")]);
    let page = page_of(&cloud, Some(&labels), &classes);
    let (carried, places) = unpacked(&page);
    assert_eq!(carried.means, cloud.means, "not rounded at all");
    let off = carried
        .log_scales
        .as_flattened()
        .iter()
        .zip(cloud.log_scales.as_flattened())
        .map(|(a, b)| (a - b).abs());
    assert!(off.fold(0.0, f32::max) < 0.51 / 1024.0);
    let (a, b) = (picture(&carried), picture(&cloud));
    assert!(psnr(&a, &b) > 60.0, "{}", psnr(&a, &b));
    assert!(
        psnr(&picture(&cloud.clone().with_sh_degree(0)), &b) < 35.0,
        "view-dependent colours are in the picture"
    );

    let header: serde_json::Value = serde_json::from_str(inside(&page, "header")).unwrap();
    let objects = header["objects"].as_array().unwrap();
    for (place, label) in places.iter().zip(&labels) {
        assert_eq!(objects[usize::from(*place)]["id"], *label);
    }
    let names: Vec<_> = objects.iter().map(|o| o["name"].as_str()).collect();
    assert_eq!(names, [Some("void"), Some("wall"), Some("chair")]);
    // As in the report, and not black as the background.
    assert_eq!(objects[0]["color"], serde_json::json!([38, 38, 42]));
    assert_eq!(objects[1]["gaussians"], 667);
    assert_eq!(header["cameras"][0]["split"], "test");
    let eye: Vec<f64> = header["cameras"][0]["center"]
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect();
    assert!(
        (DVec3::from_slice(&eye) - DVec3::new(1.5, 1.0, 3.5)).length() < 1e-9,
        "relative to the origin"
    );
}

#[test]
fn scenes_without_labels_cameras_or_degrees_have_a_page_too() {
    let cloud = cloud(300).with_sh_degree(0);
    let page = page_of(&cloud, None, &Classes::default());
    let header: serde_json::Value = serde_json::from_str(inside(&page, "header")).unwrap();
    assert_eq!(header["objects"].as_array().unwrap().len(), 1);
    assert!(header["objects"][0]["id"].is_null());
    let (carried, _) = unpacked(&page);
    assert!(psnr(&picture(&carried), &picture(&cloud)) > 60.0);

    // All of it lies before where a visit begins, upright.
    let one = cloud.select(&[0]);
    for (gaussians, up) in [
        (&cloud, None),
        (&cloud, Some(DVec3::new(0.0, 0.0, 2.0))),
        (&one, None),
    ] {
        let classes = Classes::default();
        let page = Viewer {
            up,
            ..viewer(gaussians, None, &classes)
        }
        .page()
        .unwrap();
        let header: serde_json::Value = serde_json::from_str(inside(&page, "header")).unwrap();
        let numbers = |value: &serde_json::Value| -> Vec<f64> {
            serde_json::from_value(value.clone()).unwrap()
        };
        let [rotation, center] = ["rotation", "center"].map(|key| numbers(&header["start"][key]));
        let [right, down, ahead] = [0, 3, 6].map(|row| DVec3::from_slice(&rotation[row..]));
        assert!((right.cross(down) - ahead).length() < 1e-9 && (ahead.length() - 1.0).abs() < 1e-9);
        let up = up.map_or(DVec3::NEG_Y, DVec3::normalize);
        assert!(right.dot(up).abs() < 1e-9 && down.dot(up) < -0.8, "{down}");
        let mean = DVec3::from(gaussians.means[0].map(f64::from)) - DVec3::from_slice(&center);
        let depth = mean.dot(ahead);
        assert!(depth > 0.1 && mean.dot(right).abs() < depth && mean.dot(down).abs() < depth);
    }
}

#[test]
fn the_size_of_a_page_is_known_before_it_is_made() {
    for degree in [0, 2, 3] {
        let cloud = cloud(2_000).with_sh_degree(degree);
        let rest = page_of(&cloud, None, &Classes::default()).len() - Viewer::bytes(&cloud, false);
        assert!(
            (100_000..150_000).contains(&rest),
            "{rest} bytes besides, degree {degree}"
        );
    }
    assert_eq!(Viewer::bytes(&cloud(300), false), 300 * (35 + 48) / 3 * 4);
    assert_eq!(Viewer::bytes(&cloud(300), true), 300 * (39 + 48) / 3 * 4);
}

#[test]
fn the_page_asks_nothing_of_the_network_and_names_stay_text() {
    let classes = Classes::from_names(0, [(1, "</script><script>alert(1)</script>{{columns}}")]);
    let page = page_of(&cloud(10), Some(&[1; 10]), &classes);
    for word in [
        "http:",
        "https:",
        " src=",
        "import ",
        "fetch(",
        "<b>bold",
        "alert(1)</script>",
    ] {
        assert!(!page.contains(word), "{word}");
    }
    assert!(
        !page.replace(inside(&page, "header"), "").contains("{{"),
        "nothing is left to be filled in"
    );
    let header: serde_json::Value = serde_json::from_str(inside(&page, "header")).unwrap();
    assert_eq!(header["title"], "a </script><b>bold</b> title {{script}}");
    assert_eq!(
        header["objects"][0]["name"],
        "</script><script>alert(1)</script>{{columns}}"
    );
}

#[test]
fn what_cannot_be_shown_is_an_error() {
    let cloud = cloud(10);
    let classes = Classes::default();
    let viewer = viewer(&cloud, Some(&[1; 9]), &classes);
    assert_names(
        &Viewer {
            labels: None,
            up: Some(DVec3::ZERO),
            ..viewer
        }
        .page()
        .unwrap_err(),
        &["up"],
    );
    assert_names(
        &viewer.page().unwrap_err(),
        &["gaussians.labels", "9", "10"],
    );
    assert_names(
        &Viewer {
            labels: None,
            alpha_max: 1.5,
            ..viewer
        }
        .page()
        .unwrap_err(),
        &["alpha_max", "1.5"],
    );
    let none = Gaussians::default();
    assert_names(
        &Viewer {
            labels: None,
            gaussians: &none,
            ..viewer
        }
        .page()
        .unwrap_err(),
        &["gaussians", "none"],
    );
    let mut broken = cloud.clone();
    broken.sh[100] = f32::NAN;
    assert_names(
        &Viewer {
            labels: None,
            gaussians: &broken,
            ..viewer
        }
        .page()
        .unwrap_err(),
        &["sh", "2"],
    );
}
