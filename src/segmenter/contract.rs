//! The contract of a segmenter: how a photo becomes its input, and what its output says about the photo.

use crate::data::ScoreGrid;
use crate::data::labels::classes::plain;
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files::{self, extension};
use image::RgbImage;
use image::imageops::{FilterType, resize};
use serde::Deserialize;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// The contracts that come with the program, by name.
const SHIPPED: [(&str, &str); 3] = [
    (
        "deeplab_mnv2_ade20k",
        include_str!("../../configs/segmenters/deeplab_mnv2_ade20k.toml"),
    ),
    (
        "segformer_ade20k",
        include_str!("../../configs/segmenters/segformer_ade20k.toml"),
    ),
    (
        "torchvision_voc",
        include_str!("../../configs/segmenters/torchvision_voc.toml"),
    ),
];
/// Longest side of an input, pixels.
const MAX_INPUT_SIDE: usize = 8192;

/// How a network reads photos and what its output means. `configs/segmenters/` has examples.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contract {
    /// The network's input.
    pub input: Input,
    /// The network's output.
    pub output: Output,
    /// The network's classes.
    pub classes: Names,
    /// Where it was read from.
    #[serde(skip)]
    pub file: PathBuf,
}

/// From a photo to the tensor that a network reads.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// Name of the tensor; without it, the network must have one input.
    pub tensor: Option<String>,
    /// Order of its dimensions.
    pub layout: Layout,
    /// Pixels across and down.
    pub size: [usize; 2],
    /// How the photo is made to fit.
    pub resize: Resize,
    /// Where a photo lies that does not fill the input.
    #[serde(default)]
    pub place: Anchor,
    /// Red, green and blue, 0 to 255, of pixels beside the photo.
    #[serde(default)]
    pub pad: [f32; 3],
    /// Subtracted from red, green and blue, which are 0 to 255.
    pub mean: [f32; 3],
    /// What they are divided by then.
    pub std: [f32; 3],
}

/// What a network's output says.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// Name of the tensor; without it, the network must have one output.
    pub tensor: Option<String>,
    /// Order of its dimensions.
    pub layout: Layout,
    /// Input pixels from one cell to the next.
    pub stride: usize,
    /// Where the cells lie.
    pub alignment: Alignment,
    /// What its values are.
    pub values: Values,
    /// Index of the class that means none of the others.
    pub none: Option<usize>,
}

/// The classes of a network.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Names {
    /// In the order of the output's channels.
    pub names: Vec<String>,
}

/// Order of the dimensions of a tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Batch, channels, rows, columns.
    Nchw,
    /// Batch, rows, columns, channels.
    Nhwc,
}

/// How a photo is made to fit an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resize {
    /// Scaled to fit inside, its proportions kept.
    Fit,
    /// Scaled to fill the input.
    Stretch,
}

/// Where a photo lies that does not fill the input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Anchor {
    /// In the upper left corner.
    #[default]
    TopLeft,
    /// In the middle.
    Center,
}

/// Where the cells of an output lie on the input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// Cell i is at the centre of pixel `stride * i` (`align_corners = True`).
    Corners,
    /// Cell i is in the middle of the `stride` pixels from `stride * i` on (`align_corners = False`).
    HalfPixel,
}

/// What the values of an output are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Values {
    /// Arguments of a softmax over the classes.
    Logits,
    /// Probabilities of the classes.
    Probabilities,
}

/// The area of an input that a photo fills.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotoArea {
    /// Pixels across and down of the photo as stored.
    pub photo: [usize; 2],
    /// Column and row of its upper left corner in the input.
    pub at: [usize; 2],
    /// Pixels across and down in the input.
    pub size: [usize; 2],
}

impl Contract {
    /// The contract for the network in `model`. `name` is that of a file or of a shipped contract. Without it, the file beside the model
    /// with its name and the extension `toml` is read, or else the shipped contract of the model's name.
    ///
    /// # Errors
    /// [`Error::Argument`] that lists the shipped contracts where none is found; as [`Contract::parse`].
    pub fn find(model: &Path, name: Option<&str>) -> Result<Self> {
        if let Some(name) = name {
            let file = Path::new(name);
            return match Self::shipped(name) {
                Some(read) => read,
                None if file.is_file() => Self::read(file),
                None => Err(unknown(name)),
            };
        }
        let beside = model.with_extension("toml");
        if beside.is_file() {
            return Self::read(&beside);
        }
        let stem = model.file_stem().unwrap_or_default().to_string_lossy();
        Self::shipped(&stem).unwrap_or_else(|| Err(without_contract(model, &stem)))
    }

    /// Names of the shipped contracts.
    pub fn names() -> impl Iterator<Item = &'static str> {
        SHIPPED.iter().map(|(name, _)| *name)
    }

    fn shipped(name: &str) -> Option<Result<Self>> {
        let (name, text) = SHIPPED.iter().find(|(shipped, _)| *shipped == name)?;
        Some(Self::parse(text, Path::new(name)))
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`Error::Io`]; as [`Contract::parse`].
    pub fn read(file: &Path) -> Result<Self> {
        Self::parse(&files::text(file)?, file)
    }

    /// Parses the TOML `text` of `file`.
    ///
    /// # Errors
    /// [`Error::Input`] naming line or key: malformed TOML, unknown or missing keys, values out of range, names twice.
    pub fn parse(text: &str, file: &Path) -> Result<Self> {
        let mut contract: Self = files::toml(text, file, "a contract as in configs/segmenters/")?;
        contract.file = file.to_owned();
        contract.check()?;
        Ok(contract)
    }

    fn check(&self) -> Result<()> {
        const HELP: &str = "correct the contract";
        let file = &self.file;
        let input = &self.input;
        let output = &self.output;
        let names = &self.classes.names;
        let in_range = |side: &usize| (1..=MAX_INPUT_SIDE).contains(side);
        ensure!(input.size.iter().all(in_range), file, "input.size"; found "{:?}", input.size;
            expected "sides of 1 to 8192 pixels"; help "{HELP}");
        let numbers = [input.pad, input.mean, input.std];
        let are_finite = numbers.as_flattened().iter().all(|v| v.is_finite());
        ensure!(are_finite && !input.std.contains(&0.0), file, "input"; found "pad, mean, std {numbers:?}";
            expected "finite numbers, std not 0"; help "{HELP}");
        let stride = output.stride;
        ensure!((1..=input.size[0].min(input.size[1])).contains(&stride), file, "output.stride"; found "{stride}";
            expected "1 or more, within the input"; help "{HELP}");
        let count = names.len();
        ensure!((2..=usize::from(u16::MAX)).contains(&count), file, "classes.names"; found "{count} names";
            expected "2 to 65535 names"; help "{HELP}");
        if let Some(none) = output.none.filter(|none| *none >= count) {
            bail!(file, "output.none"; found "{none}"; expected "an index below {count}"; help "{HELP}");
        }
        let mut plain_names = HashSet::new();
        if let Some(twice) = names.iter().find(|name| !plain_names.insert(plain(name))) {
            bail!(file, "classes.names"; found "{twice:?} twice"; expected "different names"; help "{HELP}");
        }
        Ok(())
    }

    /// Shape of the input tensor.
    pub fn input_shape(&self) -> [usize; 4] {
        let [width, height] = self.input.size;
        match self.input.layout {
            Layout::Nchw => [1, 3, height, width],
            Layout::Nhwc => [1, height, width, 3],
        }
    }

    /// Cells of the output, across and down.
    pub fn cells(&self) -> [usize; 2] {
        self.input.size.map(|side| match self.output.alignment {
            Alignment::Corners => (side - 1) / self.output.stride + 1,
            Alignment::HalfPixel => side.div_ceil(self.output.stride),
        })
    }

    /// Shape of the output tensor.
    pub fn output_shape(&self) -> [usize; 4] {
        let [width, height] = self.cells();
        let classes = self.classes.names.len();
        match self.output.layout {
            Layout::Nchw => [1, classes, height, width],
            Layout::Nhwc => [1, height, width, classes],
        }
    }

    /// Where a photo of this size lies in the input.
    pub fn photo_area(&self, photo: [usize; 2]) -> PhotoArea {
        let room = self.input.size;
        let size = match self.input.resize {
            Resize::Stretch => room,
            Resize::Fit => {
                let scale = |a: usize| room[a] as f64 / photo[a] as f64;
                let scale = scale(0).min(scale(1));
                [0, 1].map(|a| ((photo[a] as f64 * scale).round() as usize).clamp(1, room[a]))
            }
        };
        let at = match self.input.place {
            Anchor::TopLeft => [0, 0],
            Anchor::Center => [0, 1].map(|a| (room[a] - size[a]) / 2),
        };
        PhotoArea { photo, at, size }
    }

    /// The input tensor for a photo, and where the photo lies in it.
    pub fn prepare(&self, photo: &RgbImage) -> (Vec<f32>, PhotoArea) {
        let area = self.photo_area([photo.width() as usize, photo.height() as usize]);
        let [width, height] = area.size.map(|n| n as u32);
        // As wide as the reduction, like the bilinear filter of Pillow.
        let small = resize(photo, width, height, FilterType::Triangle);
        let input = &self.input;
        let [across, down] = input.size;
        let value = |channel: usize, v: f32| (v - input.mean[channel]) / input.std[channel];
        let index = |channel: usize, x: usize, y: usize| match input.layout {
            Layout::Nchw => (channel * down + y) * across + x,
            Layout::Nhwc => (y * across + x) * 3 + channel,
        };
        let mut values = vec![0.0; 3 * across * down];
        for (x, y) in (0..down).flat_map(|y| (0..across).map(move |x| (x, y))) {
            let inside = x.checked_sub(area.at[0]).zip(y.checked_sub(area.at[1]));
            let pixel = inside.and_then(|(x, y)| small.get_pixel_checked(x as u32, y as u32));
            let rgb = pixel.map_or(input.pad, |pixel| pixel.0.map(f32::from));
            for channel in 0..3 {
                values[index(channel, x, y)] = value(channel, rgb[channel]);
            }
        }
        (values, area)
    }

    /// Where the cells of the output lie on a photo.
    pub fn grid(&self, area: &PhotoArea) -> ScoreGrid {
        let stride = self.output.stride as f64;
        let scale = |a: usize| area.size[a] as f64 / area.photo[a] as f64 / stride;
        let offset = |a: usize| match self.output.alignment {
            Alignment::Corners => (area.at[a] as f64 - 0.5) / stride,
            Alignment::HalfPixel => area.at[a] as f64 / stride - 0.5,
        };
        ScoreGrid {
            photo: area.photo,
            scale: [0, 1].map(scale),
            offset: [0, 1].map(offset),
        }
    }
}

/// `names`, those nearest to `name` first.
pub(super) fn nearest_first<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let name = plain(name);
    let likeness = |other: &str| strsim::jaro_winkler(&name, &plain(other));
    let mut names: Vec<&str> = names.collect();
    names.sort_by(|a, b| likeness(b).total_cmp(&likeness(a)));
    names
}

fn without_contract(model: &Path, stem: &str) -> Error {
    let found = model.display();
    if extension(model) != "onnx" {
        return invalid!(argument "--model"; found "{found}"; expected "a network as .onnx file"; help "export it to ONNX");
    }
    let shipped = nearest_first(stem, Contract::names()).join(", ");
    invalid!(argument "--model"; found "{found}, which has no contract"; expected "{stem}.toml beside it, or --contract (features.contract for its features)";
        help "a contract says how a network reads photos (docs/data.md); `coseg` has {shipped}")
}

fn unknown(name: &str) -> Error {
    let shipped = nearest_first(name, Contract::names()).join(", ");
    invalid!(argument "--contract"; found "no contract {name:?}"; expected "a TOML file, or one of {shipped}";
        help "name one, or write a file (docs/data.md)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_contracts_parse() {
        for name in Contract::names() {
            let contract = Contract::find(Path::new("model.onnx"), Some(name)).expect(name);
            assert!(contract.cells().iter().all(|n| *n > 1), "{name}");
        }
    }
}
