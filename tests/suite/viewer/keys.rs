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
