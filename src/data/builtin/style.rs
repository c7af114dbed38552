//! The colours and materials that give one room its look.

use super::build::Builder;
use super::noise::rgb;
use super::patterns::Pattern;
use glam::DVec3;
use rand::Rng;

/// Materials shared by the objects of a room, and its colours.
#[derive(Clone, Debug)]
pub(super) struct Style {
    /// Wood of tables and cabinets, light and dark kinds.
    pub woods: [usize; 2],
    /// Light and dark colour of each wood.
    pub wood_colors: [[DVec3; 2]; 2],
    /// Painted white wood.
    pub white: usize,
    /// Dark metal.
    pub metal: usize,
    /// Cloth of sofas: two kinds.
    pub cloths: [usize; 2],
    /// Throw cushions.
    pub accents: [usize; 3],
    /// Strong colours for pictures, rugs and cushions.
    pub palette: [DVec3; 6],
}

const WOODS: [[u32; 2]; 6] = [
    [0xd9b381, 0xb98a55],
    [0xa8703f, 0x7d4d28],
    [0x6e4a30, 0x4d3120],
    [0xc9a06a, 0xa87d48],
    [0xe2cfae, 0xc9b08a],
    [0x8f5a3a, 0x6a3d25],
];
const CLOTHS: [[u32; 2]; 7] = [
    [0x3e6a78, 0x2f5562],
    [0x8a9a6b, 0x72835a],
    [0xb9543f, 0x9c4433],
    [0x8d8f98, 0x74767f],
    [0xd2b48c, 0xbd9d74],
    [0x4a4f7c, 0x3b3f66],
    [0xc98f2f, 0xb07b26],
];
const PALETTES: [[u32; 6]; 4] = [
    [0xc8503c, 0x2f5d7c, 0xe3b04b, 0x4f7d5b, 0xefe3cc, 0x35323a],
    [0x1f4e5f, 0xd9783e, 0xf0d9a8, 0x79a3a0, 0x8c2f39, 0xf3efe4],
    [0x6b3f69, 0xd8a7b1, 0xb6c7a5, 0xe9c46a, 0x3f4a6b, 0xf4ead8],
    [0x2d6a4f, 0xbc4749, 0xf2c078, 0x386fa4, 0xe8e1d3, 0x4a3c31],
];

impl Style {
    /// Draws a look.
    pub fn draw(b: &mut Builder, rng: &mut impl Rng) -> Self {
        let palette = PALETTES[rng.random_range(0..PALETTES.len())].map(rgb);
        let first = rng.random_range(0..WOODS.len());
        let second = (first + rng.random_range(1..WOODS.len())) % WOODS.len();
        let wood_colors = [first, second].map(|i| WOODS[i].map(rgb));
        let woods = wood_colors.map(|[l, d]| b.matt(Pattern::Wood(l, d)));
        let first = rng.random_range(0..CLOTHS.len());
        let second = (first + rng.random_range(1..CLOTHS.len())) % CLOTHS.len();
        let cloths = [first, second].map(|i| {
            let [l, d] = CLOTHS[i].map(rgb);
            b.matt(Pattern::Clouds(l, d, 0.16))
        });
        let accents = [
            b.matt(Pattern::Stripes(palette[0], palette[4], 0.14)),
            b.matt(Pattern::Checks(palette[2], palette[1], 0.16)),
            b.matt(Pattern::Motif(palette[3], palette[4], 0.17)),
        ];
        let white = b.matt(Pattern::Plain(rgb(0xeeeae0)));
        let metal = b.matt(Pattern::Plain(rgb(0x3a3d42)));
        Self {
            woods,
            wood_colors,
            white,
            metal,
            cloths,
            accents,
            palette,
        }
    }

    /// Three different colours of the palette.
    pub fn three(&self, rng: &mut impl Rng) -> [DVec3; 3] {
        let start = rng.random_range(0..6);
        let stride = [1, 5][rng.random_range(0..2)];
        [0, 1, 2].map(|i| self.palette[(start + i * stride) % 6])
    }
}
