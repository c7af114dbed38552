//! Photos that are stored on their side: a network sees them upright.

use crate::support::exif_photo;
use crate::support::onnx::plates;
use crate::support::program::{succeeds, utf8};
use crate::support::transforms_json::edit;
use coseg::data::LabelMap;

#[test]
fn a_network_sees_photos_upright() {
    let (folder, scene, net) = plates();
    let photo = scene.join("images/v1.png");
    let upright = image::open(&photo).expect("a photo").into_rgb8();
    // Three quarter turns later it is upright again.
    let turned = image::imageops::rotate270(&upright);
    let labels = |name: &str| {
        let out = folder.path().join(name);
        let options = ["label", "--data", utf8(&scene), "--model", utf8(&net)];
        succeeds(&[&options[..], &["--out", utf8(&out)]].concat());
        LabelMap::read(&out.join("v1.png")).expect("a map")
    };
    let want = labels("upright");
    exif_photo::with_orientation(&photo, &turned, 6);
    edit(&scene, |file| {
        let frame = &mut file["frames"][1];
        frame["w"] = turned.width().into();
        frame["h"] = turned.height().into();
        for maps in ["label_path", "raw_label_path"] {
            frame.as_object_mut().expect("a frame").remove(maps);
        }
    });
    let found = labels("turned");
    assert_eq!((found.width, found.height), (want.height, want.width));
    for (i, id) in found.ids.iter().enumerate() {
        let (x, y) = (i % found.width, i / found.width);
        let there = x * want.width + want.width - 1 - y;
        assert_eq!(*id, want.ids[there], "{x} {y}");
    }
}
