//! The files of a scene: given by name, or in the folder that `coseg train` wrote.

use crate::config::Config;
use crate::data::{
    Classes, LoadOptions, NamedCamera, Split, ViewPhoto, locate, read_cameras, read_cameras_moved,
    view_photos,
};
use crate::error::{Error, Result, ensure, invalid};
use crate::features::FeatureColors;
use crate::files::{self, atomic, extension, own, shell_word};
use crate::splat::formats;
use crate::splat::ply::PlyScene;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The settings of a run folder.
pub const CONFIG: &str = "config.toml";
/// The command lines of a run.
pub(super) const COMMANDS: &str = "commands.json";
/// The figures of a run for programs, the last file that it writes.
pub(super) const METRICS: &str = "metrics.json";
/// The class table of a run folder.
pub const CLASSES: &str = "classes.json";
/// The scene of a run folder.
pub const SCENE: &str = "scene.ply";
/// The cameras of a run folder.
pub const CAMERAS: &str = "cameras.json";
/// Colours of the Gaussians of a run folder by their image features.
pub const FEATURE_COLORS: &str = "feature_colors.safetensors";
/// The page of a scene.
pub const VIEWER: &str = "viewer.html";
/// The scene of a model folder of graphdeco's 3DGS, in point_cloud/iteration_N.
const GRAPHDECO: &str = "point_cloud.ply";

/// The PLY file that `--scene` means: the file itself, scene.ply in a folder, or the last of a model folder of graphdeco's
/// 3DGS.
///
/// # Errors
/// [`Error::Missing`] where nothing is there; [`Error::Input`] for a folder without a scene.
pub fn scene_path(path: &Path) -> Result<PathBuf> {
    const HELP: &str = "give a .ply, .spz, .sog or .splat file, or the folder that `coseg train` or graphdeco's 3DGS wrote";
    let exists = path.try_exists();
    if !exists.map_err(|e| Error::io(path, "look at", e))? {
        return Err(Error::missing("file", path, HELP));
    }
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let inside = path.join(SCENE);
    if inside.is_file() {
        return Ok(inside);
    }
    if let Some(newest) = of_graphdeco(path) {
        return Ok(newest);
    }
    let plys = files::names(path, |_, path| extension(path) == "ply");
    let help = match plys.first() {
        _ if locate(path, &LoadOptions::default()).is_ok() => {
            format!("photos with poses are given by --data; {HELP}")
        }
        Some(other) => format!("give {}", path.join(other).display()),
        None => HELP.to_owned(),
    };
    Err(invalid!(path, "{SCENE}"; found "no such file"; expected "a run folder"; help "{help}"))
}

/// The Gaussians of the last iteration in a model folder of graphdeco's 3DGS: point_cloud/iteration_N/point_cloud.ply.
fn of_graphdeco(folder: &Path) -> Option<PathBuf> {
    let iterations = std::fs::read_dir(folder.join("point_cloud")).ok()?;
    let numbered = |entry: std::fs::DirEntry| {
        let name = entry.file_name();
        let number: u64 = name.to_str()?.strip_prefix("iteration_")?.parse().ok()?;
        let file = entry.path().join(GRAPHDECO);
        file.is_file().then_some((number, file))
    };
    let newest = iterations.flatten().filter_map(numbered).max()?;
    Some(newest.1)
}

/// The class table in the file `table`, or the one beside the scene `scene`; empty if there is none.
///
/// # Errors
/// As [`Classes::read`].
pub fn classes_beside(scene: &Path, table: Option<&Path>) -> Result<Classes> {
    let beside = scene.with_file_name(CLASSES);
    match table {
        Some(path) => Classes::read(path),
        None if beside.is_file() => Classes::read(&beside),
        None => Ok(Classes::default()),
    }
}

/// Main components of the image features of each of `gaussians`, of the scene.ply beside which a run wrote some; none for other
/// scenes. A file that is damaged or of another number of Gaussians is ignored with a warning.
pub fn features_beside(scene: &Path, gaussians: usize) -> Vec<[f32; 3]> {
    let file = scene.with_file_name(FEATURE_COLORS);
    if !file.is_file() || scene.file_name().is_none_or(|name| name != SCENE) {
        return Vec::new();
    }
    match FeatureColors::read(&file, gaussians) {
        Ok(colors) => colors.rgb,
        Err(error) => {
            tracing::warn!("no image features are compared: {error}");
            Vec::new()
        }
    }
}

/// Reads a scene that must hold Gaussians.
///
/// # Errors
/// As [`formats::read`]; [`Error::Input`] for an empty one.
pub fn read_scene(path: &Path) -> Result<PlyScene> {
    let scene = formats::read(path)?;
    ensure!(!scene.gaussians.is_empty(), path, "element vertex"; found "no Gaussian"; expected "one or more";
        help "name a scene that is not empty");
    Ok(scene)
}

/// The command that continues the run in `folder`, if there is one that was stopped before its end.
pub(super) fn unfinished_run(folder: &Path) -> Option<String> {
    let is_unfinished = folder.join(COMMANDS).is_file() && !folder.join(METRICS).is_file();
    is_unfinished.then(|| format!("coseg train --resume {}", shell_word(folder)))
}

/// What `--cameras` names, or else the cameras beside the scene `scene` or in its model folder of graphdeco's 3DGS.
///
/// # Errors
/// [`Error::Argument`] if there are none.
pub fn cameras_path(cameras: Option<&Path>, scene: &Path) -> Result<PathBuf> {
    if let Some(path) = cameras {
        return Ok(path.to_owned());
    }
    let beside = scene.with_file_name(CAMERAS);
    if beside.is_file() {
        return Ok(beside);
    }
    // graphdeco's 3DGS keeps its cameras above point_cloud/iteration_N.
    let model = scene.ancestors().nth(3);
    let above = model.map(|model| model.join(CAMERAS));
    let is_graphdeco = scene.file_name().is_some_and(|name| name == GRAPHDECO);
    above
        .filter(|file| is_graphdeco && file.is_file())
        .ok_or_else(|| {
            const HELP: &str = "give a file of cameras, a scene folder or a run folder";
            let command = unfinished_run(files::folder(scene));
            let help = command.map_or_else(
                || HELP.to_owned(),
                |command| format!("{HELP}; the run was stopped, and {command} continues it"),
            );
            invalid!(argument "--cameras"; found "nothing"; expected "cameras: {} does not exist", beside.display(); help "{help}")
        })
}

/// The cameras in the file or folder `cameras`, see [`read_cameras`], for the scene `scene`. Those of a scene folder are where nerfstudio
/// had them, if the run of the scene moved them there by its `data.dataparser_transforms`.
///
/// # Errors
/// As [`read_cameras`].
pub fn cameras_for(scene: &Path, cameras: &Path, split: Option<Split>) -> Result<Vec<NamedCamera>> {
    let file = scene.with_file_name(CONFIG);
    if !cameras.is_dir() || !file.is_file() {
        return read_cameras(cameras, split);
    }
    // Other programs have files of that name too.
    let world = Config::dataparser_transforms_of(&file).unwrap_or_else(|error| {
        tracing::warn!("the cameras are taken as they are: {error}");
        None
    });
    read_cameras_moved(cameras, world, split)
}

/// The photos of the views whose cameras are in the file or folder `cameras`, by the names of the views. They lie in the scene
/// folder that `cameras` is or lies in, or else in the one that the run in this folder was trained on. Empty where neither is
/// there.
pub fn photos_of(cameras: &Path) -> BTreeMap<String, ViewPhoto> {
    let folder = if cameras.is_dir() {
        cameras
    } else {
        files::folder(cameras)
    };
    let photos = view_photos(folder, &LoadOptions::default());
    if !photos.is_empty() {
        return photos;
    }
    let of_run = |config: Config| {
        let dir = config.data.dir.as_deref()?;
        Some(view_photos(dir, &LoadOptions::from(&config)))
    };
    // Other programs have files of that name too.
    let config = Config::load(Some(&folder.join(CONFIG)), &[]).ok();
    config.and_then(of_run).unwrap_or_default()
}

/// The camera of the frame `frame`: a name of a view, or the path of its photo, with or without extension.
///
/// # Errors
/// [`Error::Argument`] with names like `frame`.
pub fn named_frame<'a>(frames: &'a [NamedCamera], frame: &str) -> Result<&'a NamedCamera> {
    let named = |name: &str| frames.iter().find(|f| f.name == name);
    let names = view_names(frame);
    let mut found = names.iter().filter_map(|name| named(name));
    if let Some(found) = named(frame).or_else(|| found.next()) {
        return Ok(found);
    }
    let stem = names.last().map_or(frame, String::as_str);
    let mut near: Vec<&str> = frames.iter().map(|f| f.name.as_str()).collect();
    let likeness = |name: &str| strsim::jaro_winkler(name, stem);
    near.sort_by(|a, b| likeness(b).total_cmp(&likeness(a)));
    near.truncate(5);
    Err(invalid!(argument "--frame"; found "{frame}";
        expected "one of {} frames such as {}", frames.len(), near.join(", "); help "name one of these frames"))
}

/// Names that the view of the photo `path` may have: the path with its folders joined by `_`, then with ever fewer of them, each with
/// and without extension.
fn view_names(path: &str) -> Vec<String> {
    let parts = path.split(['/', '\\']);
    let parts: Vec<&str> = parts.filter(|part| !["", "."].contains(part)).collect();
    let names = (0..parts.len()).flat_map(|first| {
        let name = parts[first..].join("_");
        let stem = Path::new(&name).file_stem().and_then(|stem| stem.to_str());
        let stem = stem.unwrap_or(&name).to_owned();
        [name, stem]
    });
    names.collect()
}

/// The same, where the frame must have the pixel `[x, y]`.
///
/// # Errors
/// As [`named_frame`]; [`Error::Argument`] with the size of the frame.
pub fn frame_with_pixel<'a>(
    frames: &'a [NamedCamera],
    frame: &str,
    [x, y]: [usize; 2],
) -> Result<&'a NamedCamera> {
    let found = named_frame(frames, frame)?;
    let [width, height] = [found.camera.width, found.camera.height];
    ensure!(x < width && y < height, argument "--pixel"; found "{x},{y}";
        expected "a column below {width} and a row below {height}"; help "choose a pixel of the frame");
    Ok(found)
}

/// The settings that rendered the run of the scene `scene`, see [`Config::rendering_of`]; defaults if there are none.
/// Other programs have files called config.toml too: one that cannot be used is a warning, not an error.
pub fn rendering_beside(scene: &Path) -> Config {
    let file = scene.with_file_name(CONFIG);
    if !file.is_file() {
        return Config::default();
    }
    Config::rendering_of(&file).unwrap_or_else(|error| {
        tracing::warn!("the scene is rendered with default raster settings: {error}");
        Config::default()
    })
}

/// Copies the file `name` beside the scene `from` beside the scene `to`. Without it, that of an earlier scene is removed. A file that
/// this program did not write stays. [`FEATURE_COLORS`] needs the Gaussians of `to` in the order of `from`.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn copy_beside(name: &str, from: &Path, to: &Path) -> Result<()> {
    let [source, target] = [from, to].map(|scene| scene.with_file_name(name));
    if atomic::same_file(&source, &target) || own::check(&target).is_err() {
        return Ok(());
    }
    if !source.is_file() {
        return atomic::remove(&target);
    }
    atomic::write_bytes(&target, &files::read(&source)?)
}
