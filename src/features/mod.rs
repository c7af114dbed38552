//! 2D image features: where they come from, reduction by PCA, and the on-disk cache; texts that they are compared with.
//!
//! For every view an [`Extractor`] gives one to four [`FeatureMap`]s, fine and local to coarse and global. [`FeatureReduction`] fits
//! a PCA per scale on the training views, reduces every map to [`crate::config::FeatureConfig::dimensions`] channels and
//! L2-normalises each cell.

mod cache;
pub mod clip;
mod colors;
pub mod descriptor;
pub mod dino;
mod extract;
pub(crate) mod import;
mod lattice;
mod map;
pub mod mobilenet;
mod pca;
mod segmenter;
mod transformer;

pub use self::colors::FeatureColors;
pub use self::extract::{FeatureReduction, PCA_CELLS, ViewFeatures};
pub use self::lattice::{Lattice, Steps};
pub use self::map::FeatureMap;
pub use self::pca::{Moments, Pca};
pub use self::segmenter::Tap;
pub use self::transformer::Activation;
pub use crate::config::SCALES;

use crate::backend::device::upload;
use crate::config::{FeatureConfig, FeatureSource};
use crate::data::View;
use crate::error::{Error, Result, bail, invalid};
use crate::files::sha256;
use burn::tensor::{Device, Tensor};
use image::RgbImage;
use std::path::PathBuf;
use std::sync::Arc;

/// Where feature maps come from.
#[derive(Debug)]
pub struct Extractor {
    /// Name for reports: `descriptor`, `mobilenetv2 FILE`, `dino FILE`, `segmenter FILE, TENSOR` or `imported DIR`.
    pub name: String,
    /// What the maps of an image depend on besides its pixels; `None` when caching them gains nothing.
    cache_key: Option<String>,
    /// Maps of an image.
    scales: usize,
    source: Source,
}

/// What makes the maps.
#[derive(Debug)]
enum Source {
    Descriptor,
    MobileNetV2(Box<mobilenet::MobileNetV2>),
    Dino(Box<dino::Vit>),
    Segmenter(Box<Tap>),
    /// The folder of the files that hold them.
    Import(PathBuf),
}

impl Extractor {
    /// The extractor of the settings. Reads its weights, if it has any, onto `device`.
    ///
    /// # Errors
    /// [`Error::Config`] when a needed path is not set; [`Error::Io`] and [`Error::Input`] for unusable weights.
    pub fn open(config: &FeatureConfig, device: &Device) -> Result<Self> {
        let device = device.clone().inner();
        let weights = |network: &str| {
            config.weights.as_deref().ok_or_else(|| {
                invalid!(setting "features.weights"; found "nothing";
                    expected "a path to {network} weights"; help "set features.weights")
            })
        };
        let source = match &config.source {
            FeatureSource::Auto if config.weights.is_none() => &FeatureSource::Descriptor,
            source => source,
        };
        let (name, cache_key, source) = match source {
            FeatureSource::Descriptor => {
                let key = descriptor::VERSION.to_owned();
                ("descriptor".to_owned(), Some(key), Source::Descriptor)
            }
            FeatureSource::Auto | FeatureSource::Mobilenetv2 => {
                let path = weights("MobileNetV2")?;
                let net = mobilenet::MobileNetV2::load(path, &device);
                let net = net.map_err(|error| naming_source(error, source))?;
                let name = format!("mobilenetv2 {}", path.display());
                let key = format!("{} {}", mobilenet::VERSION, sha256(path)?);
                (name, Some(key), Source::MobileNetV2(Box::new(net)))
            }
            FeatureSource::Dino => {
                let path = weights("DINO")?;
                let net = dino::Vit::load(path, &device)?;
                let name = format!("dino {}", path.display());
                let key = format!("{} {} norm true", dino::VERSION, sha256(path)?);
                (name, Some(key), Source::Dino(Box::new(net)))
            }
            FeatureSource::Segmenter(tensor) => {
                let path = weights("segmenter")?;
                let tap = Tap::load(path, config.contract.as_deref(), tensor)?;
                let name = format!("segmenter {}, {tensor}", path.display());
                let key = format!("{} {} {tensor}", segmenter::VERSION, tap.digest());
                (name, Some(key), Source::Segmenter(Box::new(tap)))
            }
            FeatureSource::Import(dir) if dir.is_dir() => {
                let name = format!("imported {}", dir.display());
                (name, None, Source::Import(dir.clone()))
            }
            FeatureSource::Import(dir) => {
                let error = std::io::ErrorKind::NotFound.into();
                return Err(Error::io(dir, "open folder", error));
            }
        };
        let scales = config.scale_count();
        Ok(Self {
            name,
            cache_key: cache_key.map(|key| format!("{key} scales {scales}")),
            scales,
            source,
        })
    }

    /// Refuses a view without maps, where maps are imported.
    ///
    /// # Errors
    /// [`Error::Input`].
    pub(crate) fn expect(&self, view: &str) -> Result<()> {
        match &self.source {
            Source::Import(dir) => import::expect(dir, view, self.scales),
            _ => Ok(()),
        }
    }

    /// The maps of a view before reduction, fine to coarse, [`FeatureConfig::scale_count`] of them.
    ///
    /// Imported maps are `STEM.1.npy`, `STEM.2.npy` and so on (`[H, W, C]`, f32 or f16) or the tensors `scale1`, `scale2` and so on
    /// of `STEM.safetensors`, STEM being the view's name.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Input`] and [`Error::NonFinite`] for imported files that cannot be used; [`Error::NonFinite`]
    /// for weights under which an activation is not finite; those of [`crate::data::Photo::pixels`].
    pub fn maps(&self, view: &View) -> Result<Vec<FeatureMap>> {
        self.maps_of(&view.name, || view.image.pixels())
    }

    /// The maps of the view `name`; `pixels` decodes its photo where that is needed.
    fn maps_of(
        &self,
        name: &str,
        pixels: impl FnOnce() -> Result<Arc<RgbImage>>,
    ) -> Result<Vec<FeatureMap>> {
        let scales = self.scales;
        let mut maps = match &self.source {
            Source::Descriptor => descriptor::describe(&*pixels()?, scales),
            Source::MobileNetV2(net) => net.maps(&*pixels()?)?,
            Source::Dino(net) => net.maps(&*pixels()?)?,
            Source::Segmenter(tap) => tap.maps(&*pixels()?, scales)?,
            Source::Import(dir) => import::read(dir, name, scales)?,
        };
        maps.truncate(scales);
        Ok(maps)
    }
}

/// An error of MobileNetV2's weights that says which setting makes them MobileNetV2's: `"auto"` takes every file for them.
fn naming_source(mut error: Error, source: &FeatureSource) -> Error {
    if let (FeatureSource::Auto, Error::Input { help, .. }) = (source, &mut error) {
        help.push_str(
            ", or set features.source, which decides what features.weights are for: \"auto\" takes them for MobileNetV2; for \
             weights of DINO, set it to \"dino\"",
        );
    }
    error
}

/// The image as `[1, 3, H, W]`, normalised as networks trained on ImageNet expect it.
///
/// # Errors
/// [`Error::Argument`] for an image without pixels.
fn normalized(image: &RgbImage, device: &Device) -> Result<Tensor<4>> {
    /// Mean of ImageNet's RGB, 0..1.
    const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
    /// Standard deviation of ImageNet's RGB.
    const STD: [f32; 3] = [0.229, 0.224, 0.225];

    let (width, height) = (image.width() as usize, image.height() as usize);
    if width == 0 || height == 0 {
        bail!(argument "image"; found "{width} x {height} pixels";
            expected "one pixel or more"; help "give another image");
    }
    let mut planes = Vec::with_capacity(3 * width * height);
    for (c, (mean, std)) in MEAN.iter().zip(STD).enumerate() {
        let channel = image.as_raw().iter().skip(c).step_by(3);
        planes.extend(channel.map(|&x| (f32::from(x) / 255.0 - mean) / std));
    }
    Ok(upload(planes, [1, 3, height, width], device))
}
