//! Score files: what they give back, and one broken in each field.

use crate::support::assert_names;
use coseg::data::{ScoreGrid, ScoreMap};
use std::path::Path;

/// Three classes at 3 x 2 cells of a photo of 12 x 8 pixels.
fn scores() -> ScoreMap {
    let grid = ScoreGrid { photo: [12, 8], scale: [0.25; 2], offset: [-0.5; 2] };
    ScoreMap {
        grid,
        width: 3,
        height: 2,
        classes: 2,
        id_limit: 10,
        ids: vec![1, 1, 2, 3, 9, 4, 5, 0, 1, 0, 3, 0],
        probabilities: vec![200, 255, 128, 130, 100, 99, 55, 0, 127, 0, 80, 0],
    }
}

fn write(scores: &ScoreMap, path: &Path) -> coseg::Result<()> {
    scores.write(path)
}

#[test]
fn a_file_gives_back_what_was_written() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.scores");
    write(&scores(), &path).expect("write");
    assert_eq!(ScoreMap::read(&path).expect("read"), scores());
}

#[test]
fn scores_that_cannot_be_are_refused() {
    let path = Path::new("never-written.scores");
    let cases: [(fn(&mut ScoreMap), &str); 11] = [
        (|s| s.probabilities[6] = 56, "255 at most"),
        (|s| s.probabilities.swap(2, 8), "255 at most"),
        (|s| s.probabilities[8] = 129, "descend"),
        (|s| s.ids[0] = 10, "below 10"),
        (|s| s.ids[6] = 1, "different class ids"),
        (|s| s.width = 4, "tensors"),
        (|s| s.classes = 0, "tensors"),
        (|s| s.grid.scale[1] = 0.0, "grid"),
        (|s| s.grid.scale[0] = f64::INFINITY, "grid"),
        (|s| s.grid.offset[0] = f64::NAN, "grid"),
        (|s| s.grid.photo[1] = 0, "grid"),
    ];
    for (spoil, named) in cases {
        let mut spoilt = scores();
        spoil(&mut spoilt);
        if spoilt == scores() {
            continue;
        }
        assert_names(&write(&spoilt, path).expect_err(named), &["never-written.scores", named]);
    }
    let large = ScoreMap { width: 1 << 14, height: 1 << 13, ..scores() };
    assert!(matches!(write(&large, path), Err(coseg::Error::Limit { .. })));
    assert!(!path.exists());
}

#[test]
fn damaged_files_are_errors() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.scores");
    write(&scores(), &path).expect("write");
    let bytes = std::fs::read(&path).expect("read");
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).expect("write");
        ScoreMap::read(&path)
    };
    for end in 0..bytes.len() {
        assert!(read(&bytes[..end]).is_err(), "cut off after {end}");
    }
    for at in 0..bytes.len() {
        for bit in 0..8 {
            let mut spoilt = bytes.clone();
            spoilt[at] ^= 1 << bit;
            // The checksum of zlib covers everything but its own header's level.
            if let Ok(found) = read(&spoilt) {
                assert_eq!(found, scores());
            }
        }
    }
    let longer = [&bytes[..], &[0]].concat();
    assert_names(&read(&longer).expect_err("longer"), &["data after the end"]);
    assert_names(&read(b"\x89PNG").expect_err("a PNG"), &["a.scores", "compressed data"]);
    assert!(ScoreMap::read(&folder.path().join("none.scores")).is_err());
}

#[test]
fn tensors_of_other_kinds_are_named() {
    use flate2::{Compression, write::ZlibEncoder};
    use safetensors::tensor::{Dtype, TensorView};
    use std::collections::HashMap;
    use std::io::Write;
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("a.scores");
    let grid = r#"{"grid":{"photo":[4,4],"scale":[0.5,0.5],"offset":[0,0]},"id_limit":9}"#;
    let read = |tensors: &[(&str, Dtype, &[usize])], key: &str, grid: &str| {
        let size = |kind: &Dtype| kind.bitsize() / 8;
        let zeros: Vec<Vec<u8>> = tensors.iter().map(|(_, kind, shape)| vec![0; size(kind) * shape.iter().product::<usize>()]).collect();
        let views = tensors.iter().zip(&zeros).map(|((name, kind, shape), bytes)| {
            (*name, TensorView::new(*kind, shape.to_vec(), bytes).expect("view"))
        });
        let bytes = safetensors::serialize(views, Some(HashMap::from([(key.to_owned(), grid.to_owned())]))).expect("file");
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(&bytes).expect("encode");
        std::fs::write(&path, encoder.finish().expect("encode")).expect("write");
        ScoreMap::read(&path)
    };
    let shape: &[usize] = &[1, 2, 2];
    let (ids, probabilities) = (("ids", Dtype::U16, shape), ("probabilities", Dtype::U8, shape));
    let key = "coseg scores 1";
    read(&[ids, probabilities], key, grid).expect("sound");
    let refused = |tensors: &[(&str, Dtype, &[usize])], key: &str, grid: &str, part: &str| {
        assert_names(&read(tensors, key, grid).expect_err(part), &["a.scores", part]);
    };
    refused(&[ids], key, grid, "tensor probabilities");
    refused(&[probabilities], key, grid, "tensor ids");
    refused(&[("ids", Dtype::U8, shape), probabilities], key, grid, "U16 [classes, height, width]");
    refused(&[ids, ("probabilities", Dtype::F32, shape)], key, grid, "U8 [classes, height, width]");
    refused(&[("ids", Dtype::U16, &[2, 2]), probabilities], key, grid, "tensor ids");
    refused(&[ids, ("probabilities", Dtype::U8, &[1, 2, 3])], key, grid, "[1, 2, 2], as of ids");
    refused(&[("ids", Dtype::U16, &[0, 2, 2]), ("probabilities", Dtype::U8, &[0, 2, 2])], key, grid, "at least one");
    refused(&[ids, probabilities], "coseg scores 0", grid, "this version");
    refused(&[ids, probabilities], key, &grid.replace("scale", "scales"), "metadata");
    refused(&[ids, probabilities], key, &grid.replace("[4,4]", "[4,-4]"), "metadata");
}
