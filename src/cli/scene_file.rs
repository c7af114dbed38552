//! Where a scene and its cameras lie: in files, or in the folder that `coseg train` wrote.

use coseg::config::{Config, RasterConfig};
use coseg::data::atomic;
use coseg::error::{Error, Result};
use std::path::{Path, PathBuf};

/// The settings of a run folder.
pub const CONFIG: &str = "config.toml";
/// The scene of a run folder.
const SCENE: &str = "scene.ply";
/// The cameras of a run folder.
const CAMERAS: &str = "cameras.json";
/// The scene of a model folder of graphdeco's 3DGS, in point_cloud/iteration_N.
const GRAPHDECO: &str = "point_cloud.ply";

/// The PLY file that `--scene` means: itself, scene.ply in a folder, or the last of a model folder of graphdeco's 3DGS.
pub fn scene_path(given: &Path) -> Result<PathBuf> {
    const MEND: &str = "give a .ply file, or the folder that `coseg train` wrote";
    if !given
        .try_exists()
        .map_err(|e| Error::io(given, "look at", e))?
    {
        return Err(Error::Missing {
            what: "file",
            path: given.to_owned(),
            help: MEND.to_owned(),
        });
    }
    if !given.is_dir() {
        return Ok(given.to_owned());
    }
    let inside = given.join(SCENE);
    if inside.is_file() {
        return Ok(inside);
    }
    if let Some(newest) = of_graphdeco(given) {
        return Ok(newest);
    }
    let names = std::fs::read_dir(given).into_iter().flatten().flatten();
    let names = names.filter_map(|entry| entry.file_name().into_string().ok());
    let other = names
        .filter(|name| name.to_lowercase().ends_with(".ply"))
        .min();
    let (found, help) = match other {
        Some(name) => (
            format!("no such file, but {name}"),
            format!("give {}", given.join(name).display()),
        ),
        None => ("no such file".to_owned(), MEND.to_owned()),
    };
    Err(Error::input(given, SCENE, found, "a run folder", help))
}

/// The Gaussians of the last iteration in a model folder of graphdeco's 3DGS: point_cloud/iteration_N/point_cloud.ply.
fn of_graphdeco(folder: &Path) -> Option<PathBuf> {
    let iterations = std::fs::read_dir(folder.join("point_cloud"))
        .ok()?
        .flatten();
    let numbered = |entry: std::fs::DirEntry| {
        let number: u64 = entry
            .file_name()
            .to_str()?
            .strip_prefix("iteration_")?
            .parse()
            .ok()?;
        let file = entry.path().join(GRAPHDECO);
        file.is_file().then_some((number, file))
    };
    iterations.filter_map(numbered).max().map(|(_, file)| file)
}

/// What `--cameras` names, or else the cameras beside the scene `scene`, or those of graphdeco's model folder.
pub fn cameras_path(given: Option<&Path>, scene: &Path) -> Result<PathBuf> {
    let beside = scene.with_file_name(CAMERAS);
    // graphdeco's 3DGS keeps its cameras above point_cloud/iteration_N.
    let above = scene.ancestors().nth(3).map(|model| model.join(CAMERAS));
    let above = above
        .filter(|file| file.is_file() && scene.file_name().is_some_and(|name| name == GRAPHDECO));
    match (given, above) {
        (Some(path), _) => Ok(path.to_owned()),
        (None, _) if beside.is_file() => Ok(beside),
        (None, Some(above)) => Ok(above),
        (None, None) => {
            let expected = format!("cameras: {} is not there", beside.display());
            let help = "give a file of cameras, a scene folder or a run folder";
            Err(Error::argument("--cameras", "nothing", expected, help))
        }
    }
}

/// How the run that the scene `scene` lies in rendered, see [`Config::rendering_of`]; else the defaults. Files of other
/// programs are called config.toml too: one without such settings says nothing, and one that cannot be used is warned of, since
/// the scene can be looked at all the same.
pub fn rendering_beside(scene: &Path) -> Config {
    let file = scene.with_file_name(CONFIG);
    if !file.is_file() {
        return Config::default();
    }
    let read = Config::rendering_of(&file);
    let read = read.inspect_err(|error| {
        tracing::warn!("the scene is rendered with default raster settings: {error}")
    });
    read.unwrap_or_default()
}

/// The raster settings among these.
pub fn raster_beside(scene: &Path) -> RasterConfig {
    rendering_beside(scene).raster
}

/// Copies the cameras beside the scene `from` beside the scene `to`, where there are some and none yet.
pub fn bring_cameras(from: &Path, to: &Path) -> Result<()> {
    let [source, target] = [from, to].map(|scene| scene.with_file_name(CAMERAS));
    if !source.is_file() || target.exists() {
        return Ok(());
    }
    let bytes = std::fs::read(&source).map_err(|e| Error::io(&source, "read", e))?;
    atomic::write_bytes(&target, &bytes)
}
