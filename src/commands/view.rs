//! `coseg view`: a scene as a page for the browser.

use super::scene_file::{cameras_path, scene_path};
use super::terminal;
use clap::Args;
use coseg::data::{Classes, Limits, read_cameras};
use coseg::error::{Error, Result};
use coseg::gaussians::ply;
use coseg::raster::Settings;
use coseg::viewer::Viewer;
use std::path::{Path, PathBuf};

const HELP: &str = "\
One page that works offline, 111 bytes a Gaussian of SH degree 3, drawn by the browser's WebGL 2. It shows colours, labels, or
both; an object is chosen by a click, hidden, shown alone, moved; the page says which `coseg edit` does that to the file.

  FILE.html#view=NAME&mode=labels   begins at the view NAME; modes are colour, both and labels

`coseg train` writes this page as viewer.html into its run folder.

Examples:
  coseg view --scene runs/room
  coseg view --scene edited/scene.ply --out table.html
  coseg view --scene other/point_cloud.ply --cameras other/cameras.json";

/// Arguments of `coseg view`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct ViewArgs {
    /// Scene in the 3DGS PLY convention, or a run folder; with a `label` column it has objects
    #[arg(long, value_name = "FILE.ply|RUN")]
    scene: PathBuf,
    /// Page to write [default: viewer.html beside the scene]
    #[arg(long, value_name = "FILE.html")]
    out: Option<PathBuf>,
    /// Views to go to, as `coseg render` takes them [default: cameras.json beside the scene, if it is there]
    #[arg(long, value_name = "FILE.json|DIR")]
    cameras: Option<PathBuf>,
    /// Names of the labels [default: classes.json beside the scene, if it is there]
    #[arg(long, value_name = "FILE.json")]
    classes: Option<PathBuf>,
    /// Cap of a splat's opacity at a pixel, in (0, 1]; graphdeco has 0.99, gsplat 0.999 [default: 0.999]
    #[arg(long, value_name = "X")]
    alpha_max: Option<f64>,
}

impl ViewArgs {
    /// Writes the page.
    pub fn run(self) -> Result<()> {
        let path = scene_path(&self.scene)?;
        let out = self.out.unwrap_or_else(|| path.with_file_name("viewer.html"));
        if !out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("html")) {
            let mend = "end the name in .html";
            return Err(Error::config("--out", out.display().to_string(), "an .html file", mend));
        }
        let ply = ply::read(&path, &Limits::default())?;
        let beside = |name: &str| Some(path.with_file_name(name)).filter(|file| file.is_file());
        let classes = self.classes.or_else(|| beside("classes.json"));
        let classes = classes.map_or_else(|| Ok(Classes::default()), |file| Classes::read(&file))?;
        let cameras = self.cameras.or_else(|| cameras_path(None, &path).ok());
        let cameras = cameras.map_or_else(|| Ok(Vec::new()), |file| read_cameras(&file, None))?;
        let viewer = Viewer {
            title: &title(&path),
            scene: &self.scene.display().to_string(),
            gaussians: &ply.gaussians,
            origin: ply.origin,
            labels: ply.labels.as_deref(),
            classes: &classes,
            cameras: &cameras,
            alpha_max: self.alpha_max.unwrap_or(Settings::default().alpha_max),
        };
        viewer.write(&out)?;
        terminal::say(&format!("{}: open it in a browser", out.display()));
        Ok(())
    }
}

/// The folder of a scene.ply, as of a run, otherwise the file's own name.
fn title(scene: &Path) -> String {
    let folder = scene.parent().and_then(|folder| folder.canonicalize().ok());
    let named = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let folder =
        folder.as_deref().and_then(named).filter(|_| scene.file_name().is_some_and(|name| name == "scene.ply"));
    folder.or_else(|| named(scene)).unwrap_or_else(|| "scene".to_owned())
}
