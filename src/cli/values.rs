//! Values of options: numbers and names.

use coseg::objects::is_name;
use std::str::FromStr;

/// Exactly `N` numbers with `separator` between them.
pub fn numbers<T: FromStr, const N: usize>(text: &str, separator: char) -> Option<[T; N]> {
    let values = text.split(separator).map(|value| value.trim().parse().ok());
    values.collect::<Option<Vec<T>>>()?.try_into().ok()
}

/// Column and row of a pixel.
pub fn pixel(text: &str) -> Result<[usize; 2], String> {
    let expected = "expected a column and a row separated by a comma, for instance 240,180";
    numbers(text, ',').ok_or_else(|| expected.into())
}

/// The cap of a splat's opacity.
pub fn alpha_max(text: &str) -> Result<f64, String> {
    number(text, "a number above 0, at most 1", |alpha| {
        *alpha > 0.0 && *alpha <= 1.0
    })
}

/// A number that `fits`.
pub fn number<T: FromStr>(
    text: &str,
    expected: &str,
    fits: impl FnOnce(&T) -> bool,
) -> Result<T, String> {
    let number = text.trim().parse().ok().filter(fits);
    number.ok_or_else(|| format!("expected {expected}"))
}

/// The name of an object.
pub fn name(text: &str) -> Result<String, String> {
    let name = text.trim();
    let expected = "expected a name of 1 to 200 characters, without line ends";
    is_name(name)
        .then(|| name.to_owned())
        .ok_or_else(|| expected.into())
}

/// A number from 0 to 1.
pub fn share(text: &str) -> Result<f32, String> {
    number(text, "a number from 0 to 1", |share| {
        (0.0..=1.0).contains(share)
    })
}
