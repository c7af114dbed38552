//! Masks of photos: which pixels count.

use crate::error::{Result, ensure};
use rayon::prelude::*;
use std::fmt;
use std::sync::Arc;

/// Pixels in a word.
const WORD: usize = u32::BITS as usize;
/// Least number of words for one task.
const TASK: usize = 1 << 9;
/// Words whose used pixels are counted together for [`Mask::nth`].
const BLOCK: usize = 1 << 6;

/// Which pixels of a photo are used and which are left out, `[H, W]` row-major, one bit for each pixel. Copies share the
/// bits.
#[derive(Clone, PartialEq, Eq)]
pub struct Mask {
    width: usize,
    height: usize,
    left_out: usize,
    /// Lowest bit first, set where the pixel is used; the last word is filled up with zeros.
    words: Arc<[u32]>,
    /// Used pixels before each block of words.
    before: Arc<[usize]>,
}

impl Mask {
    /// A mask of `width` x `height` pixels; `used` decides by the row-major number of a pixel whether it is used.
    pub fn new(width: usize, height: usize, used: impl Fn(usize) -> bool) -> Self {
        let pixels = width * height;
        let word = |first: usize| {
            (first..pixels.min(first + WORD)).fold(0, |word, pixel| {
                word | u32::from(used(pixel)) << (pixel - first)
            })
        };
        let words: Arc<[u32]> = (0..pixels).step_by(WORD).map(word).collect();
        let mut kept = 0;
        let count = |block: &[u32]| {
            let before = kept;
            kept += block
                .iter()
                .map(|word| word.count_ones() as usize)
                .sum::<usize>();
            before
        };
        let before = words.chunks(BLOCK).map(count).collect();
        Self {
            width,
            height,
            left_out: pixels - kept,
            words,
            before,
        }
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height
    }

    /// How many pixels are left out.
    pub fn left_out(&self) -> usize {
        self.left_out
    }

    /// Whether a pixel, numbered row-major, is used; `false` beyond the last one.
    pub fn uses(&self, pixel: usize) -> bool {
        self.words
            .get(pixel / WORD)
            .is_some_and(|word| word >> (pixel % WORD) & 1 == 1)
    }

    /// The bits, lowest first, set where the pixel is used; the last word is filled up with zeros.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// How many pixels are used.
    pub fn kept(&self) -> usize {
        self.width * self.height - self.left_out
    }

    /// The number, row-major, of the used pixel after `rank` other used pixels; `None` where at most `rank` are used.
    pub fn nth(&self, rank: usize) -> Option<usize> {
        let block = self
            .before
            .partition_point(|before| *before <= rank)
            .checked_sub(1)?;
        let mut rest = rank - self.before[block];
        for (at, &word) in self.words.iter().enumerate().skip(block * BLOCK) {
            let used = word.count_ones() as usize;
            if rest < used {
                let above = (0..rest).fold(word, |word, _| word & (word - 1));
                return Some(at * WORD + above.trailing_zeros() as usize);
            }
            rest -= used;
        }
        None
    }

    /// Refuses a mask of a different size than `view` has.
    pub(crate) fn expect_size(&self, view: &str, width: usize, height: usize) -> Result<()> {
        ensure!((self.width, self.height) == (width, height),
            argument "data"; found "a mask of {}x{} pixels in {view}", self.width, self.height;
            expected "{width}x{height} as its photo"; help "resize the mask, or leave it out");
        Ok(())
    }

    /// Puts `value` into the pixels that are left out. `values` has `channels` of them for each pixel, row-major.
    pub fn fill<T: Copy + Send + Sync>(&self, values: &mut [T], channels: usize, value: T) {
        let row = (WORD * channels).max(1);
        values
            .par_chunks_mut(row)
            .with_min_len(TASK)
            .zip(&self.words[..])
            .for_each(|(pixels, &word)| {
                if word == u32::MAX {
                    return;
                }
                for (bit, pixel) in pixels.chunks_mut(channels.max(1)).enumerate() {
                    if word >> bit & 1 == 0 {
                        pixel.fill(value);
                    }
                }
            });
    }

    /// The rows of `values`, `[pixels, channels]`, of the used pixels, in their order.
    pub fn used<T: Copy>(&self, values: &[T], channels: usize) -> Vec<T> {
        let pixels = values.chunks(channels.max(1)).enumerate();
        pixels
            .filter(|(pixel, _)| self.uses(*pixel))
            .flat_map(|(_, values)| values)
            .copied()
            .collect()
    }
}

impl fmt::Debug for Mask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = f.debug_struct("Mask");
        text.field("width", &self.width)
            .field("height", &self.height)
            .field("left_out", &self.left_out)
            .finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_pass_over_blocks_that_are_left_out() {
        let used = |pixel: usize| matches!(pixel, 5 | 31 | 32 | 9_000 | 39_999);
        let mask = Mask::new(200, 200, used);
        let found: Vec<_> = (0..6).map(|rank| mask.nth(rank)).collect();
        assert_eq!(
            found,
            [Some(5), Some(31), Some(32), Some(9_000), Some(39_999), None]
        );
        assert_eq!(Mask::new(200, 200, |_| false).nth(0), None);
    }

    #[test]
    fn bits_are_those_of_the_pixels() {
        for (width, height) in [(1, 1), (7, 5), (32, 2), (33, 1_000), (0, 4)] {
            let used = |pixel: usize| pixel % 7 != 3 && pixel / 40 % 3 != 1;
            let mask = Mask::new(width, height, used);
            let pixels = width * height;
            assert_eq!(
                (mask.width(), mask.height(), mask.words().len()),
                (width, height, pixels.div_ceil(32))
            );
            assert!((0..pixels).all(|pixel| mask.uses(pixel) == used(pixel)) && !mask.uses(pixels));
            assert_eq!(
                mask.left_out(),
                (0..pixels).filter(|&pixel| !used(pixel)).count()
            );
            let numbers: Vec<usize> = (0..3 * pixels).collect();
            let mut filled = numbers.clone();
            mask.fill(&mut filled, 3, usize::MAX);
            let want = numbers
                .iter()
                .map(|&i| if used(i / 3) { i } else { usize::MAX });
            assert!(filled.iter().copied().eq(want));
            let kept = mask.used(&numbers, 3);
            assert!(
                kept.iter()
                    .copied()
                    .eq(numbers.into_iter().filter(|i| used(i / 3)))
            );
            let all: Vec<usize> = (0..pixels).filter(|&pixel| used(pixel)).collect();
            assert!(
                all.iter()
                    .enumerate()
                    .all(|(rank, pixel)| mask.nth(rank) == Some(*pixel))
            );
            assert_eq!((mask.nth(all.len()), mask.nth(usize::MAX)), (None, None));
        }
    }
}
