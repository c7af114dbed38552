//! Which layout a scene folder has.

use super::listing::{Listing, Problems};
use super::{colmap, replica, scannet, transforms};
use crate::config::Layout;
use crate::data::LoadOptions;
use crate::data::diagnostics::cautions;
use crate::data::labels::map_geometry;
use crate::data::labels::map_geometry::MapGeometries;
use crate::data::labels::mask_file;
use crate::error::{Error, Result};
use std::path::Path;

impl Layout {
    /// As settings have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Transforms => "transforms",
            Self::Colmap => "colmap",
            Self::Replica => "replica",
            Self::Scannet => "scannet",
        }
    }
}

/// The layout of the scene folder `dir`: the one that the options name, or the one whose files are there. Cheap, so
/// that a run can ask before it begins.
///
/// # Errors
/// [`Error::Missing`] when there is no such folder; [`Error::Input`] when it is no folder, or has the files of no
/// layout or of several: then the error says what was looked for, or found.
pub fn locate(dir: &Path, options: &LoadOptions) -> Result<Layout> {
    if !dir.try_exists().map_err(|e| Error::io(dir, "look at", e))? {
        let help =
            "give the scene folder that holds the photos and their cameras (--data, or data.dir)"
                .into();
        return Err(Error::Missing {
            what: "folder",
            path: dir.to_owned(),
            help,
        });
    }
    if !dir.is_dir() {
        let help = "give the folder that holds the photos and their cameras, not a file";
        return Err(Error::input(dir, "scene", "a file", "a scene folder", help));
    }
    let layout = match (options.layout, &found(dir, options)[..]) {
        (Layout::Auto, [(layout, _)]) => *layout,
        // Who names another file of cameras means that one.
        (Layout::Auto, [(Layout::Transforms, _), ..])
            if options.transforms != LoadOptions::default().transforms =>
        {
            Layout::Transforms
        }
        // nerfstudio keeps the model that its transforms.json was made from.
        (Layout::Auto, [(layout, _), (Layout::Colmap, model)]) if model.starts_with("colmap") => {
            *layout
        }
        (Layout::Auto, []) => return Err(nothing(dir, options)),
        (Layout::Auto, several) => {
            let list: Vec<_> = several
                .iter()
                .map(|(l, file)| format!("{file} ({})", l.name()))
                .collect();
            let help = format!("choose one with --set data.layout={}", several[0].0.name());
            return Err(Error::input(
                dir,
                "layout",
                list.join(" and "),
                "the files of one layout",
                help,
            ));
        }
        (named, _) => named,
    };
    match layout {
        Layout::Auto | Layout::Transforms => transforms::expect(dir, options)?,
        Layout::Colmap => colmap::expect(dir, options)?,
        Layout::Replica => replica::expect(dir)?,
        Layout::Scannet => scannet::expect(dir)?,
    }
    Ok(layout)
}

/// Layouts whose files lie in `dir`, with the file that tells. Blender's files count where there is nothing else.
fn found(dir: &Path, options: &LoadOptions) -> Vec<(Layout, String)> {
    let found = [
        (Layout::Transforms, transforms::found(dir, options)),
        (Layout::Colmap, colmap::found(dir)),
        (Layout::Replica, replica::found(dir)),
        (Layout::Scannet, scannet::found(dir)),
    ];
    let mut found: Vec<_> = found
        .into_iter()
        .filter_map(|(layout, file)| Some((layout, file?)))
        .collect();
    if found.len() > 1 {
        found.retain(|(layout, file)| *layout != Layout::Transforms || *file == options.transforms);
    }
    found
}

/// What is told of Blender's files that another layout came before.
fn passed_over(dir: &Path, options: &LoadOptions, layout: Layout) -> Option<String> {
    let other = options.layout == Layout::Auto && layout != Layout::Transforms;
    let file = transforms::found(dir, options).filter(|_| other)?;
    let name = layout.name();
    Some(format!(
        "{file} is not read, as the folder is of layout {name}; data.layout=transforms reads it instead"
    ))
}

/// A folder within `dir` that has a layout: the first by name of those that are looked at.
fn below(dir: &Path) -> Option<(String, Layout)> {
    let folders = std::fs::read_dir(dir)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| entry.path().is_dir());
    let mut names: Vec<String> = folders
        .take(256)
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort_unstable();
    names.into_iter().find_map(|name| {
        let layout = found(&dir.join(&name), &LoadOptions::default()).first()?.0;
        Some((name, layout))
    })
}

/// The error that says what was looked for.
fn nothing(dir: &Path, options: &LoadOptions) -> Error {
    let expected = "cameras and frames: transforms.json (nerfstudio, instant-ngp), transforms_train.json with \
                    transforms_test.json (Blender), sparse/0 or sparse with cameras and images \
                    as .bin or .txt (COLMAP), traj.txt with results/ or traj_w_c.txt with rgb/ (Replica), or color/ with pose/ \
                    (ScanNet); README, 'Data'";
    let (found, help) = match transforms::alternatives(dir) {
        others if others.is_empty() => match below(dir) {
            Some((folder, layout)) => (
                format!(
                    "no such file, nor those of another layout, but a folder {folder} of layout {}",
                    layout.name()
                ),
                format!("give {}", dir.join(&folder).display()),
            ),
            None => (
                "no such file, nor those of another layout".to_owned(),
                "give another folder".into(),
            ),
        },
        others => (
            format!("no such file, but {}", others.join(", ")),
            format!("name one with --set data.transforms={}", others[0]),
        ),
    };
    Error::input(dir, &options.transforms, found, expected, help)
}

/// What the folder says, by its layout. What is wrong with single frames goes to `problems`.
pub(crate) fn list(dir: &Path, options: &LoadOptions, problems: &mut Problems) -> Result<Listing> {
    let listing = match locate(dir, options)? {
        Layout::Auto | Layout::Transforms => transforms::list(dir, options, problems),
        Layout::Colmap => colmap::list(dir, options, problems),
        Layout::Replica => replica::list(dir, options, problems),
        Layout::Scannet => scannet::list(dir, options, problems),
    }?;
    let mut listing = listing.with_raw_labels(dir, options, problems);
    listing.geometries = MapGeometries::read(&listing.frames, problems);
    let notices = [
        passed_over(dir, options, listing.layout),
        cautions::of_sizes(&listing, options.max_side),
        map_geometry::told_by_size(&listing, options),
        cautions::of_unit(&listing, options.unit_is_metre),
        cautions::without_mask(
            &listing,
            mask_file::folder_name(dir, options, listing.layout),
        ),
    ];
    listing.notices.extend(
        notices
            .into_iter()
            .flatten()
            .chain(cautions::of_frames(&listing)),
    );
    Ok(listing)
}
