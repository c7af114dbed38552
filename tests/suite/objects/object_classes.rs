//! Objects that have classes: their scores by class, and how the classes travel.

use crate::support::plate_objects::short_run;
use crate::support::plates;
use crate::support::program::{read_json, succeeds, utf8};
use coseg::data::{Class, Classes, LabelMap, ObjectOf};
use coseg::metrics::{SemanticView, semantic_scores};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Objects 1 (wall), 2 and 3 (chairs) and 4, of which no class is known.
fn objects() -> Classes {
    let of = [Some((1, false)), Some((2, true)), Some((2, true)), None];
    let object = |(id, of): (u16, Option<(u16, bool)>)| Class {
        id,
        name: format!("object {id}"),
        color: [id as u8; 3],
        object_of: of.map(|(class, thing)| ObjectOf { class, thing }),
    };
    Classes {
        entries: (1..).zip(of).map(object).collect(),
        ignore: 0,
    }
}

fn runs(of: &[(u16, usize)]) -> Vec<u16> {
    of.iter().flat_map(|&(id, n)| vec![id; n]).collect()
}

#[track_caller]
fn near(found: Option<f64>, want: f64) {
    let found = found.expect("value");
    assert!((found - want).abs() < 1e-12, "{found} {want}");
}

#[test]
fn scores_by_class_by_hand() {
    let classes = Classes::from_names(0, [(1, "wall"), (2, "chair"), (3, "door")]);
    // Ten pixels of wall, chairs of six and four, three of a chair without an instance, two unlabelled.
    let truth = runs(&[(1, 10), (2, 6), (2, 4), (2, 3), (0, 2)]);
    // Instances of stuff say nothing.
    let instances = runs(&[(8, 5), (0, 5), (5, 6), (6, 4), (0, 3), (7, 2)]);
    let found = runs(&[
        (1, 8),
        (2, 2),
        (2, 5),
        (4, 1),
        (3, 3),
        (1, 1),
        (2, 3),
        (3, 2),
    ]);
    let view = SemanticView {
        truth: &truth,
        instances: Some(&instances),
        objects: &found,
    };
    let stuff = BTreeSet::from([1]);
    let scores = semantic_scores(&objects(), &classes, &stuff, [view]);
    // Wall: 8 of 10, and one of the chair. Chair: 11 of 13, and two of the wall; an object without a class is wrong.
    let (wall, chair) = (8.0 / 11.0, 11.0 / 15.0);
    near(scores.pixels.miou, (wall + chair) / 2.0);
    near(scores.pixels.miou_per_view, (wall + chair) / 2.0);
    near(scores.pixels.accuracy, 19.0 / 23.0);
    let per_class: Vec<(u16, &str)> = scores.per_class.iter().map(|c| (c.id, &*c.name)).collect();
    assert_eq!(per_class, [(1, "wall"), (2, "chair")]);
    near(Some(scores.per_class[1].iou), chair);
    // Object 2 has five pixels of the first chair, two of the wall and three of no true segment: 5 / (6 + 10 - 5 - 3).
    // Object 3 has three of the second and two unlabelled: 3 / (4 + 5 - 3 - 2).
    let things = (5.0 / 8.0 + 3.0 / 4.0) / 2.0;
    let panoptic = scores.panoptic.expect("instances");
    near(panoptic.things.pq, things);
    near(panoptic.stuff.pq, wall);
    near(panoptic.all.pq, (things + wall) / 2.0);
    near(panoptic.all.rq, 1.0);
    assert_eq!(panoptic.scene, panoptic.all);
    // The same objects, all of them walls: every chair is missed, and two segments of wall are wrong.
    let mut walls = objects();
    walls.entries.iter_mut().for_each(|object| {
        object.object_of = object.object_of.map(|of| ObjectOf { class: 1, ..of })
    });
    let panoptic = semantic_scores(&walls, &classes, &stuff, [view])
        .panoptic
        .expect("instances");
    assert_eq!(
        (panoptic.things.pq, panoptic.things.rq),
        (Some(0.0), Some(0.0))
    );
    near(panoptic.stuff.rq, 1.0 / 2.0);
}

#[test]
fn an_object_that_changes_its_id_is_two_in_the_scene() {
    let classes = Classes::from_names(0, [(2, "chair")]);
    let chair = runs(&[(2, 4)]);
    let [first, second] = [runs(&[(2, 4)]), runs(&[(3, 4)])];
    let view = |objects| SemanticView {
        truth: &chair,
        instances: Some(&chair),
        objects,
    };
    let scores = semantic_scores(
        &objects(),
        &classes,
        &BTreeSet::new(),
        [view(&first), view(&second)],
    );
    let panoptic = scores.panoptic.expect("instances");
    assert_eq!(
        (scores.pixels.miou, panoptic.all.pq, panoptic.scene.pq),
        (Some(1.0), Some(1.0), Some(0.0))
    );
    let without = SemanticView {
        instances: None,
        ..view(&first)
    };
    let scores = semantic_scores(&objects(), &classes, &BTreeSet::new(), [without]);
    assert_eq!((scores.pixels.accuracy, scores.panoptic), (Some(1.0), None));
    let scores = semantic_scores(&objects(), &classes, &BTreeSet::new(), []);
    assert_eq!(
        (scores.pixels.miou, scores.pixels.accuracy, scores.panoptic),
        (None, None, None)
    );
}

#[test]
fn classes_of_objects_survive_their_file() {
    let dir = tempfile::tempdir().expect("folder");
    let path = dir.path().join("classes.json");
    objects().write(&path).expect("write");
    assert_eq!(Classes::read(&path).expect("read"), objects());
    let value = read_json(&path);
    assert_eq!(
        value["classes"][1],
        json!({"id": 2, "name": "object 2", "color": [2, 2, 2], "class": 2, "thing": true})
    );
    assert_eq!(
        value["classes"][3],
        json!({"id": 4, "name": "object 4", "color": [4, 4, 4]})
    );
}

/// The plates before a wall as COCO panoptic maps under ids of each view's own, with true labels and instances.
fn panoptic_plates(dir: &Path) {
    plates::scene(dir);
    let mut value = read_json(&dir.join("transforms.json"));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut annotations = Vec::new();
    fs::create_dir_all(dir.join("coco")).expect("folder");
    for (i, frame) in value["frames"]
        .as_array_mut()
        .expect("frames")
        .iter_mut()
        .enumerate()
    {
        let path = dir.join(format!("labels/v{i}.png"));
        let instances = LabelMap::read(&path).expect("truth");
        instances
            .write(&dir.join(format!("instances/v{i}.png")))
            .expect("instances");
        let class = |&id: &u16| [0, 1, 1, 1, 2][usize::from(id)];
        LabelMap {
            ids: instances.ids.iter().map(class).collect(),
            ..instances
        }
        .write(&path)
        .expect("labels");
        frame["instance_path"] = format!("instances/v{i}.png").into();
        frame["raw_label_path"] = format!("coco/v{i}.png").into();
        let mut colors: Vec<u8> = (1..=255).collect();
        colors.shuffle(&mut rng);
        let pixel = |x: u32, y: u32| match instances.ids[y as usize * instances.width + x as usize]
        {
            0 => image::Rgb([0; 3]),
            id => image::Rgb([colors[usize::from(id)], 0, 0]),
        };
        let (w, h) = (instances.width as u32, instances.height as u32);
        image::RgbImage::from_fn(w, h, pixel)
            .save(dir.join(format!("coco/v{i}.png")))
            .expect("map");
        let present: BTreeSet<u16> = instances.ids.iter().copied().filter(|id| *id > 0).collect();
        let segment = |id: u16| json!({ "id": colors[usize::from(id)], "category_id": if id == 4 { 20 } else { 10 } });
        let segments: Vec<Value> = present.into_iter().map(segment).collect();
        annotations.push(json!({ "file_name": format!("v{i}.png"), "segments_info": segments }));
    }
    fs::write(dir.join("transforms.json"), value.to_string()).expect("write");
    let categories = json!([{ "id": 10, "name": "plate", "isthing": 1 }, { "id": 20, "name": "wall", "isthing": 0 }]);
    let file = json!({ "annotations": annotations, "categories": categories });
    fs::write(dir.join("coco.json"), file.to_string()).expect("json");
    Classes::from_names(0, [(1, "plate"), (2, "wall")])
        .write(&dir.join("classes.json"))
        .expect("classes");
}

#[test]
fn runs_score_objects_by_class_and_eval_says_the_same() {
    let folder = tempfile::tempdir().expect("folder");
    let dir = folder.path();
    panoptic_plates(dir);
    let ply = dir.join("plates.ply");
    let out = dir.join("out");
    let run = dir.join("run");
    let said = succeeds(&[
        "associate",
        "--scene",
        utf8(&ply),
        "--data",
        utf8(dir),
        "--out",
        utf8(&out),
    ]);
    let all = "by class: mIoU 1.0000, mIoU per view 1.0000, accuracy 1.0000, PQ 1.0000, PQ of things 1.0000";
    assert!(
        said.contains(&format!("maps, {all}")) && said.contains(&format!("rendered, {all}")),
        "{said}"
    );
    let said = short_run(dir, &run);
    assert!(said.contains("vote, by class"), "{said}");
    let labels = &read_json(&run.join("metrics.json"))["test"]["labels"];
    for row in ["raw", "vote", "per_gaussian"] {
        let scores = &labels[row]["semantic"];
        assert_eq!(scores["per_class"][1]["name"], "wall", "{scores}");
        let share = |value: &Value| value.as_f64().expect("score");
        assert!(share(&scores["accuracy"]) > 0.5, "{row}: {scores}");
        let panoptic = &scores["panoptic"];
        let mean = 0.5 * (share(&panoptic["things"]["pq"]) + share(&panoptic["stuff"]["pq"]));
        assert!(
            (share(&panoptic["all"]["pq"]) - mean).abs() < 1e-9,
            "{row}: two classes, one of stuff: {scores}"
        );
    }
    let classes = Classes::read(&run.join("classes.json")).expect("classes");
    let wall = classes
        .entries
        .iter()
        .find(|object| object.name == "wall")
        .expect("stuff is one object");
    assert_eq!(
        wall.object_of,
        Some(ObjectOf {
            class: 2,
            thing: false
        })
    );
    assert!(classes.entries.iter().any(|object| object.object_of
        == Some(ObjectOf {
            class: 1,
            thing: true
        })));
    let page = fs::read_to_string(run.join("report.html")).expect("page");
    assert!(
        page.contains("Objects by class against true labels")
            && page.contains("IoU by class of the objects")
    );
    let said: Value =
        serde_json::from_str(&succeeds(&["eval", utf8(&run), "--json"])).expect("JSON");
    for key in ["miou", "accuracy"] {
        let [found, told] = [
            &said["test"]["labels"]["per_gaussian"]["semantic"][key],
            &labels["per_gaussian"]["semantic"][key],
        ];
        assert!(
            (found.as_f64().expect("score") - told.as_f64().expect("score")).abs() < 1e-3,
            "{key}: {said}"
        );
    }
    let said = succeeds(&["eval", utf8(&run)]);
    assert!(
        said.contains("objects, by class: mIoU")
            && said.contains("PQ of things")
            && said.contains("IoU of 2 wall"),
        "{said}"
    );
}
