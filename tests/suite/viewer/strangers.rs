//! What the server of a scene takes and refuses, of programs and of other pages.

use crate::support::browser::browser;
use crate::support::client::Client;
use crate::support::devtools::Tab;
use crate::support::program::text as text_of;
use crate::support::served_plates::Plates;
use coseg::Error;
use coseg::objects::Edits;
use coseg::viewer::Served;
use serde_json::{Value, json};
use std::net::Ipv4Addr;

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

#[test]
fn a_page_of_another_origin_reads_and_writes_nothing() {
    let Some(browser) = browser() else { return };
    let (mine, others) = (Plates::new(), Plates::new());
    let dir = tempfile::tempdir().unwrap();
    let edits = dir.path().join("edits.json");
    let of_others = dir.path().join("others.json");
    // The page of one server knows the token of the other. Its own policy would stop it too, so it is lifted.
    mine.served(&edits, |address| {
        others.served(&of_others, |own| {
            let mut tab = Tab::visit(&browser, own, [600, 400]);
            tab.send("Page.setBypassCSP", json!({"enabled": true}));
            tab.reload();
            let ask = |tab: &mut Tab, address: &str| {
                let asked = json!([address, mine.edits()]);
                tab.value(&format!("({ASK})(...{asked})"))
            };
            let refused = "error";
            let unread = "opaque 0 ";
            let want = [
                refused, refused, refused, refused, unread, unread, unread, unread,
            ];
            assert_eq!(ask(&mut tab, address), json!(want));
            assert!(!edits.exists());
            let own_answers = ask(&mut tab, own);
            let read = |i: usize| own_answers[i].as_str().unwrap().to_owned();
            assert!(read(0).starts_with("basic 200 <!"), "its own are read");
            assert_eq!(read(3), "basic 200 1", "and written");
            assert!(of_others.exists());
        });
    });
}

/// Asks the server at `address` for all that it has, and posts `edits`: what came of it.
const ASK: &str = "async (address, edits) => { const said = []; \
    for (const mode of ['cors', 'no-cors']) \
    for (const [what, method, body] of [['', 'GET'], ['places', 'GET'], ['edits', 'GET'], ['edits/0', 'POST', edits]]) \
    said.push(await fetch(address + what, { mode, method, body }) \
    .then(async (r) => `${r.type} ${r.status} ${(await r.text()).slice(0, 9)}`, () => 'error')); \
    return said; }";
