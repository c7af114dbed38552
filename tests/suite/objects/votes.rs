//! What `coseg vote` takes for votes.

use crate::support::plates::{HEIGHT, WIDTH, scene};
use crate::support::program::{fails, utf8};
use coseg::data::LabelMap;
use image::{GrayImage, Luma};

#[test]
fn segments_of_single_views_are_not_voted_for() {
    let folder = tempfile::tempdir().unwrap();
    let ply = scene(folder.path());
    let out = folder.path().join("out");
    let vote = [
        "vote",
        "--scene",
        utf8(&ply),
        "--data",
        utf8(folder.path()),
        "--out",
        utf8(&out),
    ];
    let message = fails(
        &[&vote[..], &["--set", "data.association=gaussians"]].concat(),
        1,
    );
    for word in [
        "data.association",
        "found \"gaussians\"",
        "`coseg associate`",
    ] {
        assert!(message.contains(word), "{word}: {message}");
    }

    // A folder of masks, one a segment.
    for i in 0..6 {
        let masks = folder.path().join(format!("sam/v{i}"));
        std::fs::create_dir_all(&masks).unwrap();
        let mask = GrayImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, _| {
            Luma([if x < 30 { 255 } else { 0 }])
        });
        mask.save(masks.join("0.png")).unwrap();
    }
    let message = fails(&[&vote[..], &["--set", "data.raw_labels=sam"]].concat(), 1);
    assert!(
        message.contains("folders of masks") && message.contains("`coseg associate`"),
        "{message}"
    );
    // Ids that the class table does not have.
    for i in 0..6 {
        let map = LabelMap {
            width: WIDTH,
            height: HEIGHT,
            ids: vec![700; WIDTH * HEIGHT],
        };
        map.write_wide(&folder.path().join(format!("segments/v{i}.png")))
            .unwrap();
    }
    let message = fails(
        &[&vote[..], &["--set", "data.raw_labels=segments"]].concat(),
        1,
    );
    assert!(
        message.contains("700") && message.contains("`coseg associate`"),
        "{message}"
    );
    assert!(!out.exists());
}
