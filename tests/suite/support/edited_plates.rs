//! The plates in the viewer's page, driven by a person with a mouse or with keys.

use crate::support::browser::browser;
use crate::support::devtools::Tab;
use crate::support::plates::scene as plates_scene;
use crate::support::program::{succeeds, utf8};
use coseg::data::Classes;
use coseg::splat::ply;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A page of the plates in `dir`, seen from before the wall.
pub fn page(dir: &Path) -> PathBuf {
    let scene = plates_scene(dir);
    let page = dir.join("page.html");
    succeeds(&[
        "view",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(dir),
        "--out",
        utf8(&page),
    ]);
    page
}

/// The folder of the plates and a tab with their page; none without a browser.
pub fn opened() -> Option<(TempDir, Tab)> {
    let browser = browser()?;
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path());
    let tab = Tab::open(&browser, &page, [1000, 700]);
    Some((dir, tab))
}

/// Where a point of the world is in the picture.
pub fn spot(tab: &mut Tab, point: [f64; 3]) -> [f64; 2] {
    let place = format!(
        "(() => {{ const c = page.fitted; const d = {point:?}.map((v, k) => v - c.center[k]); \
         const at = [0, 3, 6].map((r) => d.reduce((s, v, k) => s + v * c.rotation[r + k], 0)); \
         return [c.fx * at[0] / at[2] + c.cx, c.fy * at[1] / at[2] + c.cy]; }})()"
    );
    serde_json::from_value(tab.value(&place)).unwrap()
}

/// All that edits can change, with the pose of every Gaussian.
pub fn state(tab: &mut Tab) -> String {
    tab.text(
        "JSON.stringify([[...page.state.objects.values()].map((o) => \
         [o.id, o.name, o.color, o.count, o.shown, o.offset, o.degrees]), page.state.parts, Array.from(page.state.partOf)])",
    )
}

/// Selected Gaussians and the names of their objects.
pub fn selected(tab: &mut Tab) -> Value {
    tab.value("[page.selection.count, page.selection.objects(page.state).map((id) => page.state.object(id).name).sort().join()]")
}

/// Writes what the page saves, applies it, and compares labels, names and colours with those of the page.
pub fn assert_applied(tab: &mut Tab, dir: &Path) {
    assert_applied_to(tab, &dir.join("plates.ply"), dir);
}

/// The same for another scene.
pub fn assert_applied_to(tab: &mut Tab, scene: &Path, dir: &Path) {
    let edits = dir.join("edits.json");
    std::fs::write(&edits, tab.text("page.edits.text()")).unwrap();
    let out = dir.join("edited");
    let edit = ["edit", "--scene", utf8(scene), "--edits", utf8(&edits)];
    succeeds(&[&edit[..], &["--out", utf8(&out), "--force"]].concat());
    let edited = ply::read(&out.join("scene.ply")).unwrap();
    let want = tab.value("Array.from(page.state.labels())");
    assert_eq!(json!(edited.labels.unwrap()), want);
    let classes = Classes::read(&out.join("classes.json")).unwrap();
    let entries: Vec<_> = classes
        .entries
        .iter()
        .map(|c| json!([c.id, c.name, c.color]))
        .collect();
    let want = tab.value(
        "[...page.state.objects.values()].filter((o) => o.id !== page.scene.ignore).sort((a, b) => a.id - b.id).map((o) => [o.id, o.name, o.color])",
    );
    assert_eq!(json!(entries), want);
}
