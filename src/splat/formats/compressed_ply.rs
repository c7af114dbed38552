//! Compressed PLY of PlayCanvas, which SuperSplat and splat-transform read and write.
//!
//! A chunk is 256 Gaussians, with the lowest and the highest position, log-scale and colour. A Gaussian has four 32-bit numbers:
//! position and log-scale between those of its chunk (11, 10 and 11 bits), the quaternion (2 bits for the place of its largest
//! component, 10 for each other one), colour and opacity (8 bits each). Higher SH coefficients have 8 bits for -4 to 4.

use super::{PlyScene, from_smallest_three, logit, opacity, scene_of, sh_degree, smallest_three};
use crate::error::{Result, bail, ensure};
use crate::files::atomic;
use crate::files::ply::PlyFile;
use crate::splat::{Gaussians, SH_0};
use glam::DVec3;
use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};
use std::io::{self, Write};
use std::path::Path;

/// Gaussians of a chunk.
const CHUNK: usize = 256;
/// Log-scales beyond this are cut off.
const MAX_LOG_SCALE: f64 = 20.0;
/// SH coefficients lie within half of this about 0.
const SH_RANGE: f32 = 8.0;
/// What a chunk bounds: position, log-scale and colour.
const BOUNDED: [[&str; 3]; 3] = [
    ["x", "y", "z"],
    ["scale_x", "scale_y", "scale_z"],
    ["r", "g", "b"],
];
const PACKED: [&str; 4] = [
    "packed_position",
    "packed_rotation",
    "packed_scale",
    "packed_color",
];
/// Bits of the three parts of a position or log-scale, and how far they are shifted.
const COARSE: [(u32, u32); 3] = [(11, 21), (10, 11), (11, 0)];

/// Names of the bounds of a chunk: three low and three high ones of each of [`BOUNDED`].
fn bound_names() -> [String; 18] {
    let end = |i: usize| ["min", "max"][i / 3 % 2];
    std::array::from_fn(|i| format!("{}_{}", end(i), BOUNDED[i / 6][i % 3]))
}

/// The number of `bits` bits for a value of 0 to 1.
fn pack(value: f64, bits: u32) -> u32 {
    let most = f64::from((1_u32 << bits) - 1);
    (value.clamp(0.0, 1.0) * most).round() as u32
}

/// The inverse of [`pack`] for the part of `packed` from bit `shift` on.
fn unpack(packed: u32, bits: u32, shift: u32) -> f64 {
    let most = (1_u32 << bits) - 1;
    f64::from(packed >> shift & most) / f64::from(most)
}

/// Position, log-scale and colour of a Gaussian.
fn bounded(gaussians: &Gaussians, positions: &[DVec3], row: usize) -> [[f64; 3]; 3] {
    let scale =
        gaussians.log_scales[row].map(|v| f64::from(v).clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE));
    let color = &gaussians.sh[3 * gaussians.sh_len() * row..];
    let color = [0, 1, 2].map(|c| f64::from(color[c] * SH_0) + 0.5);
    [positions[row].to_array(), scale, color]
}

/// The lowest and the highest position, log-scale and colour of Gaussians.
type Bounds = [[[f32; 3]; 2]; 3];

/// The bounds of Gaussians with these [`bounded`] values.
fn bounds_of(values: impl Iterator<Item = [[f64; 3]; 3]>) -> Bounds {
    let mut bounds = [[[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]]; 3];
    for values in values {
        for ([low, high], values) in bounds.iter_mut().zip(values) {
            for (i, value) in values.into_iter().enumerate() {
                low[i] = low[i].min(value as f32);
                high[i] = high[i].max(value as f32);
            }
        }
    }
    bounds
}

/// Writes `gaussians` at the world positions `positions`.
///
/// # Errors
/// [`crate::Error::Io`].
pub(super) fn write(path: &Path, gaussians: &Gaussians, positions: &[DVec3]) -> Result<()> {
    let count = gaussians.len();
    let rest = 3 * (gaussians.sh_len() - 1);
    let bounded = |row| bounded(gaussians, positions, row);
    let rows = |chunk: usize| CHUNK * chunk..count.min(CHUNK * (chunk + 1));
    let chunks = 0..count.div_ceil(CHUNK);
    let bounds: Vec<Bounds> = chunks.map(|i| bounds_of(rows(i).map(bounded))).collect();
    atomic::write(path, |out| {
        write_header(out, bounds.len(), count, rest)?;
        for value in bounds.as_flattened().as_flattened().as_flattened() {
            out.write_all(&value.to_le_bytes())?;
        }
        for row in 0..count {
            let rotation = gaussians.rotations[row];
            let opacity = opacity(gaussians.opacity_logits[row]);
            let packed = pack_gaussian(&bounded(row), &bounds[row / CHUNK], rotation, opacity);
            out.write_all(packed.map(u32::to_le_bytes).as_flattened())?;
        }
        for sh in gaussians.sh.chunks_exact(3 + rest).filter(|_| rest > 0) {
            let byte = |i: usize| {
                ((sh[3 + i % (rest / 3) * 3 + i / (rest / 3)] / SH_RANGE + 0.5) * 256.0) as u8
            };
            let bytes: Vec<u8> = (0..rest).map(byte).collect();
            out.write_all(&bytes)?;
        }
        Ok(())
    })
}

/// Writes the header of `count` Gaussians in `chunks` chunks, with `rest` higher SH coefficients each.
fn write_header(out: &mut impl Write, chunks: usize, count: usize, rest: usize) -> io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    writeln!(out, "element chunk {chunks}")?;
    for name in bound_names() {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "element vertex {count}")?;
    for name in PACKED {
        writeln!(out, "property uint {name}")?;
    }
    if rest > 0 {
        writeln!(out, "element sh {count}")?;
    }
    for i in 0..rest {
        writeln!(out, "property uchar f_rest_{i}")?;
    }
    writeln!(out, "end_header")
}

/// The numbers [`PACKED`] of a Gaussian with these [`bounded`] values, in a chunk with these bounds.
fn pack_gaussian(
    values: &[[f64; 3]; 3],
    bounds: &Bounds,
    rotation: [f32; 4],
    opacity: f64,
) -> [u32; 4] {
    let share = |part: usize, i: usize| {
        let [low, high] = bounds[part].map(|end| f64::from(end[i]));
        // Equal bounds give the low one.
        (values[part][i] - low) / (high - low).max(f64::MIN_POSITIVE)
    };
    let coarse = |part| {
        let packed = |i: usize| pack(share(part, i), COARSE[i].0) << COARSE[i].1;
        packed(0) | packed(1) | packed(2)
    };
    let color = [share(2, 0), share(2, 1), share(2, 2), opacity];
    let color = color.iter().fold(0, |bits, v| bits << 8 | pack(*v, 8));
    [coarse(0), pack_rotation(rotation), coarse(1), color]
}

/// The components w, x, y, z.
fn pack_rotation(rotation: [f32; 4]) -> u32 {
    let (largest, three) = smallest_three(rotation.map(f64::from), [1.0, 0.0, 0.0, 0.0]);
    three.iter().fold(largest as u32, |bits, v| {
        bits << 10 | pack(v * FRAC_1_SQRT_2 + 0.5, 10)
    })
}

/// The inverse of [`pack_rotation`].
fn unpack_rotation(packed: u32) -> [f32; 4] {
    let three = [20, 10, 0].map(|shift| (unpack(packed, 10, shift) - 0.5) * SQRT_2);
    from_smallest_three((packed >> 30) as usize, three)
}

/// Reads such a file.
///
/// # Errors
/// [`crate::Error::Input`], [`crate::Error::Limit`], [`crate::Error::Io`].
pub(super) fn read(path: &Path) -> Result<PlyScene> {
    let file = PlyFile::open(path, "chunk")?;
    // Older files have no bounds of colours.
    let has_colors = file.scalar("min_r").is_some();
    let mut names = bound_names().map(Some);
    if !has_colors {
        names[12..].fill(None);
    }
    let mut bounds: Vec<[f64; 18]> = Vec::new();
    file.read(&names, |row, cells| {
        let mut cells = *cells;
        if !has_colors {
            cells[15..].fill(1.0);
        }
        ensure!(cells.iter().all(|v| v.is_finite()), path, "element chunk, row {row}"; found "a bound that is not finite";
            expected "finite numbers"; help "export the file again");
        bounds.push(cells);
        Ok(())
    })?;
    let file = PlyFile::open(path, "vertex")?;
    let has_sh = file.has_element("sh");
    let mut gaussians = Gaussians::default();
    let packed = PACKED.map(|name| Some(name.to_owned()));
    file.read(&packed, |row, cells| {
        let Some(bounds) = bounds.get(row / CHUNK) else {
            bail!(path, "element chunk"; found "{} rows", bounds.len(); expected "one for each {CHUNK} Gaussians";
                help "export the file again");
        };
        let [position, rotation, scale, color] = cells.map(|v| v as u32);
        let between = |part: usize, i: usize, share: f64| {
            let [low, high] = [bounds[6 * part + i], bounds[6 * part + 3 + i]];
            low * (1.0 - share) + high * share
        };
        let coarse = |part, packed| {
            let unpacked = |i: usize| unpack(packed, COARSE[i].0, COARSE[i].1);
            [0, 1, 2].map(|i| between(part, i, unpacked(i)) as f32)
        };
        gaussians.means.push(coarse(0, position));
        gaussians.log_scales.push(coarse(1, scale));
        gaussians.rotations.push(unpack_rotation(rotation));
        gaussians.opacity_logits.push(logit(color as u8));
        for i in 0..3 {
            let color = between(2, i, unpack(color, 8, 24 - 8 * i as u32));
            gaussians.sh.push(((color - 0.5) / f64::from(SH_0)) as f32);
        }
        Ok(())
    })?;
    if has_sh {
        read_sh(path, &mut gaussians)?;
    }
    scene_of(path, gaussians)
}

/// Adds the coefficients of the element `sh`.
fn read_sh(path: &Path, gaussians: &mut Gaussians) -> Result<()> {
    let file = PlyFile::open(path, "sh")?;
    gaussians.sh_degree = sh_degree(path, &file)?;
    let rest = gaussians.sh_len() - 1;
    let columns: [_; 45] = std::array::from_fn(|i| (i < 3 * rest).then(|| format!("f_rest_{i}")));
    let mut colors = std::mem::take(&mut gaussians.sh).into_iter();
    file.read(&columns, |_, cells| {
        gaussians.sh.extend(colors.by_ref().take(3));
        for k in 0..rest {
            let share = |byte: f64| match byte {
                0.0 => 0.0,
                255.0 => 1.0,
                _ => (byte + 0.5) / 256.0,
            };
            let value = |c: usize| (share(cells[c * rest + k]) as f32 - 0.5) * SH_RANGE;
            gaussians.sh.extend([0, 1, 2].map(value));
        }
        Ok(())
    })?;
    let [found, expected] = [gaussians.sh.len() / (3 * rest + 3), gaussians.len()];
    ensure!(found == expected && colors.len() == 0, path, "element sh"; found "{found} rows";
        expected "{expected}, one for each Gaussian"; help "export the file again");
    Ok(())
}
