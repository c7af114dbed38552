//! A resumed run equals an uninterrupted one; a checkpoint of another run is refused.

use crate::support::plate_runs::{StopAt, config, same, stopped, whole};
use coseg::config::{Config, Encode, LabelLoss, LabelSource, SegmentationConfig, Variant};
use coseg::pipeline::run;
use coseg::progress::Silent;

#[test]
fn a_resumed_row_equals_an_uninterrupted_one_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let js = LabelLoss::Js { pi_rl: 0.9 };
    for (encode, loss, chunk) in [
        (Encode::Scene, LabelLoss::GCE, 65_536),
        (Encode::View, js, 65_536),
        (Encode::Scene, js, 97),
    ] {
        let mut config = config(folder.path());
        config.spatial.encode = encode;
        config.segmentation.decoder_chunk = chunk;
        config.segmentation.loss = Some(loss);
        let out = |name: &str| folder.path().join(format!("{encode:?}-{chunk}-{name}"));
        let uninterrupted = whole(&config, &out("whole"));
        assert_eq!(uninterrupted.rows[1].curve.len(), 3);
        let mut point = uninterrupted.rows[2].curve.clone();
        point.dedup_by_key(|p| p.loss.to_bits());
        assert_eq!(
            point.len(),
            3,
            "the decoder learns something in every third of its run"
        );
        let parts = out("parts");
        // Stopped between evaluations and between checkpoints, twice in each row.
        for (stage, iteration) in [
            ("per_gaussian", 3),
            ("per_gaussian", 17),
            ("ours", 14),
            ("ours", 29),
        ] {
            stopped(&config, &parts, &mut StopAt::new(stage, iteration));
        }
        // A stop adds no point to the curve.
        same(&uninterrupted, &whole(&config, &parts));
        // And once more from the end: nothing is left to do.
        same(&uninterrupted, &whole(&config, &parts));
    }
}

#[test]
fn checkpoints_of_other_settings_or_data_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let base = config(folder.path());
    let out = folder.path().join("run");
    let done = whole(&base, &out);
    let notes = coseg::report::Report::notes_of(&done);
    for part in [
        "segmentation.loss = {\"gce\":{\"exponent\":0.7",
        ", after 3 steps of cross-entropy",
    ] {
        assert!(notes.concat().contains(part), "{part}: {notes:?}");
    }
    let refusal = |edit: &dyn Fn(&mut Config)| {
        let mut config = base.clone();
        edit(&mut config);
        let error = run(&config, &out, &crate::support::device(), &mut Silent)
            .err()
            .expect("must be refused");
        (
            matches!(error, coseg::Error::Config { .. }),
            error.to_string(),
        )
    };
    let named = |key: &str, now: &str, then: &str, edit: &dyn Fn(&mut Config)| {
        let (typed, message) = refusal(edit);
        let wanted = [
            key,
            &format!("found {now}"),
            &format!("expected {then}, as when"),
            "another folder",
        ];
        assert!(
            typed && wanted.iter().all(|w| message.contains(w)),
            "{wanted:?}: {message}"
        );
        message
    };
    named("building.iterations", "50", "40", &|c| {
        c.building.iterations = 50
    });
    named("building.lr_means", "0.001", "0.00016", &|c| {
        c.building.lr_means = 1e-3
    });
    named("raster.alpha_max", "0.9", "0.999", &|c| {
        c.raster.alpha_max = 0.9
    });
    let message = named("segmentation.iterations", "20", "30", &|c| {
        c.segmentation.iterations = 20
    });
    assert!(message.contains("per_gaussian.safetensors"), "{message}");
    named("segmentation.lr", "0.01", "0.006", &|c| {
        c.segmentation.lr = 0.01
    });
    let gce = |exponent| format!("{{\"gce\":{{\"exponent\":{exponent},\"least_recall\":1.0}}}}");
    named("segmentation.loss", &gce(0.5), &gce(0.7), &|c| {
        c.segmentation.loss = Some(LabelLoss::Gce {
            exponent: 0.5,
            least_recall: 1.0,
        })
    });
    // What a row does not read is not an obstacle to it, but to the next.
    let message = named("features.dimensions", "8", "64", &|c| {
        c.features.dimensions = 8
    });
    assert!(message.contains("ours.safetensors"), "{message}");
    // When something is measured, saved or kept does not matter; nor do rows that are added.
    let mut other = base.clone();
    (
        other.segmentation.eval_every,
        other.building.checkpoint_every,
    ) = (3, 5);
    other.segmentation.rows = Some(vec![
        Variant::Raw,
        Variant::Vote,
        Variant::PerGaussian,
        Variant::Ours,
    ]);
    assert_eq!(
        whole(&other, &out).rows.last().expect("a row").identities,
        done.rows[2].identities
    );

    // What is finished may be scored by another rule of rendering, and its curve of scores by the old one goes.
    let mut scores = base.clone();
    scores.segmentation.render = LabelSource::Scores;
    let (other, anew) = (
        whole(&scores, &out),
        whole(&scores, &folder.path().join("anew")),
    );
    let (other, anew) = (
        other.rows.last().expect("a row"),
        anew.rows.last().expect("a row"),
    );
    assert_eq!(
        (&other.identities, &other.scores),
        (&anew.identities, &anew.scores)
    );
    assert_ne!(other.scores, done.rows[2].scores);
    assert!(
        other.curve.iter().all(|point| point.miou.is_none())
            && anew.curve.iter().any(|point| point.miou.is_some())
    );
    // What is not finished may not.
    let half = folder.path().join("half");
    stopped(&base, &half, &mut StopAt::new("per_gaussian", 20));
    let error = run(&scores, &half, &crate::support::device(), &mut Silent)
        .err()
        .expect("must be refused")
        .to_string();
    assert!(
        error.contains("segmentation.render") && error.contains("per_gaussian.safetensors"),
        "{error}"
    );

    // Another geometry under the same settings: the building stage done anew from another seed of points.
    let elsewhere = folder.path().join("elsewhere");
    let mut shorter = base.clone();
    shorter.segmentation.rows = Some(Vec::new());
    shorter.seed = 6;
    whole(&shorter, &elsewhere);
    let file = "checkpoint/building.safetensors";
    std::fs::copy(elsewhere.join(file), out.join(file)).expect("copied");
    named("seed", "5", "6", &|_| ());
    for row in ["per_gaussian", "ours"] {
        let rows = Some(vec![if row == "ours" {
            Variant::Ours
        } else {
            Variant::PerGaussian
        }]);
        std::fs::copy(
            out.join(format!("checkpoint/{row}.safetensors")),
            elsewhere.join("kept"),
        )
        .expect("copied");
        let path = elsewhere.join(format!("checkpoint/{row}.safetensors"));
        std::fs::rename(elsewhere.join("kept"), &path).expect("renamed");
        let config = Config {
            seed: 6,
            segmentation: SegmentationConfig {
                rows,
                ..base.segmentation.clone()
            },
            ..base.clone()
        };
        let error = run(&config, &elsewhere, &crate::support::device(), &mut Silent)
            .err()
            .expect("another seed")
            .to_string();
        assert!(error.contains("seed") && error.contains(row), "{error}");
    }
}

#[test]
fn a_row_of_other_gaussians_or_labels_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    crate::support::plates::scene(folder.path());
    let mut config = config(folder.path());
    config.segmentation.rows = Some(vec![Variant::PerGaussian]);
    let out = folder.path().join("run");
    let trained = whole(&config, &out);
    let refusal = || {
        run(&config, &out, &crate::support::device(), &mut Silent)
            .err()
            .expect("must be refused")
    };

    // As many Gaussians, one of them moved by a hair.
    let building = out.join("checkpoint/building.safetensors");
    let before = std::fs::read(&building).expect("read");
    let mut state = coseg::reconstruction::TrainerState::load(&building).expect("loaded");
    state.gaussians.means[7][0] += 1e-3;
    state.save(&building).expect("saved");
    let error = refusal();
    assert!(matches!(error, coseg::Error::Input { .. }), "{error}");
    let message = error.to_string();
    assert!(
        message.contains("per_gaussian.safetensors") && message.contains("Gaussians"),
        "{message}"
    );
    std::fs::write(&building, before).expect("written");
    same(&trained, &whole(&config, &out));

    let raw = folder.path().join("raw/v0.png");
    std::fs::copy(folder.path().join("raw/v1.png"), &raw).expect("copied");
    let message = refusal().to_string();
    assert!(
        message.contains("per_gaussian.safetensors") && message.contains("raw labels"),
        "{message}"
    );
    std::fs::copy(
        folder.path().join("images/v0.png"),
        folder.path().join("images/v1.png"),
    )
    .expect("copied");
    let message = refusal().to_string();
    assert!(
        message.contains("building checkpoint") && message.contains("photos"),
        "{message}"
    );
}
