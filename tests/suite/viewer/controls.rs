//! Controls of the viewer's page: wheel, sliders, buttons, and the light or dark of the system.

use crate::support::devtools::Tab;
use crate::support::edited_plates::{opened, spot};
use serde_json::json;

/// Sets a slider as a person does.
fn slide(tab: &mut Tab, id: &str, value: u32) {
    tab.value(&format!(
        "document.getElementById('{id}').value = {value}; \
         document.getElementById('{id}').dispatchEvent(new Event('input', {{ bubbles: true }}))"
    ));
}

#[test]
fn a_roll_of_the_wheel_looks_once_what_is_there() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let [x, y] = spot(&mut tab, [0.0, 0.3, 0.0]);
    let roll = format!(
        "(() => {{ let looks = 0; const {{ pickAt }} = page; page.pickAt = (...at) => {{ looks++; return pickAt.apply(page, at); }}; \
         const before = page.fitted.depth([0, 0.3, 0]); \
         const step = () => new WheelEvent('wheel', {{ deltaY: -100, clientX: {x}, clientY: {y}, cancelable: true }}); \
         for (const event of [step(), step(), step(), step()]) page.canvas.dispatchEvent(event); \
         page.pickAt = pickAt; return [looks, page.fitted.depth([0, 0.3, 0]) / before]; }})()"
    );
    let still = (-4.0 * 0.16_f64).exp();
    for _ in 0..2 {
        let [looks, closer]: [f64; 2] = serde_json::from_value(tab.value(&roll)).unwrap();
        assert_eq!(looks, 1.0);
        assert!((closer / still - 1.0).abs() < 0.1, "{closer} {still}");
        std::thread::sleep(std::time::Duration::from_millis(200));
    }
}

#[test]
fn sliders_say_what_they_are_set_to() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    tab.key("KeyX", 0);
    let text = "document.getElementById('depth-text').textContent";
    let before = tab.text(text);
    slide(&mut tab, "depth", 60);
    assert_eq!(tab.value("page.tools.slider"), 60);
    assert_ne!(tab.text(text), before);
    slide(&mut tab, "depth", 100);
    assert_eq!(tab.text(text), "no limit");
    assert_eq!(tab.value("page.tools.limit === Infinity"), true);

    let red = spot(&mut tab, [-0.9, 0.0, 0.1]);
    tab.key("KeyC", 0);
    tab.drag(&[red], 0);
    let last = tab.value("page.selection.growth.levels.length - 1");
    let some = tab.value("page.selection.count").as_u64();
    slide(&mut tab, "reach", last.as_u64().unwrap() as u32);
    assert_eq!(tab.value("page.selection.level"), last);
    assert!(tab.value("page.selection.count").as_u64() > some);
    let of = tab.text("document.getElementById('reach-text').textContent");
    let levels = last.as_u64().unwrap() + 1;
    assert_eq!(of, format!("{levels} of {levels}"));
}

#[test]
fn the_command_is_copied_or_selected() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    tab.value("page.rename(1, 'mat')");
    let command = tab.text("document.getElementById('command').textContent");
    assert!(command.starts_with("coseg edit "), "{command}");
    let clipboard = |write: &str| {
        format!(
            "Object.defineProperty(navigator, 'clipboard', {{ configurable: true, value: {{ writeText: {write} }} }}); \
             document.getElementById('copy').click()"
        )
    };
    let label = "document.getElementById('copy').textContent";
    tab.value(&clipboard("async (text) => { page.copied = text; }"));
    tab.until(&format!("{label} === 'Copied'"));
    assert_eq!(tab.text("page.copied"), command);
    tab.value(&clipboard("async () => { throw new Error('no'); }"));
    tab.until(&format!("{label} === 'Selected'"));
    assert_eq!(tab.text("getSelection().toString().trim()"), command);
    tab.until(&format!("{label} === 'Copy'"));
}

#[test]
fn the_page_is_as_light_or_dark_as_the_system() {
    let Some((_dir, mut tab)) = opened() else {
        return;
    };
    let light = "[getComputedStyle(document.querySelector('aside')).backgroundColor, getComputedStyle(document.body).color] \
        .map((color) => color.match(/\\d+/g).slice(0, 3).reduce((sum, v) => sum + Number(v), 0) > 380)";
    for (scheme, want) in [("dark", [false, true]), ("light", [true, false])] {
        let features = json!([{"name": "prefers-color-scheme", "value": scheme}]);
        tab.send("Emulation.setEmulatedMedia", json!({"features": features}));
        assert_eq!(tab.value(light), json!(want), "paper and ink, {scheme}");
    }
}
