//! Labels drawn in CVAT, in its own XML: whole, then broken.

use crate::support::plates::{HEIGHT, WIDTH};
use crate::support::program::{succeeds, utf8};
use crate::support::raw_labels::{
    associated, at, folder, labelled, options, raw, refused, without_truth,
};
use coseg::config::RawFormat;
use coseg::data::{LoadOptions, Segment, check, load};
use std::fs;
use std::path::Path;

/// An `<image>` of the size of the photos.
fn image(name: &str, shapes: &str) -> String {
    format!(
        "<image id=\"0\" name=\"{name}\" width=\"{WIDTH}\" height=\"{HEIGHT}\">{shapes}</image>\n"
    )
}

/// The file, as CVAT writes it.
fn cvat(images: &[String]) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<annotations>\n<version>1.1</version>\n<meta><task><name>room &amp; hall</name>\
         <labels><label><name>red</name></label></labels></task></meta>\n{}</annotations>\n",
        images.concat()
    )
}

/// Writes `annotations.xml` below `dir`.
fn write(dir: &Path, folder: &str, text: &str) {
    let folder = dir.join(folder);
    fs::create_dir_all(&folder).expect("folder");
    fs::write(folder.join("annotations.xml"), text).expect("write");
}

/// Shapes of every kind, the lowest one last.
fn shapes() -> String {
    [
        "<polygon label=\"Green\" source=\"manual\" occluded=\"0\" points=\"0.00,0.00;40.00,0.00;40.00,40.00;0.00,40.00\" z_order=\"1\">\
         <attribute name=\"old\">true</attribute></polygon>",
        "<box label=\"red\" xtl=\"10.00\" ytl=\"10.00\" xbr=\"20.00\" ybr=\"20.00\" z_order=\"2\"/>",
        "<ellipse label=\"red\" cx=\"60.00\" cy=\"20.00\" rx=\"10.00\" ry=\"5.00\" rotation=\"90.00\" z_order=\"2\"/>",
        "<mask label=\"blue\" rle=\"1, 3, 2\" left=\"50\" top=\"50\" width=\"3\" height=\"2\" z_order=\"2\"/>",
        "<polygon label=\"lamp\" points=\"30,30;35,30;35,35;30,35\" z_order=\"2\"/>",
        "<polygon label=\"void\" points=\"2,2;6,2;6,6;2,6\" z_order=\"2\"/>",
        "<polyline label=\"red\" points=\"1,1;70,60\" z_order=\"9\"/>",
        "<points label=\"red\" points=\"1,1\" z_order=\"9\"/>",
        "<tag label=\"red\"/>",
        "<skeleton label=\"red\" z_order=\"9\"><points label=\"hand\" points=\"1,1\"/></skeleton>",
        "<polygon label=\"wall\" points=\"0,0;80,0;80,64;0,64\" z_order=\"0\"/>",
    ]
    .join("\n")
}

#[test]
fn shapes_of_cvat_are_painted_by_their_depth() {
    let folder = folder();
    let dir = folder.path();
    let turned = "<box label=\"red\" xtl=\"20\" ytl=\"27\" xbr=\"60\" ybr=\"37\" rotation=\"45\"/>";
    let images = [
        image("room/v1.png", &shapes()),
        image("v3.png", turned),
        image("v4.png", ""),
        image("other.png", turned),
    ];
    write(dir, "export", &cvat(&images));
    let loaded = load(dir, &options("export")).expect("scene");
    assert!(loaded.drawn);
    assert_eq!(labelled(&loaded), ["v1", "v3"]);
    let map = raw(&loaded, 1);
    // Wall, polygon, box, unlabelled ones, and the ellipse, which stands upright.
    let places = [
        (70, 60),
        (39, 39),
        (15, 15),
        (32, 32),
        (4, 4),
        (60, 12),
        (67, 20),
        (1, 1),
    ];
    assert_eq!(at(&map, &places), [4, 2, 1, 0, 0, 1, 4, 2]);
    // . # #
    // # . .
    let places = [
        (50, 50),
        (51, 50),
        (52, 50),
        (50, 51),
        (51, 51),
        (53, 50),
        (50, 52),
    ];
    assert_eq!(at(&map, &places), [4, 3, 3, 3, 4, 4, 4]);
    // The far end goes down, as on a clock.
    let places = [(40, 32), (52, 44), (28, 20), (52, 20), (58, 32)];
    assert_eq!(at(&raw(&loaded, 3), &places), [1, 1, 1, 0, 0]);

    let notices = check(dir, &options("export")).notices;
    for part in [
        "4 of the 5 classes",
        "lamp",
        "1 labelled images",
        "2 of 4 training frames",
    ] {
        let told = notices.iter().any(|notice| notice.contains(part));
        assert!(told, "{part}: {notices:?}");
    }
    let set = "data.raw_labels=export/annotations.xml";
    let said = succeeds(&["data", "check", utf8(dir), "--set", set]);
    assert!(said.contains("no problems"), "{said}");
}

#[test]
fn exports_are_found_beside_copies_of_the_photos() {
    let folder = folder();
    let dir = folder.path();
    let text = cvat(&[image("v1.png", &shapes())]);
    write(dir, "bare", &text);
    write(dir, "zip", &text);
    fs::create_dir(dir.join("zip/images")).expect("folder");
    for i in 0..6 {
        let photo = format!("images/v{i}.png");
        fs::copy(dir.join(&photo), dir.join("zip").join(&photo)).expect("copy");
    }
    let expected = load(dir, &options("bare/annotations.xml")).expect("scene");
    let named = LoadOptions {
        raw_format: RawFormat::Cvat,
        ..options("zip")
    };
    for options in [options("bare"), options("zip"), named] {
        let loaded = load(dir, &options).expect("scene");
        assert_eq!(labelled(&loaded), ["v1"]);
        assert_eq!(loaded.views[1].raw, expected.views[1].raw);
    }
}

#[test]
fn label_maps_come_before_a_file_of_cvat_beside_them() {
    let folder = folder();
    let dir = folder.path();
    let maps = load(dir, &options("raw")).expect("scene");
    write(dir, "raw", &cvat(&[image("v1.png", &shapes())]));
    let loaded = load(dir, &options("raw")).expect("scene");
    assert!(!loaded.drawn);
    assert_eq!(loaded.views[1].raw, maps.views[1].raw);
    let named = LoadOptions {
        raw_format: RawFormat::Cvat,
        ..options("raw")
    };
    assert_eq!(labelled(&load(dir, &named).expect("scene")), ["v1"]);
}

#[test]
fn shapes_of_a_group_are_one_segment_and_may_be_of_a_smaller_copy() {
    let folder = folder();
    let dir = folder.path();
    without_truth(dir);
    let square = |x: usize, more: &str| {
        let (left, right) = (x as f64, (x + 5) as f64);
        format!("<box label=\"sofa\" xtl=\"{left}\" ytl=\"0\" xbr=\"{right}\" ybr=\"5\" {more}/>")
    };
    let mask = "<mask label=\"lamp\" rle=\"0, 4\" left=\"30\" top=\"20\" width=\"2\" height=\"2\" z_order=\"1\"/>";
    let all = [
        square(0, "group_id=\"7\""),
        square(10, ""),
        square(20, "group_id=\"7\""),
        mask.to_owned(),
    ];
    let half = image("v0.png", &all.concat())
        .replace(&format!("\"{WIDTH}\""), &format!("\"{}\"", WIDTH / 2))
        .replace(&format!("\"{HEIGHT}\""), &format!("\"{}\"", HEIGHT / 2));
    write(dir, "export", &cvat(&[half]));
    let loaded = load(dir, &associated("export")).expect("scene");
    let names: Vec<_> = loaded
        .classes
        .entries
        .iter()
        .map(|c| (c.id, &*c.name))
        .collect();
    assert_eq!(names, [(1, "lamp"), (2, "sofa")]);
    let places = [
        (9, 9),
        (25, 5),
        (45, 5),
        (5, 50),
        (60, 40),
        (63, 43),
        (59, 40),
        (64, 43),
    ];
    assert_eq!(at(&raw(&loaded, 0), &places), [1, 2, 1, 0, 3, 3, 0, 0]);
    let segment = |id, class| Segment {
        id,
        class: Some(class),
        thing: true,
    };
    let expected = [segment(1, 2), segment(2, 2), segment(3, 1)];
    assert_eq!(loaded.views[0].segments, expected);
}

#[test]
fn broken_files_of_cvat_are_refused() {
    let folder = folder();
    let dir = folder.path();
    let export = options("export");
    let good = cvat(&[image("v1.png", &shapes())]);
    let broken = |from: &str, to: &str, parts: &[&str]| {
        assert!(good.contains(from), "{from}");
        write(dir, "export", &good.replacen(from, to, 1));
        refused(dir, &export, &[&["annotations.xml"], parts].concat());
    };
    write(dir, "export", &good);
    load(dir, &export).expect("whole");
    // The file has one image, on line 5.
    broken("xtl=\"10.00\"", "", &["line 6, <box>, xtl", "nothing"]);
    broken(
        "xtl=\"10.00\"",
        "xtl=\"ten\"",
        &["<box>, xtl", "\"ten\"", "a number"],
    );
    broken("xtl=\"10.00\"", "xtl=\"NaN\"", &["<box>, xtl", "finite"]);
    broken(
        "xtl=\"10.00\"",
        "xtl=\"-900\"",
        &["points", "-900", "80x64"],
    );
    broken("cx=\"60.00\"", "cx=\"1e300\"", &["points", "80x64"]);
    broken(
        "rotation=\"90.00\"",
        "rotation=\"inf\"",
        &["<ellipse>, rotation", "finite"],
    );
    broken(
        "z_order=\"1\"",
        "z_order=\"top\"",
        &["line 5, <polygon>, z_order", "\"top\""],
    );
    let points = ["line 5, <polygon>, points", "three points"];
    broken(";40.00,40.00;0.00,40.00", "", &points);
    broken(";40.00,40.00", ";40.00", &points);
    broken(";40.00,40.00", ";40.00,40.00;", &points);
    broken("40.00,40.00", "40.00,NaN", &["points", "80x64"]);
    broken(
        "label=\"Green\" ",
        "",
        &["line 5, <polygon>, label", "nothing"],
    );
    let rle = ["line 8, <mask>, rle", "3x2 at 50, 50", "80x64"];
    broken("1, 3, 2", "1, 3, 3", &rle);
    broken("1, 3, 2", "1, -3, 2", &rle);
    broken("1, 3, 2", "", &rle);
    broken("1, 3, 2", "1, 18446744073709551615, 6", &rle);
    broken(
        "left=\"50\"",
        "left=\"78\"",
        &["<mask>, rle", "3x2 at 78, 50"],
    );
    broken(
        "left=\"50\"",
        "left=\"18446744073709551615\"",
        &["<mask>, rle"],
    );
    broken(
        "left=\"50\"",
        "left=\"-1\"",
        &["<mask>, left", "a number of pixels"],
    );
    broken(
        "<ellipse ",
        "<heart ",
        &["<heart>", "polygon, box, ellipse or mask"],
    );
    broken(
        "width=\"80\"",
        "width=\"64\"",
        &["size of the picture", "64x64"],
    );
    broken("width=\"80\"", "width=\"4294967295\"", &["pixels", "limit"]);
    broken("width=\"80\"", "", &["line 5, <image>, width", "nothing"]);
    broken(
        "v1.png",
        "x.png",
        &["annotations", "none of which is a photo", "v0"],
    );
    broken("</annotations>", "", &["XML", "<annotations>"]);
    broken(
        "<annotations>",
        "<!DOCTYPE a [<!ENTITY b \"b\">]>\n<annotations>",
        &["XML", "DTD"],
    );
    let again = image(
        "v1.jpg",
        "<box label=\"red\" xtl=\"1\" ytl=\"1\" xbr=\"2\" ybr=\"2\"/>",
    );
    broken(
        "</annotations>",
        &format!("{again}</annotations>"),
        &["another image of this photo"],
    );
    let shape = "<box label=\"red\" xtl=\"1\" ytl=\"1\" xbr=\"2\" ybr=\"2\"/>".repeat(70_000);
    broken(
        "<tag label=\"red\"/>",
        &shape,
        &["shapes of a photo", "65535", "limit"],
    );
    let attributes: String = (0..300).map(|i| format!(" a{i}=\"\"")).collect();
    broken(
        "<ellipse ",
        &format!("<ellipse{attributes} "),
        &["attributes of an element", "limit", "256"],
    );
    for (text, parts) in [
        ("", &["XML"][..]),
        ("<svg/>", &["line 1, <svg>", "<annotations>"]),
        (
            "<annotations><track/></annotations>",
            &["no <image>", "CVAT for images 1.1"],
        ),
        (
            "<annotations><image/></annotations>",
            &["shapes", "none with a label"],
        ),
    ] {
        write(dir, "export", text);
        refused(dir, &export, &[&["annotations.xml"], parts].concat());
    }
    write(dir, "export", &good.replace("label=\"", "label=\"no "));
    refused(dir, &export, &["categories", "class table", "rename"]);
    let file = dir.join("export/annotations.xml");
    fs::write(&file, [0xFF, 0xFE, 0x00]).expect("write");
    refused(dir, &export, &["annotations.xml", "read"]);
    // A file that is empty after its first bytes.
    let file = fs::OpenOptions::new().write(true).open(&file);
    file.and_then(|file| file.set_len((1 << 28) + 1))
        .expect("grown");
    refused(dir, &export, &["annotations.xml", "bytes", "limit"]);
}
