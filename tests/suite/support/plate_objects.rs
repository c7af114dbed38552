//! The plates as objects: segments with ids of their own in every view, and their association.

use crate::support::hard_labels::hard_label_map;
use crate::support::plates::{self, camera, plates};
use crate::support::program::{read_json, succeeds, utf8};
use crate::support::spoilt_masks::shuffled;
use coseg::config::LabelSource;
use coseg::data::{LabelMap, LabelRuns, LoadOptions, Scene, Split, View, load};
use coseg::error::Result;
use coseg::metrics::{InstanceScores, instance_scores};
use coseg::objects::{self, LabelMaps, vote};
use coseg::raster::{Projected, Settings, SplatTensors};
use coseg::splat::Gaussians;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::Path;

/// Six views of the plates with exact instances; raw labels are the same under ids drawn anew in each view.
pub fn plate_scene() -> (Gaussians, Scene) {
    let folder = tempfile::tempdir().expect("folder");
    plates::scene(folder.path());
    let (gaussians, labels) = plates();
    let mut scene = load(folder.path(), &LoadOptions::default()).expect("scene");
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (i, view) in scene.views.iter_mut().enumerate() {
        view.camera = camera(i);
        let projected =
            Projected::new(&gaussians.splats(), &view.camera, &Settings::default()).expect("view");
        let truth = hard_label_map(&projected, &labels, 0.5);
        view.raw = Some(shuffled(&truth, &mut rng).into());
        view.instances = Some(truth.into());
    }
    (gaussians, scene)
}

/// The association that nothing stops.
pub fn associate(gaussians: &Gaussians, scene: &Scene) -> Result<objects::AssociatedObjects> {
    let go_on = &mut |_| Ok(());
    objects::associate(gaussians, scene, &Settings::default(), go_on)
}

/// The association, which succeeds.
pub fn found(gaussians: &Gaussians, scene: &Scene) -> objects::AssociatedObjects {
    associate(gaussians, scene).expect("association")
}

/// The map, which is there.
pub fn map(runs: &Option<LabelRuns>) -> LabelMap {
    runs.as_ref().expect("map").map()
}

/// Scores of the maps of both splits against the instances.
pub fn map_scores(scene: &Scene, maps: &[Option<LabelRuns>]) -> InstanceScores {
    let pairs = scene.views.iter().zip(maps);
    instance_scores(pairs.map(|(v, m)| (map(&v.instances), map(m))))
}

/// Scores of what a vote of the objects shows in the test views.
pub fn rendered_scores(gaussians: &Gaussians, mut scene: Scene) -> InstanceScores {
    found(gaussians, &scene).apply(&mut scene);
    let maps = rendered(gaussians, &scene);
    let truth = scene.split(Split::Test).map(|view| map(&view.instances));
    instance_scores(truth.zip(&maps))
}

/// The plates where in the training views, in order, `joined` are one segment: pairs of instances, one pair a view.
pub fn joined(joined: [Option<(u16, u16)>; 4]) -> (Gaussians, Scene) {
    let (gaussians, mut scene) = plate_scene();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let trained = scene
        .views
        .iter_mut()
        .filter(|view| view.split == Split::Train);
    for (view, pair) in trained.zip(joined) {
        let truth = map(&view.instances);
        let one = |&id: &u16| pair.filter(|(_, b)| *b == id).map_or(id, |(a, _)| a);
        let map = LabelMap {
            ids: truth.ids.iter().map(one).collect(),
            ..truth
        };
        view.raw = Some(shuffled(&map, &mut rng).into());
    }
    (gaussians, scene)
}

/// What `coseg train` says of a short run that associates the labels of `dir`.
pub fn short_run(dir: &Path, run: &Path) -> String {
    let sets = [
        "data.association=gaussians",
        "building.iterations=60",
        "building.random_points=400",
        "segmentation.iterations=20",
        "segmentation.rows=raw,vote,per_gaussian",
    ];
    let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
    succeeds(
        &[
            &["train", "--data", utf8(dir), "--out", utf8(run)][..],
            &sets,
        ]
        .concat(),
    )
}

/// The plates with raw labels under shuffled ids, and true instances.
pub fn plate_folder(dir: &Path) {
    plates::scene(dir);
    let mut value = read_json(&dir.join("transforms.json"));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for frame in value["frames"].as_array_mut().expect("frames") {
        frame["instance_path"] = frame["label_path"].take();
        frame.as_object_mut().expect("frame").remove("label_path");
        let truth = LabelMap::read(&dir.join(frame["instance_path"].as_str().expect("path")));
        let raw = dir.join(frame["raw_label_path"].as_str().expect("path"));
        shuffled(&truth.expect("truth"), &mut rng)
            .write(&raw)
            .expect("raw labels");
    }
    fs::write(dir.join("transforms.json"), value.to_string()).expect("write");
    fs::remove_file(dir.join("classes.json")).expect("remove");
}

/// What a vote of the raw labels of the training views shows in the test views.
fn rendered(gaussians: &Gaussians, scene: &Scene) -> Vec<LabelMap> {
    let settings = Settings::default();
    let votes = vote(
        gaussians,
        scene.split(Split::Train),
        &scene.classes,
        &settings,
        &crate::support::device(),
    )
    .expect("votes")
    .identities();
    let maps = LabelMaps::new(&votes, &scene.classes, LabelSource::Labels, 0.5);
    let splats = SplatTensors::new(gaussians, &crate::support::device());
    let render = |view: &View| {
        maps.of(&splats.seen_by(&view.camera, &settings))
            .expect("a map")
    };
    scene.split(Split::Test).map(render).collect()
}
