//! More readers of files on thousands of damaged ones: feature maps, text encoders, photos without poses, edits.

use super::mutations::survives;
use crate::support::clip_weights::{Size, as_openai, generated};
use crate::support::dino_weights::write;
use crate::support::exif_photo::photo;
use crate::support::pictures::{picture, view};
use crate::support::plates::plates;
use crate::support::torch_file;
use coseg::capture::Capture;
use coseg::config::{FeatureConfig, FeatureSource};
use coseg::data::{Classes, Split};
use coseg::features::Extractor;
use coseg::features::clip::TextEncoder;
use coseg::objects::{Editing, Edits};
use coseg::progress::Silent;
use glam::DVec3;
use serde_json::json;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

#[test]
fn imported_features() {
    let dir = tempfile::tempdir().expect("folder");
    let config = FeatureConfig {
        source: FeatureSource::Import(dir.path().to_owned()),
        ..FeatureConfig::default()
    };
    let extractor = Extractor::open(&config, &crate::support::device()).expect("a folder");
    let view = view("v", Split::Train, picture(16, 12, 1), None);
    let text = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 2, 3), }";
    let mut npy = b"\x93NUMPY\x01\0".to_vec();
    npy.extend((text.len() as u16).to_le_bytes());
    npy.extend(text.bytes());
    npy.extend([0.5_f32; 12].iter().flat_map(|v| v.to_le_bytes()));
    for n in 1..=4 {
        fs::write(dir.path().join(format!("v.{n}.npy")), &npy).expect("write");
    }
    extractor.maps(&view).expect("maps");
    let file = dir.path().join("v.1.npy");
    survives(&file, |_| extractor.maps(&view));
    // A safetensors file goes before them.
    let bundle = dir.path().join("v.safetensors");
    let scale = |n| (format!("scale{n}"), (vec![2, 2, 3], vec![0.5; 12]));
    write(&bundle, &(1..=4).map(scale).collect());
    extractor.maps(&view).expect("maps");
    survives(&bundle, |_| extractor.maps(&view));
    fs::remove_file(bundle).expect("removed");
    // 16 nested dictionaries took the parser of such headers for ever.
    let nested = [&b"\x93NUMPY\x01\0\x10\0"[..], &[b'{'; 16]].concat();
    fs::write(&file, nested).expect("write");
    let message = extractor.maps(&view).expect_err("nested").to_string();
    assert!(
        message.contains("v.1.npy: header: found nested values"),
        "{message}"
    );
}

/// The smallest text encoder.
const TINY: Size = Size {
    vocabulary: 5,
    width: 64,
    hidden: 3,
    blocks: 1,
    positions: 4,
    projection: 2,
};

#[test]
fn text_encoders() {
    let dir = tempfile::tempdir().expect("folder");
    let device = crate::support::device();
    let weights = dir.path().join("clip.safetensors");
    // The names of Hugging Face, and those of OpenAI and OpenCLIP.
    for tensors in [generated(TINY), as_openai(generated(TINY))] {
        write(&weights, &tensors);
        TextEncoder::load(&weights, &device).expect("weights");
        // Most of the file are values, so its header is changed by itself.
        let whole = fs::read(&weights).expect("read");
        let (length, rest) = whole.split_at(8);
        let length = u64::from_le_bytes(length.try_into().expect("8 bytes"));
        let (header, values) = rest.split_at(length as usize);
        let file = dir.path().join("header");
        fs::write(&file, header).expect("write");
        survives(&file, |file| {
            let header = fs::read(file).expect("read");
            let length = (header.len() as u64).to_le_bytes();
            fs::write(&weights, [&length[..], &header, values].concat()).expect("write");
            TextEncoder::load(&weights, &device)
        });
    }
    let config = dir.path().join("config.json");
    fs::write(
        &config,
        json!({ "text_config": { "hidden_act": "gelu" } }).to_string(),
    )
    .expect("write");
    TextEncoder::activation_beside(&weights).expect("a configuration");
    survives(&config, |_| TextEncoder::activation_beside(&weights));
}

#[test]
fn text_encoders_of_pytorch() {
    let dir = tempfile::tempdir().expect("folder");
    let device = crate::support::device();
    let weights = dir.path().join("open_clip_pytorch_model.bin");
    let state = torch_file::state_dict(&as_openai(generated(TINY)), "");
    let mut entries = torch_file::entries(&state);
    fs::write(&weights, torch_file::zip(&entries)).expect("write");
    TextEncoder::load(&weights, &device).expect("weights");
    survives(&weights, |file| TextEncoder::load(file, &device));
    // Checksums of the archive may hide what is changed in the pickle, so that they follow it.
    let pickle = dir.path().join("pickle");
    fs::write(&pickle, &entries[0].1).expect("write");
    let values = entries.split_off(1);
    survives(&pickle, |pickle| {
        let changed = fs::read(pickle).expect("read");
        let whole = [&[(entries[0].0.clone(), changed)], &values[..]].concat();
        fs::write(&weights, torch_file::zip(&whole)).expect("write");
        TextEncoder::load(&weights, &device)
    });
}

/// A folder in memory where the system has such a place: files that are written whole are synced, which takes time on a disk.
fn memory() -> TempDir {
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir());
    folder.expect("folder")
}

/// A scene folder of the photos in `photos`; its poses are taken to be there, so that COLMAP is not run.
fn capture(photos: &Path, masks: Option<&Path>, out: &Path) -> coseg::Result<()> {
    let capture = Capture {
        source: photos,
        masks,
        frames: 2,
        python: Some(Path::new("/nothing/python")),
    };
    capture.make(out, &mut Silent).map(drop)
}

/// The record of a scene folder whose photos are not copied yet.
fn begun(out: &Path) {
    let record = json!({ "source": "", "input": "", "photos": 0, "poses": "colmap" });
    fs::create_dir_all(out).expect("folder");
    fs::write(out.join("from-photos.json"), record.to_string()).expect("write");
}

#[test]
fn photos_with_damaged_exif() {
    let dir = memory();
    let (photos, out) = (dir.path().join("photos"), dir.path().join("room"));
    fs::create_dir(&photos).expect("folder");
    for name in ["a.jpg", "b.jpg"] {
        photo(&photos.join(name), (16, 12), 6);
    }
    begun(&out);
    capture(&photos, None, &out).expect("photos");
    // The segment behind the first two bytes, with a length that does not count its marker.
    let whole = fs::read(photos.join("a.jpg")).expect("read");
    let end = 4 + usize::from(u16::from_be_bytes([whole[4], whole[5]]));
    let segment = dir.path().join("exif");
    fs::write(&segment, &whole[2..end]).expect("write");
    survives(&segment, |segment| {
        let segment = fs::read(segment).expect("read");
        let damaged = [&whole[..2], &segment, &whole[end..]].concat();
        fs::write(photos.join("a.jpg"), damaged).expect("write");
        fs::remove_dir_all(&out).expect("removed");
        begun(&out);
        capture(&photos, None, &out)
    });
}

#[test]
fn masks_of_photos() {
    let dir = memory();
    let [photos, masks, out] = ["photos", "masks", "room"].map(|name| dir.path().join(name));
    fs::create_dir(&photos).expect("folder");
    fs::create_dir(&masks).expect("folder");
    for name in ["a.jpg", "b.jpg"] {
        photo(&photos.join(name), (16, 12), 6);
    }
    let mask = masks.join("a.png");
    let picture = image::GrayImage::from_fn(16, 12, |x, _| [if x < 5 { 0 } else { 255 }].into());
    picture.save(&mask).expect("PNG");
    let read = || {
        if out.exists() {
            fs::remove_dir_all(&out).expect("removed");
        }
        begun(&out);
        capture(&photos, Some(&masks), &out)
    };
    read().expect("a mask");
    survives(&mask, |_| read());
    // Checksums hide most changes, so that they follow these.
    let file = dir.path().join("changed");
    fs::copy(&mask, &file).expect("copied");
    survives(&file, |file| {
        let changed = checksummed(fs::read(file).expect("read"));
        fs::write(&mask, changed).expect("write");
        read()
    });
}

/// A PNG file with right checksums, as far as it has chunks.
fn checksummed(mut png: Vec<u8>) -> Vec<u8> {
    let mut start = 8;
    while let Some(length) = png.get(start..start + 4) {
        let length = u32::from_be_bytes(length.try_into().expect("4 bytes")) as usize;
        let end = start + 8 + length;
        let Some(chunk) = png.get(start + 4..end) else {
            break;
        };
        let mut sum = flate2::Crc::new();
        sum.update(chunk);
        let sum = sum.sum().to_be_bytes();
        let place = png.iter_mut().skip(end).take(4);
        place.zip(sum).for_each(|(byte, new)| *byte = new);
        start = end + 4;
    }
    png
}

#[test]
fn records_of_scene_folders() {
    let dir = memory();
    let (photos, out) = (dir.path().join("photos"), dir.path().join("room"));
    fs::create_dir(&photos).expect("folder");
    for name in ["a.png", "b.png"] {
        picture(16, 12, 1).save(photos.join(name)).expect("photo");
    }
    begun(&out);
    capture(&photos, None, &out).expect("photos");
    survives(&out.join("from-photos.json"), |_| {
        capture(&photos, None, &out)
    });
}

#[test]
fn edits() {
    let dir = tempfile::tempdir().expect("folder");
    let file = dir.path().join("edits.json");
    let edits = json!({ "version": 1, "scene": "00ff", "operations": [
        { "op": "rename", "object": 1, "name": "rug" },
        { "op": "recolor", "object": 2, "color": [1, 2, 3] },
        { "op": "assign", "gaussians": [75, 110, 0], "object": 10, "new": { "name": "door", "color": [9, 8, 7] } },
        { "op": "merge", "objects": [1, 3], "into": 2 },
        { "op": "delete_gaussians", "gaussians": [25, 26] },
        { "op": "move", "object": 10, "shift": [0, 0, 2], "turn": { "axis": [0, 0, 2], "degrees": 90, "pivot": [1, 0, -7] } },
        { "op": "delete_objects", "objects": [4] },
    ] });
    fs::write(&file, edits.to_string()).expect("write");
    let apply = |file: &Path| {
        let names = [(1, "red"), (2, "green"), (3, "blue"), (4, "wall")];
        let (gaussians, labels) = plates();
        let mut editing = Editing::new(gaussians, labels, Classes::from_names(0, names));
        Edits::read(file)?.apply(&mut editing, "00ff", DVec3::ZERO)?;
        editing.finish("--edits")
    };
    apply(&file).expect("edits");
    survives(&file, apply);
}
