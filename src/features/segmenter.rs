//! Features from within a semantic segmenter in an ONNX file: one tensor of the network, and the same over larger areas.

use super::FeatureMap;
use crate::data::bilinear::{among, beside};
use crate::error::Result;
use crate::segmenter::contract::Alignment;
use crate::segmenter::{Contract, Network};
use image::RgbImage;
use sha2::{Digest, Sha256};
use std::path::Path;

/// Changes with the arithmetic: cached maps of another version are computed again.
pub(super) const VERSION: &str = "segmenter 2";

/// A network, one of whose inner tensors is read.
#[derive(Debug)]
pub struct Tap {
    network: Network,
}

impl Tap {
    /// The tensor of this name within the network in `file`. [`Contract::find`] tells what `contract` may be.
    ///
    /// # Errors
    /// As [`Contract::find`] and [`Network::load`]; [`crate::Error::Input`] for a name that the network does not have, listing
    /// the nearest ones, and for a tensor that is not a map.
    pub fn load(file: &Path, contract: Option<&str>, tensor: &str) -> Result<Self> {
        let contract = Contract::find(file, contract)?;
        let network = Network::open(file, contract, Some(tensor))?;
        Ok(Self { network })
    }

    /// SHA-256 of the network's file and of what its contract says of input and output, in hexadecimal digits.
    pub fn digest(&self) -> String {
        let Contract { input, output, .. } = &self.network.contract;
        let said = format!("{} {input:?} {output:?}", self.network.digest);
        format!("{:x}", Sha256::digest(said))
    }

    /// The maps of a photo, fine to coarse, of `scales` scales: the tensor, and its means over areas of 2, 4 and 8 cells a side.
    ///
    /// # Errors
    /// As [`Tap::map`].
    pub(super) fn maps(&self, photo: &RgbImage, scales: usize) -> Result<Vec<FeatureMap>> {
        let finest = self.map(photo)?;
        // An odd map shares its middle cells between two.
        let halved =
            |map: &FeatureMap| Some(map.resized(map.height.div_ceil(2), map.width.div_ceil(2)));
        Ok(std::iter::successors(Some(finest), halved)
            .take(scales)
            .collect())
    }

    /// The features of a photo, bilinear between the cells of the tensor. Cells beside the photo are left out: those of the map divide
    /// it evenly.
    ///
    /// # Errors
    /// As [`Network::run`].
    pub fn map(&self, photo: &RgbImage) -> Result<FeatureMap> {
        let contract = &self.network.contract;
        let (input, area) = contract.prepare(photo);
        let values = self.network.output(&input)?;
        let [down, across, channels] = self.network.map_shape();
        let axis = |a: usize, cells: usize| -> Vec<(usize, usize, f64)> {
            let side = contract.input.size[a] as f64;
            let at = area.at[a] as f64;
            let size = area.size[a] as f64;
            let count = (cells as f64 * size / side).round().max(1.0) as usize;
            let taps = |i: usize| {
                let input = at + (i as f64 + 0.5) * size / count as f64;
                let cell = match contract.output.alignment {
                    Alignment::Corners => {
                        (input - 0.5) * (cells as f64 - 1.0) / (side - 1.0).max(1.0)
                    }
                    Alignment::HalfPixel => input * cells as f64 / side - 0.5,
                };
                beside(cell, cells)
            };
            (0..count).map(taps).collect()
        };
        let columns = axis(0, across);
        let rows = axis(1, down);
        let mut data = Vec::with_capacity(rows.len() * columns.len() * channels);
        for &(top, bottom, fy) in &rows {
            for &(left, right, fx) in &columns {
                let corners = [(left, top), (right, top), (left, bottom), (right, bottom)];
                for channel in 0..channels {
                    let value = |(x, y)| values[(y * across + x) * channels + channel];
                    let values = corners.map(value);
                    data.push(among(values, fx as f32, fy as f32));
                }
            }
        }
        Ok(FeatureMap {
            width: columns.len(),
            height: rows.len(),
            channels,
            data,
            steps: None,
        })
    }
}
