//! What the processor can do at most, on all threads: a copy of large buffers, and chains of multiply-adds in registers.

use crate::backend::simd::{Kernel, dispatch};
use crate::backend::vector::{LANES, Vector};
use rayon::prelude::*;
use std::hint::black_box;

/// Chains under way at a time: two units of a core with a latency of four or five cycles are busy with ten.
const CHAINS: usize = 12;
/// Rows of [`LANES`] chains: twice as many, which registers of 16 lanes hold at a time and those of 8 one half after the
/// other.
const ROWS: usize = 2 * CHAINS;
/// Chains of a thread.
type Rows = [[f32; LANES]; ROWS];

/// Operations of a step on all threads, two a multiply-add.
pub(super) fn operations_of_a_step() -> f64 {
    2.0 * (rayon::current_num_threads() * ROWS * LANES) as f64
}

/// A buffer of `len` floats whose memory is there: written, by the threads that will use it.
pub(super) fn buffer(len: usize, first: f32) -> Vec<f32> {
    let mut buffer = vec![0.0; len];
    buffer
        .par_chunks_mut(part(len))
        .for_each(|part| part.fill(first));
    buffer
}

/// Copies `from` over `to`, a part a thread. Large parts the C library writes past the caches; of small ones the destination is read too,
/// which is not counted.
pub(super) fn copy(from: &[f32], to: &mut [f32]) {
    let part = part(from.len());
    to.par_chunks_mut(part)
        .zip(from.par_chunks(part))
        .with_max_len(1)
        .for_each(|(to, from)| to.copy_from_slice(from));
    black_box(to);
}

fn part(len: usize) -> usize {
    len.div_ceil(rayon::current_num_threads()).max(1)
}

/// `x = x factor + term`, `steps` times in every chain of every thread.
pub(super) fn multiply_add(steps: usize) {
    rayon::broadcast(|_| {
        let mut rows = black_box(starts());
        // Numbers that the compiler does not know, so that no step is done beforehand.
        chains(&mut rows, black_box(FACTOR), black_box(TERM), steps);
        black_box(rows);
    });
}

/// They lead to 2, from anywhere, and so neither overflow nor vanish.
const FACTOR: f32 = 0.75;
const TERM: f32 = 0.5;

fn starts() -> Rows {
    std::array::from_fn(|row| std::array::from_fn(|lane| (row * LANES + lane) as f32))
}

fn chains(rows: &mut Rows, factor: f32, term: f32, steps: usize) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx512f") {
        // SAFETY: the processor has it, checked just now.
        return unsafe { widest(rows, factor, term, steps) };
    }
    dispatch(Chains {
        rows,
        factor,
        term,
        steps,
    });
}

struct Chains<'a> {
    rows: &'a mut Rows,
    factor: f32,
    term: f32,
    steps: usize,
}

impl Kernel<f32> for Chains<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: Vector<f32>>(self) {
        let (factor, term) = (V::splat(self.factor), V::splat(self.term));
        for half in self.rows.chunks_exact_mut(CHAINS) {
            let mut x = [V::splat(0.0); CHAINS];
            for (x, row) in x.iter_mut().zip(&*half) {
                *x = V::load(row);
            }
            for _ in 0..self.steps {
                for x in &mut x {
                    *x = x.fma(factor, term);
                }
            }
            for (x, row) in x.into_iter().zip(half) {
                x.store(row);
            }
        }
    }
}

/// Kernels of this crate have 8 lanes; what the processor could do has 16.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn widest(rows: &mut Rows, factor: f32, term: f32, steps: usize) {
    use std::arch::x86_64::{
        _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_set1_ps, _mm512_setzero_ps, _mm512_storeu_ps,
    };
    let (factor, term) = (_mm512_set1_ps(factor), _mm512_set1_ps(term));
    let (pairs, _) = rows.as_chunks_mut::<2>();
    let mut x = [_mm512_setzero_ps(); CHAINS];
    for (x, pair) in x.iter_mut().zip(&*pairs) {
        // SAFETY: two rows of eight are sixteen floats.
        *x = unsafe { _mm512_loadu_ps(pair.as_flattened().as_ptr()) };
    }
    for _ in 0..steps {
        for x in &mut x {
            *x = _mm512_fmadd_ps(*x, factor, term);
        }
    }
    for (x, pair) in x.into_iter().zip(pairs) {
        // SAFETY: as above.
        unsafe { _mm512_storeu_ps(pair.as_flattened_mut().as_mut_ptr(), x) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chains_are_what_plain_steps_give() {
        for steps in [0, 1, 7, 100] {
            let mut rows = [starts(); 2];
            chains(&mut rows[0], FACTOR, TERM, steps);
            dispatch(Chains {
                rows: &mut rows[1],
                factor: FACTOR,
                term: TERM,
                steps,
            });
            for rows in rows {
                for (i, x) in rows.as_flattened().iter().enumerate() {
                    let want = (0..steps).fold(i as f32, |x, _| x * FACTOR + TERM);
                    assert!(
                        (x - want).abs() <= 1e-5 * want,
                        "{steps} steps from {i}: {x}, expected {want}"
                    );
                }
            }
        }
        multiply_add(3);
        assert!(operations_of_a_step() >= 384.0);
    }

    #[test]
    fn a_copy_is_whole() {
        for len in [1, 1000, 70_001] {
            let from: Vec<f32> = (0..len).map(|i| i as f32).collect();
            let mut to = buffer(len, -1.0);
            assert!(to.iter().all(|v| *v == -1.0));
            copy(&from, &mut to);
            assert_eq!(from, to);
        }
    }
}
