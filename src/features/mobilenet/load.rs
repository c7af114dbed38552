//! MobileNetV2 weights from `.safetensors` or PyTorch files.
//!
//! Two layouts of keys are published: torchvision's nested one (`features.2.conv.0.0.weight`) and a flat one
//! (`features.2.conv.0.weight`). Both are renamed to the names of the modules here.

use super::{BLOCKS, MobileNetV2};
use crate::error::{Error, Result};
use burn::store::{ApplyError, ApplyResult, KeyRemapper, ModuleSnapshot, ModuleStore};
use burn::store::{PyTorchToBurnAdapter, PytorchStore, SafetensorsStore};
use burn::tensor::Device;
use std::path::Path;

/// Names listed in an error at most.
const LISTED: usize = 6;

/// Any parents before `features.`, such as `module.` or `state_dict.`.
const PARENTS: &str = r"^(?:[A-Za-z_]\w*\.)*?";

impl MobileNetV2 {
    /// Reads weights from a `.safetensors` file, or anything else as a PyTorch checkpoint; the classifier and
    /// `features.18` may be there and are not used.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be opened; [`Error::Input`] when it is damaged, when tensors are missing, have
    /// other shapes, hold a value that is not finite, or are blocks this network does not have.
    pub fn load(path: &Path, device: &Device) -> Result<Self> {
        std::fs::File::open(path).map_err(|e| Error::io(path, "open", e))?;
        let mut net = Self::new(device);
        let result = if path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("safetensors"))
        {
            let open = || {
                SafetensorsStore::from_file(path)
                    .allow_partial(true)
                    .validate(false)
            };
            let keys = open().keys().map_err(|e| damaged(path, e))?;
            let mut store = open()
                .with_from_adapter(PyTorchToBurnAdapter)
                .remap(renaming(path, &keys)?);
            net.load_from(&mut store).map_err(|e| damaged(path, e))?
        } else {
            let open = || {
                PytorchStore::from_file(path)
                    .allow_partial(true)
                    .validate(false)
                    .map_indices_contiguous(false)
            };
            let keys = open().keys().map_err(|e| damaged(path, e))?;
            let mut store = open().remap(renaming(path, &keys)?);
            net.load_from(&mut store).map_err(|e| damaged(path, e))?
        };
        check(path, &result)?;
        net.check_values(path)?;
        Ok(net)
    }

    fn check_values(&self, path: &Path) -> Result<()> {
        for tensor in self.collect(None, None, false) {
            let data = burn::store::bridge::to_data(&tensor).map_err(|e| damaged(path, e))?;
            let negative_variance = tensor.name.ends_with("running_var");
            let Ok(values) = data.as_slice::<f32>() else {
                continue;
            }; // flags
            if let Some(v) = values
                .iter()
                .find(|v| !v.is_finite() || negative_variance && **v < 0.0)
            {
                let expected = if negative_variance {
                    "finite values, none negative"
                } else {
                    "finite values"
                };
                return Err(Error::input(
                    path,
                    tensor.name.clone(),
                    v.to_string(),
                    expected,
                    "download the file again",
                ));
            }
        }
        Ok(())
    }
}

/// From the file's keys to the modules' names.
fn renaming(path: &Path, keys: &[String]) -> Result<KeyRemapper> {
    let nested = keys
        .iter()
        .any(|k| k.ends_with("features.1.conv.0.0.weight"));
    let mut rules = vec![(
        format!(r"{PARENTS}features\.0\.0\."),
        "stem.conv.".to_owned(),
    )];
    rules.push((
        format!(r"{PARENTS}features\.0\.1\."),
        "stem.norm.".to_owned(),
    ));
    for (n, &(expansion, ..)) in BLOCKS.iter().enumerate() {
        let expands = expansion > 1;
        let places: &[(&str, [&str; 2])] = match (nested, expands) {
            (false, false) => &[("depthwise", ["0", "1"]), ("project", ["3", "4"])],
            (false, true) => &[
                ("expand", ["0", "1"]),
                ("depthwise", ["3", "4"]),
                ("project", ["6", "7"]),
            ],
            (true, false) => &[("depthwise", ["0.0", "0.1"]), ("project", ["1", "2"])],
            (true, true) => &[
                ("expand", ["0.0", "0.1"]),
                ("depthwise", ["1.0", "1.1"]),
                ("project", ["2", "3"]),
            ],
        };
        for (layer, indices) in places {
            for (part, index) in ["conv", "norm"].into_iter().zip(indices) {
                let index = index.replace('.', r"\.");
                let from = format!(r"{PARENTS}features\.{}\.conv\.{index}\.", n + 1);
                rules.push((from, format!("blocks.{n}.{layer}.{part}.")));
            }
        }
    }
    KeyRemapper::from_patterns(rules).map_err(|e| damaged(path, e))
}

fn check(path: &Path, result: &ApplyResult) -> Result<()> {
    let help = "give MobileNetV2 weights of width 1, torchvision or flat keys";
    if let Some(error) = result.errors.first() {
        let (name, found, expected) = match error {
            ApplyError::ShapeMismatch {
                path,
                expected,
                found,
            } => (path, format!("{found:?}"), format!("{expected:?}")),
            ApplyError::DTypeMismatch {
                path,
                expected,
                found,
            } => (path, format!("{found:?}"), format!("{expected:?}")),
            ApplyError::AdapterError { path, message }
            | ApplyError::LoadError { path, message } => {
                (path, message.clone(), "a readable tensor".to_owned())
            }
        };
        return Err(Error::input(path, file_name(name), found, expected, help));
    }
    let missing: Vec<String> = result
        .missing
        .iter()
        .map(|(name, _)| name)
        .filter(|n| !n.ends_with(".training"))
        .map(|n| file_name(n))
        .collect();
    if !missing.is_empty() {
        return Err(Error::input(
            path,
            "tensors",
            format!("no {}", list(&missing)),
            "all of features.0 to features.17",
            help,
        ));
    }
    let unexpected: Vec<String> = result
        .unused
        .iter()
        .filter(|n| !n.ends_with("num_batches_tracked") && !n.contains("features.18."))
        .filter(|n| n.starts_with("blocks.") || n.starts_with("stem.") || n.contains("features."))
        .map(|n| file_name(n))
        .collect();
    if !unexpected.is_empty() {
        let expected = "no other tensors in features.0 to features.17";
        return Err(Error::input(
            path,
            "tensors",
            format!("also {}", list(&unexpected)),
            expected,
            help,
        ));
    }
    Ok(())
}

/// A module's tensor as messages name it: `features.2 expand conv weight`.
fn file_name(module_name: &str) -> String {
    let parts: Vec<&str> = module_name.split('.').collect();
    match parts.as_slice() {
        ["stem", rest @ ..] => format!("features.0 {}", rest.join(" ")),
        ["blocks", n, rest @ ..] => match n.parse::<usize>() {
            Ok(n) => format!("features.{} {}", n + 1, rest.join(" ")),
            Err(_) => module_name.to_owned(),
        },
        _ => module_name.to_owned(),
    }
}

fn list(names: &[String]) -> String {
    let shown = names[..names.len().min(LISTED)].join(", ");
    if names.len() > LISTED {
        format!("{shown} and {} more", names.len() - LISTED)
    } else {
        shown
    }
}

fn damaged(path: &Path, cause: impl std::fmt::Display) -> Error {
    Error::input(
        path,
        "contents",
        cause.to_string(),
        "a whole weight file",
        "check that the download is complete",
    )
}
