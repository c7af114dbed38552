//! 2D image features: where they come from, reduction by PCA, and the on-disk cache.
//!
//! For every view an [`Extractor`] gives four [`FeatureMap`]s, fine and local to coarse and global. [`Reduction`] fits a PCA per
//! scale on the training views, reduces every map to [`crate::config::FeatureConfig::dimensions`] channels and
//! L2-normalises each cell.

mod cache;
pub mod descriptor;
pub mod dino;
mod extract;
mod import;
mod lattice;
mod map;
pub mod mobilenet;
mod pca;
mod segmenter;

pub use self::extract::{PCA_CELLS, Reduction, ViewFeatures};
pub(crate) use self::lattice::Axis;
pub use self::lattice::{Lattice, Steps};
pub use self::map::FeatureMap;
pub use self::pca::{Moments, Pca};

use crate::backend::device::upload;
use crate::config::{FeatureConfig, FeatureSource};
use crate::data::View;
use crate::error::{Error, Result, invalid};
use crate::segmenter::Tap;
use crate::weights::file_digest;
use burn::tensor::{Device, Tensor};
use image::RgbImage;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Scales per view.
pub const SCALES: usize = 4;

/// Where feature maps come from.
#[derive(Debug)]
#[non_exhaustive]
pub enum Extractor {
    /// The built-in descriptor, see [`descriptor`].
    Descriptor,
    /// MobileNetV2, see [`mobilenet`].
    MobileNetV2 {
        /// The network.
        net: Box<mobilenet::MobileNetV2>,
        /// Where its weights were read from.
        path: PathBuf,
        /// SHA-256 of that file.
        hash: String,
    },
    /// DINO's vision transformer, see [`dino`].
    Dino {
        /// The network.
        net: Box<dino::Vit>,
        /// Where its weights were read from.
        path: PathBuf,
        /// SHA-256 of that file.
        hash: String,
        /// Whether maps take the final layer normalisation.
        final_norm: bool,
    },
    /// A tensor within a semantic segmenter, see [`Tap`].
    Segmenter {
        /// The network.
        tap: Box<Tap>,
        /// Where it was read from.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
    },
    /// Maps read from files of this folder, see [`Extractor::maps`].
    Import(PathBuf),
}

impl Extractor {
    /// The extractor of the settings. Reads its weights, if it has any, onto `device`.
    ///
    /// # Errors
    /// [`Error::Config`] when a needed path is not set; [`Error::Io`] and [`Error::Input`] for unusable weights.
    pub fn open(config: &FeatureConfig, device: &Device) -> Result<Self> {
        let weights = |network: &str| {
            config.weights.as_deref().ok_or_else(|| {
                invalid!(setting "features.weights"; found "nothing";
                    expected "a path to {network} weights"; help "set features.weights")
            })
        };
        match &config.source {
            FeatureSource::Descriptor => Ok(Self::Descriptor),
            FeatureSource::Auto if config.weights.is_none() => Ok(Self::Descriptor),
            FeatureSource::Auto | FeatureSource::Mobilenetv2 => {
                Self::mobilenet(weights("MobileNetV2")?, device)
            }
            FeatureSource::Dino => Self::dino(weights("DINO")?, config.final_norm, device),
            FeatureSource::Segmenter(tensor) => {
                let path = weights("segmenter")?;
                let tap = Box::new(Tap::load(path, tensor)?);
                let path = path.to_owned();
                let tensor = tensor.clone();
                Ok(Self::Segmenter { tap, path, tensor })
            }
            FeatureSource::Import(dir) if dir.is_dir() => Ok(Self::Import(dir.clone())),
            FeatureSource::Import(dir) => {
                let error = std::io::ErrorKind::NotFound.into();
                Err(Error::io(dir, "open folder", error))
            }
        }
    }

    fn mobilenet(path: &Path, device: &Device) -> Result<Self> {
        let net = mobilenet::MobileNetV2::load(path, &device.clone().inner())?;
        Ok(Self::MobileNetV2 {
            net: Box::new(net),
            path: path.to_owned(),
            hash: file_digest(path)?,
        })
    }

    fn dino(path: &Path, final_norm: bool, device: &Device) -> Result<Self> {
        let net = dino::Vit::load(path, &device.clone().inner())?.with_final_norm(final_norm);
        Ok(Self::Dino {
            net: Box::new(net),
            path: path.to_owned(),
            hash: file_digest(path)?,
            final_norm,
        })
    }

    /// Name for reports: `descriptor`, `mobilenetv2 FILE`, `dino FILE`, `segmenter FILE, TENSOR` or `imported DIR`.
    pub fn name(&self) -> String {
        match self {
            Self::Descriptor => "descriptor".into(),
            Self::MobileNetV2 { path, .. } => format!("mobilenetv2 {}", path.display()),
            Self::Dino { path, .. } => format!("dino {}", path.display()),
            Self::Segmenter { path, tensor, .. } => {
                format!("segmenter {}, {tensor}", path.display())
            }
            Self::Import(dir) => format!("imported {}", dir.display()),
        }
    }

    /// The four maps of a view before reduction, fine to coarse.
    ///
    /// Imported maps are `STEM.1.npy` to `STEM.4.npy` (`[H, W, C]`, f32 or f16) or the tensors `scale1` to `scale4` of
    /// `STEM.safetensors`, STEM being the view's name.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Input`] and [`Error::NonFinite`] for imported files that cannot be used; [`Error::NonFinite`]
    /// for weights under which an activation is not finite; those of [`crate::data::Photo::pixels`].
    pub fn maps(&self, view: &View) -> Result<[FeatureMap; SCALES]> {
        self.maps_of(&view.name, || view.image.pixels())
    }

    /// The maps of the view `name`; `pixels` decodes its photo where that is needed.
    fn maps_of(
        &self,
        name: &str,
        pixels: impl FnOnce() -> Result<Arc<RgbImage>>,
    ) -> Result<[FeatureMap; SCALES]> {
        match self {
            Self::Descriptor => Ok(descriptor::describe(&*pixels()?)),
            Self::MobileNetV2 { net, .. } => net.maps(&*pixels()?),
            Self::Dino { net, .. } => net.maps(&*pixels()?),
            Self::Segmenter { tap, .. } => segmenter::maps(tap, &*pixels()?),
            Self::Import(dir) => import::read(dir, name),
        }
    }

    /// What the maps of an image depend on besides its pixels; `None` when caching them gains nothing.
    fn cache_key(&self) -> Option<String> {
        match self {
            Self::Descriptor => Some(descriptor::VERSION.into()),
            Self::MobileNetV2 { hash, .. } => Some(format!("{} {hash}", mobilenet::VERSION)),
            Self::Dino {
                hash, final_norm, ..
            } => Some(format!("{} {hash} norm {final_norm}", dino::VERSION)),
            Self::Segmenter { tap, tensor, .. } => {
                Some(format!("{} {} {tensor}", segmenter::VERSION, tap.digest()))
            }
            Self::Import(_) => None,
        }
    }
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
        return Err(
            invalid!(argument "image"; found "{width} x {height} pixels";
            expected "one pixel or more"; help "give another image"),
        );
    }
    let mut planes = Vec::with_capacity(3 * width * height);
    for (c, (mean, std)) in MEAN.iter().zip(STD).enumerate() {
        let channel = image.as_raw().iter().skip(c).step_by(3);
        planes.extend(channel.map(|&x| (f32::from(x) / 255.0 - mean) / std));
    }
    Ok(upload(planes, [1, 3, height, width], device))
}
