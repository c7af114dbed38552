//! The panel of the viewer's page: the list of objects, fields, and what fits a phone.

use crate::support::browser::browser;
use crate::support::devtools::Tab;
use coseg::data::Classes;
use coseg::splat::Gaussians;
use coseg::viewer::Viewer;
use glam::DVec3;
use serde_json::json;
use std::path::{Path, PathBuf};

/// A page of `count` balls in a row, one object each, seen from before them.
fn balls(dir: &Path, count: u16) -> PathBuf {
    let n = usize::from(count);
    let gaussians = Gaussians {
        means: (0..n)
            .map(|i| [i as f32 - 0.5 * n as f32, 0.0, 0.0])
            .collect(),
        log_scales: vec![[-1.2; 3]; n],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: vec![5.0; n],
        sh: vec![0.4; 3 * n],
        sh_degree: 0,
    };
    let labels: Vec<u16> = (1..=count).collect();
    let classes = Classes::from_names(0, labels.iter().map(|&id| (id, format!("ball {id}"))));
    let page = dir.join("page.html");
    Viewer {
        title: "balls",
        scene: "balls.ply",
        names: None,
        sha256: "00ff",
        gaussians: &gaussians,
        features: &[],
        origin: DVec3::ZERO,
        labels: Some(&labels),
        classes: &classes,
        cameras: &[],
        up: None,
        alpha_max: 0.99,
    }
    .write(&page)
    .unwrap();
    page
}

const NAMES: &str = "[...document.querySelectorAll('#objects .name')].map((e) => e.textContent)";

#[test]
fn objects_are_in_natural_order_and_found() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut tab = Tab::open(&browser, &balls(dir.path(), 12), [1000, 700]);
    let names: Vec<String> = (1..=12).map(|i| format!("ball {i}")).collect();
    assert_eq!(tab.value(NAMES), json!(names));
    tab.value("page.rename(11, 'Apple'); page.rename(3, 'zebra')");
    let listed: Vec<String> = serde_json::from_value(tab.value(NAMES)).unwrap();
    assert_eq!(
        (listed[0].as_str(), listed[11].as_str()),
        ("Apple", "zebra")
    );
    tab.key("KeyF", 0);
    tab.type_text("ALL 1");
    assert_eq!(tab.value(NAMES), json!(["ball 1", "ball 10", "ball 12"]));
    tab.type_text("nobody");
    assert_eq!(tab.value(NAMES), json!([]));
    assert_eq!(tab.value("document.getElementById('none').hidden"), false);
    // Esc leaves the field empty, and keys are keys again.
    tab.key("Escape", 0);
    assert_eq!(tab.value(&format!("{NAMES}.length")), 12);
    tab.key("KeyP", 0);
    assert_eq!(tab.text("page.tools.tool"), "brush");
}

#[test]
fn hiding_keeps_the_chosen_row_in_sight_and_no_name_at_the_pointer() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut tab = Tab::open(&browser, &balls(dir.path(), 60), [1000, 640]);
    let place = "(() => { const c = page.fitted; const d = [9, 0, 0].map((v, k) => v - c.center[k]); \
        const at = [0, 3, 6].map((r) => d.reduce((s, v, k) => s + v * c.rotation[r + k], 0)); \
        return [c.fx * at[0] / at[2] + c.cx, c.fy * at[1] / at[2] + c.cy]; })()";
    let ball: [f64; 2] = serde_json::from_value(tab.value(place)).unwrap();
    tab.drag(&[ball], 0);
    std::thread::sleep(std::time::Duration::from_millis(100));
    tab.hover([ball[0] + 1.0, ball[1]]);
    let hint = "document.getElementById('hint').textContent";
    assert_eq!(tab.text(hint), "ball 40");
    tab.value("page.rename(40, 'ball 40 b')");
    let in_sight = "(() => { const list = document.getElementById('objects').getBoundingClientRect(); \
        const row = document.querySelector('li.chosen').getBoundingClientRect(); \
        return row.height > 10 && row.top >= list.top - 1 && row.bottom <= Math.min(list.bottom, innerHeight) + 1; })()";
    let settled = |tab: &mut Tab| {
        tab.value(
            "new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(() => r(1))))",
        )
    };
    settled(&mut tab);
    assert_eq!(tab.value(in_sight), true);
    tab.hover([ball[0], ball[1] + 1.0]);
    tab.key("KeyH", 0);
    assert_eq!(tab.text(hint), "");
    settled(&mut tab);
    assert_eq!(tab.value(in_sight), true);
    assert_eq!(tab.value("page.state.object(40).shown"), false);
}

#[test]
fn esc_leaves_a_number_field_as_it_was() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut tab = Tab::open(&browser, &balls(dir.path(), 3), [1000, 700]);
    tab.value("page.choose(2); page.details.shift[1].select()");
    tab.type_text("4");
    tab.key("Escape", 0);
    assert_eq!(tab.text("document.activeElement.id"), "picture");
    assert_eq!(tab.value("page.edits.done.length"), 0);
    assert_eq!(tab.text("page.details.shift[1].value"), "0");
    tab.value("page.details.shift[1].select()");
    tab.type_text("4");
    tab.key("Enter", 0);
    assert_eq!(tab.value("page.state.object(2).offset"), json!([0, 4, 0]));
    tab.value("page.details.name.select()");
    tab.type_text("x");
    // What comes from a server meanwhile does not matter.
    tab.value("page.panel.update()");
    assert_eq!(tab.text("page.details.name.value"), "x");
    tab.key("Escape", 0);
    assert_eq!(tab.text("page.details.name.value"), "ball 2");
    assert_eq!(tab.text("page.state.object(2).name"), "ball 2");
}

#[test]
fn keys_that_lead_to_a_field_bring_the_panel_back() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut tab = Tab::open(&browser, &balls(dir.path(), 3), [1000, 700]);
    for (script, key, field) in [
        ("page.choose(2)", "F2", "page.details.name"),
        ("page.choose(2)", "KeyT", "page.details.target"),
        ("1", "KeyF", "document.getElementById('search')"),
        (
            "page.selection.set(0, 1); page.refresh()",
            "KeyN",
            "page.details.name",
        ),
    ] {
        tab.value(script);
        tab.value("document.activeElement.blur(); document.getElementById('fold').click()");
        assert_eq!(tab.value("page.details.box.checkVisibility()"), false);
        tab.key(key, 0);
        let is_there = format!("{field}.checkVisibility() && document.activeElement === {field}");
        assert_eq!(tab.value(&is_there), true, "{key}");
        assert_eq!(
            tab.text("document.getElementById('fold').getAttribute('aria-expanded')"),
            "true"
        );
    }
    // What is typed now is the name, and no key.
    tab.type_text("hat");
    tab.key("Enter", 0);
    assert_eq!(tab.text("page.state.object(4).name"), "hat");
    // Without a use for the field the panel stays away.
    tab.value("page.choose(null); document.getElementById('fold').click()");
    tab.key("F2", 0);
    assert_eq!(
        tab.value("document.body.classList.contains('folded')"),
        true
    );
}

#[test]
fn what_is_chosen_is_spoken_and_its_buttons_fill_one_row() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut tab = Tab::open(&browser, &balls(dir.path(), 5), [1000, 700]);
    let spoken = "document.querySelector('main > [role=status]')";
    let row = "[...page.details.drop.parentElement.children].filter((e) => e.checkVisibility())";
    for (script, words) in [
        ("page.choose(2)", "ball 2 chosen"),
        ("page.choose(3, 'add')", "2 objects chosen ball 2, ball 3"),
        (
            "page.selection.set(0, 1); page.refresh()",
            "1 Gaussian selected of ball 1",
        ),
    ] {
        tab.value(script);
        tab.until(&format!("{spoken}.textContent === '{words}'"));
        let tops = format!("new Set({row}.map((e) => e.getBoundingClientRect().top)).size");
        assert_eq!(tab.value(&tops), 1, "{words}");
        let cut = format!("{row}.filter((e) => e.scrollWidth > e.clientWidth).length");
        assert_eq!(tab.value(&cut), 0, "{words}");
    }
    tab.value("document.getElementById('fold').click(); page.choose(null)");
    tab.until(&format!(
        "{spoken}.textContent === 'nothing chosen' && {spoken}.checkVisibility()"
    ));
}

#[test]
fn a_finger_hits_every_control_of_a_phone() {
    let Some(browser) = browser() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut tab = Tab::open(&browser, &balls(dir.path(), 5), [390, 844]);
    let small = "[...document.querySelectorAll('button, input, select, summary')].filter((e) => e.checkVisibility()) \
        .map((e) => [e, (e.type === 'checkbox' ? e.parentElement : e).getBoundingClientRect()]) \
        .filter(([, box]) => box.width < 44 || box.height < 44) \
        .map(([e, box]) => `${e.id || e.textContent || e.ariaLabel} ${box.width} x ${box.height}`)";
    let wide = "document.documentElement.scrollWidth > innerWidth || \
        document.querySelector('aside').scrollWidth > document.querySelector('aside').clientWidth";
    let over = "(() => { const boxes = [...document.querySelectorAll('#toolbar > div, #fold')].map((e) => e.getBoundingClientRect()); \
         return boxes.some((a, i) => boxes.slice(i + 1).some((b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom)); })()";
    // Upright, on its side, and a tablet.
    for size in [[390, 844], [844, 390], [667, 375], [1180, 820]] {
        tab.resize(size, true);
        for script in [
            "page.tools.choose('objects'); page.choose(null)",
            "page.choose(2)",
            "page.choose(3, 'add')",
            "page.tools.choose('brush')",
            "page.tools.choose('points')",
            "page.rename(2, 'a'); page.rename(2, 'b')",
            "page.selection.set(1, 1); page.refresh()",
        ] {
            tab.value(script);
            assert_eq!(tab.value(small), json!([]), "{size:?} {script}");
            assert_eq!(tab.value(wide), false, "{size:?} {script}");
            assert_eq!(tab.value(over), false, "{size:?} {script}");
        }
    }
}
