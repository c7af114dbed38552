//! Keys of the viewer's page: on every layout, and beside sliders.

use crate::support::devtools::{ALT, CTRL, SHIFT, Tab};
use crate::support::edited_plates::{opened, selected, spot};
use serde_json::json;

/// Drags the slider `id` to a share of its way with the pointer, as a person does.
fn slide(tab: &mut Tab, id: &str, share: f64) {
    let place = format!(
        "(() => {{ const box = document.getElementById('{id}').getBoundingClientRect(); \
         return [box.left + {share} * box.width, box.top + box.height / 2]; }})()"
    );
    let at: [f64; 2] = serde_json::from_value(tab.value(&place)).unwrap();
    tab.drag(&[at], 0);
    assert_eq!(tab.text("document.activeElement.id"), id);
}

#[test]
fn a_slider_leaves_the_keys_of_the_page_alone() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let red = spot(&mut tab, [-0.9, 0.0, 0.1]);
    let level = "page.selection.level";
    tab.key("KeyC", 0);
    tab.drag(&[red], 0);
    slide(&mut tab, "reach", 0.99);
    assert_ne!(tab.value(level), 0);
    slide(&mut tab, "reach", 0.01);
    assert_eq!(tab.value(level), 0);
    tab.key("ArrowRight", 0);
    assert_eq!(tab.value(level), 1, "a key of the slider");
    tab.key("BracketLeft", 0);
    assert_eq!(tab.value(level), 0, "a key of the page");
    let count = selected(&mut tab)[0].clone();
    tab.key("KeyN", 0);
    tab.key("Enter", 0);
    assert_eq!(tab.value("page.state.object(5).count"), count);

    tab.key("KeyP", 0);
    slide(&mut tab, "depth", 0.99);
    assert_eq!(tab.value("page.tools.slider > 90"), true);
    tab.key("KeyZ", CTRL);
    assert_eq!(tab.value("page.edits.done"), json!([]));
}

#[test]
fn letters_count_as_they_are_typed() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let done = "page.edits.done.length";
    let press = |tab: &mut Tab, key: &str, code: &str, more: &str| {
        tab.value(&format!(
            "dispatchEvent(new KeyboardEvent('keydown', {{ key: '{key}', code: '{code}', {more} }}))"
        ));
    };
    tab.value("page.rename(1, 'mat')");
    // German: Z is where the English Y is. French: where the W is.
    press(&mut tab, "z", "KeyY", "ctrlKey: true");
    assert_eq!(tab.value(done), 0);
    press(&mut tab, "Z", "KeyW", "ctrlKey: true, shiftKey: true");
    assert_eq!(tab.value(done), 1);
    press(&mut tab, "z", "KeyW", "ctrlKey: true");
    press(&mut tab, "y", "KeyZ", "ctrlKey: true");
    assert_eq!(tab.value(done), 1);
    // Russian has no Z.
    press(&mut tab, "\u{44f}", "KeyZ", "ctrlKey: true");
    assert_eq!(tab.value(done), 0);

    for (key, code, more, tool) in [
        ("p", "KeyR", "", "brush"),
        ("X", "KeyX", "shiftKey: true", "box"),
        (",", "KeyV", "", "box"),
        ("o", "KeyO", "altKey: true", "box"),
    ] {
        press(&mut tab, key, code, more);
        assert_eq!(tab.text("page.tools.tool"), tool, "{key}");
    }
    // The French row of digits, and a German bracket.
    press(&mut tab, "\u{e9}", "Digit2", "");
    assert_eq!(tab.text("page.mode"), "both");
    let radius = tab.value("page.tools.radius").as_f64();
    press(&mut tab, "]", "Digit9", "ctrlKey: true, altKey: true");
    assert!(tab.value("page.tools.radius").as_f64() > radius);
}

/// Moves the crosshair by arrow keys to within four pixels of a point of the world.
fn aim(tab: &mut Tab, point: [f64; 3]) {
    let to = spot(tab, point);
    let now = tab.value("page.tools.aim ?? page.tools.middle");
    let now: [f64; 2] = serde_json::from_value(now).unwrap();
    let keys = [["ArrowLeft", "ArrowRight"], ["ArrowUp", "ArrowDown"]];
    for (k, [back, forth]) in keys.into_iter().enumerate() {
        let strides = ((to[k] - now[k]) / 8.0).round();
        for _ in 0..strides.abs() as usize {
            tab.key(if strides > 0.0 { forth } else { back }, 0);
        }
    }
}

#[test]
fn shapes_are_drawn_by_keys_alone() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let camera = tab.value("[page.fitted.center, page.fitted.rotation]");
    tab.key("Tab", 0);
    tab.key("KeyX", 0);
    aim(&mut tab, [-1.35, 0.45, 0.1]);
    let crosshair = "document.querySelector('#overlay path') !== null";
    assert_eq!(tab.value(crosshair), true);
    tab.key("Enter", 0);
    aim(&mut tab, [-0.45, -0.45, 0.1]);
    tab.key("Enter", 0);
    assert_eq!(selected(&mut tab), json!([25, "red"]));

    tab.key("KeyO", 0);
    for (x, y) in [(0.35, 0.15), (1.25, 0.15), (1.25, -0.75), (0.35, -0.75)] {
        aim(&mut tab, [x, y, 0.2]);
        tab.key("Enter", SHIFT);
    }
    assert_eq!(selected(&mut tab), json!([25, "red"]), "it is not closed");
    tab.key("Enter", 0);
    assert_eq!(selected(&mut tab), json!([50, "blue,red"]));

    // A stroke through the middle row.
    tab.key("KeyP", 0);
    tab.value("page.tools.radius = 8");
    aim(&mut tab, [-1.2, 0.0, 0.1]);
    tab.key("Enter", ALT);
    aim(&mut tab, [-0.6, 0.0, 0.1]);
    tab.key("Enter", 0);
    assert_eq!(selected(&mut tab), json!([45, "blue,red"]));
    tab.key("KeyZ", CTRL);
    assert_eq!(selected(&mut tab), json!([50, "blue,red"]));
    let there = "[page.fitted.center, page.fitted.rotation]";
    assert_eq!(tab.value(there), camera, "the view stays");

    // Walking gives a shape up.
    tab.key("Enter", 0);
    tab.key("KeyW", 0);
    assert_eq!(tab.value("page.tools.shape"), json!(null));
}

#[test]
fn keys_choose_several_objects_and_raise_one() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    tab.key("Tab", 0);
    tab.value("page.choose(1)");
    let chosen = "[...page.chosen]";
    tab.key("Enter", SHIFT);
    assert_eq!(tab.value(chosen), json!([1, 2]));
    tab.key("Enter", ALT);
    assert_eq!(tab.value(chosen), json!([1]));
    let offset = "page.state.object(1).offset[1]";
    tab.key("KeyU", 0);
    assert!(tab.value(offset).as_f64() > Some(0.01));
    tab.key("KeyJ", 0);
    assert_eq!(tab.value(offset), 0);
}

#[test]
fn a_screen_reader_has_a_name_for_every_control() {
    const OPERATED: [&str; 8] = [
        "button",
        "checkbox",
        "combobox",
        "menuitem",
        "searchbox",
        "slider",
        "spinbutton",
        "textbox",
    ];
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let states = [
        "page.choose(null)",
        "page.choose(2); document.querySelector('details').open = true",
        "page.moveTo(1, [0.25, 0, 0])",
        "page.tools.choose('points'); page.point(30, 'new')",
        "page.tools.choose('brush')",
        "page.tools.choose('box')",
    ];
    let mut counts = Vec::new();
    for state in states {
        tab.value(state);
        let tree = tab.send("Accessibility.getFullAXTree", json!({}));
        let nodes = tree["nodes"].as_array().unwrap().iter();
        let operated = nodes.filter(|node| {
            let role = node["role"]["value"].as_str().unwrap_or_default();
            node["ignored"] == false && OPERATED.contains(&role)
        });
        let operated: Vec<_> = operated.collect();
        for node in &operated {
            let name = node["name"]["value"].as_str().unwrap_or_default();
            assert!(!name.trim().is_empty(), "{state}: {node}");
        }
        counts.push(operated.len());
    }
    // The states differ: objects and selections have controls of their own.
    assert!(
        counts[0] > 10 && counts[1] > counts[0] && counts[3] > counts[0],
        "{counts:?}"
    );
}
