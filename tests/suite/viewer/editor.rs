//! Labels edited in the viewer's page: what a selection takes, and what becomes of it.

use crate::support::browser::browser;
use crate::support::devtools::{ALT, SHIFT, Tab};
use crate::support::edited_plates::{assert_applied, opened, page, selected, spot, state};
use crate::support::program::{succeeds, utf8};
use coseg::objects::Regions;
use coseg::splat::ply;
use serde_json::json;

#[test]
fn a_plate_that_is_called_wall_is_put_right() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let page = page(dir.path());
    // The green plate is called wall.
    let path = dir.path().join("plates.ply");
    let mut scene = ply::read(&path).unwrap();
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
    let Some((dir, mut tab)) = opened() else {
        return;
    };
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
    let Some((dir, mut tab)) = opened() else {
        return;
    };
    let scene = ply::read(&dir.path().join("plates.ply")).unwrap();
    let of = Regions::new(&scene.gaussians, &[]).unwrap().superpoints.of;
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
fn a_new_object_does_not_look_like_what_lies_beside_it() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    // All colours are in use but those like red: one of these would be farthest from all.
    tab.value(
        "(() => { const steps = [0, 1, 2, 3, 4].map((k) => 63 * k); let id = 100; \
         for (const r of steps) for (const g of steps) for (const b of steps) if (Math.hypot(r - 230, g - 30, b - 30) > 90) \
         page.state.objects.set(id, { ...page.state.object(4), id: id++, color: [r, g, b] }); })()",
    );
    tab.value("page.recolor(1, [230, 30, 30]); page.selection.set(0, 1); page.split()");
    let color: [f64; 3] =
        serde_json::from_value(tab.value("page.state.object([...page.chosen][0]).color")).unwrap();
    let square: f64 = color
        .iter()
        .zip([230.0, 30.0, 30.0])
        .map(|(a, b)| (a - b).powi(2))
        .sum();
    assert!(square > 100.0 * 100.0, "{color:?}");
    assert_ne!(color, [0.0; 3]);
}

#[test]
fn a_stroke_does_not_take_what_is_deleted_during_it() {
    let Some((dir, mut tab)) = opened() else {
        return;
    };
    let row = [-1.2, -1.05, -0.6].map(|x| spot(&mut tab, [x, 0.0, 0.1]));
    tab.key("KeyP", 0);
    tab.value("page.tools.radius = 6");
    tab.hover(row[0]);
    tab.press(row[0]);
    tab.pull(row[1]);
    assert_eq!(selected(&mut tab), json!([2, "red"]));
    tab.key("Delete", 0);
    tab.pull(row[0]);
    tab.pull(row[2]);
    tab.release(row[2]);
    assert_eq!(selected(&mut tab), json!([0, ""]));
    // What is left is taken by the next stroke, and can be given away.
    tab.drag(&[row[0], row[2]], 0);
    assert_eq!(selected(&mut tab), json!([3, "red"]));
    tab.value("page.putInto(3)");
    assert_applied(&mut tab, dir.path());
}
