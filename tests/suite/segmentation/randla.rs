//! The RandLA encoder against stored activations of the published one.

use burn::tensor::{Tensor, TensorData};
use coseg::Error;
use coseg::config::{SpatialConfig, SpatialSource};
use coseg::segmentation::encoder::{Cloud, EncodedLevel, encode, load_spatial, random_weights};
use coseg::segmentation::neighbours::Neighbours;
use coseg::segmentation::randla::RandlaEncoder;
use coseg::segmentation::sampling::{Hierarchy, LAYERS, SampledLevel};
use coseg::weights::WeightFile;
use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use safetensors::SafeTensors;

/// The stored cloud with its stored indices, and its stored activations as `[N, channels]`.
struct Reference {
    hierarchy: Hierarchy,
    input: Vec<f32>,
    levels: Vec<Vec<f32>>,
    coarsest: Vec<f32>,
}

fn floats(file: &SafeTensors, name: &str) -> Vec<f32> {
    let view = file.tensor(name).expect(name);
    view.data()
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect()
}

fn integers(file: &SafeTensors, name: &str) -> Vec<u32> {
    let view = file.tensor(name).expect(name);
    view.data()
        .chunks_exact(4)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect()
}

/// `[channels, points]` to `[points, channels]`.
fn rows(values: &[f32], points: usize) -> Vec<f32> {
    let channels = values.len() / points;
    (0..values.len())
        .map(|i| values[i % channels * points + i / channels])
        .collect()
}

fn reference(bytes: &[u8]) -> Reference {
    let file = SafeTensors::deserialize(bytes).expect("a safetensors file");
    let mut hierarchy = Hierarchy::default();
    for n in 0..LAYERS {
        let xyz = floats(&file, &format!("xyz.{n}"));
        let positions: Vec<[f32; 3]> = xyz.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
        let neighbours = Neighbours {
            k: 16,
            indices: integers(&file, &format!("neigh_idx.{n}")),
        };
        let kept = positions.len() / 4;
        assert_eq!(
            neighbours.indices[..kept * 16],
            integers(&file, &format!("sub_idx.{n}")),
            "the first quarter is kept"
        );
        let indices = (0..positions.len() as u32).collect();
        hierarchy.levels.push(SampledLevel {
            indices,
            positions,
            neighbours,
            kept: (0..kept as u32).collect(),
        });
    }
    let points = |n: usize| hierarchy.levels[n].positions.len();
    let levels = (0..LAYERS)
        .map(|n| rows(&floats(&file, &format!("enc_out.{n}")), points(n)))
        .collect();
    let input = rows(&floats(&file, "features_in"), points(0));
    let coarsest = rows(&floats(&file, "enc_sampled.3"), points(3) / 4);
    Reference {
        hierarchy,
        input,
        levels,
        coarsest,
    }
}

fn largest_difference(found: Tensor<2>, stored: &[f32]) -> f64 {
    let found: Vec<f32> = found.into_data().into_vec().expect("f32");
    assert_eq!(found.len(), stored.len());
    assert!(found.iter().all(|v| v.is_finite()));
    found
        .iter()
        .zip(stored)
        .map(|(a, b)| f64::from((a - b).abs()))
        .fold(0.0, f64::max)
}

#[test]
fn encoder_equals_the_published_one_on_its_stored_activations() {
    let Some(dir) = crate::support::shared_dir() else {
        return;
    };
    let dir = dir.join("weights/randlanet");
    let weights =
        WeightFile::open(dir.join("randlanet_semantickitti.safetensors")).expect("weights");
    let bytes = std::fs::read(dir.join("randlanet_parity_4096.safetensors")).expect("reference");
    let reference = reference(&bytes);
    let device = crate::support::device();
    for chunked in [false, true] {
        let encoder = RandlaEncoder::load(&weights, &device).expect("RandLA weights");
        assert_eq!(
            (encoder.inputs(), encoder.widths()),
            (3, vec![32, 128, 256, 512])
        );
        let input =
            Tensor::<2>::from_data(TensorData::new(reference.input.clone(), [4096, 3]), &device);
        let (levels, coarsest) = encoder.encode_levels(input, &reference.hierarchy, chunked);
        for (n, (found, stored)) in levels.into_iter().zip(&reference.levels).enumerate() {
            let difference = largest_difference(found, stored);
            eprintln!(
                "chunked {chunked}, level {}: largest difference {difference:.2e}",
                n + 1
            );
            assert!(difference < 2e-3, "level {}: {difference}", n + 1);
        }
        let difference = largest_difference(coarsest, &reference.coarsest);
        eprintln!("chunked {chunked}, coarsest: largest difference {difference:.2e}");
        assert!(difference < 2e-3, "coarsest: {difference}");
    }
}

fn room(count: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // the six sides of a box, as a scan would see them
    (0..count)
        .map(|_| {
            let mut p: [f32; 3] = std::array::from_fn(|_| rng.random_range(-2.0f32..2.0));
            p[rng.random_range(0..3)] = if rng.random_bool(0.5) { 2.0 } else { -2.0 };
            p
        })
        .collect()
}

fn spatial(source: SpatialSource) -> SpatialConfig {
    SpatialConfig {
        source,
        ..SpatialConfig::default()
    }
}

/// Encoding 1e5 points is to take 5 seconds on 2 cores; the test allows for a busy machine.
#[test]
fn levels_of_a_hundred_thousand_points_are_a_quarter_each() {
    let device = crate::support::device();
    let points = room(100_000, 1);
    let cloud = Cloud {
        positions: &points,
        colors: None,
        up: DVec3::Z,
        scale: 1.0,
    };
    let mut encoders =
        vec![load_spatial(&spatial(SpatialSource::Random), 0, &device).expect("random weights")];
    if let Some(dir) = crate::support::shared_dir() {
        let weights = dir.join("weights/randlanet/randlanet_semantickitti.safetensors");
        let config = spatial(SpatialSource::Pretrained(weights));
        encoders.push(load_spatial(&config, 0, &device).expect("published weights"));
    }
    for (encoder, name) in encoders {
        let encoding = encode(&encoder, &cloud, 0, &device).expect("finite");
        let sizes: Vec<usize> = encoding
            .levels
            .iter()
            .map(|l| l.features.dims()[0])
            .collect();
        assert_eq!(
            (sizes, encoding.coarsest.features.dims()[0]),
            (vec![100_000, 25_000, 6_250, 1_562], 390),
            "{name}"
        );
    }
}

#[test]
fn the_first_blocks_give_the_first_levels() {
    let device = crate::support::device();
    let (encoder, _) =
        load_spatial(&spatial(SpatialSource::Random), 2, &device).expect("random weights");
    let points = room(2_000, 3);
    let cloud = Cloud {
        positions: &points,
        colors: None,
        up: DVec3::Z,
        scale: 1.0,
    };
    let features = |encoder: &RandlaEncoder| -> Vec<(Vec<u32>, Vec<f32>)> {
        let levels = encode(encoder, &cloud, 9, &device).expect("finite").levels;
        let level = |l: EncodedLevel| (l.indices, l.features.into_data().into_vec().expect("f32"));
        levels.into_iter().map(level).collect()
    };
    let all = features(&encoder);
    for count in 1..=4 {
        let first = features(&encoder.clone().first_blocks(count));
        assert_eq!(first, all[..count], "{count}");
    }
}

#[test]
fn encoding_follows_up_and_scale_and_repeats_at_any_thread_count() {
    let device = crate::support::device();
    let (encoder, _) =
        load_spatial(&spatial(SpatialSource::Random), 2, &device).expect("random weights");
    let points = room(4_000, 3);
    let features = |cloud: &Cloud, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        let encoding = pool
            .install(|| encode(&encoder, cloud, 9, &device))
            .expect("finite");
        let mut all: Vec<Vec<f32>> = encoding
            .levels
            .into_iter()
            .map(|l| l.features.into_data().into_vec().expect("f32"))
            .collect();
        all.push(
            encoding
                .coarsest
                .features
                .into_data()
                .into_vec()
                .expect("f32"),
        );
        all.concat()
    };
    let cloud = Cloud {
        positions: &points,
        colors: None,
        up: DVec3::Z,
        scale: 1.0,
    };
    let want = features(&cloud, 1);
    assert_eq!(want, features(&cloud, 2));
    // the same room in other units, elsewhere, and lying on its side: x to y to z to x
    let moved: Vec<[f32; 3]> = points
        .iter()
        .map(|[x, y, z]| [z * 4.0 + 8.0, x * 4.0 - 16.0, y * 4.0 + 4.0])
        .collect();
    let found = features(
        &Cloud {
            positions: &moved,
            colors: None,
            up: DVec3::X * 5.0,
            scale: 0.25,
        },
        2,
    );
    let upright = Cloud {
        positions: &moved,
        colors: None,
        up: DVec3::X,
        scale: 0.25,
    }
    .oriented()
    .expect("finite");
    let heights = upright.iter().zip(cloud.oriented().expect("finite"));
    assert!(
        heights.clone().all(|(a, b)| (a[2] - b[2]).abs() < 1e-5),
        "up is the third axis"
    );
    assert_eq!(found.len(), want.len());
    assert!(found.iter().all(|v| v.is_finite()));
}

#[test]
fn hard_clouds_encode_or_say_why_not() {
    let device = crate::support::device();
    let (encoder, _) =
        load_spatial(&spatial(SpatialSource::Random), 2, &device).expect("random weights");
    let run = |positions: &[[f32; 3]], scale: f64, up: DVec3| {
        encode(
            &encoder,
            &Cloud {
                positions,
                colors: None,
                up,
                scale,
            },
            0,
            &device,
        )
    };
    for points in [
        vec![[1.0, 2.0, 3.0]],
        vec![[0.5; 3]; 300],
        room(5, 1),
        room(17, 1),
    ] {
        let encoding = run(&points, 1.0, DVec3::Z).expect("small and identical clouds are fine");
        assert_eq!(encoding.levels[0].indices.len(), points.len());
        for level in encoding.levels.iter().chain([&encoding.coarsest]) {
            assert_eq!(level.features.dims()[0], level.indices.len());
        }
    }
    assert!(matches!(
        run(&[], 1.0, DVec3::Z),
        Err(Error::Argument { .. })
    ));
    assert!(matches!(
        run(&[[0.0; 3], [0.0, f32::NAN, 0.0]], 1.0, DVec3::Z),
        Err(Error::NonFinite { row: 1, .. })
    ));
    assert!(matches!(
        run(&room(50, 1), 0.0, DVec3::Z),
        Err(Error::Config { .. })
    ));
    assert!(matches!(
        run(&room(50, 1), 1.0, DVec3::ZERO),
        Err(Error::Argument { .. })
    ));
    let vast: Vec<[f32; 3]> = room(50, 1)
        .into_iter()
        .map(|p| p.map(|v| v * 1e37))
        .collect();
    assert!(
        matches!(run(&vast, 1.0, DVec3::Z), Err(Error::NonFinite { .. })),
        "features beyond f32 are an error"
    );
}

#[test]
fn encoders_of_colour_ask_for_it() {
    let device = crate::support::device();
    let encoder = RandlaEncoder::load(&random_weights(6, 1), &device).expect("weights");
    let points = room(200, 1);
    let run = |colors: Option<&[[f32; 3]]>| {
        encode(
            &encoder,
            &Cloud {
                positions: &points,
                colors,
                up: DVec3::Z,
                scale: 1.0,
            },
            0,
            &device,
        )
    };
    assert!(matches!(run(None), Err(Error::Argument { .. })));
    assert!(matches!(
        run(Some(&points[..7])),
        Err(Error::Argument { .. })
    ));
    assert_eq!(
        run(Some(&vec![[0.5; 3]; 200]))
            .expect("colours")
            .levels
            .len(),
        LAYERS
    );
}
