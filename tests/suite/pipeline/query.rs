//! Feature maps with all channels on Gaussians, in parts, compared with phrases.

use crate::support::devices;
use crate::support::feature_maps::write_npy;
use crate::support::plates::loaded;
use crate::support::program::listed;
use coseg::config::{Config, Normalisation};
use coseg::data::Split;
use coseg::features::FeatureMap;
use coseg::pipeline::LiftedMaps;
use coseg::raster::Settings;
use coseg::segmentation::unprojection::LiftedViews;

const CHANNELS: usize = 7;
/// Height and width of each scale.
const SIZES: [[usize; 2]; 2] = [[16, 20], [3, 4]];

fn wave(count: usize, step: f32) -> Vec<f32> {
    (0..count).map(|i| (i as f32 * step).sin()).collect()
}

/// Vectors of length 1.
fn directions(values: &[f32]) -> Vec<f32> {
    let rows = values.chunks_exact(CHANNELS);
    let direction = |row: &[f32]| {
        let length = row.iter().map(|v| v * v).sum::<f32>().sqrt();
        row.iter().map(|v| v / length).collect::<Vec<_>>()
    };
    rows.flat_map(direction).collect()
}

#[test]
fn parts_of_the_channels_give_what_all_of_them_give_on_every_device() {
    let (scene, gaussians, _, folder) = loaded();
    let maps = folder.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    let n = gaussians.len();
    let phrases = directions(&wave(3 * CHANNELS, 1.7));
    let phrases: Vec<Vec<f32>> = phrases
        .chunks_exact(CHANNELS)
        .map(<[f32]>::to_vec)
        .collect();
    let settings = Settings::default();
    let device = crate::support::device();
    let mut plain = LiftedViews::new(&gaussians, &[CHANNELS; 2], Normalisation::Weight, &device);
    for (number, view) in scene.split(Split::Train).enumerate() {
        let lifted: Vec<FeatureMap> = (1..)
            .zip(SIZES)
            .map(|(scale, [height, width])| {
                let values = wave(
                    height * width * CHANNELS,
                    0.3 + 0.17 * (number + scale) as f32,
                );
                let path = maps.join(format!("{}.{scale}.npy", view.name));
                write_npy(&path, &[height, width, CHANNELS].map(|v| v as u64), &values);
                FeatureMap {
                    data: directions(&values),
                    ..FeatureMap::zeros(height, width, CHANNELS)
                }
            })
            .collect();
        plain.add(&view.camera, &lifted, None, &settings).unwrap();
    }
    let plain = plain.features().unwrap();
    let config = Config::default();
    for (name, device) in devices() {
        for (bytes, files) in [(usize::MAX, 1), (4 * 2 * n * 3, 3), (0, CHANNELS)] {
            let cache = folder.path().join(format!("cache_{name}_{files}"));
            let lifted = LiftedMaps {
                folder: &maps,
                scene: &scene,
                gaussians: &gaussians,
                config: &config,
                cache: &cache,
                device: &device,
                most_bytes: bytes,
            };
            let mut steps = Vec::new();
            let first = lifted.similarities(&phrases, &mut |done, all| steps.push((done, all)));
            let first = first.unwrap();
            assert_eq!(steps.last(), Some(&(4 * files, 4 * files)), "{name}");
            assert!(steps.is_sorted(), "{steps:?}");
            assert_eq!(listed(&cache).len(), files, "{name}");
            assert_eq!(
                lifted.similarities(&phrases, &mut |_, _| ()).unwrap(),
                first,
                "{name}: kept"
            );
            assert_eq!(first.len(), SIZES.len());
            for (scale, similarities) in first.iter().enumerate() {
                let found = similarities.relevancy(0, &[1, 2]);
                for (row, found) in plain[scale].chunks_exact(CHANNELS).zip(found) {
                    let dot =
                        |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
                    let length = dot(row, row).sqrt();
                    let share = |other: usize| {
                        let difference = dot(row, &phrases[other]) - dot(row, &phrases[0]);
                        1.0 / (1.0 + (10.0 * difference / length).exp())
                    };
                    let want = if length > 0.0 {
                        share(1).min(share(2))
                    } else {
                        0.0
                    };
                    assert!((found - want).abs() < 1e-3, "{name}: {found} {want}");
                }
            }
        }
    }
}
