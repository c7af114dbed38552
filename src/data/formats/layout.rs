//! Which layout a scene folder has.

use super::block::{BLOCK, Block};
use super::dataparser::Similarity;
use super::folder::{Folder, Problems};
use super::label_folder::stray_drawings;
use super::listing::Listing;
use super::unread_labels::{drawings_beside_photos, no_label_file, stray_maps};
use super::{colmap, replica, scannet, transforms};
use crate::config::Layout;
use crate::data::LoadOptions;
use crate::data::labels::map_geometry::MapGeometries;
use crate::data::photos::{HEIC_HELP, is_heic, is_photo, is_video};
use crate::error::{Error, Result, bail, ensure, invalid};
use crate::files::names;
use std::path::Path;

/// Largest number of inner folders that are searched for a layout.
const MAX_FOLDERS: usize = 256;

/// The layout of the scene folder `dir`: the options name it, or its files show it. Cheap: a run asks before it begins.
///
/// # Errors
/// [`Error::Missing`] when there is no such folder; [`Error::Input`] when it is a file, or has the files of no layout or of
/// several.
pub fn locate(dir: &Path, options: &LoadOptions) -> Result<Layout> {
    find(dir, options)?.ok_or_else(|| nothing(dir, options))
}

/// As [`locate`]; `None` where the options name no layout and the folder has the files of none.
pub(super) fn find(dir: &Path, options: &LoadOptions) -> Result<Option<Layout>> {
    if !dir.try_exists().map_err(|e| Error::io(dir, "look at", e))? {
        let help = "give the scene folder that holds the photos and their cameras";
        return Err(Error::missing("folder", dir, help));
    }
    let help = if is_video(dir) {
        "`coseg from-photos VIDEO --out DIR` makes one from a video".to_owned()
    } else if is_heic(dir) {
        format!("{HEIC_HELP}; then `coseg from-photos PHOTOS --out DIR` finds their poses")
    } else {
        "give the folder that holds the photos and their cameras, not a file".to_owned()
    };
    ensure!(dir.is_dir(), dir, "scene"; found "a file"; expected "a scene folder"; help "{help}");
    if let Some(block) = Block::in_folder(dir)? {
        let (scene, options) = block.whole(dir, options)?;
        return find(&scene, &options);
    }
    let layout = match options.layout {
        Layout::Auto => detect(dir, options)?,
        named => Some(named),
    };
    match layout {
        Some(Layout::Colmap) => colmap::expect(dir, options)?,
        Some(named) if marker(named, dir, options).is_none() => return Err(nothing(dir, options)),
        _ => {}
    }
    Ok(layout)
}

/// The one layout whose files lie in `dir`; `None` if there are no such files.
fn detect(dir: &Path, options: &LoadOptions) -> Result<Option<Layout>> {
    let found = markers(dir, options);
    let is_named = options.transforms != LoadOptions::default().transforms;
    match &found[..] {
        [] => Ok(None),
        [(layout, _)] => Ok(Some(*layout)),
        // A user who names another file of cameras means that one.
        [(Layout::Transforms, _), ..] if is_named => Ok(Some(Layout::Transforms)),
        // nerfstudio keeps the model that its transforms.json was made from.
        [(layout, _), (Layout::Colmap, model)] if model.starts_with("colmap") => Ok(Some(*layout)),
        [(first, _), ..] => {
            let all: Vec<_> = found
                .iter()
                .map(|(l, file)| format!("{file} ({l})"))
                .collect();
            bail!(dir, "layout"; found "{}", all.join(" and "); expected "the files of one layout";
                help "choose one with --set data.layout={first}")
        }
    }
}

/// Layouts whose files are in `dir`, each with such a file. Blender's files count only if there is no other layout.
fn markers(dir: &Path, options: &LoadOptions) -> Vec<(Layout, String)> {
    let all = [
        Layout::Transforms,
        Layout::Colmap,
        Layout::Replica,
        Layout::Scannet,
    ];
    let found = all.map(|layout| Some((layout, marker(layout, dir, options)?)));
    let mut found: Vec<_> = found.into_iter().flatten().collect();
    if found.len() > 1 {
        found.retain(|(layout, file)| *layout != Layout::Transforms || *file == options.transforms);
    }
    found
}

/// A file of a layout in `dir`, if there is one.
fn marker(layout: Layout, dir: &Path, options: &LoadOptions) -> Option<String> {
    match layout {
        Layout::Auto | Layout::Transforms => transforms::marker(dir, options),
        Layout::Colmap => colmap::marker(dir),
        Layout::Replica => replica::marker(dir),
        Layout::Scannet => scannet::marker(dir),
    }
}

/// A notice on Blender's files beside those of another layout.
fn unread_transforms(dir: &Path, options: &LoadOptions, layout: Layout) -> Option<String> {
    let other = options.layout == Layout::Auto && layout != Layout::Transforms;
    let file = transforms::marker(dir, options).filter(|_| other)?;
    Some(format!(
        "{file} is not read: the folder has the layout {layout}; data.layout=transforms reads it instead"
    ))
}

/// What a folder of a layout has.
const fn requirements(layout: Layout) -> &'static str {
    match layout {
        Layout::Auto => {
            "transforms.json (nerfstudio, instant-ngp), transforms_train.json with transforms_test.json (Blender), \
            sparse/0 or sparse with cameras and images as .bin or .txt (COLMAP), traj.txt with results/ or traj_w_c.txt with \
            rgb/ (Replica), or color/ with pose/ (ScanNet)"
        }
        Layout::Transforms => {
            "transforms.json (nerfstudio, instant-ngp), or transforms_train.json with transforms_test.json (Blender)"
        }
        Layout::Colmap => "sparse/0 or sparse with cameras and images as .bin or .txt",
        Layout::Replica => {
            "traj.txt with results/ (NICE-SLAM) or traj_w_c.txt with rgb/ (Semantic-NeRF)"
        }
        Layout::Scannet => "color/ with pose/, as ScanNet's SensReader writes them",
    }
}

/// The error for a folder of no layout, or not of the one that the options name.
fn nothing(dir: &Path, options: &LoadOptions) -> Error {
    let named = options.layout;
    let file = &options.transforms;
    let expected = format!(
        "cameras and frames: {}; see docs/data.md",
        requirements(named)
    );
    if matches!(named, Layout::Auto | Layout::Transforms) {
        let others = transforms::alternatives(dir);
        if let Some(first) = others.first() {
            return invalid!(dir, "{file}"; found "no such file, but {}", others.join(", ");
                expected "{expected}"; help "name one with --set data.transforms={first}");
        }
    }
    if let Some((other, marker)) = markers(dir, options).first() {
        return invalid!(dir, "data.layout"; found "{named}, but {marker} of layout {other}"; expected "{expected}";
            help "choose that one with --set data.layout={other}, or give another folder");
    }
    let (found, help) = meant(dir);
    match named {
        Layout::Auto | Layout::Transforms => {
            invalid!(dir, "{file}"; found "no such file, {found}"; expected "{expected}"; help "{help}")
        }
        _ => {
            invalid!(dir, "data.layout"; found "no files of layout {named}, {found}"; expected "{expected}"; help "{help}")
        }
    }
}

/// What a folder without the files of a layout has, and what the user may have meant by it.
fn meant(dir: &Path) -> (String, String) {
    let inner = names(dir, |_, path| path.is_dir());
    for folder in inner.into_iter().take(MAX_FOLDERS) {
        let inner = dir.join(&folder);
        if let Some((layout, _)) = markers(&inner, &LoadOptions::default()).first() {
            let found =
                format!("nor those of another layout, but a folder {folder} of layout {layout}");
            return (found, format!("give {}", inner.display()));
        }
    }
    let most = |is: fn(&Path) -> bool| {
        let folders = [dir.to_owned(), dir.join("images")];
        let counts = folders.map(|folder| names(&folder, |_, path| is(path)).len());
        counts[0].max(counts[1])
    };
    let from_photos = "`coseg from-photos PHOTOS --out DIR` finds";
    match (most(is_photo), most(is_heic), most(is_video)) {
        (photos @ 2.., ..) => (
            format!("but {photos} photos without poses"),
            format!(
                "{from_photos} the poses, and makes label maps with --segmenter FILE.onnx; see docs/from-photos.md"
            ),
        ),
        (_, heic @ 1.., _) => (
            format!("but {heic} HEIC photos"),
            format!("{HEIC_HELP}; then {from_photos} their poses"),
        ),
        (.., videos @ 1..) => (
            format!("but {videos} videos"),
            "`coseg from-photos VIDEO --out DIR` makes a scene folder of one".to_owned(),
        ),
        _ => (
            "nor those of another layout".to_owned(),
            "give another folder".to_owned(),
        ),
    }
}

/// Refuses a file or folder of raw labels that is not there.
fn expect_raw_labels(dir: &Path, options: &LoadOptions) -> Result<()> {
    let Some(named) = &options.raw_labels else {
        return Ok(());
    };
    let path = dir.join(named);
    let has_labels = |name: &str, path: &Path| name.contains("label") && path.is_dir();
    let help = match (Path::new(named).canonicalize(), &names(dir, has_labels)[..]) {
        (Ok(here), _) => format!("write {}", here.display()),
        (_, []) => "correct the name".to_owned(),
        (_, there) => format!("the scene folder has {}", there.join(", ")),
    };
    ensure!(path.exists(), setting "data.raw_labels"; found "{named}";
        expected "a folder or file of label maps, absolute or in {}", dir.display(); help "{help}");
    Ok(())
}

/// Lists the frames of a folder of any layout, or of a block of one. Faults of single frames go to `problems`.
pub(crate) fn list(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Listing> {
    if let Some(block) = Block::in_folder(dir)? {
        let (scene, whole) = block.whole(dir, options)?;
        let listing = list(&scene, &whole, problems)?;
        return Ok(listing.of_block(&block, &dir.join(BLOCK), options, problems));
    }
    let layout = locate(dir, options)?;
    let mut options = options.clone();
    let reads_raw_labels = problems.ok(expect_raw_labels(dir, &options)).is_some();
    if !reads_raw_labels {
        options.raw_labels = None;
    }
    let options = &options;
    let folder = Folder {
        dir,
        options,
        layout,
    };
    let listing = match folder.layout {
        Layout::Auto | Layout::Transforms => transforms::list(folder, problems),
        Layout::Colmap => colmap::list(folder, problems),
        Layout::Replica => replica::list(folder, problems),
        Layout::Scannet => scannet::list(folder, problems),
    }?;
    let world = options.dataparser_transforms.as_ref();
    let world = world.and_then(|file| problems.ok(Similarity::read(file)));
    let listing = match world {
        Some(world) => listing.moved(world),
        None => listing,
    };
    let frames = &listing.frames;
    let no_file = no_label_file(dir, options, frames).filter(|_| reads_raw_labels);
    let unread = [
        stray_maps(dir, options, frames),
        drawings_beside_photos(dir, options, frames),
    ];
    let mut listing = if reads_raw_labels {
        listing.with_raw_labels(dir, options, problems)
    } else {
        listing.without_raw_labels()
    };
    let maps = listing
        .frames
        .iter()
        .flat_map(|frame| [&frame.truth, &frame.raw, &frame.instances]);
    listing.no_label_file = no_file;
    listing.geometries = MapGeometries::read(maps.flatten(), |fault| problems.push(fault));
    let strays = stray_drawings(dir, options, &listing.frames);
    let file = unread_transforms(dir, options, listing.layout);
    let notices = [file, strays].into_iter().chain(unread);
    listing.notices.extend(notices.flatten());
    Ok(listing)
}
