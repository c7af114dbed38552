//! Edits in the viewer's page: undone, kept, saved, and reached by keys.

use crate::support::devtools::{CTRL, SHIFT};
use crate::support::edited_plates::{assert_applied, opened, selected, spot, state};
use crate::support::program::utf8;
use coseg::splat::ply;
use serde_json::json;
use std::path::Path;

#[test]
fn everything_is_undone_and_done_again_bit_for_bit() {
    let Some((dir, mut tab)) = opened() else {
        return;
    };
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
    // Positions too, except for the rounding of each motion.
    let edited = ply::read(&dir.path().join("edited/scene.ply")).unwrap();
    let places = tab.value(
        "Array.from(page.state.partOf).map((part, i) => [part, i]).filter(([part]) => page.state.parts[part].object !== null) \
         .map(([part, i]) => { const { rotation, shift } = page.state.parts[part].pose; \
         return [0, 1, 2].map((k) => shift[k] + [0, 1, 2].reduce((s, c) => s + rotation[3 * k + c] * page.scene.geometry[16 * i + c], 0)); })",
    );
    let places: Vec<[f64; 3]> = serde_json::from_value(places).unwrap();
    for (place, mean) in places.iter().zip(&edited.gaussians.means) {
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
fn an_arrow_moves_the_object_along_its_axis() {
    let Some((dir, mut tab)) = opened() else {
        return;
    };
    let start = state(&mut tab);
    let tip = |axis: usize| format!("page.gizmo.arrows[{axis}].tip");
    let hidden = "page.gizmo.drawing.hasAttribute('hidden')";
    tab.value("page.choose(2); page.draw()");
    assert_eq!(tab.value(hidden), json!(true), "not asked for");
    tab.key("KeyM", 0);
    tab.value("page.draw()");
    assert_eq!(tab.value(hidden), json!(false));
    for axis in [0, 1] {
        let place = format!(
            "['cx', 'cy'].map((k) => Number({}.getAttribute(k)))",
            tip(axis)
        );
        let from: [f64; 2] = serde_json::from_value(tab.value(&place)).unwrap();
        let middle = spot(&mut tab, [0.0, 0.3, 0.0]);
        let ahead = [0, 1].map(|k| (from[k] - middle[k]) / 2.0);
        let to = [0, 1].map(|k| from[k] + ahead[k]);
        tab.drag(&[from, [0, 1].map(|k| from[k] + 0.4 * ahead[k]), to], 0);
        tab.value("page.draw()");
        let tip: [f64; 2] = serde_json::from_value(tab.value(&place)).unwrap();
        assert!(
            (0..2).all(|k| (tip[k] - to[k]).abs() < 1.0),
            "the arrow follows the pointer: {tip:?} {to:?}"
        );
        let offset: [f64; 3] =
            serde_json::from_value(tab.value("page.state.object(2).offset")).unwrap();
        for (k, along) in offset.into_iter().enumerate() {
            assert_eq!(along > 0.0, k == axis, "{offset:?}");
        }
        assert_eq!(tab.value("page.edits.done.length"), json!(1));
        assert_applied(&mut tab, dir.path());
        tab.key("KeyZ", CTRL);
        assert_eq!(state(&mut tab), start);
        tab.value("page.draw()");
    }
}

#[test]
fn edits_outlive_a_reload_and_leaving_asks_while_they_are_not_saved() {
    let Some((dir, mut tab)) = opened() else {
        return;
    };
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
    assert_eq!(downloaded(&dir.path().join("edits.json")), text);
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
fn two_windows_keep_what_is_not_saved_of_one_and_warn_in_the_other() {
    let Some((dir, mut tab)) = opened() else {
        return;
    };
    let page = dir.path().join("page.html").canonicalize().unwrap();
    let names = "[1, 2].map((id) => page.state.object(id).name)";
    let summary = "document.getElementById('summary').textContent";
    let mut first = tab.window(&format!("file://{}", page.display()), [1000, 700]);
    tab.swap(&mut first);
    tab.value("page.rename(1, 'mat')");
    tab.swap(&mut first);
    tab.until("localStorage.length === 1");
    tab.value("page.rename(2, 'rug')");
    let warning = tab.text(summary);
    assert!(warning.starts_with("Another window has edits"), "{warning}");
    tab.swap(&mut first);
    tab.reload();
    assert_eq!(tab.value(names), json!(["mat", "green"]));

    // As soon as those are saved, the others are kept.
    tab.value("page.edits.download = () => ''; page.edits.save()");
    tab.swap(&mut first);
    tab.until(&format!("{summary} === '1 edit, not saved'"));
    tab.reload();
    assert_eq!(tab.value(names), json!(["red", "rug"]));
}

#[test]
fn a_large_selection_fits_what_the_browser_keeps() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    tab.value(
        "for (const row of [0, 1, 2, 7, 30, 31, 110]) page.selection.set(row, 1); page.putInto(3)",
    );
    let end = state(&mut tab);
    let text = tab.text("page.edits.text()");
    assert!(
        text.contains(r#""gaussians":[0,1,2,7,30,31,110]"#),
        "{text}"
    );
    let kept = "JSON.parse(localStorage.getItem(`coseg edits ${page.scene.sha256}`)).done.at(-1).gaussians";
    assert_eq!(tab.value(kept), json!({"runs": [0, 3, 4, 1, 22, 2, 78, 1]}));
    tab.reload();
    assert_eq!(state(&mut tab), end);
    assert_eq!(tab.text("page.edits.text()"), text);

    // One by one these rows take more than the 5 MB that there are.
    tab.value(
        "page.edits.done.push({ op: 'assign', object: 3, gaussians: Array.from({ length: 700_000 }, (_, i) => i + (i >> 1)) }); \
         page.edits.keep()",
    );
    assert_eq!(tab.text("page.edits.trouble"), "");
    assert_eq!(tab.value(&format!("{kept}.runs.length")), 700_000);
}

#[test]
fn keys_alone_reach_every_action() {
    let Some((dir, mut tab)) = opened() else {
        return;
    };
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

#[test]
fn a_key_during_a_drag_shifts_no_other_move() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let green = spot(&mut tab, [0.0, 0.3, 0.0]);
    tab.value("page.moveTo(1, [0.25, 0, 0])");
    tab.drag(&[green], 0);
    tab.key("KeyM", 0);
    tab.press(green);
    tab.pull([green[0] + 30.0, green[1]]);
    tab.key("KeyZ", CTRL);
    tab.pull([green[0] + 50.0, green[1]]);
    tab.release([green[0] + 50.0, green[1]]);
    let moves = tab.value("page.edits.done.map((o) => [o.op, o.object])");
    assert_eq!(moves, json!([["move", 1], ["move", 2]]));
    assert_eq!(
        tab.value("page.state.object(1).offset"),
        json!([0.25, 0, 0])
    );
    assert_ne!(tab.value("page.state.object(2).offset"), json!([0, 0, 0]));
}

#[test]
fn no_object_moves_farther_than_the_command_takes() {
    let Some((dir, mut tab)) = opened() else {
        return;
    };
    let done = "page.edits.done.length";
    let notice = "document.getElementById('notice').textContent";
    tab.value("page.choose(2); page.details.shift[0].select()");
    tab.type_text("1e9");
    tab.key("Enter", 0);
    assert_eq!(tab.value(done), 0);
    assert_eq!(tab.text("page.details.shift[0].value"), "0");
    assert!(tab.text(notice).starts_with("Not moved"));
    tab.value("page.moveHeld({ object: 2 }, [0, 1e9, 0])");
    assert_eq!(tab.value(done), 0);
    tab.value("page.moveTo(2, [(1 - 1e-12) * page.scene.farthest, 0, 0])");
    assert_eq!(tab.value(done), 1);
    // So far off it does not turn either.
    tab.value("page.turnTo(2, 30)");
    assert_eq!(tab.value(done), 1);
    assert_applied(&mut tab, dir.path());
}

#[test]
fn names_hold_no_control_characters() {
    let Some((dir, mut tab)) = opened() else {
        return;
    };
    tab.value("page.rename(2, ' red\\trug ')");
    assert_eq!(tab.text("page.state.object(2).name"), "red rug");
    assert_applied(&mut tab, dir.path());
}

/// The text of a JSON file that the browser downloads. The browser makes the file empty and fills it later.
fn downloaded(path: &Path) -> String {
    for _ in 0..600 {
        match std::fs::read_to_string(path) {
            Ok(text) if serde_json::from_str::<serde_json::Value>(&text).is_ok() => return text,
            _ => std::thread::sleep(std::time::Duration::from_millis(50)),
        }
    }
    panic!(
        "{} is not there, or not complete, after 30 seconds",
        path.display()
    );
}
