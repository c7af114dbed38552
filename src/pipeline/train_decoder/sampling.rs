//! The view of an iteration of stage two, and its sample of pixels.

use crate::random::{Purpose, in_epochs};
use rand::Rng;

/// The view of each iteration: a fresh shuffle every epoch, a function of (seed, iteration) alone.
pub fn view_at(seed: u64, iteration: usize, views: usize) -> usize {
    let views = (0..views).collect();
    in_epochs(views, seed, Purpose::SegmentationViews, iteration)
}

/// A stratified sample of the numbers below `count`: one of each run of `1 / share` of them, ascending. Where `1 / share` is not
/// a whole number, runs of two lengths alternate so that the share is exact. They start at a random offset then, so that each
/// number is equally likely.
pub(in crate::pipeline) fn stratified_sample(
    count: usize,
    share: f64,
    rng: &mut impl Rng,
) -> Vec<u32> {
    let run = (1.0 / share.clamp(0.0, 1.0)).max(1.0);
    // One divided by 1/49 is not quite 49.
    let whole = (run - run.round()).abs() < 1e-9 * run;
    let run = if whole { run.round() } else { run };
    if run == 1.0 {
        return (0..count as u32).collect();
    }
    let shift = if whole {
        0.0
    } else {
        run * rng.random::<f64>()
    };
    let start = |i: usize| ((i as f64 * run - shift) as usize).min(count);
    let runs = (0..)
        .map(|i| start(i)..start(i + 1))
        .take_while(|run| run.start < count);
    runs.filter(|run| !run.is_empty())
        .map(|run| rng.random_range(run) as u32)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::stratified_sample;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn any_share_of_the_pixels_is_drawn_as_given() {
        for count in [0, 1, 7, 1_000, 123_457] {
            for share in [
                1e-9,
                1e-3,
                0.07,
                0.25,
                0.4,
                0.5,
                0.6,
                0.7,
                0.9,
                0.999_999,
                1.0 - 1e-12,
                1.0,
            ] {
                let rows = stratified_sample(count, share, &mut ChaCha8Rng::seed_from_u64(3));
                assert!(
                    rows.is_sorted_by(|a, b| a < b)
                        && rows.iter().all(|row| (*row as usize) < count)
                );
                let off = rows.len() as f64 - share * count as f64;
                assert!(
                    off > -1.0 && off < 2.0,
                    "{share} of {count}: {}",
                    rows.len()
                );
            }
        }
        // Each number is equally likely, except at the ends, where runs are cut.
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut drawn = [0; 700];
        (0..1_000)
            .flat_map(|_| stratified_sample(700, 0.7, &mut rng))
            .for_each(|row| drawn[row as usize] += 1);
        assert!(
            drawn[2..698].iter().all(|times| (620..780).contains(times)),
            "{drawn:?}"
        );
    }

    #[test]
    fn a_whole_number_of_runs_draws_one_of_each() {
        for (share, stride) in [
            (0.5, 2),
            (0.25, 4),
            (0.1, 10),
            (1.0 / 3.0, 3),
            (1.0 / 49.0, 49),
        ] {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let mut same = ChaCha8Rng::seed_from_u64(5);
            let count = 100_003;
            let want = (0..count)
                .step_by(stride)
                .map(|first| same.random_range(first..(first + stride).min(count)));
            let want: Vec<u32> = want.map(|row| row as u32).collect();
            assert_eq!(stratified_sample(count, share, &mut rng), want, "{share}");
        }
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        assert!(stratified_sample(50, 1.0, &mut rng).into_iter().eq(0..50));
        assert_eq!(
            rng.random::<u64>(),
            ChaCha8Rng::seed_from_u64(6).random::<u64>(),
            "a share of 1 draws no random number"
        );
    }
}
