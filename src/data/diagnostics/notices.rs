//! Notices on poses, intrinsics, labels and the initial cloud: input that loads but is probably a mistake.

use crate::data::first_names;
use crate::data::formats::camera_checks::odd_intrinsics;
use crate::data::formats::folder::{Folder, Problems};
use crate::data::formats::frame::{Frame, reduced};
use crate::data::formats::layout;
use crate::data::formats::listing::{Cloud, Listing};
use crate::data::formats::mask_file;
use crate::data::labels::classes::plain;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LoadOptions, MapGeometry, Scene, Split};
use crate::error::{Error, Result, invalid};
use glam::DVec3;
use std::collections::{BTreeMap, HashMap};
use std::ops::RangeInclusive;
use std::path::Path;

/// Cameras that are nearer to each other than this, in world units, count as being at one place.
const MIN_CAMERA_DISTANCE: f64 = 1e-6;
/// Range of the fields of view, in degrees, of lenses without fisheye projection.
const USUAL_FIELDS_OF_VIEW: RangeInclusive<f64> = 5.0..=170.0;
/// A principal point further from the middle, in sides of the photo, is outside.
const MAX_CENTER_OFFSET: f64 = 0.5;

/// What follows from labels without a labelled pixel, and what to do.
const NOTHING_TO_LEARN: &str = "stage two has nothing to learn from";
const LOOK_AT_IDS: &str = "look at the ids and at classes.json";

/// Lists the frames of a folder, with notices on poses, intrinsics, labels and masks.
pub(crate) fn list(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Listing> {
    let mut listing = layout::list(dir, options, problems)?;
    let layout = listing.layout;
    let folder = Folder {
        dir,
        options,
        layout,
    };
    let cameras = cameras(&listing);
    let others = [
        large_photos(&listing, options.max_side),
        assumed_undistorted(&listing, options),
        without_mask(&listing, mask_file::folder_name(folder)),
        mask_file::unused_folder(folder, &listing.frames),
        without_raw(&listing),
        unread_maps(&listing),
        held_out_drawn_labels(&listing),
        repeated_names(&listing.classes, &dir.join(Classes::FILE)),
    ];
    listing.notices.extend(cameras);
    listing.notices.extend(others.into_iter().flatten());
    Ok(listing)
}

/// As [`list`], where a fault is an error.
///
/// # Errors
/// The first fault.
pub(crate) fn list_sound(dir: &Path, options: &LoadOptions) -> Result<Listing> {
    Problems::first_of(|problems| list(dir, options, problems))
}

/// The number of `frames` and the first few names; `None` if there are none.
fn listed<'a>(frames: impl Iterator<Item = &'a Frame>) -> Option<(usize, String)> {
    let names: Vec<&str> = frames.map(|frame| &*frame.name).collect();
    (!names.is_empty()).then(|| (names.len(), first_names(&names)))
}

/// Photos that are reduced to at most `most` pixels a side; 0 means no limit.
fn large_photos(listing: &Listing, most: usize) -> Option<String> {
    let is_large =
        |frame: &&Frame| !frame.resizable && frame.camera.width.max(frame.camera.height) > most;
    let count = listing.frames.iter().filter(is_large).count();
    (most > 0 && count > 0)
        .then(|| format!("{count} photos have more than {most} pixels a side and are reduced to that (data.max_side)"))
}

/// Photos without a mask where others have one, or where `folder` holds masks.
fn without_mask(listing: &Listing, folder: Option<&str>) -> Option<String> {
    let is_whole = |frame: &&Frame| frame.mask.is_none();
    let (count, names) = listed(listing.frames.iter().filter(is_whole))?;
    let all = listing.frames.len();
    if count < all {
        return Some(format!(
            "{count} of {all} photos have no mask and are used whole: {names}"
        ));
    }
    folder.map(|folder| {
        format!("no photo has a mask in {folder}, and all are used whole: masks of a.jpg are named a.png or a.jpg.png")
    })
}

/// Masks that leave out most of their views. `masked` has, for each view with a mask, its pixels and the pixels left out.
pub(crate) fn inverted_masks(masked: impl Iterator<Item = [usize; 2]>) -> Option<String> {
    let masked: Vec<_> = masked.collect();
    let views = masked.len();
    let all: usize = masked.iter().map(|[pixels, _]| pixels).sum();
    let left_out: usize = masked.iter().map(|[_, out]| out).sum();
    let percent = 100.0 * left_out as f64 / all as f64;
    (2 * left_out > all).then(|| {
        format!(
            "masks leave {percent:.0} % of the pixels of {views} views out: black is left out, so invert masks that are \
             white there"
        )
    })
}

/// Unusual poses and intrinsics.
pub(crate) fn cameras(listing: &Listing) -> Vec<String> {
    let posed: Vec<&Frame> = listing.frames.iter().filter(|frame| frame.posed).collect();
    let centers = || posed.iter().map(|frame| frame.camera.center);
    let size = centers().fold(DVec3::NEG_INFINITY, DVec3::max)
        - centers().fold(DVec3::INFINITY, DVec3::min);
    let mut notices = Vec::new();
    if posed.len() > 1 && size.max_element() < MIN_CAMERA_DISTANCE {
        notices.push(format!(
            "all {} cameras stand at one place: depth can only be learned from photos of different places",
            posed.len()
        ));
    }
    notices.extend(equal_poses(&posed));
    notices.extend(unusual_intrinsics(&posed));
    let file = listing.file.display();
    notices
        .into_iter()
        .map(|notice| format!("{file}: {notice}"))
        .collect()
}

/// Frames that have exactly the same pose as another one.
fn equal_poses(posed: &[&Frame]) -> Option<String> {
    let mut first: HashMap<Vec<u64>, &str> = HashMap::new();
    let mut pairs = Vec::new();
    for frame in posed {
        let rotation = frame.camera.rotation.to_cols_array().into_iter();
        // Adding 0 makes both zeros one.
        let pose = rotation
            .chain(frame.camera.center.to_array())
            .map(|number| (number + 0.0).to_bits());
        let earlier = *first.entry(pose.collect()).or_insert(&frame.name);
        if earlier != frame.name {
            pairs.push(format!("{} as {earlier}", frame.name));
        }
    }
    (!pairs.is_empty()).then(|| {
        let count = pairs.len();
        let all = posed.len();
        format!(
            "{count} of {all} frames have exactly the pose of an earlier one: {}",
            first_names(&pairs)
        )
    })
}

/// Frames whose principal point is outside the photo, or whose field of view only a fisheye lens has.
fn unusual_intrinsics(posed: &[&Frame]) -> Option<String> {
    let odd =
        |frame: &Frame| odd_intrinsics(&frame.camera, &USUAL_FIELDS_OF_VIEW, MAX_CENTER_OFFSET);
    let found = posed.iter().find_map(|frame| odd(frame))?;
    let (_, names) = listed(posed.iter().copied().filter(|frame| odd(frame).is_some()))?;
    Some(format!(
        "intrinsics of {names}: found {found}, expected a field of view from {} to {} degrees and a principal point on the photo; \
         give them in pixels of these photos, not in millimetres or for another size",
        USUAL_FIELDS_OF_VIEW.start(),
        USUAL_FIELDS_OF_VIEW.end()
    ))
}

/// Names that several classes have, where `file` is a class table.
fn repeated_names(classes: &Classes, file: &Path) -> Option<String> {
    let mut ids: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for class in classes.entries.iter().filter(|_| file.is_file()) {
        let of_name = ids.entry(plain(&class.name)).or_default();
        of_name.push(class.id.to_string());
    }
    ids.retain(|_, ids| ids.len() > 1);
    let repeated = ids
        .iter()
        .map(|(name, ids)| format!("{name} ({})", ids.join(", ")));
    let repeated: Vec<String> = repeated.collect();
    (!repeated.is_empty()).then(|| {
        format!(
            "{}: several ids have one name, by which labels are matched and objects are named: {}; give each class a name of its own",
            file.display(),
            first_names(&repeated)
        )
    })
}

/// Training frames without raw labels where others have some.
fn without_raw(listing: &Listing) -> Option<String> {
    let is_training = |frame: &&Frame| frame.split == Split::Train;
    let train = || listing.frames.iter().filter(is_training);
    let (count, names) = listed(train().filter(|frame| frame.raw.is_none()))?;
    let all = train().count();
    let labelled = all - count;
    (labelled > 0).then(|| {
        format!(
            "{count} of {all} training frames have no raw labels: {names}; {labelled} have some"
        )
    })
}

/// Label maps where files of LabelMe come first.
fn unread_maps(listing: &Listing) -> Option<String> {
    let has_unread = |frame: &&Frame| frame.has_unread_map;
    let (count, names) = listed(listing.frames.iter().filter(has_unread))?;
    Some(format!(
        "{count} label maps are not read: {names}; where files of LabelMe are used, label maps are not; data.raw_format names \
         the format that is read, such as grey"
    ))
}

/// Held-out photos with labels drawn by hand: no training view learns from them.
fn held_out_drawn_labels(listing: &Listing) -> Option<String> {
    let is_drawn = |frame: &&Frame| listing.scores_against_drawing(frame);
    let (count, names) = listed(listing.frames.iter().filter(is_drawn))?;
    Some(format!(
        "{count} photos with drawn labels are held out ({names}): nothing learns from these labels, and scores are measured against \
         them; `coseg data suggest` names photos that are trained on"
    ))
}

/// Training frames whose raw labels have no labelled pixel.
pub(crate) struct VoidLabels {
    /// How many of how many training frames.
    count: String,
    /// The first names.
    names: String,
    /// Whether these are all that have raw labels: stage two is left out.
    pub are_all: bool,
}

/// The training frames whose raw labels have no labelled pixel; `None` if there are none. `train` has the name of each frame with raw
/// labels, and whether that is the case.
pub(crate) fn void_raw<'a>(train: impl Iterator<Item = (&'a str, bool)>) -> Option<VoidLabels> {
    let (void, labelled): (Vec<_>, Vec<_>) = train.partition(|(_, void)| *void);
    let all = void.len() + labelled.len();
    let names: Vec<&str> = void.iter().map(|(name, _)| *name).collect();
    (!void.is_empty()).then(|| VoidLabels {
        count: format!("{} of {all} training frames", void.len()),
        names: first_names(&names),
        are_all: labelled.is_empty(),
    })
}

impl VoidLabels {
    /// A sentence on them.
    pub fn notice(&self) -> String {
        let Self { count, names, .. } = self;
        let found = format!("raw labels of {count} are unlabelled in every pixel: {names}");
        if self.are_all {
            format!("{found}; {NOTHING_TO_LEARN}: {LOOK_AT_IDS}")
        } else {
            found
        }
    }

    /// The fault of a scene in which they are all. `file` lists its frames.
    pub fn fault(&self, file: &Path) -> Error {
        let Self { count, names, .. } = self;
        invalid!(file, "raw labels"; found "no labelled pixel in {count}: {names}";
            expected "some labelled pixels: without them {NOTHING_TO_LEARN}"; help "{LOOK_AT_IDS}")
    }
}

/// A notice of the photos whose labels may belong to a turned copy. Sizes alone do not show this: the flag of each frame says it.
pub(crate) fn turned<'a>(frames: impl Iterator<Item = (&'a Frame, bool)>) -> Option<String> {
    let turned = frames.filter(|(_, turned)| *turned);
    let (count, names) = listed(turned.map(|(frame, _)| frame))?;
    Some(format!(
        "{count} photos have an EXIF orientation, by which other programs turn or mirror them; coseg does not. No size shows \
         whether their label maps and masks were made from turned photos: {names}; apply the orientation to the photos \
         or strip it (docs/from-photos.md, 1), before COLMAP and the segmenter see them"
    ))
}

/// A notice if only the size of a map suggests that lens distortion was removed from it. It looks at the first raw labels of a
/// photo with distortion.
fn assumed_undistorted(listing: &Listing, options: &LoadOptions) -> Option<String> {
    let mut distorted = listing
        .frames
        .iter()
        .filter(|frame| !frame.lens.is_pinhole() && !frame.resizable);
    let (map, size) = distorted.find_map(|frame| {
        let size = reduced((frame.camera.width, frame.camera.height), options.max_side)?;
        Some((frame.raw.as_ref().filter(|map| map.is_file())?, size))
    })?;
    let is_declared = listing.geometries.of(map).is_some();
    // A file that cannot be read is reported where it is read.
    let file = ImageFile::open(map).ok()?;
    (!is_declared && file.size == size).then(|| {
        format!(
            "{}: label maps of {}x{} pixels, to which photos are reduced, are taken for maps that coseg wrote, without \
             lens distortion; if they are of photos that were only reduced, write {{\"maps\": \"photos\"}} into {}",
            map.display(),
            size.0,
            size.1,
            map.with_file_name(MapGeometry::FILE).display()
        )
    })
}

/// Notices on a loaded scene.
pub(crate) fn scene(scene: &Scene, unlabelled: u16) -> Vec<String> {
    let masks = scene.views.iter().filter_map(|view| view.mask.as_ref());
    let inverted =
        inverted_masks(masks.map(|mask| [mask.width() * mask.height(), mask.left_out()]));
    let train = scene
        .split(Split::Train)
        .filter_map(|view| Some((&*view.name, view.raw.as_ref()?)));
    let void =
        void_raw(train.map(|(name, raw)| (name, raw.runs().all(|(id, _)| id == unlabelled))));
    let void = void.map(|void| void.notice());
    inverted.into_iter().chain(void).collect()
}

/// A cloud without points.
pub(crate) fn empty_cloud(cloud: &Cloud) -> Option<String> {
    let what = match cloud {
        Cloud::None => return None,
        Cloud::Ply(path) | Cloud::Colmap(path) => format!("{} holds no points", path.display()),
        Cloud::Depth(_) => "the depth images show nothing".to_owned(),
    };
    Some(format!(
        "{what}: Gaussians start at random places in front of the cameras"
    ))
}
