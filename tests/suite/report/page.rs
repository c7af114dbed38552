//! The report's page in a real browser.

use crate::support::browser::browser;
use crate::support::devtools::Tab;
use crate::support::made_up_report::{folder, with_report};
use serde_json::json;

#[test]
fn a_picture_fills_the_window_and_shrinks_again_by_pointer_and_key() {
    let Some(browser) = browser() else { return };
    let (_keep, dir) = folder();
    with_report(|report| report.write(&dir).unwrap());
    let mut tab = Tab::page(&browser, &dir.join("report.html"), [1000, 700]);
    let size = "(() => { const at = document.querySelector('.pictures img').getBoundingClientRect(); \
        return [Math.round(at.width), Math.round(at.height)]; })()";
    let small = tab.value(size);
    let middle = "(() => { const img = document.querySelector('.pictures img'); img.scrollIntoView({ block: 'center' }); \
        const at = img.getBoundingClientRect(); return [at.x + at.width / 2, at.y + at.height / 2]; })()";
    let middle: [f64; 2] = serde_json::from_value(tab.value(middle)).unwrap();
    tab.drag(&[middle], 0);
    assert_eq!(tab.value(size), json!([1000, 700]));
    tab.drag(&[[20.0, 20.0]], 0);
    assert_eq!(tab.value(size), small);

    tab.value("document.querySelector('.pictures input').focus()");
    tab.key("Space", 0);
    assert_eq!(tab.value(size), json!([1000, 700]));
    tab.key("Space", 0);
    assert_eq!(tab.value(size), small);
}
