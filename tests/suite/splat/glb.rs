//! Labels that are added to binary glTF.

use crate::support::glb::{Glb, glb, parsed, slice};
use crate::support::plates::plates;
use coseg::splat::formats::glb::with_labels;
use glam::DVec3;
use serde_json::{Map, json};
use std::path::Path;

/// The plates in another place.
const ORIGIN: DVec3 = DVec3::new(0.25, -7.0, 3.0);

fn names() -> Map<String, serde_json::Value> {
    [
        ("1".to_owned(), json!("red")),
        ("4".to_owned(), json!("wall")),
    ]
    .into_iter()
    .collect()
}

#[test]
fn labels_become_an_attribute_of_the_vertices() {
    let (gaussians, labels) = plates();
    let given = glb(&gaussians, ORIGIN);
    let made = with_labels(
        Path::new("a.glb"),
        &given,
        (&gaussians, ORIGIN),
        &labels,
        names(),
    );
    let made = made.expect("labelled");
    let (before, after) = (parsed(&given), parsed(&made));
    assert_eq!(after.labels(), labels);
    assert_eq!(
        after.json["meshes"][0]["extras"],
        json!({ "labels": { "1": "red", "4": "wall" } })
    );
    assert_eq!(after.json["buffers"][0]["byteLength"], after.binary.len());
    // All that was there is as it was.
    assert!(after.binary.starts_with(&before.binary));
    let old = |glb: &Glb| {
        let mut json = glb.json.clone();
        for (key, count) in [("bufferViews", 2), ("accessors", 2)] {
            json[key].as_array_mut().expect("a list").truncate(count);
        }
        let mesh = json["meshes"][0].as_object_mut().expect("a mesh");
        mesh.remove("extras");
        let attributes = &mut mesh["primitives"][0]["attributes"];
        attributes
            .as_object_mut()
            .expect("attributes")
            .remove("_LABEL");
        json["buffers"][0]["byteLength"] = json!(0);
        json
    };
    assert_eq!(old(&after), old(&before));
}

#[test]
fn a_file_without_names_has_no_extras() {
    let (gaussians, labels) = plates();
    let given = glb(&gaussians, DVec3::ZERO);
    let scene = (&gaussians, DVec3::ZERO);
    let made =
        with_labels(Path::new("a.glb"), &given, scene, &labels, Map::new()).expect("labelled");
    assert!(parsed(&made).json["meshes"][0].get("extras").is_none());
}

#[test]
fn vertices_in_another_order_get_no_labels() {
    let (gaussians, labels) = plates();
    let rows = gaussians.len() as u32;
    let reversed: Vec<u32> = (0..rows).rev().collect();
    let fewer: Vec<u32> = (0..rows - 1).collect();
    for rows in [reversed, fewer] {
        let given = glb(&gaussians.select(&rows), ORIGIN);
        let scene = (&gaussians, ORIGIN);
        let error = with_labels(Path::new("a.glb"), &given, scene, &labels, names());
        let message = error.expect_err("another order").to_string();
        assert!(
            message.contains("a.glb: POSITION: found") && message.contains("another order"),
            "{message}"
        );
    }
}

#[test]
fn far_from_zero_neighbours_that_change_places_are_noticed() {
    let (gaussians, labels) = plates();
    // Float has steps of 0.004 there, and the plates have a Gaussian every 0.15.
    let far = DVec3::splat(50_000.0);
    let mut rows: Vec<u32> = (0..gaussians.len() as u32).collect();
    let label = |rows: &[u32], origin| {
        let given = glb(&gaussians.select(rows), origin);
        let scene = (&gaussians, origin);
        with_labels(Path::new("a.glb"), &given, scene, &labels, names())
    };
    assert_eq!(
        parsed(&label(&rows, far).expect("labelled")).labels(),
        labels
    );
    rows.swap(0, 1);
    let message = label(&rows, far).expect_err("another order").to_string();
    assert!(message.contains("another order"), "{message}");
}

#[test]
fn where_float_hides_the_order_there_are_no_labels() {
    let (gaussians, labels) = plates();
    // Float has steps of half a unit there.
    let origin = DVec3::new(500_000.0, 5_000_000.0, 100.0);
    let given = glb(&gaussians, origin);
    let scene = (&gaussians, origin);
    let error = with_labels(Path::new("a.glb"), &given, scene, &labels, names());
    let message = error.expect_err("too far").to_string();
    assert!(
        message.contains("a.glb: POSITION: found Gaussians") && message.contains("far from zero"),
        "{message}"
    );
    // One alone has no order.
    let one = gaussians.select(&[3]);
    let scene = (&one, origin);
    let made = with_labels(Path::new("a.glb"), &glb(&one, origin), scene, &[7], names());
    assert_eq!(parsed(&made.expect("labelled")).labels(), [7]);
}

#[test]
fn damaged_files_are_errors() {
    let (gaussians, labels) = plates();
    let given = glb(&gaussians, ORIGIN);
    let refused = |bytes: &[u8]| {
        let scene = (&gaussians, ORIGIN);
        let error = with_labels(Path::new("a.glb"), bytes, scene, &labels, names());
        let message = error.expect_err("damaged").to_string();
        assert!(message.contains("a.glb: content: found"), "{message}");
    };
    for cut in (0..given.len()).step_by(7) {
        refused(&given[..cut]);
    }
    let text = slice(&given, 12);
    for (old, new) in [
        (&b"\"VEC3\""[..], &b"\"VEC2\""[..]),
        (b"5126", b"5123"),
        (b"\"meshes\"", b"\"mashes\""),
        (b"\"count\":111", b"\"count\":999"),
        (b"\"buffers\"", b"\"buffets\""),
    ] {
        let at = text.windows(old.len()).position(|part| part == old);
        let at = 20 + at.unwrap_or_else(|| panic!("{}", old.escape_ascii()));
        let mut bytes = given.clone();
        bytes[at..at + old.len()].copy_from_slice(new);
        refused(&bytes);
    }
}
