//! Not committed: dumps votes per view and weights of held-out views for experiments.
//! dump_votes PLY DATA TRANSFORMS RAW_LABELS|- OUT [weights]
use coseg::data::{Limits, LoadOptions, Split, load};
use coseg::raster::{Projected, Settings};
use coseg::splat::ply;
use std::io::Write;
use std::path::Path;

fn bytes<T: Copy>(v: &[T]) -> &[u8] {
    unsafe { std::slice::from_raw_parts(v.as_ptr().cast(), std::mem::size_of_val(v)) }
}
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let a: Vec<String> = std::env::args().collect();
    let g = ply::read(Path::new(&a[1]), &Limits::default())?.gaussians;
    let mut o = LoadOptions {
        transforms: a[3].clone(),
        ..LoadOptions::default()
    };
    if a[4] != "-" {
        o.raw_labels = Some(a[4].clone());
    }
    let scene = load(Path::new(&a[2]), &o)?;
    let classes = scene.classes.len();
    let lookup = scene.classes.lookup();
    let settings = Settings::default();
    let mut f = std::io::BufWriter::new(std::fs::File::create(format!("{}.votes", a[5]))?);
    println!(
        "classes {classes} {:?}",
        scene
            .classes
            .entries
            .iter()
            .map(|c| c.id)
            .collect::<Vec<_>>()
    );
    for (v, view) in scene.split(Split::Train).enumerate() {
        let Some(raw) = &view.raw else { continue };
        let p = Projected::new(&g.splats(), &view.camera, &settings)?;
        let ids = raw.map().ids;
        let mut shown: Vec<u16> = ids
            .iter()
            .map(|i| lookup[usize::from(*i)])
            .filter(|c| usize::from(*c) < classes)
            .collect();
        shown.sort_unstable();
        shown.dedup();
        let k = shown.len();
        let mut image = vec![0.0_f32; ids.len() * k];
        for (px, id) in image.chunks_exact_mut(k).zip(&ids) {
            if let Ok(i) = shown.binary_search(&lookup[usize::from(*id)]) {
                px[i] = 1.0;
            }
        }
        let sums = p.blend_adjoint(&image, k);
        let dist = |i: usize| {
            let m = g.means[i];
            (view.camera.center - glam::DVec3::new(m[0].into(), m[1].into(), m[2].into())).length()
                as f32
        };
        for (i, row) in sums.chunks_exact(k).enumerate() {
            for (c, &w) in shown.iter().zip(row) {
                if w > 1e-3 {
                    f.write_all(bytes(&[
                        i as u32,
                        (v as u32) << 8 | u32::from(*c) + 1,
                        w.to_bits(),
                        dist(i).to_bits(),
                    ]))?;
                }
            }
        }
    }
    let mut t = std::io::BufWriter::new(std::fs::File::create(format!("{}.truth", a[5]))?);
    let want = a.len() > 6;
    let mut w = want
        .then(|| std::fs::File::create(format!("{}.weights", a[5])).map(std::io::BufWriter::new))
        .transpose()?;
    for view in scene.split(Split::Test) {
        let (width, height) = (view.camera.width, view.camera.height);
        let pixels: Vec<u32> = (0..height)
            .step_by(2)
            .flat_map(|y| (0..width).step_by(2).map(move |x| (y * width + x) as u32))
            .collect();
        let truth = view.truth.as_ref().map(|t| t.map().ids);
        let ids: Vec<u8> = pixels
            .iter()
            .map(|&p| {
                truth.as_ref().map_or(0, |t| {
                    let c = lookup[usize::from(t[p as usize])];
                    if usize::from(c) < classes {
                        c as u8 + 1
                    } else {
                        0
                    }
                })
            })
            .collect();
        t.write_all(&ids)?;
        if let Some(w) = &mut w {
            let m = Projected::new(&g.splats(), &view.camera, &settings)?.weights(Some(&pixels));
            for r in 0..m.rows() {
                let (i, v) = m.row(r);
                w.write_all(bytes(&[i.len() as u32]))?;
                w.write_all(bytes(i))?;
                w.write_all(bytes(v))?;
            }
        }
    }
    Ok(())
}
