//! The runs of blocks as one scene.

use crate::support::assert_names;
use crate::support::hall::{ROW, hall};
use coseg::config::{Association, Config};
use coseg::data::blocks::{Block, split};
use coseg::data::formats::transforms::write_cameras;
use coseg::data::{Class, Classes, LoadOptions, ObjectOf, load};
use coseg::objects::Identities;
use coseg::runs::merge;
use coseg::splat::{Gaussians, ply};
use glam::DVec3;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Gaussians along the hall, with a spread, and a class for each.
fn scene() -> (Gaussians, Vec<u16>) {
    let count = 400;
    let means = (0..count).map(|i| {
        [
            0.03 * i as f32 - 0.3,
            0.5 * (i % 7) as f32,
            0.25 * (i % 5) as f32,
        ]
    });
    let gaussians = Gaussians {
        means: means.collect(),
        log_scales: (0..count).map(|i| [-3.0 - 0.001 * i as f32; 3]).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
        opacity_logits: (0..count).map(|i| 0.01 * i as f32).collect(),
        sh: (0..3 * count).map(|i| 0.001 * i as f32).collect(),
        sh_degree: 0,
    };
    (
        gaussians,
        (0..count).map(|i| 1 + (i / 50 % 2) as u16).collect(),
    )
}

/// The hall split in two by three in `blocks`, and a run on each block, which has the Gaussians of its region.
struct Runs {
    folder: TempDir,
    runs: Vec<PathBuf>,
}

/// What the runs have: labels of a Gaussian in a block, and the class table there.
type Labels<'a> = (
    &'a dyn Fn(usize, usize) -> u16,
    &'a dyn Fn(usize) -> Classes,
    Association,
);

impl Runs {
    fn new((label, table, association): Labels<'_>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("hall");
        hall(&dir, false);
        let mut runs = Vec::new();
        let (gaussians, _) = scene();
        for (number, planned) in split(&dir, &LoadOptions::default(), [3, 1])
            .unwrap()
            .into_iter()
            .enumerate()
        {
            let block = planned.block;
            let data = folder.path().join("blocks").join(block.name());
            block.write(&data).unwrap();
            let run = folder.path().join("runs").join(block.name());
            let inside = |row: &u32| {
                block
                    .region()
                    .contains(DVec3::from(gaussians.means[*row as usize].map(f64::from)))
            };
            let rows: Vec<u32> = (0..gaussians.len() as u32).filter(inside).collect();
            let labels: Vec<u16> = rows
                .iter()
                .map(|&row| label(number, row as usize))
                .collect();
            write_run(
                &run,
                &data,
                &gaussians.select(&rows),
                (&labels, &table(number), association),
            );
            runs.push(run);
        }
        Self { folder, runs }
    }

    fn semantic() -> Self {
        let (_, labels) = scene();
        let table = |_| Classes::from_names(0, [(1, "wall"), (2, "door")]);
        Self::new((&|_, row| labels[row], &table, Association::None))
    }
}

fn write_run(
    run: &Path,
    data: &Path,
    gaussians: &Gaussians,
    (labels, classes, association): (&[u16], &Classes, Association),
) {
    fs::create_dir_all(run).unwrap();
    // As a run that is started does.
    if data.join("block.json").exists() {
        fs::copy(data.join("block.json"), run.join("block.json")).unwrap();
    }
    let mut config = Config::default();
    config.data.dir = Some(data.to_owned());
    config.data.association = association;
    fs::write(run.join("config.toml"), config.to_toml().unwrap()).unwrap();
    ply::write(&run.join("scene.ply"), gaussians, DVec3::ZERO, Some(labels)).unwrap();
    classes.write(&run.join("classes.json")).unwrap();
    let cameras = load(data, &LoadOptions::default()).unwrap().cameras();
    write_cameras(&run.join("cameras.json"), &cameras).unwrap();
    let one_hot = |id: &u16| {
        classes
            .entries
            .iter()
            .map(|class| f32::from(class.id == *id))
            .collect::<Vec<_>>()
    };
    let scores = labels.iter().flat_map(one_hot).collect();
    let identities = Identities {
        scores,
        classes: classes.len(),
    };
    identities
        .write(&run.join("identities.safetensors"))
        .unwrap();
}

/// Rows in an order that the values alone decide.
fn sorted(gaussians: &Gaussians, labels: &[u16]) -> (Gaussians, Vec<u16>) {
    let mut rows: Vec<u32> = (0..gaussians.len() as u32).collect();
    rows.sort_by(|a, b| {
        gaussians.opacity_logits[*a as usize].total_cmp(&gaussians.opacity_logits[*b as usize])
    });
    let labels = rows.iter().map(|&row| labels[row as usize]).collect();
    (gaussians.select(&rows), labels)
}

#[test]
fn blocks_of_one_scene_give_the_scene_again() {
    let Runs { folder, mut runs } = Runs::semantic();
    runs.reverse();
    let merged = merge(&runs).unwrap();
    let (gaussians, labels) = scene();
    let (found, found_labels) = sorted(&merged.gaussians, merged.labels.as_ref().unwrap());
    assert_eq!(found, gaussians);
    assert_eq!(found_labels, labels);
    let kept: usize = merged.blocks.iter().map(|(_, [kept, _])| kept).sum();
    let all: usize = merged.blocks.iter().map(|(_, [_, all])| all).sum();
    assert!(
        kept == gaussians.len() && all > kept,
        "{all}: the margins are left out"
    );
    assert_eq!(
        merged.identities.as_ref().unwrap().ids(&merged.classes),
        *merged.labels.as_ref().unwrap()
    );
    assert_eq!((merged.cameras.len(), merged.joined), (ROW + 1, None));
    let dir = merged.config.data.dir.as_ref().unwrap();
    assert_eq!(dir, &folder.path().join("hall").canonicalize().unwrap());
}

#[test]
fn runs_with_other_origins_come_to_one_place() {
    let Runs {
        runs,
        folder: _folder,
    } = Runs::semantic();
    let file = runs[1].join("scene.ply");
    let mut ply = ply::read(&file).unwrap();
    let shift = DVec3::new(0.5, -2.0, 8.0);
    ply.gaussians.means.iter_mut().for_each(|mean| {
        *mean = (DVec3::from(mean.map(f64::from)) - shift)
            .as_vec3()
            .to_array()
    });
    ply::write(&file, &ply.gaussians, shift, ply.labels.as_deref()).unwrap();
    let merged = merge(&runs).unwrap();
    // The order of the runs makes no difference.
    let reversed: Vec<PathBuf> = runs.iter().rev().cloned().collect();
    let other = merge(&reversed).unwrap();
    assert_eq!(
        (&other.gaussians, other.origin),
        (&merged.gaussians, merged.origin)
    );
    let (gaussians, labels) = scene();
    let (found, _) = sorted(&merged.gaussians, merged.labels.as_ref().unwrap());
    assert_eq!(found.len(), labels.len());
    for (a, b) in found.means.iter().zip(&gaussians.means) {
        assert!(
            (0..3).all(|axis| (a[axis] - b[axis]).abs() < 1e-5),
            "{a:?} {b:?}"
        );
    }
}

#[test]
fn all_blocks_of_one_split_are_asked_for_once() {
    let Runs { folder, runs } = Runs::semantic();
    let at = |name: &str| folder.path().join(name);
    assert_names(
        &merge(&runs[..2]).unwrap_err(),
        &["no run on 2_0", "all 3 blocks"],
    );
    assert_names(&merge(&runs[2..]).unwrap_err(), &["no run on 0_0, 1_0"]);
    assert_names(&merge(&[]).unwrap_err(), &["RUN", "nothing"]);
    let doubled: Vec<PathBuf> = runs.iter().chain(&runs[1..2]).cloned().collect();
    assert_names(
        &merge(&doubled).unwrap_err(),
        &["two runs on block 1_0", "each block once"],
    );
    // A block of another grid, and one of another scene.
    for (name, dir, counts) in [("others", "hall", [2, 1]), ("elsewhere", "annex", [3, 1])] {
        hall(&at("annex"), false);
        let block: Block = split(&at(dir), &LoadOptions::default(), counts)
            .unwrap()
            .remove(0)
            .block;
        block.write(&at(name)).unwrap();
        let table = Classes::from_names(0, [(1, "wall"), (2, "door")]);
        let run = at(&format!("run of {name}"));
        write_run(
            &run,
            &at(name),
            &scene().0,
            (&scene().1, &table, Association::None),
        );
        let mixed = [&runs[1..], &[run]].concat();
        assert_names(
            &merge(&mixed).unwrap_err(),
            &[name, "a different split", "1_0"],
        );
    }
    // A run on a whole scene.
    let run = at("run of the hall");
    let table = Classes::from_names(0, [(1, "wall"), (2, "door")]);
    write_run(
        &run,
        &at("hall"),
        &scene().0,
        (&scene().1, &table, Association::None),
    );
    let mixed = [&runs[1..], &[run]].concat();
    assert_names(
        &merge(&mixed).unwrap_err(),
        &["run of the hall", "no block.json", "`coseg split`"],
    );
    // A folder that is not a run, and a run that was not finished.
    assert_names(
        &merge(&[at("hall")]).unwrap_err(),
        &["config.toml", "a run folder"],
    );
    fs::remove_file(runs[0].join("scene.ply")).unwrap();
    assert_names(&merge(&runs).unwrap_err(), &["scene.ply"]);
}

#[test]
fn a_run_belongs_to_the_split_that_it_was_trained_on() {
    let Runs { runs, folder } = Runs::semantic();
    let before = merge(&runs).unwrap();
    // The scene is split anew into the same folders.
    let hall = folder.path().join("hall");
    let [planned, ..] = &split(&hall, &LoadOptions::default(), [2, 1]).unwrap()[..] else {
        panic!("two blocks");
    };
    let again = folder.path().join("blocks").join(planned.block.name());
    planned.block.write(&again).unwrap();
    assert_eq!(merge(&runs).unwrap().gaussians, before.gaussians);
    fs::copy(again.join("block.json"), runs[0].join("block.json")).unwrap();
    assert_names(&merge(&runs).unwrap_err(), &["a different split"]);
}

#[test]
fn tables_that_contradict_each_other_are_refused() {
    let (_, labels) = scene();
    let table =
        |block| Classes::from_names(0, [(1, "wall"), (2, ["door", "door", "window"][block])]);
    let Runs {
        runs,
        folder: _folder,
    } = Runs::new((&|_, row| labels[row], &table, Association::None));
    assert_names(
        &merge(&runs).unwrap_err(),
        &["2_0", "id 2", "window", "door"],
    );
    // A class that only one block has is not a contradiction.
    let table = |block| {
        Classes::from_names(
            0,
            [(1, "wall"), (2, "door"), (3, "rug")]
                .into_iter()
                .take(2 + block),
        )
    };
    let Runs {
        runs,
        folder: _folder,
    } = Runs::new((&|_, row| labels[row], &table, Association::None));
    let merged = merge(&runs).unwrap();
    assert_eq!(merged.classes.len(), 3);
    assert_eq!(
        merged.identities.unwrap().ids(&merged.classes),
        merged.labels.unwrap()
    );
}

#[test]
fn objects_of_each_block_are_joined_where_blocks_overlap() {
    // Eight objects along the hall; each block numbers those that it has by itself, from the other end in every second one.
    let of_row = |row: usize| row / 50;
    let local = |block: usize, object: usize| {
        if block == 1 {
            8 - object as u16
        } else {
            1 + object as u16
        }
    };
    let table = |_| Classes {
        entries: (1..=8)
            .map(|id| Class {
                id,
                name: format!("chair {id}"),
                color: [0; 3],
                object_of: Some(ObjectOf {
                    class: 1,
                    thing: true,
                }),
            })
            .collect(),
        ignore: 0,
    };
    let Runs {
        runs,
        folder: _folder,
    } = Runs::new((
        &|block, row| local(block, of_row(row)),
        &table,
        Association::Gaussians,
    ));
    let merged = merge(&runs).unwrap();
    let (_, labels) = sorted(&merged.gaussians, merged.labels.as_ref().unwrap());
    let ids: Vec<u16> = labels.chunks(50).map(|object| object[0]).collect();
    assert!(
        labels
            .chunks(50)
            .all(|object| object.iter().all(|id| *id == object[0])),
        "{labels:?}"
    );
    let mut distinct = ids.clone();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), 8, "{ids:?}");
    assert!(merged.joined.unwrap() >= 2);
    assert_eq!(merged.classes.len(), 8);
    assert_eq!(
        merged.identities.unwrap().ids(&merged.classes),
        merged.labels.unwrap()
    );
}
