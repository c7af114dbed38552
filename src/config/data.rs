//! Where the scene comes from and how its folder is read.

use super::Association;
use super::range::checked;
use crate::error::{Result, bail};
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use std::path::{Component, Path, PathBuf};

/// Value of [`DataConfig::masks`] that turns masks off.
pub const NO_MASKS: &str = "none";

/// Whether two names, as written, mean the same folder, as `masks`, `./masks` and `masks/` do.
pub(crate) fn same_folder(a: &str, b: &str) -> bool {
    let parts = |name| {
        Path::new(name)
            .components()
            .filter(|part| *part != Component::CurDir)
    };
    parts(a).eq(parts(b))
}

/// Where the scene comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, SmartDefault)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Scene folder; absent means the built-in scene.
    #[serde(deserialize_with = "super::optional_path")]
    pub dir: Option<PathBuf>,
    /// How the folder is laid out.
    pub layout: Layout,
    /// File within `dir` that lists frames, of layout `transforms`. If the usual one is missing, `transforms_train.json` and
    /// `transforms_test.json` (else `transforms_val.json`) are read together.
    #[default("transforms.json".into())]
    pub transforms: String,
    /// nerfstudio's `dataparser_transforms.json` of a run: the poses are moved to where nerfstudio had them, so that they fit the
    /// Gaussians that it exported. Absent: the poses stay.
    #[serde(deserialize_with = "super::optional_path")]
    pub dataparser_transforms: Option<PathBuf>,
    /// Folder of photos within `dir`, of layout `colmap`. Its photos may be smaller than the model says, in the same
    /// proportion: cameras are scaled to them.
    #[default("images".into())]
    pub images: String,
    /// Folder of raw labels within `dir`, a file of COCO instances or CVAT, or the folder of its extracted export; replaces what the
    /// frames name. Photos without a label file are unlabelled. Empty: as the frames say.
    pub raw_labels: String,
    /// Folder of masks within `dir`, which replace the masks that the frames name. They are PNG files named as their photos, black
    /// where a photo is left out. Empty: the masks that the frames name, or `masks` in layout `colmap`, unless raw labels lie
    /// there. [`NO_MASKS`]: photos are used whole and masks are ignored; a folder of that name is `./none`.
    pub masks: String,
    /// Origin of the raw labels, for the report, such as the name of a network. Empty: unknown, but simulated for the built-in
    /// scene.
    pub raw_labels_note: String,
    /// How raw labels are stored.
    pub raw_format: RawFormat,
    /// Who made the raw labels. Those made by hand are trusted: `ours` is trained under cross-entropy and from plain votes, instead of
    /// the default loss and pooled votes.
    pub labels_by: LabelsBy,
    /// Whether ids of raw labels are class ids, or hold within their view only and are associated after stage one.
    pub association: Association,
    /// Every how many frames of each split one is used; 1 uses all.
    #[default(1)]
    pub stride: usize,
    /// No more frames than this, evenly chosen; 0 means no limit.
    pub max_frames: usize,
    /// Photos whose longer side has more pixels are reduced to this many, their cameras and label maps with them; 0 means no
    /// limit.
    #[default(1_600)]
    pub max_side: usize,
    /// Megabytes (2^20 bytes) of decoded photos kept in memory, 3 bytes a pixel; the others are decoded at each use. No result
    /// depends on it. No key sets it; tests change it.
    #[serde(skip)]
    #[default(1_024)]
    pub decoded_mb: usize,
    /// Class table that ScanNet's label ids are mapped to.
    pub scannet_classes: ScannetClasses,
}

impl DataConfig {
    /// Checks ranges, and refuses a folder of masks that holds photos or label maps.
    pub(super) fn check(&self) -> Result<()> {
        checked!(self, "data": { stride: Positive });
        let names_folder = !self.masks.is_empty() && self.masks != NO_MASKS;
        let other = [&self.images, &self.raw_labels];
        if names_folder && other.iter().any(|folder| same_folder(folder, &self.masks)) {
            bail!(setting "data.masks"; found "{}", self.masks;
                expected "a folder other than data.images and data.raw_labels";
                help "name the folder of masks, or leave the key out");
        }
        Ok(())
    }

    /// A sentence on the origin of the raw labels, where it is known.
    pub fn raw_labels_origin(&self) -> Option<String> {
        match (self.raw_labels_note.trim(), &self.dir) {
            ("", None) => Some(
                "Simulated raw labels: errors drawn on the true labels, not the output of a segmentation network."
                    .to_owned(),
            ),
            ("", Some(_)) => None,
            (note, _) => Some(format!("Raw labels: {}.", note.trim_end_matches('.'))),
        }
    }
}

/// How a scene folder is laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// By the files that are there.
    #[default]
    Auto,
    /// `transforms.json` of nerfstudio and instant-ngp.
    Transforms,
    /// A COLMAP model in `sparse/0` or `sparse`.
    Colmap,
    /// Replica as NICE-SLAM or Semantic-NeRF ship it.
    Replica,
    /// ScanNet as its SensReader exports it.
    Scannet,
}

/// How raw labels are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RawFormat {
    /// By the files that are there.
    #[default]
    Auto,
    /// Grey PNG of 8 or 16 bits: ids.
    Grey,
    /// COCO panoptic: a JSON file and PNG whose colours are segment ids.
    CocoPanoptic,
    /// PNG in the 150 colours of ADE20K that mmsegmentation and Mask2Former draw with.
    Ade20k,
    /// A folder of binary masks for each photo, as Segment Anything's `amg.py` writes them.
    Masks,
    /// A JSON file of LabelMe for each labelled photo: shapes with labels.
    Labelme,
    /// COCO instances: one JSON file with polygons, run lengths or boxes for all photos.
    CocoInstances,
    /// CVAT for images 1.1: one XML file with shapes for all photos.
    Cvat,
}

/// Who made the raw labels, which decides how far they are trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelsBy {
    /// A person, where the labels are shapes (LabelMe, COCO instances, CVAT) or where at most a quarter of the training photos have
    /// labels and none has scores. Else a network.
    #[default]
    Auto,
    /// A network, whose errors training has to withstand.
    Network,
    /// A person, who makes few errors and labels few photos.
    Hand,
}

/// Class tables for ScanNet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScannetClasses {
    /// The 40 classes of NYU Depth v2.
    #[default]
    Nyu40,
    /// The 20 of those that ScanNet's benchmark counts; the others are ignored.
    Scannet20,
}
