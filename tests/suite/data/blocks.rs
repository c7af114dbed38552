//! Blocks of a scene: the grid, the frames of each block, and what is refused.

use crate::support::assert_names;
use crate::support::hall::{ALONG, ROW, hall};
use crate::support::program::read_json;
use crate::support::{colmap, small_scene};
use coseg::data::blocks::{BLOCK, Block, Grid, PlannedBlock, split};
use coseg::data::{LoadOptions, Split, check, check_output_file, info, load};
use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

fn planned(dir: &Path, counts: [usize; 2]) -> Vec<PlannedBlock> {
    split(dir, &LoadOptions::default(), counts).expect("blocks")
}

/// The hall, and two blocks of it in `blocks`.
fn blocks(screen: bool) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("hall");
    hall(&dir, screen);
    for planned in planned(&dir, [2, 1]) {
        let name = planned.block.name();
        planned
            .block
            .write(&folder.path().join("blocks").join(name))
            .unwrap();
    }
    folder
}

#[test]
fn a_grid_covers_space_once_and_shares_the_cameras_out() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut point =
        |reach: f64| DVec3::from_array([(); 3].map(|()| rng.random_range(-reach..reach)));
    let cameras: Vec<DVec3> = (0..120).map(|_| point(3.0)).collect();
    for up in [DVec3::Z, -DVec3::Y, DVec3::new(0.3, -0.9, 0.2).normalize()] {
        let grid = Grid::new([3, 2], &cameras, up).unwrap();
        for axis in grid.axes {
            assert!(axis.dot(up).abs() < 1e-12 && (axis.length() - 1.0).abs() < 1e-12);
        }
        for index in grid.indices() {
            let count = cameras
                .iter()
                .filter(|camera| grid.cell(**camera) == index)
                .count();
            assert_eq!(count, 20, "{index:?}");
        }
        let borders = grid.axes[0] * grid.columns[1];
        for place in (0..2_000).map(|_| point(9.0)).chain([borders]) {
            let of = grid
                .indices()
                .filter(|index| grid.core(*index).contains(place));
            assert_eq!(of.collect::<Vec<_>>(), [grid.cell(place)], "{place}");
            assert!(grid.extended(grid.cell(place)).contains(place));
        }
    }
}

#[test]
fn the_margin_is_a_fifth_of_the_block_and_outer_sides_have_no_end() {
    let cameras: Vec<DVec3> = (0..40)
        .map(|i| DVec3::new(f64::from(i % 10), f64::from(i / 10), 0.0))
        .collect();
    let grid = Grid::new([2, 1], &cameras, DVec3::Z).unwrap();
    assert_eq!(grid.columns, [4.5]);
    let [left, right] = [grid.extended([0, 0]), grid.extended([1, 0])];
    assert!((left.high.x - 5.4).abs() < 1e-12 && (right.low.x - 3.6).abs() < 1e-12);
    assert_eq!(
        (left.low.x, right.high.x),
        (f64::NEG_INFINITY, f64::INFINITY)
    );
    assert_eq!(
        (left.low.y, left.high.y),
        (f64::NEG_INFINITY, f64::INFINITY)
    );
}

#[test]
fn every_camera_is_in_a_block_and_held_out_ones_stay_so() {
    let folder = tempfile::tempdir().unwrap();
    hall(folder.path(), false);
    let planned = planned(folder.path(), [3, 1]);
    let names = |of: fn(&Block) -> &Vec<String>| -> BTreeSet<String> {
        planned
            .iter()
            .flat_map(|planned| of(&planned.block))
            .cloned()
            .collect()
    };
    let held_out = BTreeSet::from(["v00", "v08", "v16"].map(str::to_owned));
    assert_eq!(names(|block| &block.test), held_out);
    let train = names(|block| &block.train);
    assert!(train.is_disjoint(&held_out));
    assert_eq!(train.len() + held_out.len(), ROW + 1);
    for planned in &planned {
        let cameras = planned.block.train.len();
        assert!((7..=13).contains(&cameras), "{cameras} of 22");
    }
}

#[test]
fn a_photo_belongs_to_the_block_that_it_shows_unless_something_hides_it() {
    let along = |screen: bool| {
        let folder = tempfile::tempdir().unwrap();
        hall(folder.path(), screen);
        let planned = planned(folder.path(), [2, 1]);
        [0, 1].map(|i: usize| planned[i].block.train.iter().any(|name| name == ALONG))
    };
    assert_eq!(along(false), [true, true]);
    assert_eq!(along(true), [false, true]);
}

#[test]
fn training_starts_from_what_the_photos_show_beyond_the_region_and_nothing_hides() {
    let panel = |screen: bool| {
        let folder = blocks(screen);
        let dir = folder.path().join("blocks/1_0");
        let scene = load(&dir, &LoadOptions::default()).unwrap();
        let world = scene.points.positions.iter();
        let world = world.map(|p| DVec3::from(p.map(f64::from)) + scene.origin);
        world.filter(|p| p.x < 1.5 && p.y < 0.0).count()
    };
    assert!(panel(false) > 10);
    assert_eq!(panel(true), 0);
}

#[test]
fn the_folder_of_a_block_is_a_scene() {
    let folder = blocks(false);
    let at = |name: &str| folder.path().join(name);
    let options = LoadOptions::default();
    let whole = load(&at("hall"), &options).unwrap();
    let planned = planned(&at("hall"), [2, 1]);
    for PlannedBlock { block, points } in planned {
        let dir = at("blocks").join(block.name());
        let written = Block::in_folder(&dir).unwrap().unwrap();
        assert_eq!(written.scene, Path::new("../../hall"));
        assert_eq!((&written.grid, &written.train), (&block.grid, &block.train));
        let scene = load(&dir, &options).unwrap();
        let names = |split: Split| {
            scene
                .split(split)
                .map(|view| view.name.clone())
                .collect::<Vec<_>>()
        };
        assert_eq!(
            (names(Split::Train), names(Split::Test)),
            (block.train.clone(), block.test.clone())
        );
        assert!(scene.views.iter().all(|view| view.raw.is_some()));
        assert_eq!(scene.classes, whole.classes);
        // All points of the region, and a few of what else its photos show.
        let inside = |scene: &coseg::data::Scene| {
            let world = scene
                .points
                .positions
                .iter()
                .map(|p| DVec3::from(p.map(f64::from)) + scene.origin);
            world
                .filter(|point| block.region().contains(*point))
                .count()
        };
        assert_eq!(inside(&scene), inside(&whole));
        // Which of equally near points comes first depends on the origin that they are rounded about.
        let found = scene.points.len();
        assert!(found.abs_diff(points) <= points / 10, "{found} of {points}");
        assert!(check(&dir, &options).problems.is_empty());
        assert_eq!(info(&dir, &options).unwrap().train, block.train.len());
        let thinned = LoadOptions {
            stride: 2,
            ..options.clone()
        };
        assert_eq!(
            load(&dir, &thinned).unwrap().split(Split::Train).count(),
            block.train.len().div_ceil(2)
        );
    }
    let left = load(&at("blocks").join("0_0"), &options).unwrap();
    let behind = |p: &[f32; 3]| f64::from(p[0]) + left.origin.x > 8.0;
    assert!(
        left.points.positions.iter().any(behind),
        "its photos show what lies beyond its region"
    );
    assert!(left.views.len() < whole.views.len());
}

#[test]
fn blocks_of_other_layouts_are_read_too() {
    let folder = colmap::scene(colmap::binary, &colmap::pinhole());
    let dir = tempfile::tempdir().unwrap();
    let planned = planned(folder.path(), [1, 1]);
    planned[0].block.write(dir.path()).unwrap();
    let options = LoadOptions::default();
    let [whole, block] = [folder.path(), dir.path()].map(|dir| load(dir, &options).unwrap());
    let cameras = |scene: &coseg::data::Scene| scene.cameras();
    assert_eq!(cameras(&block), cameras(&whole));
    assert_eq!(block.points, whole.points);
    // A block of a part of the cameras has the unit of the whole.
    let mut part = planned[0].block.clone();
    part.train.truncate(2);
    part.test.clear();
    part.write(dir.path()).unwrap();
    let part = load(dir.path(), &options).unwrap();
    assert!(part.views.len() < whole.views.len());
    assert_eq!(part.unit, whole.unit);
}

#[test]
fn requests_that_make_no_sense_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    hall(folder.path(), false);
    let options = LoadOptions::default();
    for (counts, parts) in [
        ([0, 1], ["--blocks", "found 0x1"]),
        ([1, 65], ["--blocks", "1 to 64"]),
        ([usize::MAX, 2], ["--blocks", "1 to 64"]),
        ([6, 1], ["6 blocks of 22 training cameras", "at least 4"]),
    ] {
        assert_names(&split(folder.path(), &options, counts).unwrap_err(), &parts);
    }
    let same = vec![DVec3::ONE; 40];
    let error = Grid::new([2, 1], &same, DVec3::Z).unwrap_err();
    assert_names(&error, &["0 training cameras in column 0", "in one line"]);
    let error = Grid::new([1, 2], &same, DVec3::Z).unwrap_err();
    assert_names(&error, &["0 training cameras in block 0_0", "one place"]);
    // All cameras have one x: columns cannot divide them, rows can.
    let line: Vec<DVec3> = (0..40)
        .map(|i| DVec3::new(1.0, f64::from(i), 0.0))
        .collect();
    let error = Grid::new([2, 2], &line, DVec3::Z).unwrap_err();
    assert_names(&error, &["0 training cameras in column 0", "1x4"]);
    assert_eq!(
        Grid::new([1, 4], &line, DVec3::Z)
            .unwrap()
            .indices()
            .count(),
        4
    );
    let few = small_scene::scene();
    assert_names(
        &split(few.path(), &options, [1, 1]).unwrap_err(),
        &["1 blocks of 2 training cameras"],
    );
    let folder = blocks(false);
    let block = folder.path().join("blocks/0_0");
    assert_names(
        &split(&block, &options, [1, 1]).unwrap_err(),
        &["--data", "a block", "a whole scene"],
    );
}

#[test]
fn a_broken_block_names_its_field() {
    let folder = blocks(false);
    let dir = folder.path().join("blocks/0_0");
    let file = dir.join(BLOCK);
    let good = read_json(&file);
    let options = LoadOptions::default();
    let refuses = |text: String, parts: &[&str]| {
        fs::write(&file, text).unwrap();
        assert_names(&load(&dir, &options).unwrap_err(), parts);
        let problems = check(&dir, &options).problems;
        assert!(!problems.is_empty());
        assert_names(&problems[0], parts);
    };
    let changed = |pointer: &str, value: Value| {
        let mut block = good.clone();
        *block.pointer_mut(pointer).unwrap() = value;
        block.to_string()
    };
    let cases = [
        (
            "/version",
            json!(2),
            vec!["block.json: version: found 2", "expected 1"],
        ),
        (
            "/index",
            json!([2, 0]),
            vec!["index: found 2, 0", "column below 2"],
        ),
        (
            "/grid/counts",
            json!([0, 1]),
            vec!["grid.counts", "1 to 64"],
        ),
        (
            "/grid/axes/0",
            json!([2, 0, 0]),
            vec!["grid.axes", "unit vectors"],
        ),
        (
            "/grid/columns",
            json!([]),
            vec!["grid.columns", "1 ascending numbers"],
        ),
        ("/grid/rows", json!([[]]), vec!["grid.rows", "2 lists of 0"]),
        (
            "/grid/extent/0",
            json!([1, 0]),
            vec!["grid.extent", "lower end first"],
        ),
        (
            "/grid/columns",
            json!([null]),
            vec!["block.json: line", "a block that `coseg split` wrote"],
        ),
        (
            "/scene",
            json!("../../nowhere"),
            vec!["no such folder", "nowhere", "names it"],
        ),
        (
            "/scene",
            json!("."),
            vec!["scene: found ., a block itself", "whole scene"],
        ),
        ("/scene", json!("../1_0"), vec!["a block itself"]),
        ("/train/0", json!("v99"), vec!["v99", "the scene again"]),
    ];
    for (pointer, value, parts) in cases {
        refuses(changed(pointer, value), &parts);
    }
    refuses(
        good.to_string()
            .replacen("\"columns\":[", "\"columns\":[NaN,", 1),
        &["block.json: line"],
    );
    refuses(
        changed("/grid/columns", json!([1e300]))
            .replace("1e300", "1e999")
            .replace("1e+300", "1e999"),
        &["block.json: line"],
    );
    refuses("{}".to_owned(), &["version", "a block that"]);
    refuses(String::new(), &["block.json: line"]);
    fs::write(&file, good.to_string()).unwrap();
    load(&dir, &options).unwrap();
}

#[test]
fn files_of_the_whole_scene_are_none_to_write_over() {
    let folder = blocks(false);
    let block = folder.path().join("blocks/0_0");
    let options = LoadOptions::default();
    let table = folder.path().join("hall/classes.json");
    let error = check_output_file("--out", &table, (&block, &options)).unwrap_err();
    assert_names(&error, &["--out", "classes.json", "a file of the scene"]);
}
