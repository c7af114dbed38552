//! The results in a run folder: files, layouts, and a page that needs no other file.

use crate::support::made_up_report::{
    HEIGHT, WIDTH, classes, folder, labels, metrics, with_report,
};
use crate::support::program::read_json;
use coseg::config::{Config, Variant};
use coseg::data::{Classes, LabelMap};
use coseg::metrics::PixelScores;
use coseg::report::{Metrics, Report, VariantScores, peak_memory_bytes, pictures};
use std::path::Path;

#[test]
fn scores_of_a_row_lie_side_by_side_in_json() {
    let scores = VariantScores {
        pixels: PixelScores {
            miou: Some(0.25),
            miou_per_view: None,
            accuracy: Some(1.0),
        },
        class_iou: [(3, 0.5)].into(),
        iterations: Some(7),
        ..VariantScores::default()
    };
    let text =
        r#"{"miou":0.25,"miou_per_view":null,"accuracy":1.0,"class_iou":{"3":0.5},"iterations":7}"#;
    assert_eq!(serde_json::to_string(&scores).unwrap(), text);
    assert_eq!(serde_json::from_str::<VariantScores>(text).unwrap(), scores);
}

#[test]
fn the_run_folder_is_complete() {
    let (_keep, dir) = folder();
    with_report(|report| report.write(&dir).unwrap());
    let metrics = read_json(&dir.join("metrics.json"));
    assert_eq!(metrics["scene"], "a made-up room");
    assert_eq!(metrics["gaussians"], 41_250);
    assert_eq!(metrics["test"]["psnr"], 31.42);
    assert_eq!(metrics["test"]["ssim"], 0.9412);
    for (row, miou) in [
        ("raw", 0.612),
        ("vote", 0.798),
        ("per_gaussian", 0.712),
        ("no_decoder", 0.801),
        ("ours", 0.834),
    ] {
        let scores = &metrics["test"]["labels"][row];
        assert_eq!(scores["miou"], miou, "{row}");
        assert!(scores["miou_per_view"].is_f64() && scores["accuracy"].is_f64());
    }
    for stage in [
        "building",
        "features",
        "unprojection",
        "segmentation",
        "total",
    ] {
        assert!(metrics["seconds"][stage].is_f64(), "{stage}");
    }
    assert_eq!(metrics["peak_memory_bytes"], 1_310_000_000);
    assert_eq!(metrics["learnable_bytes"]["decoder"], 1_120_000);
    assert_eq!(
        (&metrics["spatial"], &metrics["features"]),
        (&"trained here".into(), &"built-in descriptor".into())
    );

    let classes = read_json(&dir.join("classes.json"));
    assert_eq!(classes["classes"][2]["name"], "sofa");
    assert_eq!(classes["classes"][2]["id"], 3);
    assert_eq!(
        classes["classes"][2]["color"],
        serde_json::json!([214, 39, 40])
    );

    let config = std::fs::read_to_string(dir.join("config.toml")).unwrap();
    assert_eq!(config, Config::default().to_toml().unwrap());
    for kind in ["rgb", "rgb_error", "label", "label_color", "label_error"] {
        image::open(dir.join("renders").join(format!("test_007.{kind}.png"))).unwrap();
    }
    let ids = image::open(dir.join("renders/test_000.label.png")).unwrap();
    assert_eq!(
        ids.as_luma8().unwrap().as_raw()[..],
        labels(2.0).ids.iter().map(|&i| i as u8).collect::<Vec<_>>()[..]
    );
    let left: Vec<_> = std::fs::read_dir(&dir)
        .unwrap()
        .map(|e| e.unwrap().file_name())
        .collect();
    assert!(
        !left
            .iter()
            .any(|name| name.to_string_lossy().ends_with(".tmp")),
        "{left:?}"
    );
}

#[test]
fn metrics_read_back_as_written() {
    let text = serde_json::to_string(&metrics()).unwrap();
    let read: Metrics = serde_json::from_str(&text).unwrap();
    // serde_json may read the last bit of a number differently.
    assert_eq!(
        serde_json::to_value(&read).unwrap()["test"]["labels"]["raw"]["miou"],
        0.612
    );
    assert_eq!(
        (read.gaussians, read.seconds, read.test.labels.len()),
        (41_250, metrics().seconds, 5)
    );
    assert_eq!(read.learnable_bytes, metrics().learnable_bytes);
}

#[test]
fn the_page_stands_alone() {
    with_report(|report| {
        let page = report.html(Path::new("report.html")).unwrap();
        for outside in ["http://", "https://", "<script", "<link", "@import", "url("] {
            assert!(!page.contains(outside), "{outside}");
        }
        for part in [
            "83.4",
            "31.42",
            "lamp &lt;tall&gt;",
            "table &amp; chairs",
            "+22.2",
            "iterations = 400",
            "simulated",
        ] {
            assert!(page.contains(part), "{part} is not in the page");
        }
        assert!(!page.contains("lamp <tall>"));
        assert!(page.contains("--set data.raw_labels=&quot;labels&quot;"));
        let pictures = page.matches("data:image/png;base64,").count();
        // Six views: photo, render, colour error, truth, raw and three rows, and four label errors.
        assert_eq!(pictures, 6 * 12);
        assert_eq!(page.matches("<svg").count(), 8);
        assert_finite(&page);
        assert_balanced(&page);
    });
}

/// No chart has coordinates that are not numbers.
#[track_caller]
fn assert_finite(page: &str) {
    for chart in page.split("<svg").skip(1) {
        let chart = chart.split("</svg>").next().unwrap();
        assert!(!chart.contains("NaN") && !chart.contains("inf"), "{chart}");
    }
}

/// Every element that is opened is closed, in order.
#[track_caller]
fn assert_balanced(page: &str) {
    let mut open: Vec<String> = Vec::new();
    let empty = ["meta", "img", "input", "!DOCTYPE"];
    for tag in page.split('<').skip(1) {
        let inner = tag.split('>').next().unwrap();
        let name: String = inner
            .trim_start_matches('/')
            .chars()
            .take_while(|c| c.is_alphanumeric() || *c == '!')
            .collect();
        if inner.starts_with('/') {
            assert_eq!(open.pop().as_deref(), Some(name.as_str()), "at </{name}>");
        } else if !inner.ends_with('/') && !empty.contains(&name.as_str()) {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "{open:?} not closed");
}

#[test]
fn the_page_says_where_raw_labels_come_from_where_that_is_known() {
    let page = |dir: Option<&str>, note: &str| {
        let mut config = Config::default();
        config.data.dir = dir.map(Into::into);
        config.data.raw_labels_note = note.into();
        let mut page = String::new();
        let write = |report: &Report| {
            page = Report {
                config: &config,
                notes: Vec::new(),
                ..report.clone()
            }
            .html(Path::new("r"))
            .unwrap();
        };
        with_report(write);
        page.split("<details>").next().unwrap().to_lowercase()
    };
    let builtin = page(None, "");
    assert!(builtin.contains("simulated raw labels: errors drawn on the true labels"));
    let unknown = page(Some("scenes/living"), "");
    assert!(!unknown.contains("simulated") && !unknown.contains("raw labels: "));
    let told = page(Some("scenes/living"), "Mask2Former (ADE20K), <not> tuned.");
    assert!(told.contains("raw labels: mask2former (ade20k), &lt;not&gt; tuned.</p>"));
}

#[test]
fn a_scene_without_labels_and_views_has_a_page_too() {
    let classes = Classes::default();
    let config = Config::default();
    let metrics = Metrics {
        scene: "bare".into(),
        ..Metrics::default()
    };
    let report = Report {
        metrics,
        classes: &classes,
        config: &config,
        held_out: 0,
        views: Vec::new(),
        notes: Vec::new(),
    };
    let page = report.html(Path::new("report.html")).unwrap();
    assert_balanced(&page);
    assert!(!page.contains("<h2>Labels"));
    assert!(page.contains("no held-out views"));
    let json = serde_json::to_value(&report.metrics).unwrap();
    assert!(json["test"]["psnr"].is_null() && json["peak_memory_bytes"].is_null());
}

#[test]
fn labels_without_truth_are_said_to_have_no_scores() {
    with_report(|report| {
        let mut report = report.clone();
        let page = |report: &Report| report.html(Path::new("report.html")).unwrap();
        let [none, best] = ["no held-out view has true labels", "best of each column"];
        let scored = page(&report);
        assert!(scored.contains(best) && !scored.contains(none));
        for scores in report.metrics.test.labels.values_mut() {
            scores.pixels = PixelScores::default();
        }
        let bare = page(&report);
        assert!(bare.contains(none) && !bare.contains(best));
    });
}

#[test]
fn a_difference_of_nothing_has_no_sign() {
    with_report(|report| {
        let mut report = report.clone();
        let labels = &mut report.metrics.test.labels;
        for (variant, miou) in [(Variant::Raw, 0.8344), (Variant::Vote, 0.8336)] {
            labels.get_mut(&variant).unwrap().pixels.miou = Some(miou);
        }
        let page = report.html(Path::new("report.html")).unwrap();
        assert_eq!(page.matches("<b>0.0 <small>points").count(), 2);
    });
}

#[test]
fn flat_and_tiny_curves_draw() {
    with_report(|report| {
        let mut report = report.clone();
        let history = &mut report.metrics.curves;
        history.building.psnr = vec![(0, 20.0), (100, 20.0)];
        history.building.ssim = vec![(0, 0.0), (100, f64::NAN), (200, 0.0)];
        history.building.loss = vec![(0, 0.0), (1, 1e-9), (2, 5.0)];
        assert_finite(&report.html(Path::new("report.html")).unwrap());
    });
}

#[test]
fn float_images_are_clamped_and_rounded() {
    let image = pictures::from_floats(&[-0.5, 0.5, 1.5, 0.001, 0.999, f32::NAN], 2, 1).unwrap();
    assert_eq!(image.as_raw()[..], [0, 128, 255, 0, 255, 0]);
    assert!(pictures::from_floats(&[0.0; 5], 2, 1).is_err());
}

#[test]
fn label_pictures_show_classes_errors_and_void() {
    let classes = classes();
    let truth = LabelMap {
        width: 2,
        height: 2,
        ids: vec![1, 2, 0, 3],
    };
    let found = LabelMap {
        width: 2,
        height: 2,
        ids: vec![1, 3, 1, 0],
    };
    let colored = pictures::colored(&found, &classes);
    assert_eq!(colored.get_pixel(0, 0).0, [174, 199, 232]);
    assert_eq!(colored.get_pixel(1, 1).0, pictures::UNLABELLED_COLOR);
    let [right, wrong, void] = pictures::AGREEMENT;
    let errors = pictures::label_error(&found, &truth, 0);
    assert_eq!(
        errors.pixels().map(|p| p.0).collect::<Vec<_>>(),
        [right, wrong, void, wrong]
    );
    assert_eq!(pictures::accuracy(&found, &truth, 0), Some(1.0 / 3.0));
    assert_eq!(
        pictures::accuracy(
            &found,
            &LabelMap {
                ids: vec![0; 4],
                ..truth
            },
            0
        ),
        None
    );
}

#[test]
fn colour_errors_grow_from_black_to_bright() {
    let a = image::RgbImage::from_pixel(3, 1, image::Rgb([0, 0, 0]));
    let mut b = a.clone();
    b.put_pixel(1, 0, image::Rgb([12, 12, 12]));
    b.put_pixel(2, 0, image::Rgb([255, 255, 255]));
    let error = pictures::rgb_error(&a, &b);
    let light = |x| {
        error
            .get_pixel(x, 0)
            .0
            .iter()
            .map(|&c| u32::from(c))
            .sum::<u32>()
    };
    assert!(light(0) < 10 && light(0) < light(1) && light(1) < light(2));
    assert_eq!(error.get_pixel(2, 0).0, pictures::heat(1.0));
}

#[test]
fn the_legend_names_the_classes_that_occur() {
    let classes = classes();
    let map = labels(0.0);
    let colored = pictures::colored(&map, &classes);
    let with = pictures::with_legend(&colored, &map, &classes);
    assert_eq!(with.width(), colored.width());
    assert!(with.height() > colored.height() + 20);
    let strip: Vec<[u8; 3]> = with.rows().skip(HEIGHT).flatten().map(|p| p.0).collect();
    for class in &classes.entries {
        assert!(strip.contains(&class.color), "{}", class.name);
    }
    // Text is drawn.
    assert!(strip.iter().filter(|c| **c == [28, 28, 30]).count() > 200);
    let one = LabelMap {
        ids: vec![2; WIDTH * HEIGHT],
        ..map
    };
    let strip_of_one = pictures::with_legend(&colored, &one, &classes).height() - colored.height();
    assert!(strip_of_one < with.height() - colored.height());
}

#[test]
fn peak_memory_is_that_of_this_process() {
    if !cfg!(target_os = "linux") {
        return;
    }
    let before = peak_memory_bytes().unwrap();
    assert!(before > 1_000_000);
    let block = std::hint::black_box(vec![1_u8; 64 << 20]);
    assert!(peak_memory_bytes().unwrap() >= 64 << 20, "{}", block.len());
}
