//! A page that a server fills, and the file in which it saves edits.

use crate::support::browser::browser;
use crate::support::client::Client;
use crate::support::devtools::Tab;
use crate::support::mended_plates::spot;
use crate::support::plates::{camera, plates};
use crate::support::program::text as text_of;
use crate::viewer::page::viewer;
use coseg::Error;
use coseg::data::{Classes, NamedCamera, Split};
use coseg::objects::{Edits, Operation};
use coseg::splat::Gaussians;
use coseg::viewer::{Served, Viewer};
use glam::DVec3;
use serde_json::{Value, json};
use std::net::Ipv4Addr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

/// What the page of the plates has.
struct Plates {
    gaussians: Gaussians,
    labels: Vec<u16>,
    classes: Classes,
    cameras: [NamedCamera; 1],
}

impl Plates {
    fn new() -> Self {
        let (gaussians, labels) = plates();
        let names = [(1, "red"), (2, "green"), (3, "blue"), (4, "wall")];
        Self {
            gaussians,
            labels,
            classes: Classes::from_names(0, names),
            cameras: [NamedCamera {
                name: "v2".into(),
                split: Split::Test,
                camera: camera(2),
            }],
        }
    }

    fn viewer(&self) -> Viewer<'_> {
        Viewer {
            cameras: &self.cameras,
            origin: DVec3::ZERO,
            ..viewer(&self.gaussians, Some(&self.labels), &self.classes)
        }
    }

    /// Edits of them, as the page writes them.
    fn edits(&self) -> String {
        let rug = json!({"name": "rug", "color": [180, 60, 40]});
        json!({"version": 1, "scene": self.viewer().sha256, "operations": [
            {"op": "assign", "gaussians": [17, 18], "object": 5, "new": rug},
            {"op": "rename", "object": 1, "name": "mat"},
            {"op": "delete_gaussians", "gaussians": [3]},
        ]})
        .to_string()
    }

    /// Serves the plates in blocks of 20 while `act` uses the address.
    fn served<T>(&self, edits: &Path, act: impl FnOnce(&str) -> T) -> T {
        let served = Served {
            viewer: self.viewer(),
            edits: edits.to_owned(),
            block: 20,
            listen: Ipv4Addr::LOCALHOST.into(),
        };
        let is_over = AtomicBool::new(false);
        let (sender, address) = mpsc::channel();
        std::thread::scope(|scope| {
            let started = move |address: &str| sender.send(address.to_owned()).unwrap();
            let is_over = &is_over;
            scope.spawn(move || {
                served
                    .run(started, || is_over.load(Ordering::Relaxed))
                    .unwrap()
            });
            let _end = End(is_over);
            act(&address.recv().unwrap())
        })
    }
}

/// Ends a server, after a failure too.
struct End<'a>(&'a AtomicBool);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

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
    let (want, drawn) = (tab.value(DIGEST), tab.text(picture));
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

#[test]
fn only_edits_of_the_scene_are_saved() {
    let plates = Plates::new();
    let dir = tempfile::tempdir().unwrap();
    let edits = dir.path().join("edits.json");
    let text = |scene: &str| format!(r#"{{"version": 1, "scene": "{scene}", "operations": []}}"#);
    plates.served(&edits, |address| {
        let client = Client::at(address);
        let own = text(plates.viewer().sha256);
        let origin = "Origin: http://evil.example\r\n";
        assert_eq!(client.post("edits/0", &own, origin).0, 403);
        for wrong in [
            "",
            "{",
            "[]",
            &text("0000"),
            &own.replace("[]", r#"[{"op": "explode"}]"#),
        ] {
            let (status, said) = client.post("edits/0", wrong, "");
            assert_eq!(status, 400, "{wrong}");
            assert!(
                String::from_utf8(said).unwrap().contains("edits.json"),
                "{wrong}"
            );
        }
        assert!(!edits.exists());
        assert_eq!(client.post("edits/0", &own, ""), (200, b"1".to_vec()));
        assert_eq!(std::fs::read_to_string(&edits).unwrap(), own);
        // A page that has not seen this does not write, nor does any over what another program wrote.
        let (status, said) = client.post("edits/0", &own, "");
        assert!(status == 400 && text_of(&said).contains("another window"));
        std::fs::write(&edits, "somebody else's").unwrap();
        let (status, said) = client.post("edits/1", &own, "");
        assert!(status == 400 && text_of(&said).contains("another program"));
        assert_eq!(std::fs::read_to_string(&edits).unwrap(), "somebody else's");
        std::fs::remove_file(&edits).unwrap();
        assert_eq!(client.post("edits/1", &own, "").0, 200, "it is gone");
    });

    let unknown = r#"[{"op": "rename", "object": 999, "name": "rug"}]"#;
    let own = text(plates.viewer().sha256);
    for (wrong, why) in [
        (text("0000"), "edits of another scene"),
        (own.replace("[]", unknown), "operations[0].object"),
    ] {
        std::fs::write(&edits, wrong).unwrap();
        let served = Served {
            viewer: plates.viewer(),
            edits: edits.clone(),
            block: 20,
            listen: Ipv4Addr::LOCALHOST.into(),
        };
        let refused = served
            .run(|_| panic!("it has started"), || true)
            .unwrap_err();
        assert!(matches!(refused, Error::Input { .. }));
        assert!(refused.to_string().contains(why), "{refused}");
    }
}

#[test]
fn bodies_that_are_no_edits_are_refused() {
    let plates = Plates::new();
    let dir = tempfile::tempdir().unwrap();
    let edits = dir.path().join("edits.json");
    plates.served(&edits, |address| {
        let client = Client::at(address);
        let status = |more: &str, body: &[u8]| {
            client
                .request(&client.message("POST", "edits/0", more, body))
                .0
        };
        assert_eq!(status("Content-Length: 3\r\n", b"{\xff}"), 400, "no UTF-8");
        let chunks = b"3\r\n{\xff}\r\n0\r\n\r\n";
        assert_eq!(status("Transfer-Encoding: chunked\r\n", chunks), 400);
        assert_eq!(status("Content-Length: 268435457\r\n", b""), 413);
        let own = plates.edits();
        assert_eq!(client.post("edits/-1", &own, "").0, 400);
        let longer = format!("Content-Length: {}\r\n", own.len() + 1);
        client.exchange(&client.message("POST", "edits/0", &longer, own.as_bytes()));
        // Without the token.
        let stranger = Client {
            host: client.host.clone(),
            root: format!("/{}/", "0".repeat(32)),
        };
        assert_eq!(stranger.post("edits/0", &own, "").0, 404);
        assert!(!edits.exists());
        assert_eq!(client.post("edits/0", &own, "").0, 200);
    });
}

#[test]
fn broken_requests_neither_end_the_server_nor_spoil_the_edits() {
    let plates = Plates::new();
    let dir = tempfile::tempdir().unwrap();
    let edits = dir.path().join("edits.json");
    let own = plates.edits();
    plates.served(&edits, |address| {
        let client = Client::at(address);
        let length = format!("Content-Length: {}\r\n", own.len());
        let chunks = own.as_bytes().chunks(40);
        let chunks = chunks.map(|chunk| format!("{:x}\r\n{}\r\n", chunk.len(), text_of(chunk)));
        let chunks = chunks.collect::<String>() + "0\r\n\r\n";
        let chunked = "Transfer-Encoding: chunked\r\n";
        let mut requests = vec![
            client.message("POST", "edits/0", &length, own.as_bytes()),
            client.message("POST", "edits/1", &length, own.as_bytes()),
            client.message("POST", "edits/0", chunked, chunks.as_bytes()),
        ];
        for what in ["", "places", "looks/0", "tree", "edits"] {
            requests.push(client.message("GET", what, "", b""));
        }
        client.attack(&requests, 1_400);
        // Some mutants are edits too.
        if edits.exists() {
            let saved = Edits::read(&edits).unwrap();
            assert_eq!(saved.scene, plates.viewer().sha256);
        }
        let told: Value = serde_json::from_slice(&client.get("edits").1).unwrap();
        let next = format!("edits/{}", told["saves"]);
        assert_eq!(client.post(&next, &own, "").0, 200);
    });
    assert_eq!(std::fs::read_to_string(&edits).unwrap(), own);
}

#[test]
fn strangers_see_nothing() {
    let plates = Plates::new();
    let dir = tempfile::tempdir().unwrap();
    plates.served(&dir.path().join("edits.json"), |address| {
        let client = Client::at(address);
        for what in ["", "places", "looks/0", "looks/5", "tree", "edits"] {
            assert_eq!(client.get(what).0, 200, "{what}");
            let (status, _, body) = client.ask("GET", &format!("/{what}"), &client.host, "");
            assert_eq!((status, body.len()), (404, 0), "without the token");
            let path = format!("{}{what}", client.root);
            let (status, _, body) = client.ask("GET", &path, "evil.example", "");
            assert_eq!((status, body.len()), (403, 0), "another host");
            let origin = "Origin: http://evil.example\r\n";
            let (status, _, body) = client.ask("GET", &path, &client.host, origin);
            assert_eq!((status, body.len()), (403, 0), "another origin");
        }
        assert_eq!(client.get("looks/6").0, 404);
        assert_eq!(client.get("looks/-1").0, 400);
    });
}
