//! A full report on made-up data.

use coseg::config::{Config, Variant};
use coseg::data::{Class, Classes, LabelMap, Split, View};
use coseg::metrics::{ImageScores, PixelScores};
use coseg::pipeline::Seconds;
use coseg::progress::Review;
use coseg::report::{
    BuildingHistory, Command, HeldOutView, History, Metrics, Report, TestScores, VariantHistory,
    VariantScores,
};
use coseg::splat::camera::Camera;
use glam::{DMat3, DVec3};
use std::path::PathBuf;

pub const WIDTH: usize = 240;
pub const HEIGHT: usize = 180;

/// Five classes, names that HTML escapes among them.
pub fn classes() -> Classes {
    let names = ["wall", "floor", "sofa", "table & chairs", "lamp <tall>"];
    let colors = [
        [174, 199, 232],
        [152, 118, 84],
        [214, 39, 40],
        [44, 160, 44],
        [255, 187, 40],
    ];
    let entries = (1..)
        .zip(names)
        .zip(colors)
        .map(|((id, name), color)| Class {
            id,
            name: name.into(),
            color,
            object_of: None,
        });
    Classes {
        entries: entries.collect(),
        ignore: 0,
    }
}

/// Ids of a made-up room; `wobble` moves the borders.
pub fn labels(wobble: f64) -> LabelMap {
    let id = |x: f64, y: f64| {
        let (x, y) = (x + wobble * (y / 9.0).sin(), y + wobble * (x / 7.0).cos());
        match () {
            () if x < 3.0 => 0,
            () if (x - 190.0).hypot(y - 50.0) < 22.0 => 5,
            () if (20.0..100.0).contains(&x) && (80.0..135.0).contains(&y) => 3,
            () if (120.0..200.0).contains(&x) && (105.0..150.0).contains(&y) => 4,
            () if y > 115.0 => 2,
            () => 1,
        }
    };
    let ids = (0..HEIGHT)
        .flat_map(|y| (0..WIDTH).map(move |x| id(x as f64, y as f64)))
        .collect();
    LabelMap {
        width: WIDTH,
        height: HEIGHT,
        ids,
    }
}

fn views(classes: &Classes) -> Vec<View> {
    let (w, h) = (WIDTH as f64, HEIGHT as f64);
    let camera = Camera {
        rotation: DMat3::IDENTITY,
        center: DVec3::ZERO,
        fx: w,
        fy: w,
        cx: w / 2.0,
        cy: h / 2.0,
        width: WIDTH,
        height: HEIGHT,
    };
    let truth = labels(0.0);
    let photo = image::RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, y| {
        let id = truth.ids[y as usize * WIDTH + x as usize];
        let base = classes
            .index(id)
            .map_or([60, 60, 60], |i| classes.entries[i].color);
        let shade = 0.55 + 0.35 * f64::from(y) / h + 0.1 * (f64::from(x * y) / 40.0).sin();
        image::Rgb(base.map(|c| (f64::from(c) * shade) as u8))
    });
    let view = |i: usize| View {
        name: format!("test_{i:03}"),
        split: Split::Test,
        camera: camera.clone(),
        image: photo.clone().into(),
        mask: None,
        truth: Some(truth.clone().into()),
        raw: Some(labels(9.0 + i as f64).into()),
        scores: None,
        segments: Vec::new(),
        corrected: None,
        instances: None,
    };
    (0..8).map(view).collect()
}

fn curve(steps: usize, from: f64, to: f64, pace: f64) -> Vec<(usize, f64)> {
    let value = |i: usize| {
        to + (from - to) * (-pace * i as f64 / steps as f64).exp() * (1.0 + 0.05 * (i as f64).sin())
    };
    (0..=steps)
        .step_by((steps / 700).max(1))
        .map(|i| (i, value(i)))
        .collect()
}

fn sparse(steps: usize, from: f64, to: f64, pace: f64) -> Vec<(usize, f64)> {
    (0..=10)
        .map(|i| {
            (
                i * steps / 10,
                to + (from - to) * (-pace * i as f64 / 10.0).exp(),
            )
        })
        .collect()
}

fn scores(miou: f64, trained: bool) -> VariantScores {
    VariantScores {
        pixels: PixelScores {
            miou: Some(miou),
            miou_per_view: Some(miou + 0.013),
            accuracy: Some(0.5 + 0.5 * miou),
        },
        void_left_out: (miou < 0.65).then_some(PixelScores {
            miou: Some(miou + 0.02),
            miou_per_view: Some(miou + 0.03),
            accuracy: Some(0.82),
        }),
        class_iou: (1..6_u16)
            .map(|id| (id, miou - 0.0625 * (f64::from(id) - 3.0)))
            .collect(),
        iterations: trained.then_some(2_000),
        learning_rate: trained.then_some(1e-3),
        seconds: trained.then_some(74.2),
        ..VariantScores::default()
    }
}

fn history() -> History {
    let row = |row, miou: f64, loss: f64| VariantHistory {
        variant: row,
        loss: curve(2_000, 2.1, loss, 7.0),
        miou: sparse(2_000, 0.1, miou, 6.0),
    };
    History {
        building: BuildingHistory {
            loss: curve(7_000, 0.31, 0.021, 6.0),
            psnr: sparse(7_000, 11.0, 31.4, 5.0),
            ssim: sparse(7_000, 0.3, 0.941, 5.0),
            gaussians: sparse(7_000, 8_000.0, 41_250.0, 4.0),
            reviews: vec![Review {
                iteration: 1_000,
                gaussians: 48_000,
                kept: 39_250,
                psnr_before: 28.42,
                psnr_after: 28.38,
                psnr_trained: 29.75,
            }],
        },
        rows: vec![
            row(Variant::PerGaussian, 0.712, 0.31),
            row(Variant::NoDecoder, 0.801, 0.24),
            row(Variant::Ours, 0.834, 0.11),
        ],
    }
}

pub fn metrics() -> Metrics {
    let rows = [
        (Variant::Raw, 0.612, false),
        (Variant::Vote, 0.798, false),
        (Variant::PerGaussian, 0.712, true),
    ];
    let more = [
        (Variant::NoDecoder, 0.801, true),
        (Variant::Ours, 0.834, true),
    ];
    Metrics {
        association: None,
        scene: "a made-up room".into(),
        gaussians: 41_250,
        test: TestScores {
            psnr: Some(31.42),
            ssim: Some(0.9412),
            views: [(
                "test_000".to_owned(),
                ImageScores {
                    psnr: Some(31.1),
                    ssim: Some(0.94),
                },
            )]
            .into(),
            labels: rows
                .into_iter()
                .chain(more)
                .map(|(row, miou, trained)| (row, scores(miou, trained)))
                .collect(),
        },
        seconds: Seconds {
            building: 141.0,
            features: 12.4,
            unprojection: 6.2,
            segmentation: 96.0,
            total: 262.0,
        },
        ranks: None,
        peak_memory_bytes: Some(1_310_000_000),
        learnable_bytes: [
            ("gaussians".to_owned(), 9_735_000),
            ("decoder".to_owned(), 1_120_000),
        ]
        .into(),
        spatial: "trained here".into(),
        features: "built-in descriptor".into(),
        commands: [
            (
                "coseg train --set data.raw_labels=\"labels\"",
                "ndarray, 2 threads",
            ),
            ("coseg train --resume <x>", "wgpu"),
        ]
        .map(|(line, device)| Command {
            line: line.into(),
            device: device.into(),
            version: "0.1.0".into(),
        })
        .into(),
        curves: history(),
    }
}

/// Hands a full report on made-up data to `check`.
pub fn with_report(check: impl FnOnce(&Report<'_>)) {
    let classes = classes();
    let config = Config::default();
    let views = views(&classes);
    let held_out = |(i, view): (usize, &'_ View)| {
        let noise = |j: usize| 0.04 * ((j * 7919 + i) as f32).sin();
        view.rgb()
            .unwrap()
            .into_iter()
            .enumerate()
            .map(|(j, v)| v + noise(j))
            .collect::<Vec<f32>>()
    };
    let rgbs: Vec<Vec<f32>> = views.iter().enumerate().map(held_out).collect();
    let held_out = views.iter().zip(rgbs).map(|(view, rgb)| HeldOutView {
        view,
        rgb,
        scores: ImageScores {
            psnr: Some(31.1),
            ssim: Some(0.94),
        },
        labels: vec![
            (Variant::Vote, labels(5.0)),
            (Variant::PerGaussian, labels(7.0)),
            (Variant::Ours, labels(2.0)),
        ],
    });
    check(&Report {
        metrics: metrics(),
        classes: &classes,
        config: &config,
        held_out: views.len(),
        views: held_out.collect(),
        notes: vec!["The raw labels are simulated: made from the true labels with errors.".into()],
    });
}

/// Where tests write: a folder that goes away, or the one that `COSEG_KEEP` names, to look at the page.
pub fn folder() -> (Option<tempfile::TempDir>, PathBuf) {
    if let Some(kept) = std::env::var_os("COSEG_KEEP") {
        return (None, kept.into());
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_owned();
    (Some(folder), path)
}
