//! A COLMAP folder: nine small photos with labels, and their model in both forms.

use coseg::data::LabelMap;
use glam::{DQuat, DVec3};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

pub const WIDTH: u32 = 16;
pub const HEIGHT: u32 = 12;
/// Views of the small model.
pub const VIEWS: usize = 9;

/// A camera of a model: number of the model, parameters.
pub struct Calibrated(pub i32, pub Vec<f64>);

impl Calibrated {
    fn name(&self) -> &'static str {
        match self.0 {
            0 => "SIMPLE_PINHOLE",
            1 => "PINHOLE",
            2 => "SIMPLE_RADIAL",
            3 => "RADIAL",
            4 => "OPENCV",
            _ => "OPENCV_FISHEYE",
        }
    }
}

/// Without distortion.
pub fn pinhole() -> Calibrated {
    Calibrated(1, vec![20.0, 21.0, 8.5, 6.25])
}

/// World-to-camera of view `i`.
pub fn pose(i: usize) -> (DQuat, DVec3) {
    let rotation = DQuat::from_rotation_y(0.1 * i as f64) * DQuat::from_rotation_x(0.2);
    (rotation, DVec3::new(0.3, -0.1 * i as f64, 2.0))
}

/// Path of photo `i` below `images`.
pub fn name(i: usize) -> String {
    format!("cam{}/photo {i}.png", i % 2)
}

/// Position, colour, length of the track.
pub const POINTS: [([f64; 3], [u8; 3], usize); 2] = [
    ([1.0, 2.0, 3.5], [255, 0, 51], 2),
    ([-1.0, 0.0, 4.0], [0, 0, 0], 0),
];

/// Writes the model as three binary files.
pub fn binary(folder: &Path, camera: &Calibrated) {
    let mut out = 1_u64.to_le_bytes().to_vec();
    out.extend(7_u32.to_le_bytes());
    out.extend(camera.0.to_le_bytes());
    out.extend(
        [WIDTH, HEIGHT]
            .iter()
            .flat_map(|v| u64::from(*v).to_le_bytes()),
    );
    out.extend(camera.1.iter().flat_map(|v| v.to_le_bytes()));
    fs::write(folder.join("cameras.bin"), out).expect("cameras");
    let mut out = (VIEWS as u64).to_le_bytes().to_vec();
    // Out of order, as COLMAP leaves them.
    for i in (0..VIEWS).rev() {
        let (q, t) = pose(i);
        out.extend((i as u32 + 1).to_le_bytes());
        out.extend(
            [q.w, q.x, q.y, q.z, t.x, t.y, t.z]
                .iter()
                .flat_map(|v| v.to_le_bytes()),
        );
        out.extend(7_u32.to_le_bytes());
        out.extend(name(i).as_bytes());
        out.push(0);
        out.extend((i as u64).to_le_bytes());
        out.extend(vec![9; 24 * i]);
    }
    fs::write(folder.join("images.bin"), out).expect("images");
    let mut out = (POINTS.len() as u64).to_le_bytes().to_vec();
    for (i, (position, color, track)) in POINTS.iter().enumerate() {
        out.extend((i as u64).to_le_bytes());
        out.extend(position.iter().flat_map(|v| v.to_le_bytes()));
        out.extend(color);
        out.extend(0.5_f64.to_le_bytes());
        out.extend((*track as u64).to_le_bytes());
        out.extend(vec![1; 8 * track]);
    }
    fs::write(folder.join("points3D.bin"), out).expect("points");
}

/// Writes the model as three text files.
pub fn text(folder: &Path, camera: &Calibrated) {
    let numbers = |values: &[f64]| {
        values
            .iter()
            .map(|v| format!("{v:?}"))
            .collect::<Vec<_>>()
            .join(" ")
    };
    let out = format!(
        "# comment\n\n7 {} {WIDTH} {HEIGHT} {}\n",
        camera.name(),
        numbers(&camera.1)
    );
    fs::write(folder.join("cameras.txt"), out).expect("cameras");
    let mut out = String::from("# two lines an image\n");
    for i in (0..VIEWS).rev() {
        let (q, t) = pose(i);
        let pose = numbers(&[q.w, q.x, q.y, q.z, t.x, t.y, t.z]);
        // The second line may be empty.
        out += &format!(
            "{} {pose} 7 {}\n{}\n",
            i + 1,
            name(i),
            "1.5 2.5 -1 ".repeat(i)
        );
    }
    fs::write(folder.join("images.txt"), out).expect("images");
    let mut out = String::from("# points\n");
    for (i, (p, [r, g, b], track)) in POINTS.iter().enumerate() {
        out += &format!(
            "{i} {} {r} {g} {b} 0.5 {}\n",
            numbers(p),
            "1 2 ".repeat(*track)
        );
    }
    fs::write(folder.join("points3D.txt"), out).expect("points");
}

/// Photo `i`.
pub fn photo(i: usize) -> image::RgbImage {
    image::RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        image::Rgb([x as u8 * 9, y as u8 * 7, i as u8])
    })
}

/// The folder, its model as `write` has it.
pub fn scene(write: fn(&Path, &Calibrated), camera: &Calibrated) -> TempDir {
    let dir = tempfile::tempdir().expect("folder");
    let at = |p: String| dir.path().join(p);
    fs::create_dir_all(at("sparse/0".into())).expect("folder");
    write(&at("sparse/0".into()), camera);
    for i in 0..VIEWS {
        let path = at(format!("images/{}", name(i)));
        fs::create_dir_all(path.parent().expect("parent")).expect("folder");
        photo(i).save(path).expect("photo");
        let map = LabelMap {
            width: 16,
            height: 12,
            ids: vec![1 + (i % 2) as u16; 192],
        };
        map.write(&at(format!("labels/{}", name(i))))
            .expect("labels");
        if i != 3 {
            map.write(&at(format!("labels_raw/photo {i}.png")))
                .expect("labels");
        }
    }
    fs::write(
        at("classes.json".into()),
        r#"{"0": "void", "1": "wall", "2": "floor"}"#,
    )
    .expect("classes");
    dir
}

/// A line of `images.txt` and the empty one that follows it: the world-to-camera pose of photo `name`, by camera `camera`.
pub fn image_line(id: usize, (q, t): (DQuat, DVec3), camera: usize, name: &str) -> String {
    let pose = [q.w, q.x, q.y, q.z, t.x, t.y, t.z].map(|v| v.to_string());
    format!("{id} {} {camera} {name}\n\n", pose.join(" "))
}
