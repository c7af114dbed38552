//! The page that shows a scene in a browser: what it carries, what it never does, and how its pictures compare.

use crate::assert_names;
use crate::cli::{fails, succeeds, utf8};
use crate::plates::scene as plates_scene;
use base64::Engine;
use coseg::camera::{Camera, Intrinsics};
use coseg::data::{Classes, NamedCamera, Split};
use coseg::gaussians::Gaussians;
use coseg::raster::{Settings, render};
use coseg::viewer::Viewer;
use glam::{DMat4, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::process::Command;

const ORIGIN: DVec3 = DVec3::new(1000.0, -20.0, 3.0);

/// Gaussians of degree 3 in a box of two units, long and flat ones and faint ones among them.
fn cloud(count: usize) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut some = |low: f32, high: f32| rng.random_range(low..high);
    let mut g = Gaussians { sh_degree: 3, ..Gaussians::default() };
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
    let lens = Intrinsics { fx: 300.0, fy: 310.0, cx: 158.0, cy: 123.0, width: 320, height: 240 };
    Camera::from_opengl(&pose, lens).unwrap()
}

fn page_of(gaussians: &Gaussians, labels: Option<&[u16]>, classes: &Classes) -> String {
    let cameras = [NamedCamera { name: "held".into(), split: Split::Test, camera: camera() }];
    let title = "a </script><b>bold</b> title {{script}}";
    let alpha_max = Settings::default().alpha_max;
    let viewer =
        Viewer { title, scene: "it's", gaussians, origin: ORIGIN, labels, classes, cameras: &cameras, alpha_max };
    viewer.page().unwrap()
}

/// What stands in the element with this id.
fn inside<'a>(page: &'a str, id: &str) -> &'a str {
    let (_, after) = page.split_once(&format!("id=\"{id}\">")).unwrap();
    after.split_once("</script>").unwrap().0
}

/// The Gaussians that the page carries, read as the page reads them, and each one's place in the list of objects.
fn unpacked(page: &str) -> (Gaussians, Vec<u16>) {
    let header: serde_json::Value = serde_json::from_str(inside(page, "header")).unwrap();
    let (n, degree) = (header["gaussians"].as_u64().unwrap() as usize, header["degree"].as_u64().unwrap() as usize);
    let bytes = base64::engine::general_purpose::STANDARD.decode(inside(page, "columns")).unwrap();
    let rest = 3 * ((degree + 1).pow(2) - 1);
    assert_eq!(bytes.len(), n * (38 + rest), "83 bytes a Gaussian of degree 3");
    let mut left = bytes.as_slice();
    let mut take = |width: usize| left.split_off(..width * n).unwrap();
    let floats: Vec<f32> = take(12).chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let mut shorts = |width: usize| -> Vec<i16> {
        take(2 * width).chunks_exact(2).map(|b| i16::from_le_bytes(b.try_into().unwrap())).collect()
    };
    let [scales, base, turns, opacities, places, spread] = [3, 3, 4, 1, 1, 1].map(&mut shorts);
    let scaled = |v: &[i16], step: f32| v.iter().map(|&v| f32::from(v) * step).collect::<Vec<f32>>();
    let mut sh = Vec::new();
    for (i, (base, &spread)) in base.chunks_exact(3).zip(&spread).enumerate() {
        sh.extend(scaled(base, 1.0 / 4096.0));
        let step = (f32::from(spread) / 1024.0).exp() / 127.0;
        sh.extend(left[rest * i..][..rest].iter().map(|&v| f32::from(v as i8) * step));
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

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let clamp = |v: &f32| f64::from(v.clamp(0.0, 1.0));
    let squares: f64 = a.iter().zip(b).map(|(a, b)| (clamp(a) - clamp(b)).powi(2)).sum();
    -10.0 * (squares / a.len() as f64).log10()
}

fn picture(gaussians: &Gaussians) -> Vec<f32> {
    let camera = Camera { center: camera().center - ORIGIN, ..camera() };
    render(gaussians, &camera, &Settings::default(), [0.0; 3]).unwrap().rgb
}

#[test]
fn the_page_carries_the_scene_to_the_eye_exactly() {
    let cloud = cloud(2000);
    let labels: Vec<u16> = (0..2000).map(|i| [3, 900, 0][i % 3]).collect();
    let classes = Classes::from_names(0, [(3, "wall"), (900, "chair")]);
    let page = page_of(&cloud, Some(&labels), &classes);
    let (carried, places) = unpacked(&page);
    assert_eq!(carried.means, cloud.means, "not rounded at all");
    let off = carried.log_scales.as_flattened().iter().zip(cloud.log_scales.as_flattened()).map(|(a, b)| (a - b).abs());
    assert!(off.fold(0.0, f32::max) < 0.51 / 1024.0);
    let (a, b) = (picture(&carried), picture(&cloud));
    assert!(psnr(&a, &b) > 60.0, "{}", psnr(&a, &b));
    assert!(psnr(&picture(&cloud.clone().with_sh_degree(0)), &b) < 35.0, "view-dependent colours are in the picture");

    let header: serde_json::Value = serde_json::from_str(inside(&page, "header")).unwrap();
    let objects = header["objects"].as_array().unwrap();
    for (place, label) in places.iter().zip(&labels) {
        assert_eq!(objects[usize::from(*place)]["id"], *label);
    }
    let names: Vec<_> = objects.iter().map(|o| o["name"].as_str()).collect();
    assert_eq!(names, [Some("void"), Some("wall"), Some("chair")]);
    assert_eq!(objects[1]["gaussians"], 667);
    assert_eq!(header["cameras"][0]["split"], "test");
    let eye: Vec<f64> =
        header["cameras"][0]["center"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!((DVec3::from_slice(&eye) - DVec3::new(1.5, 1.0, 3.5)).length() < 1e-9, "relative to the origin");
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
}

#[test]
fn the_page_asks_nothing_of_the_network_and_names_stay_text() {
    let classes = Classes::from_names(0, [(1, "</script><script>alert(1)</script>{{columns}}")]);
    let page = page_of(&cloud(10), Some(&[1; 10]), &classes);
    for word in ["http:", "https:", " src=", "import ", "fetch(", "<b>bold", "alert(1)</script>"] {
        assert!(!page.contains(word), "{word}");
    }
    assert!(!page.replace(inside(&page, "header"), "").contains("{{"), "nothing is left to be filled in");
    let header: serde_json::Value = serde_json::from_str(inside(&page, "header")).unwrap();
    assert_eq!(header["title"], "a </script><b>bold</b> title {{script}}");
    assert_eq!(header["objects"][0]["name"], "</script><script>alert(1)</script>{{columns}}");
}

#[test]
fn what_cannot_be_shown_is_an_error() {
    let (cloud, classes) = (cloud(10), Classes::default());
    let viewer = Viewer {
        title: "",
        scene: "",
        gaussians: &cloud,
        origin: DVec3::ZERO,
        labels: Some(&[1; 9]),
        classes: &classes,
        cameras: &[],
        alpha_max: 0.99,
    };
    assert_names(&viewer.page().unwrap_err(), &["gaussians.labels", "9", "10"]);
    assert_names(&Viewer { labels: None, alpha_max: 1.5, ..viewer }.page().unwrap_err(), &["alpha_max", "1.5"]);
    let none = Gaussians::default();
    assert_names(&Viewer { labels: None, gaussians: &none, ..viewer }.page().unwrap_err(), &["gaussians", "none"]);
    let mut broken = cloud.clone();
    broken.sh[100] = f32::NAN;
    assert_names(&Viewer { labels: None, gaussians: &broken, ..viewer }.page().unwrap_err(), &["sh", "2"]);
}

#[test]
fn the_command_writes_a_page_beside_the_scene() {
    let dir = tempfile::tempdir().unwrap();
    let scene = plates_scene(dir.path());
    let said = succeeds(&["view", "--scene", utf8(&scene), "--cameras", utf8(dir.path())]);
    let page = scene.with_file_name("viewer.html");
    assert!(said.contains("viewer.html"), "{said}");
    let text = std::fs::read_to_string(&page).unwrap();
    let header: serde_json::Value = serde_json::from_str(inside(&text, "header")).unwrap();
    assert_eq!(header["cameras"].as_array().unwrap().len(), 6);
    assert_eq!(header["path"], utf8(&scene));
    let other = dir.path().join("page.htm");
    let message = fails(&["view", "--scene", utf8(&scene), "--out", utf8(&other)], 1);
    assert!(message.contains("--out") && message.contains(".html") && !other.exists(), "{message}");
}

/// A browser that draws without a screen: the program that COSEG_BROWSER names, or Chromium.
fn browser() -> Option<String> {
    let named = std::env::var("COSEG_BROWSER").ok();
    let known = ["chromium", "chromium-browser", "google-chrome"].map(str::to_owned);
    let answers = |name: &String| Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success());
    let found = named.into_iter().chain(known).find(answers);
    if found.is_none() {
        eprintln!("SKIPPED: no Chromium to draw the page; COSEG_BROWSER may name one");
    }
    found
}

/// What the browser draws of the page at `path` with `#` and `address` behind its name.
fn drawn(browser: &str, path: &Path, address: &str) -> Vec<f32> {
    let shot = path.with_extension("png");
    let url = format!("file://{}#{address}&bare", path.canonicalize().unwrap().display());
    let output = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--hide-scrollbars",
            "--force-device-scale-factor=1",
            "--window-size=320,240",
        ])
        .args(["--enable-unsafe-swiftshader", "--virtual-time-budget=10000"])
        .arg(format!("--screenshot={}", shot.display()))
        .arg(&url)
        .output()
        .unwrap();
    assert!(shot.is_file(), "{}", String::from_utf8_lossy(&output.stderr));
    let picture = image::open(&shot).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (320, 240));
    picture.into_raw().into_iter().map(|v| f32::from(v) / 255.0).collect()
}

#[test]
fn a_browser_draws_what_the_rasterizer_does() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("page.html");
    let cloud = cloud(3000);
    let labels: Vec<u16> = (0..3000).map(|i| [1, 2][i % 2]).collect();
    let classes = Classes::from_names(0, [(1, "wall"), (2, "chair")]);
    std::fs::write(&path, page_of(&cloud, Some(&labels), &classes)).unwrap();
    let found = psnr(&drawn(&browser, &path, "view=held"), &picture(&cloud));
    assert!(found > 55.0, "{found}");
    let colors: Vec<[f32; 3]> = labels.iter().map(|&id| classes.color(id).map(|v| f32::from(v) / 255.0)).collect();
    let found = psnr(&drawn(&browser, &path, "view=held&mode=labels"), &picture(&cloud.painted(&colors)));
    assert!(found > 55.0, "{found}");
}
