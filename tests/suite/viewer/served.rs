//! A page that a server fills, and the file in which it saves edits.

use crate::support::browser::browser;
use crate::support::devtools::Tab;
use crate::support::edited_plates::spot;
use crate::support::served_plates::Plates;
use coseg::objects::{Edits, Operation};
use serde_json::json;

/// A number for all that a page knows of its Gaussians.
const DIGEST: &str = "[page.scene.geometry, page.scene.colours, page.scene.superpoints, page.scene.parents, page.scene.heights, \
    page.scene.prominences, page.state.partOf].map((column) => new Uint8Array(column.buffer, column.byteOffset, column.byteLength) \
    .reduce((sum, byte) => Math.imul(sum, 31) + byte | 0, 7))";

#[test]
fn blocks_make_the_scene_of_the_offline_page() {
    let Some(browser) = browser() else { return };
    let plates = Plates::new();
    let dir = tempfile::tempdir().unwrap();
    let page = dir.path().join("page.html");
    plates.viewer().write(&page).unwrap();
    let picture = "page.draw(); page.canvas.toDataURL()";
    let mut tab = Tab::open(&browser, &page, [600, 400]);
    let want = tab.value(DIGEST);
    let drawn = tab.text(picture);
    drop(tab);
    plates.served(&dir.path().join("edits.json"), |address| {
        let mut tab = Tab::served(&browser, address, [600, 400]);
        assert_eq!(tab.value("page.scene.blocks"), 6);
        assert_eq!(tab.value(DIGEST), want);
        assert_eq!(tab.text(picture), drawn);
        let lead = tab.text("document.getElementById('lead').textContent");
        assert_eq!(lead, "111 Gaussians");
        let notice = "document.getElementById('notice').textContent";
        assert_eq!(tab.text(notice), "");
        tab.value("page.panel.setReceived(40)");
        assert_eq!(tab.text(notice), "40 of 111 Gaussians");
        // A picture is sorted again only where the view has moved, or the scene has changed.
        let sorted = "(() => { let sorted = 0; const { sort } = page.order; \
            page.order.sort = (...a) => { sorted++; sort.apply(page.order, a); }; \
            const after = [() => page.choose(1), () => page.level(), () => page.show([1], false)] \
                .map((act) => { sorted = 0; act(); page.draw(); page.draw(); return sorted; }); \
            page.order.sort = sort; return after; })()";
        assert_eq!(tab.value(sorted), json!([0, 1, 1]));
        assert_eq!(
            tab.text("document.getElementById('trouble').textContent"),
            ""
        );
    });
}

#[test]
fn edits_are_saved_and_the_page_starts_from_them() {
    let Some(browser) = browser() else { return };
    let plates = Plates::new();
    let dir = tempfile::tempdir().unwrap();
    let edits = dir.path().join("edits.json");
    plates.served(&edits, |address| {
        let mut tab = Tab::served(&browser, address, [1000, 700]);
        let red = spot(&mut tab, [-0.9, 0.0, 0.1]);
        tab.key("KeyC", 0);
        tab.drag(&[red], 0);
        tab.key("KeyN", 0);
        tab.type_text("rug");
        tab.key("Enter", 0);
        assert!(!edits.exists());
        tab.value("document.getElementById('save').click()");
        tab.until("document.getElementById('summary').textContent === '2 edits, saved'");
        let command = tab.text("document.getElementById('command').textContent");
        assert!(
            command.contains(&format!("--edits {}", edits.display())),
            "{command}"
        );
    });
    let saved = Edits::read(&edits).unwrap();
    assert!(
        matches!(&saved.operations[..], [Operation::Assign { gaussians, .. }, Operation::Rename { name, .. }]
        if *gaussians == Vec::from_iter(0..25) && name == "rug")
    );

    // Another port is another origin: the browser has kept nothing for it.
    let mut tab = plates.served(&edits, |address| {
        let mut tab = Tab::served(&browser, address, [1000, 700]);
        assert_eq!(tab.text("page.state.object(5).name"), "rug");
        assert_eq!(
            tab.value("[page.edits.isSaved, page.edits.done.length]"),
            json!([true, 2])
        );
        // What is hidden is in no file, and stays hidden.
        tab.value("page.show([4], false)");
        tab.reload();
        assert_eq!(
            tab.value("[page.state.object(4).shown, page.edits.isSaved]"),
            json!([false, true])
        );
        // What is discarded is discarded in the file too, once it is saved.
        tab.value("page.edits.discard()");
        let summary = "document.getElementById('summary').textContent";
        assert_eq!(tab.text(summary), "0 edits, not saved");
        tab.reload();
        assert_eq!(tab.text(summary), "0 edits, not saved");
        tab.value("document.getElementById('save').click()");
        tab.until("page.edits.isSaved");
        assert!(Edits::read(&edits).unwrap().operations.is_empty());

        // Another window of the same browser starts from what was saved last.
        tab.value("page.rename(1, 'mat')");
        tab.value("document.getElementById('save').click()");
        tab.until("page.edits.isSaved");
        let mut other = Tab::served(&browser, address, [600, 400]);
        assert_eq!(other.text("page.state.object(1).name"), "mat");
        tab
    });
    // The server has ended: the browser downloads the file instead.
    tab.value("page.edits.download = () => { page.downloads = 1; return ''; }");
    tab.value("page.rename(1, 'cat')");
    tab.value("document.getElementById('save').click()");
    tab.until("page.downloads === 1");
    tab.until("document.getElementById('summary').textContent.startsWith('The server has ended')");
}

#[test]
fn what_another_window_has_saved_is_not_written_over() {
    let Some(browser) = browser() else { return };
    let plates = Plates::new();
    let dir = tempfile::tempdir().unwrap();
    let edits = dir.path().join("edits.json");
    let save = "document.getElementById('save').click()";
    let outdated =
        "document.getElementById('summary').textContent.startsWith('Another window has saved')";
    plates.served(&edits, |address| {
        let mut tab = Tab::served(&browser, address, [1000, 700]);
        let mut first = tab.window(address, [1000, 700]);
        tab.value("page.rename(2, 'rug')");
        tab.value(save);
        tab.until("page.edits.isSaved");
        tab.swap(&mut first);
        tab.value("page.rename(1, 'mat')");
        tab.value(save);
        tab.until(outdated);
        // A page that is loaded again knows of the other's edits, but does not have them.
        tab.reload();
        assert_eq!(tab.text("page.state.object(1).name"), "mat");
        assert_eq!(tab.value(outdated), true);
        tab.value(
            "page.edits.download = () => { page.downloaded = page.edits.text(); return ''; }",
        );
        tab.value(save);
        let text = tab.text("page.downloaded");
        assert!(text.contains("mat") && !text.contains("rug"), "{text}");
        let saved = std::fs::read_to_string(&edits).unwrap();
        assert!(saved.contains("rug") && !saved.contains("mat"), "{saved}");

        tab.value("document.getElementById('discard').click()");
        let names = "[1, 2].map((id) => page.state.object(id).name)";
        assert_eq!(tab.value(names), json!(["red", "rug"]));
        assert_eq!(tab.value(outdated), false);
        tab.value("page.rename(1, 'cat')");
        tab.value(save);
        tab.until("page.edits.isSaved");
    });
    assert_eq!(Edits::read(&edits).unwrap().operations.len(), 2);
}
