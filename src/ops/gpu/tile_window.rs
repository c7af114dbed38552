//! Separable convolution with the window of SSIM: a cube a tile and channel, a unit a pixel.

use crate::backend::gpu::UNITS;
use crate::ops::photo::CHANNELS;
use crate::ops::window::{RADIUS, TAPS, taps};
use burn_cubecl::cubecl::{self, prelude::*};

/// Pixels on a side of a tile; a unit has one.
const TILE: usize = 16;
/// The tile with the pixels around it that the window reaches.
pub(super) const SIDE: usize = TILE + 2 * RADIUS;
/// Values of a plane: a tile with its rim.
pub(super) const PLANE: usize = SIDE * SIDE;
/// Values of a plane whose rows have been convolved.
pub(super) const ROWS: usize = SIDE * TILE;

/// Cubes for all tiles and channels.
pub(super) fn cubes(height: usize, width: usize) -> usize {
    width.div_ceil(TILE) * height.div_ceil(TILE) * CHANNELS
}

/// A place in the rim of a tile.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Place {
    pub inside: bool,
    /// Pixel, row-major; that of the first one when outside.
    pub pixel: usize,
}

#[cube]
pub(super) fn place(tile: usize, column: usize, row: usize, width: u32, height: u32) -> Place {
    let across = (width + (TILE - 1) as u32) / TILE as u32;
    // Counted from the rim's corner of the first tile, so that nothing is negative.
    let x = (tile as u32 % across) * TILE as u32 + column as u32;
    let y = (tile as u32 / across) * TILE as u32 + row as u32;
    let rim = RADIUS as u32;
    let inside = x >= rim && x < width + rim && y >= rim && y < height + rim;
    Place {
        inside,
        pixel: select(inside, (y - rim) * width + x - rim, 0u32) as usize,
    }
}

/// The pixel of this unit.
#[cube]
pub(super) fn own_place(tile: usize, width: u32, height: u32) -> Place {
    let unit = UNIT_POS as usize;
    place(
        tile,
        RADIUS + unit % TILE,
        RADIUS + unit / TILE,
        width,
        height,
    )
}

/// Of the three planes, in their order.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Windowed {
    pub first: f32,
    pub second: f32,
    pub third: f32,
}

/// The three planes in `planes`, convolved, at the unit's pixel; of the third one nothing unless `all`. All units of the cube
/// call it; `planes` is complete before.
#[cube]
pub(super) fn windowed(
    planes: &Shared<[f32]>,
    rows: &mut Shared<[f32]>,
    #[comptime] all: bool,
) -> Windowed {
    let unit = UNIT_POS as usize;
    let mut k = unit;
    while k < ROWS {
        let at = k / TILE * SIDE + k % TILE;
        let mut first = 0.0f32;
        let mut second = 0.0f32;
        let mut third = 0.0f32;
        #[unroll]
        for t in 0..TAPS {
            let tap = comptime![taps::<f32>()[t]];
            first += tap * planes[at + t];
            second += tap * planes[at + t + PLANE];
            if comptime![all] {
                third += tap * planes[at + t + 2 * PLANE];
            }
        }
        rows[k] = first;
        rows[k + ROWS] = second;
        if comptime![all] {
            rows[k + 2 * ROWS] = third;
        }
        k += UNITS as usize;
    }
    sync_cube();
    let mut first = 0.0f32;
    let mut second = 0.0f32;
    let mut third = 0.0f32;
    #[unroll]
    for t in 0..TAPS {
        let tap = comptime![taps::<f32>()[t]];
        first += tap * rows[unit + t * TILE];
        second += tap * rows[unit + t * TILE + ROWS];
        if comptime![all] {
            third += tap * rows[unit + t * TILE + 2 * ROWS];
        }
    }
    Windowed {
        first,
        second,
        third,
    }
}
