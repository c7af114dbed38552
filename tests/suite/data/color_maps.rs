//! Raw labels in the colours of ADE20K.

use crate::support::raw_labels::{
    associated, folder, maps_of, options, own_maps, refused, save, without_truth,
};
use coseg::data::{LabelMap, Segment, load};
use image::Rgb;
use std::fs;

/// Colours of wall (1), floor (4) and chair (20) of ADE20K.
const ADE: [(u16, [u8; 3]); 3] = [(1, [120, 120, 120]), (4, [80, 50, 50]), (20, [204, 70, 3])];

/// ADE's class for a label of the plates.
fn ade(id: u16) -> (u16, [u8; 3]) {
    match id {
        0 => (0, [0; 3]),
        4 => ADE[0],
        1 => ADE[2],
        _ => ADE[1],
    }
}

/// A PNG with a palette: header, colours, uncompressed rows.
fn indexed(map: &LabelMap, colors: &[[u8; 3]], index: impl Fn(u16) -> u8) -> Vec<u8> {
    let crc = |bytes: &[u8]| {
        !bytes.iter().fold(!0_u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |c, _| {
                if c & 1 == 1 {
                    c >> 1 ^ 0xEDB8_8320
                } else {
                    c >> 1
                }
            })
        })
    };
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], data: &[u8]| {
        out.extend((data.len() as u32).to_be_bytes());
        out.extend(kind);
        out.extend(data);
        out.extend(crc(&[kind, data].concat()).to_be_bytes());
    };
    let size = [map.width as u32, map.height as u32]
        .map(u32::to_be_bytes)
        .concat();
    chunk(b"IHDR", &[&size[..], &[8, 3, 0, 0, 0]].concat());
    chunk(b"PLTE", colors.as_flattened());
    let rows: Vec<u8> = map
        .ids
        .chunks(map.width)
        .flat_map(|row| std::iter::once(0).chain(row.iter().map(|id| index(*id))))
        .collect();
    let (mut a, mut b) = (1_u32, 0_u32);
    for &byte in &rows {
        a = (a + u32::from(byte)) % 65_521;
        b = (b + a) % 65_521;
    }
    let length = rows.len() as u16;
    let stored = [
        &[0x78, 1, 1][..],
        &length.to_le_bytes(),
        &(!length).to_le_bytes(),
        &rows,
        &(b << 16 | a).to_be_bytes(),
    ];
    chunk(b"IDAT", &stored.concat());
    chunk(b"IEND", &[]);
    out
}

#[test]
fn ade20k_colours_are_classes() {
    let folder = folder();
    let dir = folder.path();
    let maps = own_maps(dir);
    let colors = [[0; 3], ADE[0].1, ADE[1].1, ADE[2].1];
    let index = |id: u16| colors.iter().position(|c| *c == ade(id).1).expect("colour") as u8;
    for (i, map) in maps.iter().enumerate() {
        save(&dir.join(format!("ade/v{i}.png")), map, |id| ade(id).1);
        fs::create_dir_all(dir.join("indexed")).expect("folder");
        fs::write(
            dir.join(format!("indexed/v{i}.png")),
            indexed(map, &colors, index),
        )
        .expect("map");
    }
    // Of ADE's classes the scene has the wall alone.
    let loaded = load(dir, &options("ade")).expect("scene");
    let want: Vec<u16> = maps[1]
        .ids
        .iter()
        .map(|&id| if id == 4 { 4 } else { 0 })
        .collect();
    assert_eq!(maps_of(&loaded)[1].ids, want);
    // Where nothing is to be put together, stuff stays one segment a class.
    let stuff = load(dir, &associated("ade")).expect("scene");
    assert!(stuff.views[0].segments.contains(&Segment {
        id: 4,
        class: Some(4),
        thing: false
    }));

    without_truth(dir);
    for name in ["ade", "indexed"] {
        let loaded = load(dir, &options(name)).expect(name);
        let classes: Vec<_> = loaded
            .classes
            .entries
            .iter()
            .map(|c| (c.id, &*c.name))
            .collect();
        assert_eq!(
            classes,
            [(1, "wall"), (4, "floor"), (20, "chair")],
            "{name}: those that occur"
        );
        let want: Vec<u16> = maps[3].ids.iter().map(|&id| ade(id).0).collect();
        assert_eq!(maps_of(&loaded)[3].ids, want, "{name}");
    }

    let path = dir.join("ade/v4.png");
    let mut image = image::open(&path).expect("map").into_rgb8();
    image.put_pixel(7, 9, Rgb([1, 2, 3]));
    image.save(&path).expect("map");
    refused(
        dir,
        &options("ade"),
        &["ade/v4.png", "x 7, y 9", "[1, 2, 3]", "150 colours"],
    );
    maps[4].write(&path).expect("map");
    refused(
        dir,
        &options("ade"),
        &["ade/v4.png", "pixel format", "grey", "data.raw_format"],
    );
}
