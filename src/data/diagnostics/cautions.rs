//! What loads but is seldom meant: notices on poses, intrinsics, labels and the initial cloud.

use crate::config::Layout;
use crate::data::formats::frame::Frame;
use crate::data::formats::listing::{Cloud, Listing};
use crate::data::{Scene, Split};
use crate::splat::camera::Camera;
use std::collections::HashMap;
use std::path::Path;

/// Names that a notice lists.
const NAMED: usize = 3;
/// Cameras nearer to each other than this, in world units, stand at one place.
const ONE_PLACE: f64 = 1e-6;
/// Fields of view, in degrees, outside of which no lens without fisheye projection lies.
const FIELD_OF_VIEW: [f64; 2] = [5.0, 170.0];

/// Distances of the farthest camera from the mean of all, in metres, that need no word: somebody walked about a room.
const EXTENT: [f64; 2] = [1.0, 4.0];

/// What the frames of a listing say before any file of theirs is read.
pub(crate) fn of_frames(listing: &Listing) -> Vec<String> {
    of_cameras(listing)
        .into_iter()
        .chain(without_raw(listing))
        .collect()
}

/// Cameras of a COLMAP model, whose unit is arbitrary, that are seldom so far apart in metres, where `unit_is_metre`. Without
/// labels nothing asks for the unit.
pub(crate) fn of_unit(listing: &Listing, unit_is_metre: bool) -> Option<String> {
    let labelled = listing.frames.iter().any(|frame| frame.raw.is_some());
    let mean = listing.origin();
    let extent = listing
        .frames
        .iter()
        .map(|frame| frame.camera.center.distance(mean))
        .fold(0.0, f64::max);
    let [low, high] = EXTENT;
    let asked = listing.layout == Layout::Colmap && unit_is_metre && labelled;
    (asked && !(low..=high).contains(&extent)).then(|| {
        format!(
            "cameras are up to {extent:.3} units from their mean, and the point encoder takes a unit for a metre, which in a \
             COLMAP model it seldom is: --set spatial.scale=0 takes a scale from the cameras, or give the metres of a unit"
        )
    })
}

/// How many photos will be reduced to `most` pixels a side; 0 is no limit.
pub(crate) fn of_sizes(listing: &Listing, most: usize) -> Option<String> {
    let large =
        |frame: &&Frame| !frame.scales && frame.camera.width.max(frame.camera.height) > most;
    let count = if most == 0 {
        0
    } else {
        listing.frames.iter().filter(large).count()
    };
    (count > 0)
        .then(|| format!("{count} photos have more than {most} pixels a side and are reduced to that (data.max_side)"))
}

/// How many photos have no mask where others have one, or a folder holds masks; `folder` is where these would lie.
pub(crate) fn without_mask(listing: &Listing, folder: Option<&str>) -> Option<String> {
    let without: Vec<&Frame> = listing
        .frames
        .iter()
        .filter(|frame| frame.mask.is_none())
        .collect();
    let all = listing.frames.len();
    match folder {
        _ if without.is_empty() => None,
        Some(folder) if without.len() == all => Some(format!(
            "no photo has a mask in {folder}, and all are used whole: masks of a.jpg are named a.png or a.jpg.png"
        )),
        _ if without.len() == all => None,
        _ => Some(format!(
            "{} of {all} photos have no mask and are used whole: {}",
            without.len(),
            named(&without)
        )),
    }
}

/// Masks that leave most of their views out. `masked` are the pixels of each view and how many of them its mask leaves out, for
/// the views of which one leaves some out.
pub(crate) fn inverted(masked: impl Iterator<Item = [usize; 2]>) -> Option<String> {
    let (mut views, mut sums) = (0, [0_usize; 2]);
    for pixels in masked {
        views += 1;
        sums.iter_mut().zip(pixels).for_each(|(sum, n)| *sum += n);
    }
    let [all, left_out] = sums;
    (2 * left_out > all).then(|| {
        format!(
            "masks leave {:.0} % of the pixels of {views} views out: where they are white on what to leave out, invert them; \
             black is left out",
            100.0 * left_out as f64 / all as f64
        )
    })
}

/// What poses and intrinsics say.
pub(crate) fn of_cameras(listing: &Listing) -> Vec<String> {
    let posed: Vec<&Frame> = listing.frames.iter().filter(|frame| frame.posed).collect();
    let file = listing.file.display();
    let mut notices = Vec::new();
    let low = posed
        .iter()
        .fold(glam::DVec3::INFINITY, |low, f| low.min(f.camera.center));
    let high = posed.iter().fold(glam::DVec3::NEG_INFINITY, |high, f| {
        high.max(f.camera.center)
    });
    if posed.len() > 1 && (high - low).max_element() < ONE_PLACE {
        notices.push(format!(
            "{file}: all {} cameras stand at one place: without a step aside between photos nothing tells how far things are",
            posed.len()
        ));
    }
    notices.extend(equal_poses(&posed).map(|told| format!("{file}: {told}")));
    for side in [Side { across: true }, Side { across: false }] {
        notices.extend(
            side.principal_point(listing, &posed)
                .map(|told| format!("{file}: {told}")),
        );
        notices.extend(
            side.field_of_view(listing, &posed)
                .map(|told| format!("{file}: {told}")),
        );
    }
    notices
}

/// Frames that have the pose of another one, to the last bit.
fn equal_poses(posed: &[&Frame]) -> Option<String> {
    let mut first: HashMap<[u64; 12], &str> = HashMap::new();
    let mut pairs = Vec::new();
    for frame in posed {
        let Camera {
            rotation, center, ..
        } = &frame.camera;
        let mut key = [0; 12];
        let numbers = rotation
            .to_cols_array()
            .into_iter()
            .chain(center.to_array());
        // A zero has two signs.
        key.iter_mut()
            .zip(numbers)
            .for_each(|(bits, number)| *bits = (number + 0.0).to_bits());
        match first.get(&key) {
            Some(name) => pairs.push(format!("{} as {name}", frame.name)),
            None => {
                first.insert(key, &frame.name);
            }
        }
    }
    (!pairs.is_empty()).then(|| {
        let n = pairs.len();
        format!(
            "{n} of {} frames have exactly the pose of an earlier one: {}",
            posed.len(),
            some_of(&pairs)
        )
    })
}

/// The intrinsics across or down the photo.
#[derive(Clone, Copy)]
struct Side {
    across: bool,
}

impl Side {
    /// Focal length, principal point and length of the photo.
    fn of(self, camera: &Camera) -> [f64; 3] {
        match self.across {
            true => [camera.fx, camera.cx, camera.width as f64],
            false => [camera.fy, camera.cy, camera.height as f64],
        }
    }

    fn principal_point(self, listing: &Listing, posed: &[&Frame]) -> Option<String> {
        let outside = |frame: &&Frame| {
            let [_, c, length] = self.of(&frame.camera);
            !(0.0..=length).contains(&c)
        };
        let far: Vec<&Frame> = posed.iter().copied().filter(outside).collect();
        let [_, c, length] = self.of(&far.first()?.camera);
        let field = match (listing.layout, self.across) {
            (Layout::Transforms, true) => "cx",
            (Layout::Transforms, false) => "cy",
            (_, true) => "principal point, x",
            (_, false) => "principal point, y",
        };
        Some(format!(
            "{field} of {}: found {c}, expected a pixel of the photo, 0 to {length}; where photos were scaled, scale the \
             intrinsics with them",
            named(&far)
        ))
    }

    fn field_of_view(self, listing: &Listing, posed: &[&Frame]) -> Option<String> {
        let angle = |frame: &Frame| {
            let [f, _, length] = self.of(&frame.camera);
            2.0 * (0.5 * length / f).atan().to_degrees()
        };
        let [low, high] = FIELD_OF_VIEW;
        let odd: Vec<&Frame> = posed
            .iter()
            .copied()
            .filter(|frame| !(low..=high).contains(&angle(frame)))
            .collect();
        let first = odd.first()?;
        let field = match (listing.layout, self.across) {
            (Layout::Transforms, true) => "fl_x",
            (Layout::Transforms, false) => "fl_y",
            (_, true) => "focal length, x",
            (_, false) => "focal length, y",
        };
        let [f, ..] = self.of(&first.camera);
        Some(format!(
            "{field} of {}: found {f} pixels, a field of view of {:.1} degrees, expected {low} to {high}; give it in pixels \
             of these photos, not in millimetres or for another size",
            named(&odd),
            angle(first)
        ))
    }
}

/// Training frames that lack raw labels where others have some.
fn without_raw(listing: &Listing) -> Option<String> {
    let train = || {
        listing
            .frames
            .iter()
            .filter(|frame| frame.split == Split::Train)
    };
    let without: Vec<&Frame> = train().filter(|frame| frame.raw.is_none()).collect();
    let all = train().count();
    (!without.is_empty() && without.len() < all).then(|| {
        format!(
            "{} of {all} training frames have no raw labels: {}",
            without.len(),
            named(&without)
        )
    })
}

/// Training frames of which no pixel has a raw label. `train` are those with raw labels: name, and whether it is so.
pub(crate) fn void_raw<'a>(train: impl Iterator<Item = (&'a str, bool)>) -> Option<String> {
    let (mut all, mut void) = (0, Vec::new());
    for (name, is_void) in train {
        all += 1;
        void.extend(is_void.then(|| name.to_owned()));
    }
    (!void.is_empty()).then(|| {
        let n = void.len();
        let which = format!(
            "raw labels of {n} of {all} training frames are unlabelled in every pixel: {}",
            some_of(&void)
        );
        match n == all {
            true => format!(
                "{which}; stage two has nothing to learn from: look at the ids and at classes.json"
            ),
            false => which,
        }
    })
}

/// Photos that segmenters may have turned without that a size tells. `found` are the frames with what was seen of each.
pub(crate) fn turned<'a>(found: impl Iterator<Item = (&'a Frame, bool)>) -> Option<String> {
    let turned: Vec<&Frame> = found
        .filter(|(_, turned)| *turned)
        .map(|(frame, _)| frame)
        .collect();
    (!turned.is_empty()).then(|| {
        format!(
            "{} photos ask by their EXIF orientation to be turned or mirrored, which is not done, and no size tells whether \
             their label maps and masks are of photos that were: {}; apply that to the photos or strip it \
             (docs/from-photos.md, 1), before COLMAP and the segmenter see them",
            turned.len(),
            named(&turned)
        )
    })
}

/// What a loaded scene says beside what its listing said.
pub(crate) fn of_scene(scene: &Scene, unlabelled: u16) -> Vec<String> {
    let masks = scene.views.iter().filter_map(|view| view.mask.as_ref());
    let masked = inverted(masks.map(|mask| [mask.width() * mask.height(), mask.left_out()]));
    let train = scene
        .split(Split::Train)
        .filter_map(|view| Some((&*view.name, view.raw.as_ref()?)));
    let void =
        void_raw(train.map(|(name, raw)| (name, raw.runs().all(|(id, _)| id == unlabelled))));
    masked.into_iter().chain(void).collect()
}

/// A cloud that is named and holds nothing.
pub(crate) fn empty_cloud(cloud: &Cloud) -> Option<String> {
    let what = |path: &Path| format!("{} holds no points", path.display());
    let what = match cloud {
        Cloud::None => return None,
        Cloud::Ply(path) | Cloud::Colmap(path) => what(path),
        Cloud::Depth(_) => "the depth images show nothing".to_owned(),
    };
    Some(format!(
        "{what}: Gaussians start at random places in front of the cameras"
    ))
}

fn named(frames: &[&Frame]) -> String {
    some_of(
        &frames
            .iter()
            .map(|frame| frame.name.clone())
            .collect::<Vec<_>>(),
    )
}

/// The first few, and how many more there are.
pub(crate) fn some_of(names: &[String]) -> String {
    let more = match names.len().saturating_sub(NAMED) {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    format!("{}{more}", names[..names.len().min(NAMED)].join(", "))
}
