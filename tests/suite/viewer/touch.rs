//! What fingers do on the viewer's page.

use crate::support::devtools::Tab;
use crate::support::edited_plates::{opened, selected, spot};
use glam::DVec3;
use serde_json::json;

const SIZE: [u32; 2] = [1000, 700];
const RED: [f64; 3] = [-0.9, 0.0, 0.1];
const GREEN: [f64; 3] = [0.0, 0.3, 0.0];

/// Where the camera is, and where it looks.
fn camera(tab: &mut Tab) -> [DVec3; 2] {
    serde_json::from_value(tab.value("[page.fitted.center, page.fitted.forward]")).unwrap()
}

/// Moves two fingers, and returns the cameras before and after with the point that the fingers held.
fn gesture(
    tab: &mut Tab,
    from: [[f64; 2]; 2],
    to: [[f64; 2]; 2],
) -> ([DVec3; 2], [DVec3; 2], DVec3) {
    let before = camera(tab);
    tab.fingers(from, to);
    let held = serde_json::from_value(tab.value("page.navigation.pivot")).unwrap();
    (before, camera(tab), held)
}

#[test]
fn two_fingers_turn_and_zoom_with_every_tool_and_three_pan() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    tab.resize(SIZE, true);
    let [x, y] = spot(&mut tab, GREEN);
    let pair = [[x - 50.0, y], [x + 50.0, y]];
    for tool in ["objects", "brush", "lasso", "box"] {
        tab.value(&format!("page.tools.choose('{tool}')"));
        let taken = selected(&mut tab);
        // They go to the right: the camera goes around what they hold.
        let to = pair.map(|[x, y]| [x + 60.0, y]);
        let (before, after, held) = gesture(&mut tab, pair, to);
        assert!(before[1].dot(after[1]) < 0.99, "{tool}: {after:?}");
        let [was, is] = [before[0], after[0]].map(|center| center.distance(held));
        assert!((is / was - 1.0).abs() < 1e-6, "{tool}: {was} {is}");

        // They spread to 1.6 of their distance: it comes as much closer, and does not turn.
        let apart = [[x - 80.0, y], [x + 80.0, y]];
        let (before, after, held) = gesture(&mut tab, pair, apart);
        assert!(before[1].dot(after[1]) > 1.0 - 1e-9, "{tool}: {after:?}");
        let [was, is] = [before[0], after[0]].map(|center| center.distance(held));
        assert!((was / is - 1.6).abs() < 1e-3, "{tool}: {was} {is}");
        gesture(&mut tab, apart, pair);

        // The third finger pans.
        let before = camera(&mut tab);
        let three = [pair[0], pair[1], [x, y + 60.0]];
        tab.fingers(three, three.map(|[x, y]| [x + 30.0, y + 10.0]));
        let after = camera(&mut tab);
        assert!(before[1].dot(after[1]) > 1.0 - 1e-9, "{tool}: {after:?}");
        let way = after[0] - before[0];
        assert!(
            way.length() > 0.05 && way.dot(after[1]).abs() < 1e-9,
            "{tool}: {way}"
        );
        assert_eq!(selected(&mut tab), taken, "{tool}: nothing is drawn");
        assert_eq!(tab.value("page.chosen.size"), 0, "{tool}");
    }
}

#[test]
fn a_second_finger_takes_the_stroke_of_the_first_back() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    tab.resize(SIZE, true);
    let [red, green] = [RED, GREEN].map(|point| spot(&mut tab, point));
    tab.key("KeyP", 0);
    tab.fingers([red], [[red[0] + 10.0, red[1]]]);
    let taken = selected(&mut tab);
    assert_eq!(taken[1], "red", "one finger draws: {taken}");
    let near = [green[0] + 80.0, green[1]];
    tab.touch("touchStart", &[green]);
    assert_eq!(selected(&mut tab)[1], "green");
    tab.touch("touchStart", &[green, near]);
    assert_eq!(selected(&mut tab), taken);
    tab.touch("touchMove", &[[green[0], green[1] + 20.0], near]);
    tab.touch("touchEnd", &[]);
    assert_eq!(selected(&mut tab), taken);
}

#[test]
fn fingers_choose_several_objects_and_raise_one() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    tab.value("document.querySelector('.help').open = true; page.choose(2)");
    let shown = "[...document.querySelectorAll('.touch')].map((e) => e.checkVisibility())";
    assert_eq!(tab.value(shown), json!([false, false, false]), "a mouse");
    tab.resize(SIZE, true);
    tab.until(&format!("{shown}.every((isShown) => isShown)"));
    tab.value("page.choose(null)");

    let [red, green] = [RED, GREEN].map(|point| spot(&mut tab, point));
    let chosen = "[...page.chosen]";
    tab.fingers([red], [red]);
    tab.fingers([green], [green]);
    assert_eq!(tab.value(chosen), json!([2]));
    tab.value("document.getElementById('several').click()");
    tab.fingers([red], [red]);
    assert_eq!(tab.value(chosen), json!([2, 1]));
    tab.value("[...document.querySelectorAll('#objects .name')].find((e) => e.textContent === 'blue').click()");
    assert_eq!(tab.value(chosen), json!([2, 1, 3]));
    for taken in [[red], [spot(&mut tab, [0.8, -0.3, 0.2])]] {
        tab.fingers(taken, taken);
    }
    assert_eq!(tab.value(chosen), json!([2]));

    let offset = "page.state.object(2).offset";
    tab.value("document.querySelector('.places .touch button').click()");
    let raised: DVec3 = serde_json::from_value(tab.value(offset)).unwrap();
    assert!(
        raised.x == 0.0 && raised.y > 0.01 && raised.z == 0.0,
        "{raised}"
    );
    tab.value("document.querySelector('.places .touch button + button').click()");
    assert_eq!(tab.value(offset), json!([0, 0, 0]));
    // The arrow along up.
    tab.value("page.setMoving(true); page.draw()");
    let tip =
        tab.value("['cx', 'cy'].map((k) => Number(page.gizmo.arrows[1].tip.getAttribute(k)))");
    let tip: [f64; 2] = serde_json::from_value(tip).unwrap();
    tab.fingers([tip], [[tip[0], tip[1] - 40.0]]);
    let raised: DVec3 = serde_json::from_value(tab.value(offset)).unwrap();
    assert!(
        raised.x == 0.0 && raised.y > 0.01 && raised.z == 0.0,
        "{raised}"
    );
}
