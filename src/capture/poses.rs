//! Poses of photos, by COLMAP: its program or its Python package.

use super::program;
use crate::error::{Error, Result, ensure};
use crate::files::{self, atomic, names};
use crate::progress::{Progress, Viewing};
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// How to get COLMAP.
const INSTALL: &str =
    "install COLMAP: pip install pycolmap, or apt-get install colmap, or brew install colmap";
/// What to do where COLMAP fails.
const HELP: &str = "correct what it names; the same command then continues";
/// Photos of a block of pairs that COLMAP matches at once, its default.
const BLOCK: usize = 50;

/// Who finds the poses.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Solver {
    /// The program `colmap`, and whether it was built for CUDA.
    Colmap { cuda: bool },
    /// The package of this Python.
    Pycolmap(PathBuf),
}

impl fmt::Display for Solver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Colmap { .. } => write!(f, "colmap"),
            Self::Pycolmap(python) => write!(f, "pycolmap of {}", python.display()),
        }
    }
}

/// The folders that COLMAP reads and writes.
pub(super) struct Folders<'a> {
    pub images: &'a Path,
    /// A mask for each photo, `a.jpg.png` for `a.jpg`.
    pub masks: Option<&'a Path>,
    /// COLMAP's own files, from which it continues.
    pub work: &'a Path,
    /// Receives the models, in folders 0, 1 and so on. COLMAP writes one for each group of photos that it could not join to the
    /// others.
    pub models: &'a Path,
}

impl Solver {
    /// The package of `python` if that is given. Otherwise the first of these that is installed: the program with CUDA, the package
    /// of `python3`, the program without CUDA, which is the slowest.
    ///
    /// # Errors
    /// [`Error::Missing`] with the line that installs one of them.
    pub fn find(python: Option<&Path>) -> Result<Self> {
        let colmap = output_of(Command::new("colmap").arg("help")).filter(|_| python.is_none());
        let cuda = colmap.as_ref().map(|help| !help.contains("without CUDA"));
        if cuda == Some(true) {
            return Ok(Self::Colmap { cuda: true });
        }
        let name = python.unwrap_or(Path::new("python3"));
        if output_of(Command::new(name).args(["-c", "import pycolmap"])).is_some() {
            return Ok(Self::Pycolmap(name.to_owned()));
        }
        if let Some(cuda) = cuda {
            return Ok(Self::Colmap { cuda });
        }
        let name = name.display();
        Err(if python.is_none() {
            let help = format!("{name} has no pycolmap either; {INSTALL}");
            Error::missing("program", "colmap", help)
        } else {
            let help = format!("{name} cannot import it; {INSTALL}");
            Error::missing("Python package", "pycolmap", help)
        })
    }

    /// The command of a step.
    fn command(&self, step: Step, folders: &Folders<'_>) -> Command {
        let database = folders.work.join("database.db");
        let sparse = folders.work.join("sparse");
        if let Self::Pycolmap(python) = self {
            let mut command = Command::new(python);
            command.args(["-c", include_str!("pycolmap.py"), step.name]);
            command.args([&database, folders.images, &sparse]);
            command.args(folders.masks);
            return command;
        }
        let mut command = Command::new("colmap");
        command.arg(step.of_colmap);
        command.arg("--database_path").arg(database);
        if step != MATCHES {
            command.arg("--image_path").arg(folders.images);
        }
        // Without CUDA it would use OpenGL, which needs a screen.
        if *self == (Self::Colmap { cuda: false }) {
            let help = output_of(Command::new("colmap").args([step.of_colmap, "-h"]));
            let help = help.unwrap_or_default();
            // The name of the option differs between versions.
            let option = help
                .split_whitespace()
                .find(|word| word.ends_with(".use_gpu"));
            if let Some(option) = option {
                command.args([option, "0"]);
            }
        }
        if step == FEATURES {
            command.args(["--ImageReader.single_camera", "1"]);
            command.args(["--ImageReader.camera_model", "OPENCV"]);
            if let Some(masks) = folders.masks {
                command.arg("--ImageReader.mask_path").arg(masks);
            }
        } else if step == POSES {
            command.arg("--output_path").arg(sparse);
        }
        command
    }

    /// Finds the poses of `photos` photos.
    ///
    /// # Errors
    /// [`Error::Program`] where COLMAP fails; [`Error::Input`] where it places no photo; [`Error::Io`]; [`Error::Stopped`].
    pub fn run(
        &self,
        folders: &Folders<'_>,
        photos: usize,
        progress: &mut dyn Progress,
    ) -> Result<()> {
        let sparse = folders.work.join("sparse");
        super::make_empty(&sparse)?;
        let blocks = photos.div_ceil(BLOCK).pow(2);
        for (step, length) in [(FEATURES, photos), (MATCHES, blocks), (POSES, photos)] {
            let mut viewing = Viewing::begin(progress, step.name, length);
            let mut command = self.command(step, folders);
            program::run(&mut command, HELP, &mut viewing, |line| {
                usize::from(line.contains(step.done))
            })?;
            viewing.end();
        }
        let models = names(&sparse, |_, path| path.is_dir());
        ensure!(!models.is_empty(), folders.images, "poses"; found "none of {photos} photos placed by {self}";
            expected "photos that show the same things";
            help "take sharp photos of a place with texture, so that each photo shares two thirds with the one before");
        for model in &models {
            for name in names(&sparse.join(model), |_, path| path.is_file()) {
                let bytes = files::read(&sparse.join(model).join(&name))?;
                atomic::write_bytes(folders.models.join(model).join(&name), &bytes)?;
            }
        }
        Ok(())
    }
}

/// The output of a program; `None` where the program is absent or fails.
fn output_of(command: &mut Command) -> Option<String> {
    let output = command.stdin(Stdio::null()).output().ok()?;
    let text = [output.stdout, output.stderr].concat();
    output
        .status
        .success()
        .then(|| String::from_utf8_lossy(&text).into_owned())
}

/// A step of COLMAP.
#[derive(Clone, Copy, PartialEq)]
struct Step {
    name: &'static str,
    /// The subcommand of `colmap`.
    of_colmap: &'static str,
    /// Text in an output line that reports another photo or block as done.
    done: &'static str,
}

const FEATURES: Step = Step {
    name: "features",
    of_colmap: "feature_extractor",
    done: "Processed file [",
};
const MATCHES: Step = Step {
    name: "matches",
    of_colmap: "exhaustive_matcher",
    done: " block [",
};
const POSES: Step = Step {
    name: "poses",
    of_colmap: "mapper",
    done: "Registering image #",
};
