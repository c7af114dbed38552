//! Labels mended in the viewer's page by a person with a mouse or with keys alone.

use crate::support::browser::browser;
use crate::support::devtools::{ALT, CTRL, SHIFT, Tab};
use crate::support::plates::scene as plates_scene;
use crate::support::program::{succeeds, utf8};
use coseg::data::{Classes, Limits};
use coseg::objects::superpoints;
use coseg::splat::ply;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A page of the plates in `dir`, seen from before the wall.
fn page(dir: &Path) -> PathBuf {
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

/// Where a point of the world is in the picture.
fn spot(tab: &mut Tab, point: [f64; 3]) -> [f64; 2] {
    let place = format!(
        "(() => {{ const c = page.fitted; const d = {point:?}.map((v, k) => v - c.center[k]); \
         const at = [0, 3, 6].map((r) => d.reduce((s, v, k) => s + v * c.rotation[r + k], 0)); \
         return [c.fx * at[0] / at[2] + c.cx, c.fy * at[1] / at[2] + c.cy]; }})()"
    );
    serde_json::from_value(tab.value(&place)).unwrap()
}

/// All that edits can change, with the pose of every Gaussian.
fn state(tab: &mut Tab) -> String {
    tab.text(
        "JSON.stringify([[...page.state.objects.values()].map((o) => \
         [o.id, o.name, o.color, o.count, o.shown, o.offset, o.degrees]), page.state.parts, Array.from(page.state.partOf)])",
    )
}

/// Selected Gaussians and the names of their objects.
fn selected(tab: &mut Tab) -> Value {
    tab.value("[page.selection.count, page.selection.objects(page.state).map((id) => page.state.object(id).name).sort().join()]")
}

/// Writes what the page saves, applies it, and compares labels, names and colours with those of the page.
fn assert_applied(tab: &mut Tab, dir: &Path) {
    let edits = dir.join("edits.json");
    std::fs::write(&edits, tab.text("page.edits.text()")).unwrap();
    let out = dir.join("mended");
    let scene = dir.join("plates.ply");
    let edit = ["edit", "--scene", utf8(&scene), "--edits", utf8(&edits)];
    succeeds(&[&edit[..], &["--out", utf8(&out), "--force"]].concat());
    let mended = ply::read(&out.join("scene.ply"), &Limits::default()).unwrap();
    let want = tab.value("Array.from(page.state.labels())");
    assert_eq!(json!(mended.labels.unwrap()), want);
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

#[test]
fn a_plate_that_is_called_wall_is_put_right() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path());
    // The green plate is called wall.
    let path = dir.path().join("plates.ply");
    let mut scene = ply::read(&path, &Limits::default()).unwrap();
    let right = scene.labels.clone().unwrap();
    let wrong: Vec<u16> = right
        .iter()
        .map(|&id| if id == 2 { 4 } else { id })
        .collect();
    scene.labels = Some(wrong);
    ply::write(
        &path,
        &scene.gaussians,
        scene.origin,
        scene.labels.as_deref(),
    )
    .unwrap();
    let write = [
        "view",
        "--scene",
        utf8(&path),
        "--cameras",
        utf8(dir.path()),
    ];
    succeeds(&[&write[..], &["--out", utf8(&page)]].concat());

    let mut tab = Tab::open(&browser, &page, [1000, 700]);
    let start = state(&mut tab);
    tab.key("KeyX", 0);
    let corners = [[-0.45, -0.15, 0.0], [0.45, 0.75, 0.0]].map(|point| spot(&mut tab, point));
    tab.drag(&corners, 0);
    assert_eq!(
        selected(&mut tab),
        json!([25, "wall"]),
        "not the wall behind"
    );
    tab.key("KeyN", 0);
    tab.type_text("rug");
    tab.key("Enter", 0);
    assert_eq!(tab.value("[...page.chosen]"), json!([5]));
    assert_applied(&mut tab, dir.path());
    let labels = tab.value("Array.from(page.state.labels())");
    let want: Vec<u16> = right
        .iter()
        .map(|&id| if id == 2 { 5 } else { id })
        .collect();
    assert_eq!(labels, json!(want));
    assert_eq!(tab.text("page.state.object(5).name"), "rug");

    // Instead of a new object, the class that no Gaussian had.
    tab.value("page.edits.discard()");
    assert_eq!(state(&mut tab), start);
    tab.key("KeyX", 0);
    tab.drag(&corners, 0);
    tab.key("KeyT", 0);
    tab.type_text("green");
    tab.value("page.details.target.value = '2'");
    tab.key("Enter", 0);
    assert_eq!(tab.value("Array.from(page.state.labels())"), json!(right));
    assert_applied(&mut tab, dir.path());
}

#[test]
fn brush_lasso_and_box_take_what_is_seen() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path());
    let mut tab = Tab::open(&browser, &page, [1000, 700]);
    let around = |x: f64, y: f64, z: f64| {
        let by = 0.45;
        [
            [x - by, y - by, z],
            [x + by, y - by, z],
            [x + by, y + by, z],
            [x - by, y + by, z],
        ]
    };
    let red = around(-0.9, 0.0, 0.1).map(|point| spot(&mut tab, point));
    let blue = around(0.8, -0.3, 0.2).map(|point| spot(&mut tab, point));
    tab.key("KeyO", 0);
    tab.drag(&red, 0);
    assert_eq!(selected(&mut tab), json!([25, "red"]));
    tab.drag(&blue, SHIFT);
    assert_eq!(selected(&mut tab), json!([50, "blue,red"]));
    tab.drag(&red, ALT);
    assert_eq!(selected(&mut tab), json!([25, "blue"]));
    tab.drag(&red, 0);
    assert_eq!(selected(&mut tab), json!([25, "red"]), "a new selection");

    // Without a limit of depth the wall behind is taken too; within chosen objects nothing else is.
    tab.value("page.tools.slider = 100");
    tab.key("KeyX", 0);
    tab.drag(&[red[0], red[2]], 0);
    let all = selected(&mut tab);
    assert_eq!(all[1], "red,wall", "{all}");
    tab.value("page.choose(1)");
    tab.drag(&[red[0], red[2]], 0);
    assert_eq!(selected(&mut tab), json!([25, "red"]));
    tab.value("page.choose(null); page.tools.slider = 33");

    // A stroke along the middle row of the plate.
    tab.key("KeyP", 0);
    tab.value("page.tools.radius = 6");
    let row = [[-1.2, 0.0, 0.1], [-0.6, 0.0, 0.1]].map(|point| spot(&mut tab, point));
    tab.drag(&row, 0);
    assert_eq!(selected(&mut tab), json!([5, "red"]));
    let middle = spot(&mut tab, [-0.9, 0.0, 0.1]);
    tab.drag(&[middle], ALT);
    assert_eq!(selected(&mut tab), json!([4, "red"]));
    tab.key("Delete", 0);
    assert_eq!(
        selected(&mut tab),
        json!([0, ""]),
        "what is gone is not selected"
    );
    assert_eq!(tab.value("page.state.object(1).count"), 21);
    assert_applied(&mut tab, dir.path());

    // What is hidden is not taken, and nothing behind it is safe.
    tab.value("page.show([1], false)");
    tab.key("KeyX", 0);
    tab.drag(&[red[0], red[2]], 0);
    assert_eq!(selected(&mut tab)[1], "wall");
}

#[test]
fn a_selection_grows_to_the_superpoints_that_it_touches() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path());
    let scene = ply::read(&dir.path().join("plates.ply"), &Limits::default()).unwrap();
    let of = superpoints(&scene.gaussians).unwrap().of;
    let mut tab = Tab::open(&browser, &page, [1000, 700]);
    tab.key("KeyP", 0);
    tab.value("page.tools.radius = 6");
    let middle = spot(&mut tab, [-0.9, 0.0, 0.1]);
    tab.drag(&[middle], 0);
    assert_eq!(tab.value("page.selection.rows()"), json!([12]));
    tab.key("KeyG", 0);
    let want: Vec<usize> = (0..of.len()).filter(|&i| of[i] == of[12]).collect();
    assert!(want.len() > 1);
    assert_eq!(tab.value("page.selection.rows()"), json!(want));
}

#[test]
fn everything_is_undone_and_done_again_bit_for_bit() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path());
    let mut tab = Tab::open(&browser, &page, [1000, 700]);
    let start = state(&mut tab);
    let green = spot(&mut tab, [0.0, 0.3, 0.0]);
    // Hidden, shown, moved by dragging, turned, renamed, coloured, split, assigned, merged, deleted.
    tab.drag(&[green], 0);
    assert_eq!(tab.value("[...page.chosen]"), json!([2]));
    tab.key("KeyH", 0);
    tab.key("KeyH", 0);
    tab.key("KeyM", 0);
    tab.drag(
        &[
            green,
            [green[0] + 30.0, green[1]],
            [green[0] + 50.0, green[1] + 4.0],
        ],
        0,
    );
    assert_eq!(
        tab.value("page.edits.done.length"),
        3,
        "one drag is one edit"
    );
    tab.value("page.turnTo(2, 30)");
    tab.value("page.details.color.value = '#102030'; page.details.color.dispatchEvent(new Event('change'))");
    tab.key("F2", 0);
    tab.type_text("rug");
    tab.key("Enter", 0);
    let red = [[-1.35, -0.45, 0.1], [-0.9, 0.45, 0.1]].map(|point| spot(&mut tab, point));
    tab.key("Escape", 0);
    tab.key("KeyX", 0);
    tab.drag(&red, 0);
    tab.key("KeyN", 0);
    tab.key("Enter", 0);
    tab.value("page.moveTo(5, [0, 0.5, 0.25])");
    // Gaussians of a plate that has moved stay where they are in another object.
    let moved = [[-1.35, 0.05, 0.35], [-1.05, 0.95, 0.35]].map(|point| spot(&mut tab, point));
    tab.key("Escape", 0);
    tab.key("KeyX", 0);
    tab.drag(&moved, 0);
    let some = selected(&mut tab);
    assert_eq!(some[1], "object 1", "{some}");
    tab.value("page.putInto(3)");
    tab.value("page.choose(1); page.choose(2, 'add'); page.putInto(2)");
    tab.value("page.choose(4); page.remove()");
    let end = state(&mut tab);
    let count = tab.value("page.edits.done.length").as_u64().unwrap();
    assert_eq!(count, 11);
    assert_applied(&mut tab, dir.path());
    // Positions too, but for the rounding of each motion.
    let mended = ply::read(&dir.path().join("mended/scene.ply"), &Limits::default()).unwrap();
    let places = tab.value(
        "Array.from(page.state.partOf).map((part, i) => [part, i]).filter(([part]) => page.state.parts[part].object !== null) \
         .map(([part, i]) => { const { rotation, shift } = page.state.parts[part].pose; \
         return [0, 1, 2].map((k) => shift[k] + [0, 1, 2].reduce((s, c) => s + rotation[3 * k + c] * page.scene.geometry[16 * i + c], 0)); })",
    );
    let places: Vec<[f64; 3]> = serde_json::from_value(places).unwrap();
    for (place, mean) in places.iter().zip(&mended.gaussians.means) {
        let near = place
            .iter()
            .zip(mean)
            .all(|(a, b)| (a - f64::from(*b)).abs() < 1e-5);
        assert!(near, "{place:?} {mean:?}");
    }

    for _ in 0..count {
        tab.key("KeyZ", CTRL);
    }
    assert_eq!(state(&mut tab), start);
    tab.key("KeyZ", CTRL);
    assert_eq!(state(&mut tab), start, "nothing is left to undo");
    for _ in 0..count {
        tab.key("KeyZ", CTRL | SHIFT);
    }
    assert_eq!(state(&mut tab), end);
    tab.value("document.getElementById('discard').click()");
    assert_eq!(state(&mut tab), start);
    assert_eq!(tab.value("localStorage.length"), 0);
    for _ in 0..count {
        tab.value("document.getElementById('redo').click()");
    }
    assert_eq!(state(&mut tab), end);
}

#[test]
fn edits_outlive_a_reload_and_leaving_asks_while_they_are_not_saved() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path());
    let mut tab = Tab::open(&browser, &page, [1000, 700]);
    let start = state(&mut tab);
    let green = spot(&mut tab, [0.0, 0.3, 0.0]);
    tab.drag(&[green], 0);
    assert!(!tab.reload(), "nothing is lost");
    tab.drag(&[green], 0);
    tab.key("KeyH", 0);
    let hidden = state(&mut tab);
    assert!(!tab.reload(), "hiding is not saved");
    assert_eq!(state(&mut tab), hidden);
    tab.value("page.rename(2, 'rug'); page.moveTo(2, [0.1, 0, 1 / 3])");
    let end = state(&mut tab);
    let text = tab.text("page.edits.text()");
    tab.hover(green);
    tab.drag(&[green], 0);
    assert!(tab.reload());
    assert_eq!(state(&mut tab), end);
    assert_eq!(tab.text("page.edits.text()"), text);
    let summary = "document.getElementById('summary').textContent";
    assert_eq!(tab.text(summary), "2 edits, not saved");

    let folder = json!({"behavior": "allow", "downloadPath": utf8(dir.path())});
    tab.send("Page.setDownloadBehavior", folder);
    tab.value("document.getElementById('save').click()");
    assert_eq!(tab.text(summary), "2 edits, saved");
    let saved = dir.path().join("edits.json");
    for _ in 0..100 {
        if saved.is_file() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    assert_eq!(std::fs::read_to_string(&saved).unwrap(), text);
    tab.drag(&[[5.0, 400.0]], 0);
    assert!(!tab.reload());
    assert_eq!(tab.text(summary), "2 edits, saved");
    tab.value("page.edits.discard()");
    assert_eq!(state(&mut tab), start);
    assert!(!tab.reload());
    assert_eq!(state(&mut tab), start);

    // What another program left there is dropped.
    let keep = "localStorage.setItem(`coseg edits ${page.scene.sha256}`, ";
    for kept in [
        "'{'",
        "'[]'",
        "'{\"done\": [{\"op\": \"rename\", \"object\": 77, \"name\": \"a\"}]}'",
        "'{\"done\": [{\"op\": \"delete_gaussians\", \"gaussians\": [111]}]}'",
        "'{\"done\": [{\"op\": \"fly\"}]}'",
    ] {
        tab.value(&format!("{keep}{kept})"));
        tab.reload();
        assert_eq!(state(&mut tab), start, "{kept}");
        assert!(tab.text(summary).contains("could not be read"), "{kept}");
    }
}

#[test]
fn keys_alone_reach_every_action() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path());
    let mut tab = Tab::open(&browser, &page, [1000, 700]);
    // The first stop is the picture: Enter takes the plate in its middle.
    tab.key("Tab", 0);
    assert_eq!(tab.text("document.activeElement.id"), "picture");
    tab.key("Enter", 0);
    assert_eq!(tab.value("[...page.chosen]"), json!([2]));
    tab.key("F2", 0);
    tab.type_text("rug");
    tab.key("Enter", 0);
    assert_eq!(tab.text("page.state.object(2).name"), "rug");
    tab.key("KeyH", 0);
    assert_eq!(tab.value("page.state.object(2).shown"), false);
    tab.key("KeyH", 0);
    tab.key("Escape", 0);
    assert_eq!(tab.value("page.chosen.size"), 0);
    tab.key("KeyP", 0);
    tab.key("BracketLeft", 0);
    tab.key("Space", 0);
    let some = selected(&mut tab);
    assert!(some[0].as_u64().unwrap() > 0 && some[1] == "rug", "{some}");
    tab.key("KeyN", 0);
    tab.type_text("spot");
    tab.key("Enter", 0);
    assert_eq!(tab.text("page.state.object(5).name"), "spot");
    // Merged into the wall: the list of objects takes typed letters.
    tab.key("KeyT", 0);
    assert_eq!(
        tab.text("document.activeElement.ariaLabel"),
        "object to merge into"
    );
    while tab.text("page.details.target.selectedOptions[0].text") != "wall" {
        tab.key("ArrowDown", 0);
    }
    tab.key("Enter", 0);
    assert_eq!(tab.value("page.state.object(5).count"), 0);
    assert_eq!(tab.value("[...page.chosen]"), json!([4]));
    tab.key("Delete", 0);
    assert_eq!(tab.value("page.state.object(4).count"), 0);
    assert_applied(&mut tab, dir.path());
    tab.key("KeyZ", CTRL);
    assert!(tab.value("page.state.object(4).count").as_u64() > Some(36));

    // Everything that can be pressed is a stop of Tab and says what it is.
    tab.value("page.choose(2); document.activeElement.blur()");
    let wanted = tab.value(
        "[...document.querySelectorAll('button, input, select, summary, canvas')] \
         .filter((e) => e.checkVisibility() && !e.disabled).length",
    );
    let name = "(() => { const e = document.activeElement; return e === document.body ? null : \
        (e.getAttribute('aria-label') ?? (e.labels?.[0]?.textContent || e.textContent)).trim(); })()";
    let mut stops = 0;
    tab.value("document.body.tabIndex = -1; document.body.focus(); document.body.removeAttribute('tabindex')");
    loop {
        tab.key("Tab", 0);
        let found = tab.value(name);
        if found.is_null() || stops > 200 {
            break;
        }
        assert_ne!(
            found,
            "",
            "{}",
            tab.value("document.activeElement.outerHTML")
        );
        stops += 1;
    }
    assert_eq!(json!(stops), wanted);
}
