//! `coseg export`: a scene, or each of its objects, in formats of other programs.

use super::object_scene::ObjectSceneArgs;
use super::splat_transform::SplatTransform;
use super::terminal;
use clap::{Args, ValueEnum};
use coseg::data::Classes;
use coseg::error::{Result, bail, ensure};
use coseg::files::{extension, names, own};
use coseg::runs::{Cameras, ObjectScene, SideFiles, check_output, read_scene, scene_path};
use coseg::splat::formats::{self, Format, label_path};
use std::path::{Path, PathBuf};

const HELP: &str = "\
With a file name the scene becomes that file; with a folder each object becomes a file in it, called ID_NAME: 04_chair_1.ply.

  .ply             3DGS PLY, exact, with labels
  .compressed.ply  compressed PLY of PlayCanvas and SuperSplat
  .spz             SPZ of Niantic, version 3
  .points.ply      a point cloud: the centres with colour, opacity and label
  .las .laz        the same for surveying software; labels are point source ids, and up to 191 classification = 64 + label
  .glb .sog        through splat-transform, where it is on the PATH

A .spz, .sog or .compressed.ply gets its labels in a file beside it, NAME.labels.json. --scene of all commands reads these
formats with their labels, and .splat. classes.json and cameras.json are copied beside the new files. docs/export.md says how
exact each format is.

Examples:
  coseg export --scene runs/room --out room.spz
  coseg export --scene objects --out parts                             each object as a PLY
  coseg export --scene objects --out chairs --only chair --format spz
  coseg export --scene runs/room --out room.laz                        labelled points for CloudCompare or QGIS
  coseg export --scene cloud.splat --out cloud.ply                     converts scenes without labels too";

/// Arguments of `coseg export`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct ExportArgs {
    #[command(flatten)]
    input: ObjectSceneArgs,
    /// File to write, or a folder for one file an object
    #[arg(long, value_name = "FILE|DIR")]
    out: PathBuf,
    /// Files in a folder: ply, compressed-ply, points-ply, spz, las, laz, sog or glb [default: ply]
    #[arg(long, value_enum, hide_possible_values = true)]
    format: Option<FileFormat>,
    /// Export only these objects, ids or names; may be repeated
    #[arg(long, value_name = "OBJECT,...", value_delimiter = ',')]
    only: Vec<String>,
    /// Write over the scene itself, or over files that this command did not write
    #[arg(long)]
    force: bool,
}

/// Formats of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FileFormat {
    CompressedPly,
    PointsPly,
    Ply,
    Spz,
    Las,
    Laz,
    Sog,
    Glb,
}

impl FileFormat {
    /// The end of a file name, with its dot, and the format, if this program writes it.
    fn parts(self) -> (&'static str, Option<Format>) {
        match self {
            Self::CompressedPly => (".compressed.ply", Some(Format::CompressedPly)),
            Self::PointsPly => (".points.ply", Some(Format::PointsPly)),
            Self::Ply => (".ply", Some(Format::Ply)),
            Self::Spz => (".spz", Some(Format::Spz)),
            Self::Las => (".las", Some(Format::Las)),
            Self::Laz => (".laz", Some(Format::Laz)),
            Self::Sog => (".sog", None),
            Self::Glb => (".glb", None),
        }
    }

    /// The format that a file name asks for. Other PLY end in .ply too, and come first.
    fn of(path: &Path) -> Option<Self> {
        let name = path.to_string_lossy().to_lowercase();
        let mut all = Self::value_variants().iter().copied();
        all.find(|format| name.ends_with(format.parts().0))
    }
}

/// A file to write, and the rows in it.
type Part = (PathBuf, Vec<u32>);

impl ExportArgs {
    /// Writes.
    pub fn run(self) -> Result<()> {
        let path = scene_path(&self.input.scene)?;
        let ply = read_scene(&path)?;
        let format = FileFormat::of(&self.out).filter(|_| !self.out.is_dir());
        ensure!(format.is_some() || self.out.is_dir() || extension(&self.out).is_empty(), argument "--out"; found "{}", self.out.display();
            expected "a name that ends in .ply, .compressed.ply, .points.ply, .spz, .las, .laz, .sog or .glb, or a folder"; help "change the name");
        ensure!(format.is_none() || self.format.is_none(), argument "--format"; found "a file as --out"; expected "a folder";
            help "leave it out: the name of a file says its format");
        if let Some(format) = format
            && self.only.is_empty()
            && ply.labels.is_none()
        {
            let rows = (0..ply.gaussians.len() as u32).collect();
            let scene = ObjectScene {
                path,
                ply,
                labels: Vec::new(),
                classes: Classes::default(),
                objects: Vec::new(),
            };
            return self.write(&scene, format, vec![(self.out.clone(), rows)]);
        }
        let scene = ObjectScene::new(path, ply, self.input.classes.as_deref())?;
        let only = scene.ids(&self.only, "--only")?;
        let objects = scene.objects.iter();
        let chosen = objects.filter(|object| only.is_empty() || only.contains(&object.id));
        if let Some(format) = format {
            let mut rows: Vec<u32> = chosen.flat_map(|object| &object.rows).copied().collect();
            rows.sort_unstable();
            return self.write(&scene, format, vec![(self.out.clone(), rows)]);
        }
        let format = self.format.unwrap_or(FileFormat::Ply);
        let last = scene.objects.last();
        let digits = last.map_or(1, |object| object.id.to_string().len());
        let part = |object: &coseg::objects::Object| {
            let name = safe(scene.name(object.id).unwrap_or("label"));
            let file = format!("{:0digits$}_{name}{}", object.id, format.parts().0);
            (self.out.join(file), object.rows.clone())
        };
        let parts: Vec<Part> = chosen.map(part).collect();
        self.check_folder(format, &parts)?;
        self.write(&scene, format, parts)
    }

    /// Refuses a folder that has scenes in it which this call will not write: they would look like objects.
    fn check_folder(&self, format: FileFormat, parts: &[Part]) -> Result<()> {
        let is_other = |name: &str, path: &Path| {
            FileFormat::of(Path::new(name)) == Some(format)
                && parts.iter().all(|(file, _)| file != path)
        };
        if let Some(other) = names(&self.out, is_other).first() {
            bail!(argument "--out"; found "{}", self.out.join(other).display(); expected "a folder without scenes of another export";
                help "remove it, or name another folder");
        }
        Ok(())
    }

    fn write(&self, scene: &ObjectScene, format: FileFormat, parts: Vec<Part>) -> Result<()> {
        let inputs = (scene.path.as_path(), self.input.classes.as_deref());
        for (out, _) in &parts {
            check_output(out, self.force, inputs, &scene.classes)?;
            let beside = label_path(out);
            if self.force {
                own::allow(&beside);
            }
            own::check(&beside)?;
        }
        let outs: Vec<&Path> = parts.iter().map(|(out, _)| out.as_path()).collect();
        let beside = SideFiles {
            scenes: &outs,
            classes: (!scene.labels.is_empty()).then_some(&scene.classes),
            cameras: Cameras::Beside(&scene.path),
        };
        beside.check(Some(self.force))?;
        let all = scene.ply.gaussians.len();
        let mut splat_transform = SplatTransform::default();
        for (out, rows) in &parts {
            let gaussians = scene.ply.gaussians.select(rows);
            let labels = (!scene.labels.is_empty()).then(|| {
                rows.iter()
                    .map(|&row| scene.labels[row as usize])
                    .collect::<Vec<_>>()
            });
            let (origin, labels) = (scene.ply.origin, labels.as_deref());
            match format.parts() {
                (_, Some(format)) => formats::write(out, format, &gaussians, origin, labels)?,
                (suffix, None) => {
                    let scene_of = (&gaussians, origin);
                    splat_transform.write(out, suffix, scene_of, labels, &scene.classes)?;
                }
            }
            terminal::say(&format!(
                "{}: {} of {all} Gaussians",
                out.display(),
                rows.len()
            ));
        }
        beside.write()
    }
}

/// A name as a part of a file name: letters, digits and `-` stay, others become `_`.
pub fn safe(name: &str) -> String {
    let start: String = name.chars().take(50).collect();
    start.replace(|c: char| !c.is_alphanumeric() && c != '-', "_")
}
