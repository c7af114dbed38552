//! Label maps as annotations: the regions that the files describe are those of the maps.

use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::read_json;
use crate::support::raw_labels::{folder, options, raw};
use coseg::data::labels::annotations::{Categories, CocoInstances, Yolo};
use coseg::data::load;
use coseg::data::{Class, Classes, LabelMap, ObjectOf, Split};
use coseg::files::own;
use std::collections::BTreeMap;
use std::fs;

/// Regions with holes, corners that touch, and islands in holes.
const PICTURE: [&str; 9] = [
    "111111111..",
    "1.....1.1..",
    "1.222.111..",
    "1.2.2......",
    "1.222.111..",
    "1.....1.1..",
    "1111111.1..",
    ".......11.2",
    "3.3.3.3..2.",
];

fn map() -> LabelMap {
    let id = |byte: u8| u16::from(byte.saturating_sub(b'0')) * u16::from(byte != b'.');
    let ids = PICTURE.concat().bytes().map(id).collect();
    LabelMap {
        width: 11,
        height: 9,
        ids,
    }
}

/// Two chairs of one class, and a wall.
fn classes() -> Classes {
    let class = |id, name: &str, class| Class {
        id,
        name: name.into(),
        color: [id as u8; 3],
        object_of: Some(ObjectOf { class, thing: true }),
    };
    Classes {
        entries: vec![
            class(1, "chair 1", 7),
            class(2, "chair 2", 7),
            class(3, "wall", 4),
        ],
        ignore: 0,
    }
}

#[test]
fn coco_runs_are_the_pixels() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("instances.json");
    let mut coco = CocoInstances::new(&Categories::new(&classes(), [1, 2, 3, 0, 1]));
    coco.add("a.png".into(), &map());
    coco.add(
        "b.png".into(),
        &LabelMap {
            width: 2,
            height: 1,
            ids: vec![0, 3],
        },
    );
    coco.write(&path).expect("written");
    let file = read_json(&path);
    let categories = file["categories"].as_array().expect("categories");
    let names: Vec<_> = categories
        .iter()
        .map(|c| (c["id"].as_u64(), c["name"].as_str()))
        .collect();
    assert_eq!(names, [(Some(4), Some("wall")), (Some(7), Some("chair"))]);
    let annotations = file["annotations"].as_array().expect("annotations");
    let of = |key: &str| -> Vec<u64> {
        annotations
            .iter()
            .map(|a| a[key].as_u64().expect("a number"))
            .collect()
    };
    assert_eq!(of("id"), [1, 2, 3, 4]);
    assert_eq!(of("image_id"), [1, 1, 1, 2]);
    assert_eq!(of("label"), [1, 2, 3, 3]);
    assert_eq!(of("category_id"), [7, 7, 4, 4]);
    let LabelMap { width, height, ids } = map();
    let mut decoded = vec![0; ids.len()];
    for annotation in &annotations[..3] {
        let label = annotation["label"].as_u64().expect("a number");
        let runs: Vec<usize> =
            serde_json::from_value(annotation["segmentation"]["counts"].clone()).expect("runs");
        assert_eq!(
            annotation["segmentation"]["size"],
            serde_json::json!([height, width])
        );
        let flags = runs.iter().zip([0, label].into_iter().cycle());
        let column: Vec<u64> = flags
            .flat_map(|(&run, flag)| std::iter::repeat_n(flag, run))
            .collect();
        assert_eq!(column.len(), ids.len());
        let mut inside = Vec::new();
        for (i, flag) in column.into_iter().enumerate().filter(|(_, flag)| *flag > 0) {
            let (x, y) = (i / height, i % height);
            decoded[y * width + x] = flag as u16;
            inside.push((x, y));
        }
        assert_eq!(annotation["area"], inside.len());
        let [left, top] = [
            inside.iter().map(|p| p.0).min(),
            inside.iter().map(|p| p.1).min(),
        ];
        let [right, bottom] = [
            inside.iter().map(|p| p.0 + 1).max(),
            inside.iter().map(|p| p.1 + 1).max(),
        ];
        let [left, top, right, bottom] = [left, top, right, bottom].map(|v| v.expect("a pixel"));
        assert_eq!(
            annotation["bbox"],
            serde_json::json!([left, top, right - left, bottom - top])
        );
    }
    assert_eq!(decoded, ids);
}

#[test]
fn coco_files_are_read_back_as_raw_labels() {
    let folder = folder();
    let dir = folder.path();
    let ids = (0..WIDTH * HEIGHT)
        .map(|i| [0, 1, 2, 4][(i * i / 97) % 4])
        .collect();
    let map = LabelMap {
        width: WIDTH,
        height: HEIGHT,
        ids,
    };
    let classes = Classes::read(&dir.join("classes.json")).expect("classes");
    let mut coco = CocoInstances::new(&Categories::new(&classes, map.ids.iter().copied()));
    coco.add("v1.png".into(), &map);
    coco.write(&dir.join("instances.json")).expect("written");
    let scene = load(dir, &options("instances.json")).expect("a scene");
    assert_eq!(raw(&scene, 1), map);
}

#[test]
fn lists_of_yolo_name_the_images_of_both_splits() {
    let dir = tempfile::tempdir().expect("folder");
    let at = |name: &str| dir.path().join(name);
    let categories = Categories::new(&classes(), [1, 2, 3]);
    let yolo = Yolo::new(&categories);
    let text = |name: &str| fs::read_to_string(at(name)).expect("read");
    let images = [
        (Split::Train, "a.jpg"),
        (Split::Test, "b.png"),
        (Split::Train, "c.png"),
    ];
    let images = images.map(|(split, name)| (split, name.to_owned()));
    let names = "names:\n  0: \"wall\"\n  1: \"chair\"\n";
    // One split stands for both.
    for (one, list) in [(&images[..1], "train.txt"), (&images[1..2], "val.txt")] {
        let dir = tempfile::tempdir().expect("folder");
        yolo.check_lists(dir.path(), &[one[0].0]).expect("empty");
        yolo.write_lists(dir.path(), one).expect("written");
        assert_eq!(
            fs::read_to_string(dir.path().join("data.yaml")).expect("read"),
            format!("train: {list}\nval: {list}\n{names}")
        );
    }
    // Together, and one after the other.
    let both = [&images[..]];
    let each = [&images[1..2], &[images[0].clone(), images[2].clone()]];
    for parts in [&both[..], &each] {
        for part in parts {
            yolo.write_lists(dir.path(), part).expect("written");
        }
        assert_eq!(text("train.txt"), "./images/a.jpg\n./images/c.png\n");
        assert_eq!(text("val.txt"), "./images/b.png\n");
        assert_eq!(
            text("data.yaml"),
            format!("train: train.txt\nval: val.txt\n{names}")
        );
        for list in ["train.txt", "val.txt", "data.yaml"] {
            fs::remove_file(at(list)).expect("removed");
        }
    }
}

#[test]
fn a_list_of_yolo_does_not_stay_with_other_classes() {
    let dir = tempfile::tempdir().expect("folder");
    let all = Categories::new(&classes(), [1, 2, 3]);
    let chairs = Categories::new(&classes(), [1, 2]);
    let train = [(Split::Train, "a.jpg".to_owned())];
    let of_all = Yolo::new(&all);
    of_all.write_lists(dir.path(), &train).expect("written");
    let of_chairs = Yolo::new(&chairs);
    let check = |yolo: &Yolo<'_>, splits: &[Split]| yolo.check_lists(dir.path(), splits);
    check(&of_all, &[Split::Test]).expect("the same classes");
    check(&of_chairs, &[Split::Test, Split::Train]).expect("both anew");
    let message = check(&of_chairs, &[Split::Test])
        .expect_err("others")
        .to_string();
    for part in ["data.yaml: names", "train.txt", "--split all"] {
        assert!(message.contains(part), "{message}");
    }
    let check = |splits: &[Split]| own::guarded(&["render"], || check(&of_all, splits));
    let message = check(&[Split::Train]).expect_err("not its own").to_string();
    assert!(message.contains("data.yaml"), "{message}");
}

#[test]
fn outlines_of_yolo_enclose_the_pixels() {
    let dir = tempfile::tempdir().expect("folder");
    let at = |name: &str| dir.path().join(name);
    let categories = Categories::new(&classes(), [1, 2, 3]);
    let yolo = Yolo::new(&categories);
    let map = map();
    yolo.write(&at("a.txt"), &map).expect("written");
    let text = fs::read_to_string(at("a.txt")).expect("read");
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    let mut decoded = vec![0; map.ids.len()];
    for line in text.lines() {
        let (number, rest) = line.split_once(' ').expect("a class");
        let numbers: Vec<f64> = rest
            .split(' ')
            .map(|v| v.parse().expect("a number"))
            .collect();
        let points: Vec<[f64; 2]> = numbers.as_chunks::<2>().0.to_vec();
        assert!(
            points.len() >= 4 && numbers.iter().all(|v| (0.0..=1.0).contains(v)),
            "{line}"
        );
        let number: usize = number.parse().expect("a class");
        *counts.entry(number).or_default() += 1;
        for (i, value) in decoded.iter_mut().enumerate() {
            let center = [(i % map.width) as f64 + 0.5, (i / map.width) as f64 + 0.5];
            if encloses(
                &points,
                [center[0] / map.width as f64, center[1] / map.height as f64],
            ) {
                assert_eq!(*value, 0, "pixel {i} twice");
                *value = 1 + number;
            }
        }
    }
    // Four pieces of wall; the ring of chair 1 and its tail are one, chair 2 is a ring and two pixels.
    assert_eq!(counts, BTreeMap::from([(0, 4), (1, 4)]));
    let number = |&id: &u16| [0, 2, 2, 1][usize::from(id)];
    assert_eq!(decoded, map.ids.iter().map(number).collect::<Vec<usize>>());
}

/// Whether a ray to the right crosses the polygon an odd number of times.
fn encloses(polygon: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let next = polygon.iter().cycle().skip(1);
    let crosses = |(a, b): &(&[f64; 2], &[f64; 2])| {
        (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    };
    polygon.iter().zip(next).filter(crosses).count() % 2 == 1
}
