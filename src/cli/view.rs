//! `coseg view`: a scene as a page for the browser.

use super::terminal;
use super::values::{alpha_max, numbers};
use clap::Args;
use coseg::error::{Result, ensure};
use coseg::files::{extension, file_name, folder, own, sha256};
use coseg::runs::{
    SCENE, VIEWER, cameras_for, cameras_path, classes_beside, features_beside, rendering_beside,
    scene_path,
};
use coseg::splat::formats;
#[cfg(feature = "serve")]
use coseg::viewer::Served;
use coseg::viewer::Viewer;
use glam::DVec3;
#[cfg(feature = "serve")]
use std::net::IpAddr;
use std::path::{Path, PathBuf};

const HELP: &str = "\
The page works offline and needs WebGL 2. It takes some 120 bytes for each Gaussian of SH degree 3. It shows colours, labels,
or both. Click on an object to choose it; hide it, show it alone, turn it or move it. Edit labels: name, colour, merge
and delete objects, and select things by clicks, or Gaussians by brush, lasso or box, for another object or a new one.
A scene without labels gets its first ones in this way. Save them: the page downloads edits.json, and shows the command that
writes the result as a new file.

  FILE.html#view=NAME&mode=labels   starts at the view NAME, percent-encoded; modes are colour, both and labels

`coseg train` writes this page as viewer.html into its run folder, up to 128 MB. With --serve (feature `serve`) the page is not
written: it comes from this machine piece by piece, which is for large scenes, and \"Save edits\" writes the file.

Examples:
  coseg view --scene runs/room
  coseg view --scene other/point_cloud.ply --serve
  coseg view --scene edited/scene.ply --out table.html
  coseg view --scene other/model --out model.html                   a model folder of graphdeco's 3DGS
  coseg view --scene other/point_cloud.ply --up 0,0,1";

/// Arguments of `coseg view`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct ViewArgs {
    /// Scene, a PLY, .spz, .sog or .splat file, or its folder
    #[arg(long, value_name = "FILE|DIR")]
    scene: PathBuf,
    /// Page to write [default: viewer.html beside the scene, or in the folder]
    #[arg(long, value_name = "FILE.html")]
    out: Option<PathBuf>,
    /// Views to start from, as `coseg render` takes them [default: cameras.json beside the scene]
    #[arg(long, value_name = "FILE.json|DIR")]
    cameras: Option<PathBuf>,
    /// Names of the labels [default: classes.json beside the scene, if it is there]
    #[arg(long, value_name = "FILE.json")]
    classes: Option<PathBuf>,
    /// Which way is up in the world, such as 0,0,1 [default: that of the cameras, or 0,-1,0]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_direction, allow_hyphen_values = true)]
    up: Option<DVec3>,
    /// Serve the page to a browser on this machine instead: it draws while it loads, and saves edits itself
    #[cfg(feature = "serve")]
    #[arg(long, conflicts_with = "out")]
    serve: bool,
    /// The file in which the served page saves edits, and from which it starts [default: edits.json beside the scene]
    #[cfg(feature = "serve")]
    #[arg(long, value_name = "FILE.json", requires = "serve")]
    edits: Option<PathBuf>,
    /// The address of this machine that the page is served on
    #[cfg(feature = "serve")]
    #[arg(
        long,
        value_name = "IP",
        requires = "serve",
        default_value = "127.0.0.1"
    )]
    listen: IpAddr,
    /// Cap of a splat's opacity at a pixel, in (0, 1]; graphdeco has 0.99 [default: the run's, or 0.999]
    #[arg(long, value_name = "X", value_parser = alpha_max, allow_negative_numbers = true)]
    alpha_max: Option<f64>,
}

impl ViewArgs {
    /// Writes the page, or serves it.
    pub fn run(self) -> Result<()> {
        let path = scene_path(&self.scene)?;
        #[cfg(feature = "serve")]
        if self.serve {
            return self.serve(&path);
        }
        let out = match &self.out {
            Some(out) => out.clone(),
            None if self.scene.is_dir() => self.scene.join(VIEWER),
            None => path.with_file_name(VIEWER),
        };
        ensure!(extension(&out) == "html", argument "--out"; found "{}", out.display();
            expected "an .html file"; help "end the name in .html");
        own::check(&out)?;
        self.with_viewer(&path, |viewer| viewer.write(&out))?;
        terminal::say(&format!("{}: open it in a browser", out.display()));
        Ok(())
    }

    /// Serves the page until the process ends.
    #[cfg(feature = "serve")]
    fn serve(&self, path: &Path) -> Result<()> {
        let edits_beside = || path.with_file_name("edits.json");
        let edits = self.edits.clone().unwrap_or_else(edits_beside);
        ensure!(extension(&edits) == "json", argument "--edits"; found "{}", edits.display();
            expected "a .json file"; help "end the name in .json");
        self.with_viewer(path, |viewer| {
            let served = Served {
                viewer,
                edits,
                block: Served::BLOCK,
                listen: self.listen,
            };
            let started = |address: &str| {
                terminal::say(&format!("open {address} in a browser; Ctrl-C ends it"));
            };
            served.run(started, || false)
        })
    }

    /// Reads the scene at `path`, and does `act` with its page.
    fn with_viewer(&self, path: &Path, act: impl FnOnce(Viewer) -> Result<()>) -> Result<()> {
        let ply = formats::read(path)?;
        let gaussians = ply.gaussians;
        let names = self.classes.as_ref().map(|file| file.display().to_string());
        let classes = classes_beside(path, self.classes.as_deref())?;
        // Whoever opens the page may give a scene its first labels.
        let labels = ply
            .labels
            .unwrap_or_else(|| classes.unlabelled(gaussians.len()));
        let cameras = match cameras_path(self.cameras.as_deref(), path) {
            Ok(file) => cameras_for(path, &file, None)?,
            Err(_) => Vec::new(),
        };
        act(Viewer {
            title: &title(path),
            scene: &self.scene.display().to_string(),
            names: names.as_deref(),
            sha256: &sha256(path)?,
            gaussians: &gaussians,
            origin: ply.origin,
            labels: Some(&labels),
            features: &features_beside(path, gaussians.len()),
            classes: &classes,
            cameras: &cameras,
            up: self.up,
            alpha_max: self
                .alpha_max
                .unwrap_or_else(|| rendering_beside(path).raster.alpha_max),
        })
    }
}

fn parse_direction(text: &str) -> std::result::Result<DVec3, String> {
    let direction = numbers::<f64, 3>(text, ',').map(DVec3::from);
    let direction = direction.filter(|direction| direction.try_normalize().is_some());
    let expected = "expected a direction: three numbers separated by commas, for instance 0,0,1";
    direction.ok_or_else(|| expected.into())
}

/// The name of the folder for a scene.ply, of the file for others.
fn title(scene: &Path) -> String {
    let name = file_name(scene).unwrap_or_else(|| "scene".to_owned());
    let folder = folder(scene).canonicalize().ok().filter(|_| name == SCENE);
    folder.and_then(|folder| file_name(&folder)).unwrap_or(name)
}
