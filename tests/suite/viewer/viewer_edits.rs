//! What is done to objects in the viewer's page, and the `coseg edit` line and the file that it writes of it.

use crate::support::browser::{after, browser, drawn, psnr, scripted};
use crate::support::plates::{self, plates, scene as plates_scene};
use crate::support::program::{succeeds, utf8};
use coseg::data::{Classes, read_cameras};
use coseg::raster::{Settings, render};
use coseg::splat::camera::Camera;
use coseg::splat::ply::{self, PlyScene};
use glam::{DQuat, DVec3};
use std::path::{Path, PathBuf};
use std::process::Command;

/// A page of the plates in `dir`, with `more` arguments of `coseg view`.
fn page(dir: &Path, more: &[&str]) -> PathBuf {
    let scene = plates_scene(dir);
    let page = dir.join("page.html");
    let read = [
        "view",
        "--out",
        utf8(&page),
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(dir),
    ];
    succeeds(&[&read[..], more].concat());
    page
}

/// Runs the line that the page writes after `script`, beside the file that it saves; what it makes has to look as the page does.
fn edited(browser: &str, dir: &Path, page: &Path, script: &str) -> (String, PlyScene) {
    let line = after(browser, page, script, "command");
    let telling =
        format!("{script} document.getElementById('said').textContent = page.edits.text();");
    let edits = after(browser, page, &telling, "said");
    std::fs::write(dir.join("edits.json"), &edits).unwrap();
    let run = Command::new("sh")
        .args([
            "-c",
            &line.replacen("coseg", env!("CARGO_BIN_EXE_coseg"), 1),
        ])
        .current_dir(dir)
        .output()
        .unwrap();
    assert!(
        run.status.success(),
        "{line}: {}",
        String::from_utf8_lossy(&run.stderr)
    );
    let folder = line
        .split_once("--out ")
        .unwrap()
        .1
        .split_once("/scene.ply")
        .unwrap()
        .0;
    let edited = ply::read(&dir.join(folder).join("scene.ply")).unwrap();
    let camera = plates::camera(0);
    let camera = Camera {
        center: camera.center - edited.origin,
        ..camera
    };
    let want = render(&edited.gaussians, &camera, &Settings::default(), [0.0; 3])
        .unwrap()
        .rgb;
    let size = [camera.width, camera.height];
    let view = format!("view={}", read_cameras(dir, None).unwrap()[0].name);
    let found = psnr(&drawn(browser, &scripted(page, script), &view, size), &want);
    assert!(found > 55.0, "{line}: {found}");
    assert!(psnr(&drawn(browser, page, &view, size), &want) < 30.0);
    (line + &edits, edited)
}

#[test]
fn the_command_that_the_page_writes_does_what_the_page_shows() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let classes = dir.path().join("some classes.json");
    let names = [
        (1, "plate"),
        (2, "plate"),
        (3, "it's a plate, blue"),
        (4, "wall"),
    ];
    Classes::from_names(0, names).write(&classes).unwrap();
    let page = page(dir.path(), &["--classes", utf8(&classes)]);
    let script = "page.choose(1); page.choose(4, 'add'); page.remove(); page.moveTo(3, [0.25, -1, 0]); page.turnTo(2, 90); \
        page.moveTo(2, [0, 0, 1]); page.choose(null); page.draw();";
    let (line, edited) = edited(&browser, dir.path(), &page, script);
    assert!(
        line.starts_with("coseg edit ") && line.contains("--edits edits.json"),
        "{line}"
    );
    assert!(line.contains(r#""axis":[0,1,0],"degrees":90"#), "{line}");
    assert_eq!(edited.labels.unwrap(), [vec![2; 25], vec![3; 25]].concat());
    let (before, _) = plates();
    for (row, mean) in edited.gaussians.means.iter().enumerate() {
        let [x, y, z] = before.means[25 + row];
        // Its middle is at x = z = 0.
        let want = if row < 25 {
            [z, y, 1.0 - x]
        } else {
            [x + 0.25, y - 1.0, z]
        };
        assert!(
            mean.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-5),
            "{row}: {mean:?} {want:?}"
        );
    }
}

#[test]
fn objects_turn_about_an_up_that_is_no_axis_of_the_world() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path(), &["--up", "0.3,-0.9,0.1"]);
    let script = "page.choose(4); page.remove(); page.turnTo(2, 70); page.draw();";
    let (line, edited) = edited(&browser, dir.path(), &page, script);
    assert!(line.contains(r#""degrees":70"#), "{line}");
    let turn = DQuat::from_axis_angle(DVec3::new(0.3, -0.9, 0.1).normalize(), 70_f64.to_radians());
    let (before, _) = plates();
    let middle = DVec3::new(0.0, 0.3, 0.0);
    for (row, mean) in edited.gaussians.means.iter().enumerate().take(50).skip(25) {
        let want = turn * (DVec3::from(before.means[row].map(f64::from)) - middle) + middle;
        let got = DVec3::from(mean.map(f64::from)) + edited.origin;
        assert!(got.distance(want) < 1e-5, "{row}: {got} {want}");
    }
}
