//! Whether the values of an output are what the contract calls them.

use super::contract::Values;
use super::model::Network;
use crate::error::{Result, bail};

/// How far probabilities may lie beyond 0 and 1, and their sums from 1: room for numbers of 8 or 16 bits and for cubic interpolation.
const TOLERANCE: f32 = 0.1;
/// The same where values are called logits: only what can hardly be anything but probabilities is refused.
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

    fn are_probabilities(&self, tolerance: f32) -> bool {
        let [[low, high], sums] = [self.values, self.sums];
        let is_one = |sum: f32| (sum - 1.0).abs() <= tolerance;
        low >= -tolerance && high <= 1.0 + tolerance && sums.into_iter().all(is_one)
    }
}

impl Network {
    /// Refuses an output, `[cells, classes]`, that is not what the contract says.
    ///
    /// # Errors
    /// [`crate::Error::Input`] that names the tensor.
    pub(super) fn check_values(&self, values: &[f32]) -> Result<()> {
        let [.., classes] = self.map_shape();
        let found = Ranges::of(values, classes);
        let (said, other) = match self.contract.output.values {
            Values::Probabilities if !found.are_probabilities(TOLERANCE) => {
                ("probabilities", "logits")
            }
            Values::Logits if found.are_probabilities(CERTAIN) => ("logits", "probabilities"),
            _ => return Ok(()),
        };
        let [[low, high], [least, most]] = [found.values, found.sums];
        bail!(&self.file, "tensor {}", self.output_name();
            found "values from {low} to {high}, sums over the classes from {least} to {most}";
            expected "{said}, as {} says{}", self.contract.file.display(),
                if other == "logits" { ": values from 0 to 1 that add up to 1" } else { "" };
            help "write values = \"{other}\" in the contract")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_probabilities_are_probabilities() {
        let are = |values: &[f32]| Ranges::of(values, 3).are_probabilities(TOLERANCE);
        assert!(are(&[0.2, 0.3, 0.5, 1.0, 0.0, 0.0]));
        assert!(are(&[0.21, 0.31, 0.51, 1.05, -0.05, 0.0]));
        assert!(!are(&[0.2, 0.3, 0.5, 0.9, 0.9, 0.9]), "three sigmoids");
        assert!(!are(&[0.0, -0.7, -2.3, 0.0, -9.0, -9.0]), "logarithms");
        assert!(!are(&[-6.0, 9.0, -2.0, 0.2, 0.3, 0.5]));
    }
}
