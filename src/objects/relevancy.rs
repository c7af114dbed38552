//! How well each Gaussian matches a text: LERF's relevancy (Kerr et al. 2023, section 3.4).

use crate::error::{Result, ensure};
use rayon::prelude::*;

/// LERF's canonical phrases: what a text is compared with.
pub const CANONICAL: [&str; 4] = ["object", "things", "stuff", "texture"];
/// Relevancy of a Gaussian that matches another phrase as well as the text.
pub const NEUTRAL: f32 = 0.5;
/// LERF's inverse temperature of the softmax.
const SHARPNESS: f32 = 10.0;

/// Cosines of the angles between features of Gaussians and phrases.
#[derive(Clone, Debug, PartialEq)]
pub struct Similarities {
    phrases: usize,
    /// Scalar products so far, `[N, phrases]`.
    products: Vec<f32>,
    /// Squared lengths of the features so far, `[N]`.
    squares: Vec<f32>,
}

impl Similarities {
    /// Similarities of `gaussians` features to `phrases` phrases, before any channel is added.
    pub fn new(gaussians: usize, phrases: usize) -> Self {
        Self {
            phrases,
            products: vec![0.0; gaussians * phrases],
            squares: vec![0.0; gaussians],
        }
    }

    /// Adds channels: `features` `[N, C]` and, for each phrase, `[C]`.
    ///
    /// # Errors
    /// [`crate::Error::Argument`] for other extents.
    pub fn add(&mut self, features: &[f32], phrases: &[&[f32]]) -> Result<()> {
        let channels = phrases.first().map_or(0, |phrase| phrase.len());
        let fits = phrases.len() == self.phrases
            && phrases.iter().all(|phrase| phrase.len() == channels)
            && features.len() == self.squares.len() * channels;
        ensure!(fits, argument "features"; found "{} values", features.len();
            expected "those of {} Gaussians in {channels} channels, and {} phrases", self.squares.len(), self.phrases;
            help "give the channels of all Gaussians and phrases");
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        let rows = features.par_chunks_exact(channels.max(1));
        let sums = self.products.par_chunks_exact_mut(self.phrases.max(1));
        let all = rows.zip(sums).zip(&mut self.squares);
        all.for_each(|((feature, products), square)| {
            *square += dot(feature, feature);
            let each = products.iter_mut().zip(phrases);
            each.for_each(|(product, phrase)| *product += dot(feature, phrase));
        });
        Ok(())
    }

    /// Relevancy of each Gaussian to the phrase `text`, 0 to 1: the share of the text in a softmax with each of the phrases
    /// `others`, the smallest of these shares; 1 without others. 0.5 favours neither. 0 for a Gaussian without
    /// features, or with one that is not finite. Phrases are counted from 0, and have length 1.
    ///
    /// # Panics
    /// If there is no such phrase.
    pub fn relevancy(&self, text: usize, others: &[usize]) -> Vec<f32> {
        let rows = self.products.chunks_exact(self.phrases);
        let relevancy = |(products, square): (&[f32], &f32)| {
            if *square <= 0.0 || !square.is_finite() {
                return 0.0;
            }
            let sharpness = SHARPNESS / square.sqrt();
            let shares = others.iter().map(|&other| {
                let difference = sharpness * (products[other] - products[text]);
                1.0 / (1.0 + difference.exp())
            });
            shares.fold(1.0, f32::min)
        };
        rows.zip(&self.squares).map(relevancy).collect()
    }
}

/// Relevancy of each Gaussian to the phrase `text` at the one of `scales` where the highest relevancy occurs, as
/// [`Similarities::relevancy`]; empty without scales.
///
/// # Panics
/// If there is no such phrase.
pub fn best_scale(scales: &[Similarities], text: usize, others: &[usize]) -> Vec<f32> {
    let relevancies = scales.iter().map(|scale| scale.relevancy(text, others));
    let best = relevancies.max_by(|a, b| largest(a).total_cmp(&largest(b)));
    best.unwrap_or_default()
}

/// The largest of some relevancies; 0 without any.
pub fn largest(relevancies: &[f32]) -> f32 {
    relevancies.iter().copied().fold(0.0, f32::max)
}

/// For each text the Gaussians that are more relevant to it than `threshold`, and to no other text more. `relevancies` has those of
/// all Gaussians for each text.
pub fn selections(relevancies: &[Vec<f32>], threshold: f32) -> Vec<Vec<u32>> {
    let mut selections = vec![Vec::new(); relevancies.len()];
    for row in 0..relevancies.iter().map(Vec::len).min().unwrap_or(0) {
        let mut best = None;
        let mut most = threshold;
        for (text, relevancy) in relevancies.iter().enumerate() {
            if relevancy[row] > most {
                (best, most) = (Some(text), relevancy[row]);
            }
        }
        if let Some(text) = best {
            selections[text].push(row as u32);
        }
    }
    selections
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gaussian_goes_to_the_text_it_is_most_relevant_to_if_to_any() {
        let relevancies = [vec![0.5, 0.6, 0.7, 0.0], vec![0.4, 0.8, 0.7, 0.5]];
        let expected: [Vec<u32>; 2] = [vec![2], vec![1]];
        assert_eq!(selections(&relevancies, NEUTRAL), expected);
        assert_eq!(selections(&relevancies, 0.0), [vec![0, 2], vec![1, 3]]);
        assert!(selections(&[], NEUTRAL).is_empty());
    }

    #[test]
    fn relevancy_is_the_smallest_share_of_softmaxes_whatever_the_length_of_features() {
        // Two phrases and a text; channels come in two parts.
        let phrases = [[0.6_f32, 0.8, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        let features = [[3.0_f32, 4.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]];
        let mut similarities = Similarities::new(3, 3);
        let part = |rows: &[[f32; 3]; 3], range: std::ops::Range<usize>| -> Vec<Vec<f32>> {
            rows.iter().map(|row| row[range.clone()].to_vec()).collect()
        };
        for range in [0..2, 2..3] {
            let phrases = part(&phrases, range.clone());
            let phrases: Vec<&[f32]> = phrases.iter().map(Vec::as_slice).collect();
            let features = part(&features, range).concat();
            similarities.add(&features, &phrases).unwrap();
        }
        let share = |text: f32, other: f32| {
            (10.0 * text).exp() / ((10.0 * text).exp() + (10.0 * other).exp())
        };
        let want = [share(1.0, 0.6), share(0.6, 1.0), 0.0];
        let found = similarities.relevancy(0, &[1, 2]);
        for (found, want) in found.iter().zip(want) {
            assert!((found - want).abs() < 1e-6, "{found} {want}");
        }
        assert!(similarities.add(&[1.0], &[&[1.0]]).is_err());
    }
}
