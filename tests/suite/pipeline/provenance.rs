//! What a run resumes from: variants do not decide over which Gaussians, and a refusal names the setting that made other inputs.

use crate::support::plate_runs::{StopAt, config, same, stopped, whole};
use crate::support::plates;
use coseg::config::{Association, Config, FeatureSource, SpatialSource, Variant};
use coseg::data::{LoadOptions, Split, load};
use coseg::error::Error;
use coseg::pipeline::run;
use coseg::progress::Silent;
use coseg::reconstruction::Trainer;
use coseg::segmentation::encoder::random_weights;
use coseg::splat::ply;
use glam::DVec3;
use safetensors::tensor::{Dtype, TensorView};
use std::fs;
use std::path::Path;

fn refusal(config: &Config, out: &Path) -> Error {
    run(config, out, &crate::support::device(), &mut Silent)
        .err()
        .expect("must be refused")
}

/// The refusal names a setting, its value now and then, and the file.
#[track_caller]
fn refused_by(config: &Config, out: &Path, [key, found, then, file]: [&str; 4]) {
    let error = refusal(config, out);
    assert!(matches!(error, Error::Config { .. }), "{error}");
    crate::support::assert_names(
        &error,
        &[
            key,
            &format!("found {found}"),
            &format!("expected {then}, as when"),
            file,
        ],
    );
}

/// Settings of a run that takes the plates, and three Gaussians that no camera sees.
fn with_unseen(dir: &Path) -> Config {
    plates::scene(dir);
    let (mut gaussians, _) = plates::plates();
    for i in 0..3 {
        gaussians.means.push([i as f32, 0.0, 60.0]);
        gaussians.log_scales.push([-2.0; 3]);
        gaussians.rotations.push([1.0, 0.0, 0.0, 0.0]);
        gaussians.opacity_logits.push(2.0);
        gaussians.sh.extend([0.1; 3]);
    }
    let path = dir.join("given.ply");
    ply::write(&path, &gaussians, DVec3::ZERO, None).expect("written");
    let mut config = config(dir);
    config.building.gaussians = Some(path);
    config.building.iterations = 0;
    config.segmentation.iterations = 10;
    config
}

fn rows(config: &Config, rows: &[Variant]) -> Config {
    let mut config = config.clone();
    config.segmentation.rows = Some(rows.to_vec());
    config
}

#[test]
fn rows_do_not_decide_which_gaussians_are_pruned() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = with_unseen(folder.path());
    let all = plates::plates().0.len() + 3;
    let few = [Variant::Vote, Variant::PerGaussian];
    let many = [Variant::Vote, Variant::PerGaussian, Variant::Ours];
    let out = |name: &str| folder.path().join(name);
    let before = whole(&rows(&config, &few), &out("run"));
    let pruned = before.pruned.expect("reported");
    assert_eq!(
        (pruned.before, pruned.after, before.gaussians.len()),
        (all, all - 3, all - 3)
    );
    assert!(pruned.scores_before.psnr.is_some() && pruned.scores_after == before.test);
    assert!(before.features.is_empty(), "nothing reads features");
    // A row more, and again a row less, is the same run.
    let more = whole(&rows(&config, &many), &out("run"));
    same(&more, &whole(&rows(&config, &many), &out("at once")));
    same(&before, &whole(&rows(&config, &few), &out("at once")));
    // What is not segmented is not pruned, nor what is asked not to be.
    let none = whole(&rows(&config, &[]), &out("none"));
    assert_eq!((none.pruned, none.gaussians.len()), (None, all));
    let mut kept = rows(&config, &few);
    kept.unprojection.attendance = 0.0;
    let pruned = whole(&kept, &out("kept")).pruned.expect("reported");
    assert_eq!((pruned.before, pruned.after), (all, all));
    refused_by(
        &kept,
        &out("run"),
        [
            "unprojection.attendance",
            "0.0",
            "0.00001",
            "per_gaussian.safetensors",
        ],
    );
    assert_eq!(whole(&kept, &out("kept")).gaussians.len(), all);
    let file = folder.path().join("transforms.json");
    let text = fs::read_to_string(&file)
        .expect("frames")
        .replace("\"raw_label_path\"", "\"elsewhere\"");
    fs::write(&file, text).expect("written");
    let none = whole(&rows(&config, &few), &out("without labels"));
    assert_eq!((none.pruned, none.gaussians.len()), (None, all));
}

/// Maps of every view of the plates, other ones for another `seed`.
fn write_maps(dir: &Path, seed: usize) {
    fs::create_dir_all(dir).expect("folder");
    let shape = [8, 10, 6];
    let count = 8 * 10 * 6;
    for view in 0..6 {
        let value = |i: usize| ((i * 37 + (seed * 7 + view + 1) * 101) % 997) as f32 / 997.0;
        let bytes: Vec<u8> = (0..count).flat_map(|i| value(i).to_le_bytes()).collect();
        let tensor = |n| {
            (
                format!("scale{n}"),
                TensorView::new(Dtype::F32, shape.to_vec(), &bytes).expect("whole"),
            )
        };
        let file = safetensors::serialize((1..=4).map(tensor), None).expect("encoded");
        fs::write(dir.join(format!("v{view}.safetensors")), file).expect("written");
    }
}

#[test]
fn a_decoder_of_other_image_features_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut config = rows(
        &with_unseen(folder.path()),
        &[
            Variant::PerGaussian,
            Variant::NoImageFeatures,
            Variant::Ours,
        ],
    );
    let maps = folder.path().join("maps");
    config.features.source = FeatureSource::Import(maps.clone());
    config.features.dimensions = 4;
    write_maps(&maps, 0);
    let out = folder.path().join("run");
    stopped(&config, &out, &mut StopAt::new("ours", 4));
    write_maps(&maps, 1);
    // Only of the row that reads them.
    let error = refusal(&config, &out);
    crate::support::assert_names(
        &error,
        &[
            "/ours.safetensors",
            "image features",
            "features.source.import",
            "another folder",
        ],
    );
    write_maps(&maps, 0);
    let done = whole(&config, &out);
    same(&done, &whole(&config, &folder.path().join("at once")));
}

#[test]
fn a_decoder_beside_another_point_encoder_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut config = rows(
        &with_unseen(folder.path()),
        &[Variant::NoSpatial, Variant::Ours],
    );
    let weights = folder.path().join("weights.safetensors");
    let write = |seed| {
        fs::write(
            &weights,
            random_weights(3, seed).to_safetensors().expect("whole"),
        )
        .expect("written")
    };
    config.spatial.source = SpatialSource::Pretrained(weights.clone());
    write(7);
    let out = folder.path().join("run");
    let done = whole(&config, &out);
    write(8);
    crate::support::assert_names(
        &refusal(&config, &out),
        &[
            "/ours.safetensors",
            "point encoder",
            "spatial.source.pretrained",
        ],
    );
    write(7);
    same(&done, &whole(&config, &out));
}

#[test]
fn other_data_is_told_by_the_setting_that_made_it_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path();
    let base = rows(&with_unseen(dir), &[Variant::PerGaussian]);
    let out = dir.join("run");
    let done = whole(&base, &out);
    let with = |edit: &dyn Fn(&mut Config)| {
        let mut config = base.clone();
        edit(&mut config);
        config
    };
    let initial = "initial.safetensors";
    refused_by(
        &with(&|c| c.data.stride = 2),
        &out,
        ["data.stride", "2", "1", initial],
    );
    refused_by(
        &with(&|c| c.data.max_frames = 2),
        &out,
        ["data.max_frames", "2", "0", initial],
    );
    refused_by(
        &with(&|c| c.data.max_side = 40),
        &out,
        ["data.max_side", "40", "1600", initial],
    );
    for name in ["same", "other"] {
        fs::create_dir(dir.join(name)).expect("folder");
        (0..6).for_each(|i| {
            let from = if name == "other" && i == 0 { 1 } else { i };
            fs::copy(
                dir.join(format!("raw/v{from}.png")),
                dir.join(format!("{name}/v{i}.png")),
            )
            .expect("copied");
        });
    }
    let row = "per_gaussian.safetensors";
    refused_by(
        &with(&|c| c.data.raw_labels = "other".into()),
        &out,
        ["data.raw_labels", "\"other\"", "\"\"", row],
    );
    // Another setting that gives the same data is not an obstacle; nor is a setting that has no effect on the data.
    let other = with(&|c| {
        c.data.raw_labels = "same".into();
        c.data.decoded_mb = 0;
        c.data.raw_labels_note = "drawn by hand".into();
    });
    same(&done, &whole(&other, &out));

    same(&done, &whole(&base, &out));
}

#[test]
fn a_scene_that_moved_is_refused_by_what_is_other_in_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let [own, moved, out] = ["own", "moved", "run"].map(|name| folder.path().join(name));
    let mut config = rows(&with_unseen(&own), &[Variant::PerGaussian]);
    let done = whole(&config, &out);
    fs::rename(&own, &moved).expect("moved");
    config.data.dir = Some(moved.clone());
    config.building.gaussians = Some(moved.join("given.ply"));
    same(&done, &whole(&config, &out));
    let copy = |folder| {
        let [from, to] = ["v1.png", "v0.png"].map(|name| moved.join(folder).join(name));
        fs::copy(from, to).expect("copied");
    };
    copy("raw");
    let other = "those of other data";
    let alone = "`coseg train --data DIR --scene RUN --out NEW`";
    crate::support::assert_names(
        &refusal(&config, &out),
        &["per_gaussian.safetensors", "raw labels", other, alone],
    );
    copy("images");
    let error = refusal(&config, &out);
    crate::support::assert_names(&error, &["initial.safetensors", "photos", other]);
    assert!(!error.to_string().contains(alone), "{error}");
}

#[test]
fn other_objects_are_told_by_the_setting_of_association() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut config = rows(&with_unseen(folder.path()), &[Variant::PerGaussian]);
    let out = folder.path().join("run");
    whole(&config, &out);
    let row = "per_gaussian.safetensors";
    config.data.association = Association::Gaussians;
    refused_by(
        &config,
        &out,
        ["data.association", "\"gaussians\"", "\"none\"", row],
    );
    let out = folder.path().join("objects");
    let done = whole(&config, &out);
    assert!(
        done.association.expect("objects").objects > 1,
        "{:?}",
        done.association
    );
}

#[test]
fn photos_are_compared_by_their_files_without_decoding() {
    let folder = tempfile::tempdir().expect("a folder");
    plates::scene(folder.path());
    let mut config = rows(&config(folder.path()), &[]);
    config.building.iterations = 6;
    // A photo that nothing reads need not even be there.
    let scene = load(
        folder.path(),
        &LoadOptions {
            decoded_mb: 0,
            ..LoadOptions::default()
        },
    )
    .expect("scene");
    let test = scene.split(Split::Test).next().expect("a test view");
    fs::remove_file(folder.path().join(format!("images/{}.png", test.name))).expect("removed");
    assert!(test.image.pixels().is_err());
    Trainer::new(&scene, &config, &crate::support::device()).expect("a stage");
}
