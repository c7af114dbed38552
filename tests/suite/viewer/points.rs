//! Things that clicks select in the viewer's page, in a scene without labels.

use crate::support::browser::browser;
use crate::support::devtools::Tab;
use crate::support::edited_plates::{assert_applied, selected, spot, state};
use crate::support::plates::{plates, scene as plates_scene};
use crate::support::program::{succeeds, utf8};
use coseg::objects::{Growth, Regions};
use coseg::splat::{Gaussians, ply};
use glam::DVec3;
use serde_json::{Value, json};
use tempfile::TempDir;

/// The middles of the red and the blue plate.
const RED: [f64; 3] = [-0.9, 0.0, 0.1];
const BLUE: [f64; 3] = [0.8, -0.3, 0.2];

/// A row of six squares of 36 Gaussians before the cameras of the plates, each of one grey.
fn squares() -> Gaussians {
    let greys = [0.2, 0.3, 0.85, 0.8, 0.95, 0.5];
    let (mut means, mut sh) = (Vec::new(), Vec::new());
    for (square, grey) in greys.into_iter().enumerate() {
        for i in 0..36 {
            let left = -0.9 + 0.3 * square as f32;
            let [x, y] = [i % 6, i / 6].map(|step| 0.05 * step as f32);
            means.push([left + x, y - 0.15, 0.0]);
            sh.extend([(grey - 0.5) / 0.282_094_8; 3]);
        }
    }
    let n = means.len();
    Gaussians {
        means,
        log_scales: vec![[-3.5; 3]; n],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: vec![3.0; n],
        sh,
        sh_degree: 0,
    }
}

/// A page of `gaussians`, which have neither labels nor classes, with the cameras of the plates.
fn opened(gaussians: &Gaussians) -> Option<(TempDir, Tab)> {
    let browser = browser()?;
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    plates_scene(&photos);
    let [scene, page] = ["plates.ply", "page.html"].map(|name| dir.path().join(name));
    ply::write(&scene, gaussians, DVec3::ZERO, None).unwrap();
    succeeds(&[
        "view",
        "--scene",
        utf8(&scene),
        "--cameras",
        utf8(&photos),
        "--out",
        utf8(&page),
    ]);
    let tab = Tab::open(&browser, &page, [1000, 700]);
    Some((dir, tab))
}

#[test]
fn clicks_give_a_scene_its_first_labels() {
    let Some((dir, mut tab)) = opened(&plates().0) else {
        return;
    };
    let start = state(&mut tab);
    let [red, blue] = [RED, BLUE].map(|point| spot(&mut tab, point));
    tab.key("KeyC", 0);
    tab.drag(&[red], 0);
    assert_eq!(selected(&mut tab), json!([25, "unlabelled"]));
    assert_eq!(
        tab.value("[...document.querySelectorAll('#options > :not([hidden])')].map((e) => e.id || e.control.id)"),
        json!(["reach", "how"])
    );
    tab.key("KeyN", 0);
    tab.type_text("plate");
    tab.key("Enter", 0);
    tab.value("page.choose(null)");

    // The other plate joins it.
    tab.key("KeyC", 0);
    tab.drag(&[blue], 0);
    assert_eq!(selected(&mut tab), json!([25, "unlabelled"]));
    tab.key("KeyT", 0);
    tab.value("page.details.target.value = '1'");
    tab.key("Enter", 0);
    let labels: Vec<u16> = (0..111)
        .map(|row| u16::from(row < 25 || (50..75).contains(&row)))
        .collect();
    assert_eq!(tab.value("Array.from(page.state.labels())"), json!(labels));
    assert_applied(&mut tab, dir.path());
    let scene = ply::read(&dir.path().join("edited/scene.ply")).unwrap();
    assert_eq!(scene.labels, Some(labels));
    tab.value("page.edits.undo(); page.edits.undo(); page.edits.undo()");
    assert_eq!(state(&mut tab), start);
}

#[test]
fn a_thing_that_is_gone_is_forgotten() {
    let Some((_dir, mut tab)) = opened(&plates().0) else {
        return;
    };
    let [red, blue] = [RED, BLUE].map(|point| spot(&mut tab, point));
    tab.key("KeyC", 0);
    tab.drag(&[red], 0);
    tab.key("Delete", 0);
    tab.drag(&[blue], 0);
    assert_eq!(selected(&mut tab), json!([25, "unlabelled"]));
    assert_eq!(tab.value("page.selection.seeds.length"), 1);
    tab.key("KeyN", 0);
    tab.key("Enter", 0);

    // What is chosen bounds the wand: a click beside it selects nothing.
    let green = spot(&mut tab, [0.0, 0.3, 0.0]);
    assert_eq!(tab.value("[...page.chosen]"), json!([1]));
    tab.key("KeyC", 0);
    tab.drag(&[green], 0);
    assert_eq!(
        tab.value("[page.selection.count, page.selection.seeds.length]"),
        json!([0, 0])
    );
    tab.drag(&[blue], 0);
    assert_eq!(tab.value("page.selection.count"), 25);
    // After another tool the slider would undo what that did.
    tab.key("KeyG", 0);
    assert_eq!(tab.value("page.selection.growth"), Value::Null);
    assert_eq!(tab.value("page.selection.count"), 25);
}

#[test]
fn each_level_selects_what_the_command_selects() {
    let squares = squares();
    let Some((_dir, mut tab)) = opened(&squares) else {
        return;
    };
    let [first, other] = [-0.75, -0.5].map(|x| spot(&mut tab, [x, 0.0, 0.0]));
    tab.key("KeyC", 0);
    tab.drag(&[first], 0);
    tab.drag(&[other], 0);
    let seeds: Vec<u32> = serde_json::from_value(tab.value("page.selection.seeds")).unwrap();
    assert!(seeds[0] < 36 && (36..72).contains(&seeds[1]), "{seeds:?}");
    let growth = Growth::new(&Regions::new(&squares, &[]).unwrap(), &seeds);
    assert_eq!(growth.rows(growth.proposed).len(), 72);
    let proposed = tab.value("page.selection.growth.levels[page.selection.level]");
    assert_eq!(proposed.as_f64().unwrap() as f32, growth.proposed);
    let levels = tab
        .value("page.selection.growth.levels.length")
        .as_u64()
        .unwrap();
    assert!(levels > 2);
    for level in 0..levels {
        tab.value(&format!("page.growTo({level})"));
        let threshold = tab.value("page.selection.growth.levels[page.selection.level]");
        let rows = growth.rows(threshold.as_f64().unwrap() as f32);
        assert_eq!(
            tab.value("page.selection.rows()"),
            json!(rows),
            "{threshold}"
        );
    }

    // Keys go to and fro, and stop at the ends.
    tab.key("BracketRight", 0);
    assert_eq!(tab.value("page.selection.level"), levels - 1);
    tab.key("BracketLeft", 0);
    assert_eq!(tab.value("page.selection.level"), levels - 2);
    assert_eq!(
        tab.value("Number(document.getElementById('reach').value)"),
        levels - 2
    );
    // A drag turns the view, and takes nothing; Esc drops the selection first.
    let before = selected(&mut tab);
    tab.drag(&[first, [first[0] + 60.0, first[1]]], 0);
    assert_eq!(selected(&mut tab), before);
    tab.key("Escape", 0);
    assert_eq!(selected(&mut tab), json!([0, ""]));
    assert_eq!(
        tab.value("[page.tools.tool, page.selection.seeds.length]"),
        json!(["points", 0])
    );
}
