//! The arrows of the object that is moved, where its middle is not in the picture.

use crate::support::devtools::Tab;
use crate::support::edited_plates::{opened, spot};
use serde_json::json;

/// The picture's width and height, pixels.
const PICTURE: [f64; 2] = [688.0, 700.0];
const NOTICE: &str = "document.getElementById('notice').textContent";
const HIDDEN: &str = "page.gizmo.drawing.hasAttribute('hidden')";

/// Turns the camera on the spot.
fn turn(tab: &mut Tab, radians: f64) {
    tab.value(&format!(
        "page.fitted.turn(page.up, {radians}, page.fitted.center); page.changed(); page.draw()"
    ));
}

/// Whether a place is in the picture.
fn is_inside(place: [f64; 2]) -> bool {
    (0..2).all(|k| place[k] > 0.0 && place[k] < PICTURE[k])
}

/// The tip of the arrow along y.
fn tip(tab: &mut Tab) -> [f64; 2] {
    let place = "['cx', 'cy'].map((k) => Number(page.gizmo.arrows[1].tip.getAttribute(k)))";
    serde_json::from_value(tab.value(place)).unwrap()
}

#[test]
fn arrows_stand_where_the_object_is_seen() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    assert_eq!(
        tab.value("[page.fitted.width, page.fitted.height]"),
        json!([688, 700])
    );
    tab.value("page.goTo(0); page.choose(4)");
    tab.key("KeyM", 0);
    for radians in [-0.55, 1.2] {
        turn(&mut tab, radians);
        let middle = spot(&mut tab, [0.0, 0.0, -1.5]);
        assert!(!is_inside(middle), "{middle:?}");
        assert_eq!(tab.value(HIDDEN), false);
        let from = tip(&mut tab);
        assert!(is_inside(from), "{from:?}");
        // It follows the pointer also where more of the object comes into the picture.
        let to = [from[0], from[1] - 30.0];
        tab.hover(from);
        tab.press(from);
        tab.pull([to[0], to[1] + 12.0]);
        tab.pull(to);
        tab.value("page.draw()");
        let there = tip(&mut tab);
        assert!(
            (there[0] - to[0]).abs() < 3.0 && (there[1] - to[1]).abs() < 1.0,
            "{there:?} {to:?}"
        );
        tab.release(to);
        let offset = "page.state.object(4).offset.map((v) => Math.sign(v))";
        assert_eq!(tab.value(offset), json!([0, 1, 0]));
        assert_eq!(tab.value("page.edits.done.length"), 1, "one drag, one edit");
        tab.value("page.edits.undo(); page.choose(4); page.setMoving(true)");
    }
    assert_eq!(tab.text(NOTICE), "");
    turn(&mut tab, 2.6);
    assert_eq!(tab.value(HIDDEN), true);
    let notice = tab.text(NOTICE);
    assert!(notice.starts_with("wall is out of view"), "{notice}");
    turn(&mut tab, -3.15);
    assert_eq!(tab.value(HIDDEN), false);
    assert_eq!(tab.text(NOTICE), "");

    let axes = "[...document.querySelectorAll('.shift label')].map((e) => e.innerText.trim())";
    assert_eq!(tab.value(axes), json!(["x", "y", "z"]));
}
