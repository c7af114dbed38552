//! `coseg associate`: one id for each object, from label maps whose ids differ from view to view.

use super::labelled::LabelledArgs;
use super::progress::Bars;
use super::{held_out, terminal};
use clap::Args;
use coseg::config::Association;
use coseg::data::{MapGeometry, Split};
use coseg::error::Result;
use coseg::objects::{color_all_apart, vote};
use coseg::pipeline::{Associated, HeldOut, SegmentationInputs, associate};
use coseg::raster::Settings;
use coseg::runs::{Cameras, SCENE, SideFiles, write_scene};

const HELP: &str = "\
The ids of instance masks often mean nothing in other views. Segments that cover the same Gaussians get one id. Writes
labels/VIEW.png (16-bit grey, 0 is unlabelled) for each view with raw labels, cameras.json, classes.json, and scene.ply with
a label column from a vote of the maps. Prints scores where frames have true instances, and scores by class where segments
have classes and frames have true labels. `coseg train` does the same after stage one with data.association = \"gaussians\".

The maps belong to the cameras in cameras.json: without lens distortion, and reduced where data.max_side reduced the
photos. labels/geometry.json says so, {\"maps\": \"undistorted\"}; keep it beside the maps. They can then be raw labels of any
scene folder with these photos and poses, and distortion is not removed a second time.

Examples:
  coseg associate --scene scene.ply --data scenes/living --out runs/objects --set data.raw_labels=segments
  cp runs/objects/classes.json scenes/living      # where it has no class table of its own
  coseg train --data scenes/living --set data.raw_labels=$PWD/runs/objects/labels";

/// Arguments of `coseg associate`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct AssociateArgs {
    #[command(flatten)]
    input: LabelledArgs,
}

impl AssociateArgs {
    /// Associates, writes and scores.
    pub fn run(self) -> Result<()> {
        let mut config = self.input.config()?;
        config.data.association = Association::Gaussians;
        let settings = Settings::from(&config.raster);
        let device = self.input.backend.open()?;
        let (mut scene, ply) = self.input.read(&config, &device, &["labels"])?;
        let Associated { counts, semantics } =
            associate(&ply.gaussians, &mut scene, &config, &mut Bars::default())?;
        terminal::say(&counts.to_string());
        let out = &self.input.out;
        let classes = &scene.classes;
        let train = scene.split(Split::Train);
        let identities = vote(&ply.gaussians, train, classes, &settings, &device)?.identities();
        let ids = identities.ids(classes);
        let mut colored = classes.clone();
        color_all_apart(&ply.gaussians, &ids, &mut colored)?;
        let (path, cameras) = (out.join(SCENE), scene.cameras());
        let beside = SideFiles {
            scenes: &[&path],
            classes: Some(&colored),
            cameras: Cameras::Used(&cameras),
        };
        beside.check(None)?;
        let folder = out.join("labels");
        // Written before the maps: without this file, loading would have to guess their geometry.
        MapGeometry::Undistorted.write(&folder)?;
        for view in &scene.views {
            if let Some(map) = &view.raw {
                let name = view.name.replace(['/', '\\'], "_");
                map.map().write_wide(&folder.join(format!("{name}.png")))?;
            }
        }
        write_scene(&path, (&ply.gaussians, ply.origin), Some(&ids), &beside)?;
        terminal::say(&format!(
            "{}: maps in labels, cameras.json, classes.json and scene.ply",
            out.display()
        ));

        let inputs = SegmentationInputs {
            semantics: semantics.as_ref(),
            ..SegmentationInputs::new(&scene, &ply.gaussians, &config, &device)
        };
        let views = HeldOut::new(&inputs);
        held_out::print(&views.score_raw().0, "held-out views, maps");
        let rendered = views.score(&identities)?;
        held_out::print(&rendered, "held-out views, rendered");
        Ok(())
    }
}
