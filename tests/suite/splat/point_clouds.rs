//! Point clouds of Gaussians, read back by readers other than the writers.

use crate::support::rounding::gaussians;
use coseg::splat::Gaussians;
use coseg::splat::formats::{self, Format};
use glam::DVec3;
use las::Reader;
use las::point::Classification;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use std::fs;
use std::path::Path;

/// Far from zero, as map coordinates are.
const ORIGIN: DVec3 = DVec3::new(600_000.25, 5_400_000.5, -3.0);

/// A scene, and labels up to one that LAS has no class for.
fn scene() -> (Gaussians, Vec<u16>) {
    let scene = gaussians(500, 2);
    let labels = (0..500).map(|i| [0, 1, 12, 191, 192, 65_535][i % 6]);
    (scene, labels.collect())
}

fn las_points(path: &Path) -> Vec<las::Point> {
    let mut reader = Reader::from_path(path).expect("LAS");
    let points = reader.read_all().expect("points");
    points.points().map(|point| point.expect("point")).collect()
}

#[test]
fn las_and_laz_hold_places_colours_opacities_and_labels() {
    let dir = tempfile::tempdir().expect("folder");
    let (scene, labels) = scene();
    let paths = [(Format::Las, "a.las"), (Format::Laz, "a.laz")].map(|(format, name)| {
        let path = dir.path().join(name);
        formats::write(&path, format, &scene, ORIGIN, Some(&labels)).expect("written");
        path
    });
    let points = las_points(&paths[0]);
    assert_eq!(points, las_points(&paths[1]));
    assert!(fs::metadata(&paths[1]).unwrap().len() < fs::metadata(&paths[0]).unwrap().len());
    assert_eq!(points.len(), 500);
    let colors = scene.base_colors();
    for (i, point) in points.iter().enumerate() {
        let place = glam::Vec3::from(scene.means[i]).as_dvec3() + ORIGIN;
        let found = DVec3::new(point.x, point.y, point.z);
        assert!(
            (found - place).abs().max_element() < 1e-7,
            "{found} for {place}"
        );
        let color = point.color.expect("colour");
        let found = [color.red, color.green, color.blue].map(|c| f32::from(c) / 65_535.0);
        for (found, expected) in found.iter().zip(colors[i]) {
            assert!((found - expected).abs() < 1e-5);
        }
        let opacity = 1.0 / (1.0 + (-scene.opacity_logits[i]).exp());
        assert!((f32::from(point.intensity) / 65_535.0 - opacity).abs() < 1e-5);
        assert_eq!(point.point_source_id, labels[i]);
        let class = match labels[i] {
            label @ 0..=191 => Classification::UserDefinable(label as u8 + 64),
            _ => Classification::Unclassified,
        };
        assert_eq!(point.classification, class);
    }
}

#[test]
fn equal_scenes_give_equal_files() {
    let dir = tempfile::tempdir().expect("folder");
    let (scene, _) = scene();
    for format in [Format::Las, Format::Laz, Format::PointsPly] {
        let [a, b] = ["a", "b"].map(|name| {
            let path = dir.path().join(name);
            formats::write(&path, format, &scene, ORIGIN, None).expect("written");
            fs::read(path).unwrap()
        });
        assert!(a == b, "{format:?}");
    }
}

#[test]
fn one_place_and_no_gaussian_are_written_too() {
    let dir = tempfile::tempdir().expect("folder");
    let (scene, _) = scene();
    for rows in [&[0][..], &[7, 7], &[]] {
        let path = dir.path().join(format!("{}.laz", rows.len()));
        let some = scene.select(rows);
        formats::write(&path, Format::Laz, &some, ORIGIN, None).expect("written");
        let points = las_points(&path);
        assert_eq!(points.len(), rows.len());
        let is_bare = |p: &las::Point| {
            p.classification == Classification::Unclassified && p.point_source_id == 0
        };
        assert!(points.iter().all(is_bare));
    }
}

#[test]
fn points_of_a_ply_have_bytes_as_colours() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("a.points.ply");
    let (scene, labels) = scene();
    formats::write(&path, Format::PointsPly, &scene, ORIGIN, Some(&labels)).expect("written");
    let mut file = std::io::BufReader::new(fs::File::open(&path).unwrap());
    let ply = Parser::<DefaultElement>::new()
        .read_ply(&mut file)
        .expect("PLY");
    let rows = &ply.payload["vertex"];
    assert_eq!(rows.len(), 500);
    let colors = scene.base_colors();
    for (i, row) in rows.iter().enumerate() {
        let place = glam::Vec3::from(scene.means[i]).as_dvec3() + ORIGIN;
        for (name, value) in ["x", "y", "z"].into_iter().zip(place.to_array()) {
            assert_eq!(row[name], Property::Double(value));
        }
        for (name, value) in ["red", "green", "blue"].into_iter().zip(colors[i]) {
            assert_eq!(
                row[name],
                Property::UChar((f64::from(value * 255.0)).round() as u8)
            );
        }
        assert_eq!(row["label"], Property::UShort(labels[i]));
        let opacity = 1.0 / (1.0 + (-f64::from(scene.opacity_logits[i])).exp());
        assert_eq!(row["opacity"], Property::Float(opacity as f32));
    }
}
