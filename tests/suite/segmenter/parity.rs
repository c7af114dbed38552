//! The network of `../shared` against the labels of its reference script, and how long a photo takes.

use crate::support::shared_dir;
use coseg::data::LabelMap;
use coseg::segmenter::{Contract, Mapping, Network};
use std::path::Path;
use std::time::Instant;

/// Share of pixels that are equal, over photos of a room, and seconds a photo.
fn room(network: &Network, room: &Path, every: usize) -> (f64, f64, usize) {
    let mut names: Vec<_> = std::fs::read_dir(room.join("labels_ade150"))
        .expect("labels")
        .map(|e| e.expect("entry").path())
        .collect();
    names.sort();
    let mapping = Mapping::all(&network.contract);
    let (mut equal, mut all, mut photos) = (0, 0, 0);
    let clock = Instant::now();
    for path in names.iter().step_by(every) {
        let stem = path.file_stem().expect("stem").to_string_lossy();
        let photo = ["png", "jpg"]
            .iter()
            .map(|end| room.join(format!("images/{stem}.{end}")))
            .find(|file| file.is_file());
        let photo = image::open(photo.expect("photo"))
            .expect("decode")
            .into_rgb8();
        let (map, _) = network.run(&photo).expect("run").labels(&mapping, 3);
        let expected = LabelMap::read(path).expect("labels");
        assert_eq!((map.width, map.height), (expected.width, expected.height));
        equal += map
            .ids
            .iter()
            .zip(&expected.ids)
            .filter(|(a, b)| a == b)
            .count();
        all += map.ids.len();
        photos += 1;
    }
    (
        equal as f64 / all as f64,
        clock.elapsed().as_secs_f64() / f64::from(photos),
        photos as usize,
    )
}

#[test]
fn labels_equal_those_of_the_reference() {
    let Some(shared) = shared_dir() else {
        return;
    };
    let file = shared.join("weights/deeplab_ade20k/deeplab_mnv2_ade20k.onnx");
    let network =
        Network::load(&file, Contract::find(&file, None).expect("shipped")).expect("network");
    let all = std::env::var_os("COSEG_ALL_PHOTOS").is_some();
    for name in ["house_living", "house_kitchen", "studio"] {
        let (equal, seconds, photos) = room(
            &network,
            &shared.join("data").join(name),
            if all { 1 } else { 30 },
        );
        println!(
            "{name}: {photos} photos, {:.2} % of pixels equal, {seconds:.2} s a photo on one thread",
            100.0 * equal
        );
        assert!(equal >= 0.98, "{name}: {equal}");
    }
}
