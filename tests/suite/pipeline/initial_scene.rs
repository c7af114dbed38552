//! A run that begins with Gaussians of a file.

use crate::support::plate_runs::{config, whole};
use crate::support::plates;
use coseg::config::{Budget, Config, Variant};
use coseg::error::Error;
use coseg::pipeline::run;
use coseg::progress::Silent;
use coseg::splat::{Gaussians, ply};
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Settings of a run on the plates that begins with `gaussians`, written to a file.
fn beginning_with(dir: &Path, gaussians: &Gaussians) -> (Config, PathBuf) {
    plates::scene(dir);
    let path = dir.join("given.ply");
    ply::write(&path, gaussians, DVec3::ZERO, None).unwrap();
    let mut config = config(dir);
    config.building.gaussians = Some(path);
    config.building.iterations = 0;
    config.segmentation.rows = Some(vec![Variant::Vote]);
    (config, dir.join("run"))
}

/// Positions, sorted: a run brings its Gaussians into an order of its own.
fn sorted(gaussians: &Gaussians, origin: DVec3) -> Vec<[i64; 3]> {
    let world = |m: &[f32; 3]| {
        (DVec3::from(m.map(f64::from)) + origin)
            .to_array()
            .map(|v| (v * 1e4).round() as i64)
    };
    let mut all: Vec<_> = gaussians.means.iter().map(world).collect();
    all.sort_unstable();
    all
}

#[test]
fn initial_gaussians_are_labelled_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let (plates, labels) = plates::plates();
    let (config, out) = beginning_with(folder.path(), &plates);
    let outcome = whole(&config, &out);
    assert!(outcome.building.is_empty(), "nothing was built");
    assert_eq!(outcome.gaussians.sh_degree, 0, "colours stay as they were");
    assert_eq!(
        sorted(&outcome.gaussians, outcome.scene.origin),
        sorted(&plates, DVec3::ZERO)
    );
    assert!(
        outcome.test.psnr.unwrap() > 40.0,
        "the photos are of these Gaussians: {:?}",
        outcome.test
    );
    // Most of a plate's Gaussians get its label, in spite of the view where it is another's.
    let identities = outcome.rows[0]
        .identities
        .as_ref()
        .unwrap()
        .ids(&outcome.scene.classes);
    let counts = |ids: &[u16]| [1, 2, 3, 4].map(|id| ids.iter().filter(|&&i| i == id).count());
    let (found, want) = (counts(&identities), counts(&labels));
    assert!(
        found.iter().zip(want).all(|(f, w)| f.abs_diff(w) <= w / 5),
        "{found:?}, not {want:?}"
    );
    // As does a scene that was written with another origin.
    let back = ply::read(&out.join("scene.ply")).unwrap();
    assert_eq!(
        sorted(&back.gaussians, back.origin),
        sorted(&plates, DVec3::ZERO)
    );
}

#[test]
fn initial_gaussians_are_trained_further() {
    let folder = tempfile::tempdir().unwrap();
    let (mut plates, _) = plates::plates();
    plates.sh.iter_mut().for_each(|c| *c *= 0.8);
    let (mut config, out) = beginning_with(folder.path(), &plates);
    let before = whole(&config, &out.join("before")).test.psnr.unwrap();
    config.building.iterations = 40;
    config.building.max_gaussians = Budget::Unlimited;
    config.building.sh_degree = 1;
    let outcome = whole(&config, &out.join("after"));
    let after = outcome.test.psnr.unwrap();
    assert!(after > before + 1.0, "{after:.2} dB, {before:.2} before");
    assert_eq!(outcome.gaussians.sh_degree, 1);
    assert_eq!(
        outcome.gaussians.len(),
        plates.len(),
        "40 steps densify nothing"
    );
}

#[test]
fn a_file_that_cannot_be_begun_with_is_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let (mut config, out) = beginning_with(folder.path(), &plates::plates().0);
    let refused = |config: &Config| {
        run(config, &out, &crate::support::device(), &mut Silent)
            .err()
            .expect("an error")
    };
    config.building.iterations = 40;
    config.building.max_gaussians = Budget::AtMost(50);
    let Error::Config {
        key,
        found,
        expected,
        ..
    } = refused(&config)
    else {
        panic!("no setting is named")
    };
    assert_eq!((&*key, &*found), ("building.max_gaussians", "50"));
    assert!(expected.starts_with("111 or more"), "{expected}");
    for iterations in [0, 40] {
        config.building.iterations = iterations;
        config.building.gaussians = Some(folder.path().join("none.ply"));
        let error = refused(&config).to_string();
        assert!(error.contains("none.ply"), "{error}");
    }
    let empty = folder.path().join("empty.ply");
    ply::write(&empty, &Gaussians::default(), DVec3::ZERO, None).unwrap();
    config.building.gaussians = Some(empty);
    assert!(refused(&config).to_string().contains("no Gaussian"));
    // Without them there is something to build.
    let nothing = ["building.iterations=0".to_owned()];
    assert!(
        matches!(Config::load(None, &nothing), Err(Error::Config { key, .. }) if key == "building.iterations")
    );
    let given = [
        "building.iterations=0".to_owned(),
        "building.gaussians=a b.ply".to_owned(),
    ];
    assert_eq!(
        Config::load(None, &given).unwrap().building.gaussians,
        Some(PathBuf::from("a b.ply"))
    );
}

#[test]
fn another_degree_of_harmonics_keeps_what_both_have() {
    let (plates, _) = plates::plates();
    let higher = plates.clone().with_sh_degree(2);
    assert_eq!(higher.sh.len(), plates.len() * 27);
    assert!(higher.check(None).is_ok());
    assert_eq!(
        (&higher.sh[27..30], &higher.sh[30..54]),
        (&plates.sh[3..6], &[0.0; 24][..])
    );
    assert_eq!(higher.with_sh_degree(0), plates);
}
