//! The page of a scene in a browser: its pictures, and what the pointer does.

use super::page::{cloud, page_of, picture, viewer};
use crate::support::browser::{after, browser, drawn, psnr};
use crate::support::plates::{self, plates};
use coseg::data::{Classes, NamedCamera, Split};
use coseg::viewer::Viewer;
use glam::DVec3;

#[test]
fn a_browser_draws_what_the_rasterizer_does() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("page.html");
    let cloud = cloud(3000);
    let labels: Vec<u16> = (0..3000).map(|i| [1, 2][i % 2]).collect();
    let classes = Classes::from_names(0, [(1, "wall"), (2, "chair")]);
    std::fs::write(&path, page_of(&cloud, Some(&labels), &classes)).unwrap();
    let found = psnr(
        &drawn(&browser, &path, "view=held", [320, 240]),
        &picture(&cloud),
    );
    eprintln!("PSNR of the page against the rasterizer: {found:.1} dB");
    assert!(found > 55.0, "{found}");
    let colors: Vec<[f32; 3]> = labels
        .iter()
        .map(|&id| classes.color(id).map(|v| f32::from(v) / 255.0))
        .collect();
    let found = psnr(
        &drawn(&browser, &path, "view=held&mode=labels", [320, 240]),
        &picture(&cloud.painted(&colors)),
    );
    assert!(found > 55.0, "{found}");
}

#[test]
fn the_pointer_turns_the_picture_and_chooses_what_it_shows() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = dir.path().join("page.html");
    let (gaussians, labels) = plates();
    let cameras = [NamedCamera {
        name: "front".into(),
        split: Split::Train,
        camera: plates::camera(2),
    }];
    let classes = Classes::from_names(0, [(1, "red"), (2, "green"), (3, "blue"), (4, "wall")]);
    let shown = viewer(&gaussians, Some(&labels), &classes);
    Viewer {
        cameras: &cameras,
        origin: DVec3::ZERO,
        ..shown
    }
    .write(&page)
    .unwrap();
    // A drag to the right and down takes what is seen along: the camera goes left, and up. It never turns over.
    let script = "const spot = (p) => { const c = page.fitted; const d = p.map((v, k) => v - c.center[k]); \
        const at = [0, 3, 6].map((r) => d.reduce((s, v, k) => s + v * c.rotation[r + k], 0)); \
        return [c.fx * at[0] / at[2] + c.cx, c.fy * at[1] / at[2] + c.cy]; }; \
        const said = []; const [x, y] = spot([0, 0.3, 0]); \
        send('pointerdown', x, y); send('pointerup', x, y); said.push([...page.chosen].map((id) => page.state.object(id).name).join()); \
        const [u, v] = spot([0, 0, -1]); send('pointerdown', u, v); \
        const near = page.navigation.pivot.map((w, k) => 0.7 * w + 0.3 * page.fitted.center[k]); const before = spot(near); \
        for (let i = 1; i <= 6; i++) send('pointermove', u + i, v + i); send('pointerup', u + 6, v + 6); \
        const after = spot(near); said.push(after[0] > before[0] + 1, after[1] > before[1] + 1); \
        send('pointerdown', u, v); for (let i = 1; i < 400; i++) send('pointermove', u, v + 20 * i); \
        const up = page.up; const down = page.fitted.down; \
        said.push(up.reduce((s, w, k) => s + w * down[k], 0) < 0); \
        document.getElementById('said').textContent = said.join(' ');";
    assert_eq!(
        after(&browser, &page, script, "said"),
        "green true true true"
    );
}
