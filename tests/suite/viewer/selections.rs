//! Selections in the viewer's page: undone, and added to by the wand.

use crate::support::devtools::{ALT, CTRL, SHIFT, Tab};
use crate::support::edited_plates::{opened, selected, spot, state};
use serde_json::json;

const RED: [f64; 3] = [-0.9, 0.0, 0.1];
const GREEN: [f64; 3] = [0.0, 0.3, 0.0];
const BLUE: [f64; 3] = [0.8, -0.3, 0.2];

/// A line around the plate with this middle, in the picture.
fn around(tab: &mut Tab, [x, y, z]: [f64; 3]) -> [[f64; 2]; 4] {
    let corners = [[-0.45, -0.45], [0.45, -0.45], [0.45, 0.45], [-0.45, 0.45]];
    corners.map(|[u, v]| spot(tab, [x + u, y + v, z]))
}

#[test]
fn selections_since_the_last_edit_are_undone_first() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let start = state(&mut tab);
    let [red, blue] = [RED, BLUE].map(|middle| around(&mut tab, middle));
    let green = spot(&mut tab, GREEN);
    tab.key("KeyO", 0);
    tab.drag(&red, 0);
    tab.drag(&blue, 0);
    tab.drag(&red, SHIFT);
    let both = json!([50, "blue,red"]);
    assert_eq!(selected(&mut tab), both);
    for want in [json!([25, "blue"]), json!([25, "red"]), json!([0, ""])] {
        tab.key("KeyZ", CTRL);
        assert_eq!(selected(&mut tab), want);
    }
    tab.key("KeyZ", CTRL);
    assert_eq!(state(&mut tab), start, "there is no edit");
    for want in [json!([25, "red"]), json!([25, "blue"]), both.clone()] {
        tab.key("KeyZ", CTRL | SHIFT);
        assert_eq!(selected(&mut tab), want);
    }

    // Esc, and a click that chooses an object.
    tab.key("Escape", 0);
    assert_eq!(selected(&mut tab), json!([0, ""]));
    tab.value("document.getElementById('undo').click()");
    assert_eq!(selected(&mut tab), both);
    tab.key("KeyV", 0);
    tab.drag(&[green], 0);
    assert_eq!(
        tab.value("[[...page.chosen], page.selection.count]"),
        json!([[2], 0])
    );
    tab.key("KeyM", 0);
    tab.key("KeyZ", CTRL);
    assert_eq!(
        tab.value("[[...page.chosen], page.selection.count]"),
        json!([[], 50])
    );
    assert_eq!(selected(&mut tab), both);

    // After an edit that comes first.
    tab.value("page.putInto(4)");
    assert_eq!(tab.value("page.state.object(4).count"), 86);
    tab.key("KeyZ", CTRL);
    assert_eq!(state(&mut tab), start);
    assert_eq!(tab.value("document.getElementById('undo').disabled"), true);
    tab.key("KeyZ", CTRL | SHIFT);
    assert_eq!(tab.value("page.state.object(4).count"), 86);
}

#[test]
fn a_stroke_is_taken_back_while_it_is_drawn() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let red = around(&mut tab, RED);
    let green = spot(&mut tab, GREEN);
    tab.key("KeyO", 0);
    tab.drag(&red, 0);
    tab.key("KeyP", 0);
    tab.hover(green);
    tab.press(green);
    assert_eq!(selected(&mut tab)[1], "green");
    tab.key("KeyZ", CTRL);
    tab.release(green);
    assert_eq!(selected(&mut tab), json!([25, "red"]));
}

#[test]
fn the_wand_adds_and_subtracts() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let [red, blue] = [RED, BLUE].map(|middle| spot(&mut tab, middle));
    let both = json!([50, "blue,red"]);
    tab.key("KeyC", 0);
    tab.drag(&[red], 0);
    tab.drag(&[blue], SHIFT);
    assert_eq!(selected(&mut tab), both);
    // The slider is for what was added.
    tab.value("page.growTo(0)");
    let some = selected(&mut tab);
    assert_eq!(some[1], "blue,red", "{some}");
    tab.value("page.growTo(page.selection.growth.proposed)");
    tab.drag(&[red], ALT);
    assert_eq!(selected(&mut tab), json!([25, "blue"]));
    tab.key("KeyZ", CTRL);
    assert_eq!(selected(&mut tab), both);
    tab.key("Escape", 0);
    tab.value("document.querySelector('[data-how=add]').click()");
    tab.drag(&[red], 0);
    tab.drag(&[blue], 0);
    assert_eq!(selected(&mut tab), both);
    // What a brush has taken stays too.
    tab.key("Escape", 0);
    tab.key("KeyX", 0);
    tab.value("page.tools.how = 'new'");
    let corners = around(&mut tab, GREEN);
    tab.drag(&[corners[0], corners[2]], 0);
    tab.key("KeyC", 0);
    tab.drag(&[red], SHIFT);
    assert_eq!(selected(&mut tab), json!([50, "green,red"]));
    tab.key("Escape", 0);
    tab.drag(&[red], 0);
    assert_eq!(selected(&mut tab), json!([25, "red"]));
}
