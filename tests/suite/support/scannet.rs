//! A ScanNet scene as its exporter writes it, small.

use coseg::data::LabelMap;
use std::fs;
use tempfile::TempDir;

pub const FRAMES: usize = 12;
/// Frames whose poses were lost.
const LOST: [usize; 2] = [4, 7];

fn pose(i: usize) -> String {
    if LOST.contains(&i) {
        return "-inf -inf -inf -inf\n".repeat(4);
    }
    format!("1 0 0 {i}\n0 0 1 0.5\n0 -1 0 1.5\n0 0 0 1\n")
}

/// Photos of 64x48, label maps of 32x24: wall and keyboard (an id that NYU40 has as otherprop), and unlabelled pixels.
pub fn scene() -> TempDir {
    let dir = tempfile::tempdir().expect("folder");
    let at = |p: String| dir.path().join(p);
    for folder in ["color", "depth", "pose", "intrinsic", "label-filt"] {
        fs::create_dir(at(folder.into())).expect("folder");
    }
    for i in 0..FRAMES {
        image::RgbImage::from_pixel(64, 48, image::Rgb([i as u8 * 9; 3]))
            .save(at(format!("color/{i}.jpg")))
            .expect("photo");
        fs::write(at(format!("pose/{i}.txt")), pose(i)).expect("pose");
        let ids = (0..32 * 24)
            .map(|k| {
                if k < 32 * 12 {
                    1
                } else {
                    [0, 1163][k % 32 / 16]
                }
            })
            .collect();
        LabelMap {
            width: 32,
            height: 24,
            ids,
        }
        .write(&at(format!("label-filt/{i}.png")))
        .expect("labels");
    }
    // Depth of one frame, of a different size than the photo.
    let depth = LabelMap {
        width: 8,
        height: 6,
        ids: vec![3000; 48],
    };
    depth.write(&at("depth/3.png".into())).expect("depth");
    let k = "60 0 31 0\n0 61 23 0\n0 0 1 0\n0 0 0 1\n";
    fs::write(at("intrinsic/intrinsic_color.txt".into()), k).expect("intrinsics");
    let table = "id\traw_category\tcategory\tcount\tnyu40id\teigen13id\n1\twall\twall\t8277\t1\t12\n\
        1163\tobject\tobject\t1\t40\t7\n2\tchair\tchair\t4646\t5\t4\n";
    fs::write(at("scannetv2-labels.combined.tsv".into()), table).expect("table");
    dir
}
