//! Philox 4x32-10 (Salmon et al. 2011): numbers that are a function of a key and a counter, on any device.

/// Factors of a round.
pub(crate) const FACTORS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
/// What the key grows by from round to round.
pub(crate) const STEPS: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];
/// Rounds.
pub(crate) const ROUNDS: usize = 10;

/// The four words of `counter` under `key`.
pub fn philox(key: [u32; 2], counter: [u32; 4]) -> [u32; 4] {
    (0..ROUNDS as u32).fold(counter, |[a, b, c, d], round| {
        let key = [0, 1].map(|k| key[k].wrapping_add(round.wrapping_mul(STEPS[k])));
        let [p, q] = [(a, 0), (c, 1)].map(|(word, k)| u64::from(word) * u64::from(FACTORS[k]));
        [
            (q >> 32) as u32 ^ b ^ key[0],
            q as u32,
            (p >> 32) as u32 ^ d ^ key[1],
            p as u32,
        ]
    })
}

/// Three standard normal numbers, number `index` under `key`, by Box and Muller from uniform numbers that an `f32` holds.
pub fn normals(key: [u32; 2], index: u32) -> [f64; 3] {
    let words = philox(key, [index, 0, 0, 0]);
    // neither 0 nor 1
    let radius =
        |word: u32| (-2.0 * ((f64::from(word >> 9) + 0.5) / f64::from(1 << 23)).ln()).sqrt();
    let angle = |word: u32| f64::from(word >> 8) / f64::from(1 << 24) * std::f64::consts::TAU;
    let (sin, cos) = angle(words[1]).sin_cos();
    let first = radius(words[0]);
    [
        first * cos,
        first * sin,
        radius(words[2]) * angle(words[3]).cos(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_those_of_the_authors_known_answers() {
        let digits = [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344];
        for (key, counter, want) in [
            (
                [0; 2],
                [0; 4],
                [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8],
            ),
            (
                [u32::MAX; 2],
                [u32::MAX; 4],
                [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd],
            ),
            (
                [0xa409_3822, 0x299f_31d0],
                digits,
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ] {
            assert_eq!(philox(key, counter), want, "{key:x?}");
        }
    }

    #[test]
    fn normal_numbers_have_the_moments_of_one_and_do_not_follow_each_other() {
        let count = 20_000;
        let rows: Vec<[f64; 3]> = (0..count).map(|i| normals([1, 2], i)).collect();
        let mean =
            |f: &dyn Fn(&[f64; 3]) -> f64| rows.iter().map(f).sum::<f64>() / f64::from(count);
        let noise = 4.0 / f64::from(count).sqrt();
        for k in 0..3 {
            assert!(mean(&|row| row[k]).abs() < noise, "mean of {k}");
            assert!(
                (mean(&|row| row[k].powi(2)) - 1.0).abs() < noise * 2.0_f64.sqrt(),
                "variance of {k}"
            );
            assert!(
                (mean(&|row| row[k].powi(4)) - 3.0).abs() < noise * 96.0_f64.sqrt(),
                "fourth moment of {k}"
            );
            assert!(
                mean(&|row| row[k] * row[(k + 1) % 3]).abs() < noise,
                "covariance of {k}"
            );
        }
        let next = rows
            .windows(2)
            .map(|pair| pair[0][0] * pair[1][0])
            .sum::<f64>()
            / f64::from(count);
        assert!(next.abs() < noise, "covariance with the next row: {next}");
    }
}
