//! Whether the values of an output are what the contract calls them.

use super::contract::Values;
use super::model::Network;
use crate::error::{Result, bail};

/// How far probabilities may lie beyond 0 and 1, and their sums from 1: room for cubic interpolation.
const TOLERANCE: f32 = 0.1;
/// How far the sum of probabilities of 8 bits may lie from 1 for each class.
const ROUNDING: f32 = 0.5 / 255.0;
/// As [`TOLERANCE`] where values are called logits: only what can hardly be anything but probabilities is refused.
const CERTAIN: f32 = 1e-3;

/// The ranges of the values of an output, and of their sums over the classes of a cell.
struct Ranges {
    values: [f32; 2],
    sums: [f32; 2],
}

impl Ranges {
    fn of(values: &[f32], classes: usize) -> Self {
        let none = [f32::INFINITY, f32::NEG_INFINITY];
        let widened = |[low, high]: [f32; 2], v: f32| [low.min(v), high.max(v)];
        let cells = values.chunks_exact(classes.max(1));
        Self {
            values: values.iter().copied().fold(none, widened),
            sums: cells.map(|cell| cell.iter().sum()).fold(none, widened),
        }
    }

    /// Whether all values are from 0 to 1.
    fn are_shares(&self, tolerance: f32) -> bool {
        let [low, high] = self.values;
        low >= -tolerance && high <= 1.0 + tolerance
    }

    /// Whether all sums are 1.
    fn are_whole(&self, tolerance: f32) -> bool {
        let is_one = |sum: f32| (sum - 1.0).abs() <= tolerance;
        self.sums.into_iter().all(is_one)
    }

    /// What to do about `values` that are something else; `None` if they may be what they are called.
    fn help(&self, values: Values, classes: usize) -> Option<&'static str> {
        let tolerance = TOLERANCE + ROUNDING * classes as f32;
        match values {
            Values::Probabilities if !self.are_shares(TOLERANCE) => {
                Some("write values = \"logits\" in the contract")
            }
            Values::Probabilities if !self.are_whole(tolerance) => Some(
                "end the network in a softmax over the classes, or export what its last layer reads",
            ),
            Values::Logits if self.are_shares(CERTAIN) && self.are_whole(CERTAIN) => {
                Some("write values = \"probabilities\" in the contract")
            }
            Values::Probabilities | Values::Logits => None,
        }
    }
}

impl Network {
    /// Refuses an output, `[cells, classes]`, that is not what the contract says.
    ///
    /// # Errors
    /// [`crate::Error::Input`] that names the tensor.
    pub(super) fn check_values(&self, values: &[f32]) -> Result<()> {
        let [.., classes] = self.map_shape();
        let called = self.contract.output.values;
        let found = Ranges::of(values, classes);
        let Some(help) = found.help(called, classes) else {
            return Ok(());
        };
        let expected = match called {
            Values::Probabilities => "probabilities: values from 0 to 1 that add up to 1",
            Values::Logits => "logits",
        };
        let [[low, high], [least, most]] = [found.values, found.sums];
        bail!(&self.file, "tensor {}", self.output_name();
            found "values from {low} to {high}, sums over the classes from {least} to {most}";
            expected "{expected}, as {} says", self.contract.file.display(); help "{help}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_probabilities_are_probabilities() {
        let are = |values: &[f32]| {
            Ranges::of(values, 3)
                .help(Values::Probabilities, 3)
                .is_none()
        };
        assert!(are(&[0.2, 0.3, 0.5, 1.0, 0.0, 0.0]));
        assert!(are(&[0.21, 0.31, 0.51, 1.05, -0.05, 0.0]));
        assert!(!are(&[0.2, 0.3, 0.5, 0.9, 0.9, 0.9]), "three sigmoids");
        assert!(!are(&[0.0, -0.7, -2.3, 0.0, -9.0, -9.0]), "logarithms");
        assert!(!are(&[-6.0, 9.0, -2.0, 0.2, 0.3, 0.5]));
        // 150 equal shares of 8 bits, each rounded up.
        let equal = [2.0 / 255.0; 150];
        let help = Ranges::of(&equal, 150).help(Values::Probabilities, 150);
        assert_eq!(help, None);
    }
}
