//! What the server of a run answers, and whom.

use crate::support::client::Client;
use crate::support::plates::loaded;
use coseg::progress::{CurvePoint, Event, Progress, Silent};
use coseg::splat::Gaussians;
use coseg::watch::Watched;
use serde_json::Value;
use std::net::{Ipv4Addr, TcpStream};

fn figures(client: &Client) -> Value {
    let (status, body) = client.get("status");
    assert_eq!(status, 200);
    serde_json::from_slice(&body).unwrap()
}

fn watch() -> (Watched<Silent>, Client) {
    let watch = Watched::start(Ipv4Addr::LOCALHOST.into(), "plates", 0.999, Silent).unwrap();
    let client = Client::at(watch.address());
    (watch, client)
}

#[test]
fn a_run_is_served_on_the_address_that_is_asked_for_alone() {
    let error = Watched::start(Ipv4Addr::UNSPECIFIED.into(), "plates", 0.999, Silent);
    let message = error.err().expect("refused").to_string();
    assert!(message.contains("all interfaces"), "{message}");
    if cfg!(target_os = "linux") {
        let other = Ipv4Addr::new(127, 0, 0, 2);
        let watch = Watched::start(other.into(), "plates", 0.999, Silent).unwrap();
        assert!(watch.address().starts_with("http://127.0.0.2:"));
        figures(&Client::at(watch.address()));
        let port = watch.address().split([':', '/']).nth(4).unwrap();
        let port = port.parse().unwrap();
        assert!(TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_err());
    }
}

#[test]
fn figures_follow_the_run() {
    let (mut watch, client) = watch();
    assert_eq!(figures(&client)["stage"], "");
    watch.event(&Event::Started {
        stage: "building",
        done: 0,
        iterations: 200,
    });
    watch.event(&Event::Step {
        iteration: 7,
        loss: f64::NAN,
        gaussians: 36,
    });
    let status = figures(&client);
    assert_eq!(status["title"], "plates");
    assert_eq!([&status["done"], &status["iterations"]], [7, 200]);
    assert_eq!(status["loss"], Value::Null, "no JSON for a NaN");
    watch.event(&Event::Evaluated(CurvePoint {
        iteration: 7,
        gaussians: 36,
        miou: Some(0.5),
        ..CurvePoint::default()
    }));
    let curve = &figures(&client)["curves"][0];
    assert_eq!(curve["stage"], "building");
    assert_eq!(curve["points"][0]["miou"], 0.5);
}

#[test]
fn gaussians_are_copied_for_a_browser_that_is_there() {
    let (mut watch, client) = watch();
    let (scene, gaussians, labels, _folder) = loaded();
    watch.scene(&scene);
    assert!(!watch.wants_gaussians(), "nobody has asked yet");
    assert_eq!(client.get("scene.html").0, 404, "nothing to see yet");
    assert_eq!(figures(&client)["copy"], 0);
    assert!(watch.wants_gaussians());
    watch.gaussians(&gaussians, None);
    assert!(!watch.wants_gaussians(), "the run rests from the last copy");
    assert_eq!(figures(&client)["copy"], 1);
    let (status, page) = client.get("scene.html");
    let page = String::from_utf8(page).unwrap();
    assert_eq!(status, 200);
    assert!(page.contains("\"gaussians\":111"), "all of them");
    watch.gaussians(&gaussians, Some(&labels));
    assert_eq!(figures(&client)["labelled"], true);
}

#[test]
fn a_page_with_too_many_gaussians_shows_some_of_them() {
    let (mut watch, client) = watch();
    let n = 1_200_001;
    let large = Gaussians {
        means: vec![[0.0; 3]; n],
        log_scales: vec![[0.0; 3]; n],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: vec![0.0; n],
        sh: vec![0.0; 48 * n],
        sh_degree: 3,
    };
    let labels: Vec<u16> = (0..n).map(|i| (i % 2) as u16).collect();
    watch.gaussians(&large, Some(&labels));
    let told = figures(&client);
    assert_eq!((&told["copy"], &told["every"]), (&1.into(), &2.into()));
    let (status, page) = client.get("scene.html");
    assert_eq!(status, 200);
    assert!(page.len() < 70_000_000, "{}", page.len());
    let page = String::from_utf8(page).unwrap();
    // The labels go along: each second one is 0.
    assert!(page.contains("\"gaussians\":600001,"), "each second one");
    assert_eq!(
        page.matches("\"gaussians\":600001,").count(),
        2,
        "scene and object"
    );
    let (_, gaussians, ..) = loaded();
    watch.gaussians(&gaussians, None);
    let told = figures(&client);
    assert_eq!((&told["copy"], &told["every"]), (&2.into(), &1.into()));
}

#[test]
fn photos_are_those_of_the_views() {
    let (mut watch, client) = watch();
    let (scene, ..) = loaded();
    watch.scene(&scene);
    for (index, view) in scene.views.iter().enumerate() {
        let (status, png) = client.get(&format!("photo/{index}"));
        assert_eq!(status, 200);
        let found = image::load_from_memory(&png).unwrap().to_rgb8();
        assert_eq!(found, *view.image.pixels().unwrap());
    }
    assert_eq!(client.get("photo/6").0, 404);
    assert_eq!(client.get("photo/-1").0, 400);
}

#[test]
fn a_browser_can_stop_the_run() {
    let (mut watch, client) = watch();
    let stop = format!("{}stop", client.root);
    let (status, ..) = client.ask("GET", &stop, &client.host, "");
    assert_eq!(status, 405, "looking at an address changes nothing");
    assert!(!watch.stop());
    let (status, ..) = client.ask("POST", &stop, &client.host, "Content-Length: 0\r\n");
    assert_eq!(status, 204);
    assert!(watch.stop());
    assert_eq!(figures(&client)["stopping"], true);
}

#[test]
fn strangers_learn_and_change_nothing() {
    let (mut watch, client) = watch();
    let wrong = "/00000000000000000000000000000000/";
    for what in ["", "status", "scene.html", "photo/0"] {
        let (status, _, body) = client.ask("GET", &format!("{wrong}{what}"), &client.host, "");
        assert_eq!((status, body.len()), (404, 0), "without the token");
        let (status, _, body) = client.ask("GET", &format!("/{what}"), &client.host, "");
        assert_eq!((status, body.len()), (404, 0), "without a token");
        let path = format!("{}{what}", client.root);
        // A name that leads to this machine, and a page of another server on it.
        let port = client.host.rsplit(':').next().unwrap();
        let (status, _, body) = client.ask("GET", &path, &format!("evil.example:{port}"), "");
        assert_eq!((status, body.len()), (403, 0), "another host");
        for origin in ["http://evil.example", "http://127.0.0.1:1", "null"] {
            let origin = format!("Origin: {origin}\r\n");
            let (status, _, body) = client.ask("GET", &path, &client.host, &origin);
            assert_eq!((status, body.len()), (403, 0), "{origin}");
        }
    }
    let origin = "Origin: http://evil.example\r\nContent-Length: 0\r\n";
    let stop = format!("{}stop", client.root);
    assert_eq!(client.ask("POST", &stop, &client.host, origin).0, 403);
    let stop = format!("{wrong}stop");
    let length = "Content-Length: 0\r\n";
    assert_eq!(client.ask("POST", &stop, &client.host, length).0, 404);
    assert!(!watch.stop());
    assert!(!watch.wants_gaussians(), "none of them counts as a visit");
}

#[test]
fn two_runs_have_different_tokens() {
    let ((_one, a), (_two, b)) = (watch(), watch());
    assert_ne!(a.root, b.root);
    let (status, ..) = a.ask("GET", &b.root, &a.host, "");
    assert_eq!(status, 404);
}

#[test]
fn broken_requests_do_not_end_the_server() {
    let (mut watch, client) = watch();
    let (scene, gaussians, ..) = loaded();
    watch.scene(&scene);
    watch.gaussians(&gaussians, None);
    let stop = client.message("POST", "stop", "Content-Length: 3\r\n", b"abc");
    let mut requests = vec![stop];
    for what in ["", "status", "scene.html", "photo/0"] {
        requests.push(client.message("GET", what, "", b""));
    }
    client.attack(&requests, 600);
    client.exchange(&vec![b'a'; 1 << 20]);
    assert_eq!(figures(&client)["title"], "plates");
}

#[test]
fn the_port_is_closed_with_the_run() {
    let (watch, client) = watch();
    drop(watch);
    assert!(TcpStream::connect(&client.host).is_err());
}
