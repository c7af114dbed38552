//! Keys of the viewer's page: on every layout, and beside sliders.

use crate::support::devtools::{CTRL, Tab};
use crate::support::mended_plates::{opened, selected, spot};
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
