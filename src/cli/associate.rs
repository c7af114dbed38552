//! `coseg associate`: one id for each thing, from label maps whose ids differ from view to view.

use super::labelled::LabelledArgs;
use super::terminal;
use clap::Args;
use coseg::config::Association;
use coseg::data::formats::transforms;
use coseg::data::{LabelRuns, MapGeometry, NamedCamera, Scene, Split, View};
use coseg::error::Result;
use coseg::metrics::{InstanceScores, SemanticScores, instance_scores};
use coseg::objects::{LabelMaps, LabelRule, Semantics, associate, vote};
use coseg::raster::{self, Projected};
use coseg::splat::camera::Camera;
use coseg::splat::ply;

const HELP: &str = "\
Instance masks of unordered photos have ids that mean nothing in other views. Segments that cover the same Gaussians get
one id. Writes labels/VIEW.png (16-bit grey, 0 is unlabelled) for each view with raw labels, classes.json, and scene.ply
with a label column from a vote of the maps. Where frames have true instances, prints scores; where segments have classes
and frames true labels, scores by class. coseg train does the same after stage one with data.association = \"gaussians\".

Maps are as the views' cameras see them, which cameras.json has: without lens distortion, and reduced where data.max_side
reduced the photos. labels/geometry.json says so, {\"maps\": \"undistorted\"}, and has to go where the maps go: they are then
raw labels as they are, of any scene folder of these photos and poses, and distortion is not taken out a second time.

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
        let raster = raster::Settings::from(&config.raster);
        let device = self.input.device()?;
        let (mut scene, ply) = self.input.read(&config, &device)?;
        let found = associate(&ply.gaussians, &scene, &config.association, &raster)?;
        terminal::say(&format!(
            "{} segments of training views: {} objects, {} segments of none, {} divided",
            found.segments,
            found.groups.len(),
            found.dropped,
            found.divided
        ));
        let semantics = Semantics::of(&scene);
        found.apply(&mut scene);
        let folder = self.input.out.join("labels");
        // Before the maps, so that none lies there without it.
        MapGeometry::Undistorted.write(&folder)?;
        for view in &scene.views {
            if let Some(map) = &view.raw {
                let name = view.name.replace(['/', '\\'], "_");
                map.map().write_wide(&folder.join(format!("{name}.png")))?;
            }
        }
        transforms::write_cameras(&self.input.out.join("cameras.json"), &cameras(&scene))?;
        scene.classes.write(&self.input.out.join("classes.json"))?;
        let identities = vote(
            &ply.gaussians,
            scene.split(Split::Train),
            &scene.classes,
            &raster,
            &device,
        )?
        .identities();
        let path = self.input.out.join("scene.ply");
        ply::write(
            &path,
            &ply.gaussians,
            ply.origin,
            Some(&identities.ids(&scene.classes)),
        )?;
        let out = self.input.out.display();
        terminal::say(&format!(
            "{out}: maps in labels, cameras.json, classes.json and scene.ply"
        ));

        let maps = LabelMaps::new(
            &identities,
            &scene.classes,
            LabelRule::from(&config.segmentation),
        );
        let mut rendered = Vec::new();
        for view in scene.split(Split::Test) {
            if view.instances.is_some()
                || semantics
                    .as_ref()
                    .is_some_and(|semantics| semantics.knows(view))
            {
                let projected = Projected::new(&ply.gaussians.splats(), &view.camera, &raster)?;
                rendered.push((view, LabelRuns::from(maps.of(&projected))));
            }
        }
        let own: Vec<_> = scene
            .split(Split::Test)
            .filter_map(|view| Some((view, view.raw.clone()?)))
            .collect();
        for (what, maps) in [("maps", own), ("rendered", rendered)] {
            print(what, &of_instances(&maps));
            if let Some(semantics) = &semantics {
                print_by_class(what, &semantics.score(&scene.classes, &maps));
            }
        }
        Ok(())
    }
}

/// The cameras of the views, in world units.
fn cameras(scene: &Scene) -> Vec<NamedCamera> {
    let camera = |view: &View| Camera {
        center: view.camera.center + scene.origin,
        ..view.camera.clone()
    };
    let named = |view: &View| NamedCamera {
        name: view.name.clone(),
        split: view.split,
        camera: camera(view),
    };
    scene.views.iter().map(named).collect()
}

/// Scores of the maps of views with true instances.
fn of_instances(maps: &[(&View, LabelRuns)]) -> InstanceScores {
    instance_scores(
        maps.iter()
            .filter_map(|(view, map)| Some((view.instances.as_ref()?.map(), map.map()))),
    )
}

/// The scores by class of held-out views, where there are true labels.
fn print_by_class(what: &str, scores: &SemanticScores) {
    if let (Some(miou), Some(accuracy)) = (scores.miou, scores.accuracy) {
        let figure = |name: &str, value: Option<f64>| {
            value.map_or(String::new(), |value| format!(", {name} {value:.4}"))
        };
        let quality = scores.panoptic.unwrap_or_default();
        let qualities = [
            figure("PQ", quality.all.pq),
            figure("of things", quality.things.pq),
            figure("of stuff", quality.stuff.pq),
        ];
        terminal::say(&format!(
            "held-out views, {what}, by class: mIoU {miou:.4}, accuracy {accuracy:.4}{}",
            qualities.concat()
        ));
    }
}

/// The scores of held-out views, where there are true instances.
fn print(what: &str, scores: &InstanceScores) {
    if let (Some(accuracy), Some(miou), Some(pq)) =
        (scores.accuracy, scores.miou, scores.panoptic.pq)
    {
        let [sq, rq] = [scores.panoptic.sq, scores.panoptic.rq].map(Option::unwrap_or_default);
        terminal::say(&format!(
            "held-out views, {what}: accuracy {accuracy:.4}, mIoU {miou:.4}, PQ {pq:.4} (SQ {sq:.4}, RQ {rq:.4}), {} true \
             instances, {} objects",
            scores.instances, scores.objects
        ));
    }
}
