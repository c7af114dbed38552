//! Which tiles a projected Gaussian reaches: `crate::raster::cpu::outline`'s formulas, in kernels.

use super::project::SPLAT;
use crate::raster::cpu::footprint::TILE;
use burn_cubecl::cubecl::{self, prelude::*};

/// What tile lists need of a projected Gaussian.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Outline {
    center_x: f32,
    center_y: f32,
    slope: f32,
    /// Half axes of the row section and of the bounding box.
    half_x: f32,
    half_y: f32,
    /// Row offset at which the ellipse is furthest right.
    right_at: f32,
}

/// A range of tiles.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Span {
    pub first: u32,
    pub end: u32,
}

#[cube]
pub(super) fn outline(splats: &[f32], id: usize) -> Outline {
    let at = id * SPLAT;
    let slope = splats[at + 2];
    let reach = splats[at + 6];
    let sx = 1.0f32 / splats[at + 3];
    let sy = 1.0f32 / splats[at + 4];
    let tall = slope * sy;
    let wide = (sx * sx + tall * tall).sqrt();
    Outline {
        center_x: splats[at],
        center_y: splats[at + 1],
        slope,
        half_x: reach * sx,
        half_y: reach * sy,
        right_at: reach * sy * (tall / wide),
    }
}

/// Pixels whose centres lie within `low..=high`, of `limit`.
#[cube]
fn between(low: f32, high: f32, limit: u32) -> Span {
    let limit_f = f32::cast_from(limit);
    let first = u32::cast_from(max(0.0f32, min((low - 0.5f32).ceil(), limit_f)));
    let mut end = 0u32;
    if high >= 0.5f32 {
        end = min(u32::cast_from(min(high - 0.5f32, limit_f)) + 1u32, limit);
    }
    Span {
        first,
        end: max(end, first),
    }
}

/// Rows of tiles, given the pixel rows.
#[cube]
pub(super) fn tile_rows(pixels: &Span) -> Span {
    let mut end = (pixels.end + (TILE - 1) as u32) / TILE as u32;
    if pixels.end == pixels.first {
        end = pixels.first / TILE as u32;
    }
    Span {
        first: pixels.first / TILE as u32,
        end,
    }
}

/// Pixel rows whose centres the ellipse covers.
#[cube]
pub(super) fn pixel_rows(o: &Outline, height: u32) -> Span {
    between(o.center_y - o.half_y, o.center_y + o.half_y, height)
}

/// Columns of tiles that hold a pixel centre near the ellipse in the tile row `row`; `pixels` are all its pixel rows.
#[cube]
pub(super) fn tile_columns(o: &Outline, pixels: &Span, row: u32, width: u32) -> Span {
    let first = max(pixels.first, row * TILE as u32);
    let end = min(pixels.end, (row + 1u32) * TILE as u32);
    let low = max(f32::cast_from(first) + 0.5f32 - o.center_y, -o.half_y);
    let high = min(f32::cast_from(end) - 0.5f32 - o.center_y, o.half_y);
    // The right edge is concave in dy with its top at `right_at`; the left edge is its mirror image.
    let right = min(max(o.right_at, low), high);
    let left = min(max(-o.right_at, low), high);
    let right_edge = o.center_x + o.slope * right + half_width(o, right);
    let left_edge = o.center_x + o.slope * left - half_width(o, left);
    let columns = between(left_edge, right_edge, width);
    tile_rows(&columns)
}

/// Half the length of the row section at the offset `dy` from the centre.
#[cube]
fn half_width(o: &Outline, dy: f32) -> f32 {
    let part = dy / o.half_y;
    o.half_x * max(0.0f32, 1.0f32 - part * part).sqrt()
}
