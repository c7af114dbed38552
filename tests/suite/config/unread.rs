//! Settings given in vain: what a run says of them.

use crate::cli::commands::{coseg, utf8};
use crate::config::load::{assert_names, load};
use crate::support::plates::scene;
use coseg::config::{Config, Preset, Variant};

/// What is told of these settings of the built-in scene.
#[track_caller]
fn unread(sets: &[&str]) -> Vec<String> {
    let config = load("", sets).unwrap();
    // As a run lists its settings, those that nobody gave included.
    assert_eq!(
        load(&config.to_toml().unwrap(), &[]).unwrap().unread(),
        config.unread()
    );
    config.unread()
}

/// Expects one sentence, with these parts.
#[track_caller]
fn one(sets: &[&str], parts: &[&str]) {
    let told = unread(sets);
    assert_eq!(told.len(), 1, "{sets:?}: {told:?}");
    assert_names(&told[0], parts);
}

#[test]
fn what_another_setting_leaves_unread_is_told() {
    one(
        &["spatial.weights=w.pth"],
        &[
            "spatial.weights = w.pth is not read",
            "spatial.source is not pretrained",
        ],
    );
    one(
        &["spatial.weights=w.pth", "spatial.source=random"],
        &["spatial.weights"],
    );
    one(
        &["features.weights=w.pth", "features.source=descriptor"],
        &["features.weights = w.pth", "features.source is"],
    );
    one(
        &[
            "features.weights=w",
            "features.source=import",
            "features.import_dir=d",
        ],
        &["features.weights"],
    );
    one(
        &["features.import_dir=maps"],
        &[
            "features.import_dir = maps",
            "features.source is not import",
        ],
    );
    let mcmc = ["building.strategy=mcmc", "building.max_gaussians=900"];
    let usual = [
        "densify_threshold=8e-4",
        "clone_below=0.01",
        "prune_scale=0.1",
        "reset_every=1000",
        "densify_until=0.8",
    ];
    let other = [
        "densify_threshold=1e-3",
        "clone_below=0.02",
        "prune_scale=0.5",
        "reset_every=500",
    ];
    for usual in usual {
        assert!(
            unread(&[&mcmc[..], &[&format!("building.{usual}")]].concat()).is_empty(),
            "{usual}"
        );
    }
    for other in other {
        let other = format!("building.{other}");
        assert!(unread(&[&other]).is_empty());
        one(
            &[&mcmc[..], &[&other]].concat(),
            &[
                other.split_once('=').unwrap().0,
                "building.strategy is mcmc",
            ],
        );
    }
    for read in [
        vec![],
        mcmc.to_vec(),
        vec!["features.weights=w"],
        vec!["features.weights=w", "features.source=dino"],
        vec!["spatial.weights=w", "spatial.source=pretrained"],
        vec!["data.association=gaussians", "association.sweeps=2"],
        vec![
            "data.raw_labels_note=mine",
            "raster.background=1,1,1",
            "seed=3",
        ],
    ] {
        assert_eq!(unread(&read), Vec::<String>::new());
    }
    // What `train --scene` sets beside the Gaussians that it begins with.
    let given = [
        "building.gaussians=a.ply",
        "building.iterations=0",
        "unprojection.attendance=0",
    ];
    assert_eq!(
        unread(&[&given[..], &["segmentation.rows=[]"]].concat()),
        Vec::<String>::new()
    );
    for preset in [Preset::Default, Preset::Paper, Preset::Fast] {
        assert!(
            Config::preset(preset).unread().is_empty()
                && Config::builtin_preset(preset).unread().is_empty()
        );
    }
}

/// A setting, what keeps it from being read, and what has it read.
const EACH: [(&str, &str, &str); 33] = [
    ("data.transforms=a.json", "", "data.dir=d"),
    ("data.stride=2", "", "data.dir=d"),
    (
        "data.transforms=a.json",
        "data.dir=d,data.layout=colmap",
        "data.dir=d,data.layout=transforms",
    ),
    (
        "data.images=images_4",
        "data.dir=d,data.layout=scannet",
        "data.dir=d,data.layout=colmap",
    ),
    (
        "data.scannet_classes=scannet20",
        "data.dir=d,data.layout=replica",
        "data.dir=d,data.layout=scannet",
    ),
    ("association.sweeps=2", "", "data.association=gaussians"),
    (
        "building.mcmc.growth=0.1",
        "",
        "building.strategy=mcmc,building.max_gaussians=9",
    ),
    (
        "building.absgrad=false",
        "building.strategy=mcmc,building.max_gaussians=9",
        "",
    ),
    (
        "building.mcmc.noise_opacity=0.1",
        "building.strategy=mcmc,building.max_gaussians=9,building.mcmc.noise=0",
        "building.strategy=mcmc,building.max_gaussians=9",
    ),
    (
        "building.sh_degree=2",
        "building.gaussians=a.ply,building.iterations=0",
        "building.gaussians=a.ply",
    ),
    (
        "building.mcmc.noise=2",
        "building.gaussians=a.ply,building.iterations=0,building.max_gaussians=0",
        MCMC,
    ),
    (
        "building.random_points=9",
        "data.dir=d,building.gaussians=a.ply",
        "data.dir=d",
    ),
    ("building.random_points=9", "", "data.dir=d"),
    (
        "features.final_norm=false",
        "",
        "features.source=dino,features.weights=w",
    ),
    (
        "features.cache_dir=c",
        "features.source=import,features.import_dir=d",
        "",
    ),
    (
        "features.dimensions=9",
        "segmentation.rows=vote",
        "segmentation.rows=vote,segmentation.diffusion_steps=1",
    ),
    (
        "unprojection.solve_ridge=0.2",
        "",
        "unprojection.solve_iterations=3",
    ),
    (
        "unprojection.attendance_pixels=9",
        "unprojection.attendance=0",
        "",
    ),
    (
        "spatial.scale=2",
        "segmentation.rows=per_gaussian",
        "segmentation.rows=no_spatial",
    ),
    (
        "segmentation.iterations=9",
        "segmentation.rows=raw",
        "segmentation.rows=per_gaussian",
    ),
    (
        "segmentation.min_coverage=0.4",
        "segmentation.rows=[]",
        "segmentation.rows=vote",
    ),
    (
        "segmentation.lr=1e-3",
        "segmentation.rows=per_gaussian",
        "segmentation.rows=ours_ce",
    ),
    (
        "segmentation.lr_per_gaussian=1e-3",
        "segmentation.rows=ours",
        "segmentation.rows=per_gaussian",
    ),
    ("segmentation.gce_exponent=0.5", "segmentation.loss=js", ""),
    (
        "segmentation.gce_exponent=0.5",
        "segmentation.rows=ours_ce",
        "segmentation.rows=single_scale",
    ),
    (
        "segmentation.least_recall=0.5",
        "segmentation.loss=mae",
        "segmentation.loss=gce",
    ),
    (
        "segmentation.pi_rl=0.5",
        "segmentation.loss=ce",
        "segmentation.loss=js",
    ),
    (
        "segmentation.gjs_dropout=0.5",
        "segmentation.loss=js",
        "segmentation.loss=gjs",
    ),
    (
        "segmentation.lambda_reg=0.5",
        "segmentation.rows=ours_ce",
        "",
    ),
    (
        "segmentation.reg_samples=9",
        "segmentation.lambda_reg=0",
        "",
    ),
    (
        "segmentation.warmup=0.5",
        "segmentation.loss=ce,segmentation.average=false",
        "segmentation.loss=ce",
    ),
    (
        "segmentation.diffusion_strength=0.5",
        "",
        "segmentation.diffusion_steps=3",
    ),
    (
        "segmentation.diffusion_temperature=0.5",
        "",
        "segmentation.diffusion_steps=3",
    ),
];
const MCMC: &str = "building.gaussians=a.ply,building.strategy=mcmc,building.max_gaussians=9";

#[test]
fn each_setting_is_read_where_its_cause_is_away() {
    for (set, cause, away) in EACH {
        let key = set.split_once('=').unwrap().0;
        let told = |with: &str| {
            let sets: Vec<&str> = with
                .split(',')
                .filter(|set| !set.is_empty())
                .chain([set])
                .collect();
            let told = unread(&sets);
            told.iter()
                .filter(|told| told.contains(&format!("{key} = ")))
                .count()
        };
        assert_eq!(
            (told(cause), told(away)),
            (1, 0),
            "{set} with {cause:?}, without by {away:?}"
        );
    }
    // The figures of compactness count neighbours too.
    assert!(unread(&["segmentation.diffusion_neighbours=9"]).is_empty());
}

#[test]
fn one_cause_is_told_once_and_one_factor_is_no_trial() {
    let taken = [
        "building.gaussians=a.ply",
        "building.iterations=0",
        "building.sh_degree=1",
        "building.mcmc.growth=1",
    ];
    let both = "building.mcmc.growth = 1.0, building.sh_degree = 1 are not read";
    one(
        &[&taken[..], &["building.strategy=adc"]].concat(),
        &[both, "building.iterations is 0"],
    );
    one(
        &["segmentation.lr_trials=[0.3]"],
        &["lr_trials = [0.3]", "multiplies the learning rates"],
    );
    assert!(unread(&["segmentation.lr_trials=[0.3,1]"]).is_empty());
    one(
        &["segmentation.lr_trials=[0.3]", "segmentation.rows=vote"],
        &["no row of segmentation.rows is trained"],
    );
    let mut config = Config::preset(Preset::Paper);
    config.segmentation.rows = Some(vec![Variant::Vote]);
    assert!(
        config.unread().is_empty(),
        "a preset gives nothing in vain: {:?}",
        config.unread()
    );
}

#[test]
fn a_run_warns_of_what_it_does_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let (out, file) = (folder.path().join("run"), folder.path().join("run.toml"));
    std::fs::write(&file, "[data]\ntransforms = \"transforms_4.json\"\n").unwrap();
    let sets = [
        "building.iterations=2",
        "building.max_gaussians=200",
        "segmentation.rows=[]",
        "spatial.weights=none.pth",
    ];
    let sets = sets.iter().flat_map(|set| ["--set", set]);
    let train = ["train", "--out", utf8(&out), "--config", utf8(&file)];
    let output = coseg(&train.into_iter().chain(sets).collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert_names(
        &said,
        &["none.pth is not read: spatial.source is not pretrained"],
    );
    assert_names(
        &said,
        &["data.transforms = transforms_4.json is not read: the run is of the built-in scene"],
    );
    // Where a folder is named, its file of cameras is looked for.
    scene(folder.path());
    let output = coseg(
        &[
            &train[..2],
            &[
                utf8(&folder.path().join("b")),
                "--data",
                utf8(folder.path()),
            ],
            &train[3..],
        ]
        .concat(),
    );
    assert_names(
        &String::from_utf8_lossy(&output.stderr),
        &["error", "transforms_4.json"],
    );
}
