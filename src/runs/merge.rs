//! The runs of the blocks of a scene as one scene.

use super::{
    CAMERAS, CLASSES, CONFIG, Cameras, IDENTITIES, RunFolder, SCENE, SideFiles, identities_beside,
    write_scene,
};
use crate::config::{Association, Config};
use crate::data::blocks::{BLOCK, Block, block_name};
use crate::data::{self, Classes, NamedCamera, read_cameras};
use crate::error::{Result, bail, ensure};
use crate::files::lock::Lock;
use crate::files::{atomic, own};
use crate::objects::{BlockObjects, Identities, JoinedObjects, color_all_apart, join_objects};
use crate::splat::{self, Gaussians, ply, rows_where};
use glam::DVec3;
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

/// Settings that count for the whole scene.
const SHARED: [&str; 4] = [
    "data.association",
    "data.raw_labels",
    "data.transforms",
    "raster",
];

/// A run on a block.
struct Part {
    run: PathBuf,
    config: Config,
    block: Block,
    /// The folder of the whole scene.
    scene: PathBuf,
    gaussians: Gaussians,
    origin: DVec3,
    /// Centres of the Gaussians in the world.
    places: Vec<DVec3>,
    labels: Option<Vec<u16>>,
    classes: Classes,
    identities: Option<Identities>,
    cameras: Vec<NamedCamera>,
}

/// A merged scene.
#[derive(Clone, Debug)]
pub struct Merged {
    /// The Gaussians of all cores, in the order of blocks.
    pub gaussians: Gaussians,
    /// What was subtracted from every position.
    pub origin: DVec3,
    /// One id for each, where the runs have labels.
    pub labels: Option<Vec<u16>>,
    /// What the ids mean.
    pub classes: Classes,
    /// Scores of each Gaussian for each class, where all runs have some.
    pub identities: Option<Identities>,
    /// The cameras of all runs, each once.
    pub cameras: Vec<NamedCamera>,
    /// The settings of the first run, for the whole scene.
    pub config: Config,
    /// For each block its name, how many of its Gaussians lie in its core, and all of them.
    pub blocks: Vec<(String, [usize; 2])>,
    /// How many objects of blocks were joined with one of another block; `None` where labels are classes.
    pub joined: Option<usize>,
}

/// Merges the scenes of `runs`, which were trained on all blocks of one split, each on one. Each block gives the Gaussians
/// whose centres lie in its core. Ids that association gave are joined over the borders, see [`join_objects`].
///
/// # Errors
/// [`crate::Error::Argument`] naming a run that is of no block or of another split, a block that is missing or there twice;
/// [`crate::Error::Input`] for class tables that contradict each other; those of reading the runs.
pub fn merge(runs: &[PathBuf]) -> Result<Merged> {
    ensure!(!runs.is_empty(), argument "RUN"; found "nothing"; expected "the runs of all blocks"; help "name their folders");
    let parts = runs.iter().map(|run| Part::open(run));
    let mut parts = parts.collect::<Result<Vec<Part>>>()?;
    parts.sort_by_key(|part| part.block.index);
    check_complete(&parts)?;
    check_alike(&parts)?;
    let origin = parts[0].origin;
    parts.iter_mut().for_each(|part| part.move_to(origin));
    let kept: Vec<Vec<u32>> = parts.iter().map(Part::core).collect();
    let is_labelled = parts.iter().all(|part| part.labels.is_some());
    let are_objects = |part: &Part| part.config.data.association != Association::None;
    let (mut classes, joined) = if is_labelled && parts.iter().any(are_objects) {
        let found = objects(&parts, &kept)?;
        for (part, ids) in parts.iter_mut().zip(&found.ids) {
            part.renumber(|id| ids.get(&id).copied().unwrap_or(found.classes.ignore));
        }
        (found.classes, Some(found.joined))
    } else {
        (classes(&parts)?, None)
    };
    let labels = parts.iter().zip(&kept).flat_map(|(part, rows)| {
        let labels = part.labels.as_deref().unwrap_or_default();
        rows.iter().map(|&row| labels[row as usize])
    });
    let labels: Option<Vec<u16>> = is_labelled.then(|| labels.collect());
    let gaussians = gaussians(&parts, &kept);
    if let (Some(_), Some(labels)) = (joined, &labels) {
        color_all_apart(&gaussians, labels, &mut classes)?;
    }
    let mut config = parts[0].config.clone();
    let scene = parts[0].scene.clone();
    parts[0].block.reading.apply(scene, &mut config.data);
    let mut names = HashSet::new();
    let cameras = parts.iter().flat_map(|part| &part.cameras);
    let cameras = cameras.filter(|camera| names.insert(&camera.name)).cloned();
    let count =
        |(part, rows): (&Part, &Vec<u32>)| (part.block.name(), [rows.len(), part.gaussians.len()]);
    Ok(Merged {
        gaussians,
        origin,
        labels,
        identities: identities(&parts, &kept, &classes),
        cameras: cameras.collect(),
        config,
        blocks: parts.iter().zip(&kept).map(count).collect(),
        joined,
        classes,
    })
}

/// Refuses runs of different splits, and blocks that are missing or there twice.
fn check_complete(parts: &[Part]) -> Result<()> {
    let first = &parts[0];
    let mut found: BTreeMap<[usize; 2], &Path> = BTreeMap::new();
    for part in parts {
        let run = part.run.display();
        ensure!(part.scene == first.scene && part.block.grid == first.block.grid && part.block.reading == first.block.reading,
            argument "RUN"; found "{run}, a run on a block of a different split than {}", first.run.display();
            expected "blocks of one split"; help "name the runs of one split");
        if let Some(other) = found.insert(part.block.index, &part.run) {
            bail!(argument "RUN"; found "{} and {run}, two runs on block {}", other.display(), part.block.name();
                expected "each block once"; help "leave one of the two out");
        }
    }
    let indices = first.block.grid.indices();
    let missing = indices.filter(|index| !found.contains_key(index));
    let missing: Vec<String> = missing.map(block_name).collect();
    ensure!(missing.is_empty(), argument "RUN"; found "no run on {}", missing.join(", ");
        expected "all {} blocks", first.block.grid.indices().count(); help "train the blocks that are missing, and name their runs too");
    Ok(())
}

/// Refuses runs that differ in a setting that counts for the whole scene, and runs with and without labels together.
fn check_alike(parts: &[Part]) -> Result<()> {
    let first = &parts[0];
    for part in parts {
        let [run, other] = [&part.run, &first.run].map(|run| run.display());
        let [now, then] = [part, first].map(|part| serde_json::json!(part.config));
        let differs = |key: &&str| now.pointer(&pointer(key)) != then.pointer(&pointer(key));
        if let Some(key) = SHARED.into_iter().find(differs) {
            bail!(argument "RUN"; found "{run}, whose settings of {key} are not those of {other}";
                expected "runs with the same settings"; help "train this block again with the settings of the others");
        }
        ensure!(part.labels.is_some() == first.labels.is_some(), argument "RUN";
            found "{run} and {other}, of which only one has labels"; expected "labels in all runs, or in none";
            help "train the blocks without labels again, with raw labels");
    }
    Ok(())
}

/// Where the setting `key` is in the JSON of settings.
fn pointer(key: &str) -> String {
    format!("/{}", key.replace('.', "/"))
}

impl Part {
    fn open(dir: &Path) -> Result<Self> {
        let run = RunFolder::existing(dir)?;
        let config = run.config(&[])?;
        let help = "leave it out, or put the folder of the block back";
        let Some(folder) = &config.data.dir else {
            bail!(argument "RUN"; found "{}, a run on the built-in room", dir.display();
                expected "a run on a block of `coseg split`"; help "{help}");
        };
        let Some(block) = Block::in_folder(run.path())? else {
            bail!(argument "RUN"; found "{}, where no {BLOCK} is", dir.display();
                expected "a run on a block of `coseg split`"; help "{help}");
        };
        let scene = run.file(SCENE);
        let ply = ply::read(&scene)?;
        let classes = run.classes()?;
        Ok(Self {
            run: dir.to_owned(),
            scene: block.scene_folder(folder)?,
            config,
            block,
            places: ply.gaussians.positions(ply.origin),
            origin: ply.origin,
            identities: identities_beside(&scene, ply.gaussians.len(), classes.len())?,
            cameras: read_cameras(&run.file(CAMERAS), None)?,
            gaussians: ply.gaussians,
            labels: ply.labels,
            classes,
        })
    }

    /// Makes the centres relative to `origin`.
    fn move_to(&mut self, origin: DVec3) {
        let offset = self.origin - origin;
        if offset != DVec3::ZERO {
            splat::shift(&mut self.gaussians.means, offset);
        }
    }

    /// Gives labels and classes other ids.
    fn renumber(&mut self, id: impl Fn(u16) -> u16) {
        let labels = self.labels.iter_mut().flatten();
        let classes = self.classes.entries.iter_mut();
        let ids = labels.chain(classes.map(|class| &mut class.id));
        ids.for_each(|old| *old = id(*old));
    }

    /// The Gaussians of the core.
    fn core(&self) -> Vec<u32> {
        self.rows(|place| self.block.grid.cell(place) == self.block.index)
    }

    /// The Gaussians whose centres `is_wanted` accepts.
    fn rows(&self, is_wanted: impl Fn(DVec3) -> bool) -> Vec<u32> {
        rows_where(&self.places, |place| is_wanted(*place))
    }
}

/// The Gaussians `kept` of all parts.
fn gaussians(parts: &[Part], kept: &[Vec<u32>]) -> Gaussians {
    let degree = parts.iter().map(|part| part.gaussians.sh_degree).max();
    let mut all = Gaussians {
        sh_degree: degree.unwrap_or(0),
        ..Gaussians::default()
    };
    for (part, rows) in parts.iter().zip(kept) {
        let more = part.gaussians.select(rows).with_sh_degree(all.sh_degree);
        all.means.extend(more.means);
        all.log_scales.extend(more.log_scales);
        all.rotations.extend(more.rotations);
        all.opacity_logits.extend(more.opacity_logits);
        all.sh.extend(more.sh);
    }
    all
}

/// The classes of all parts. An id must have the same name in all of them.
fn classes(parts: &[Part]) -> Result<Classes> {
    let first = parts.iter().find(|part| !part.classes.is_empty());
    let first = first.unwrap_or(&parts[0]);
    let ignore = first.classes.ignore;
    let mut entries = BTreeMap::new();
    for part in parts {
        let file = part.run.join(CLASSES);
        ensure!(part.classes.is_empty() || part.classes.ignore == ignore, &file, "unlabelled id"; found "{}", part.classes.ignore;
            expected "{ignore}, as in {}", first.run.display(); help "train the blocks on one class table");
        for class in &part.classes.entries {
            let known = entries.entry(class.id).or_insert_with(|| class.clone());
            ensure!(known.name == class.name, &file, "id {}", class.id; found "{}", class.name;
                expected "{}, as in another block", known.name; help "train the blocks on one class table");
        }
    }
    let entries = entries.into_values().collect();
    Ok(Classes { entries, ignore })
}

/// The objects of all parts, joined over the borders.
fn objects(parts: &[Part], kept: &[Vec<u32>]) -> Result<JoinedObjects> {
    let of_parts = parts.iter().zip(kept).map(|(part, kept)| BlockObjects {
        kept,
        means: &part.gaussians.means,
        labels: part.labels.as_deref().unwrap_or_default(),
        classes: &part.classes,
    });
    let mut shared = Vec::new();
    for (j, b) in parts.iter().enumerate() {
        for (i, a) in parts[..j].iter().enumerate() {
            let regions = [a.block.region(), b.block.region()];
            if !regions[0].meets(&regions[1]) {
                continue;
            }
            let inside = |part: &Part| -> Vec<u32> {
                part.rows(|place| regions.iter().all(|region| region.contains(place)))
            };
            shared.push(([i, j], [inside(a), inside(b)]));
        }
    }
    join_objects(&of_parts.collect::<Vec<_>>(), &shared)
}

/// The scores of the Gaussians `kept` for `classes`, where all blocks have scores.
fn identities(parts: &[Part], kept: &[Vec<u32>], classes: &Classes) -> Option<Identities> {
    let mut scores = Vec::new();
    for (part, rows) in parts.iter().zip(kept) {
        let own = part.identities.as_ref()?.select(rows);
        scores.extend(own.for_classes(&part.classes, classes).scores);
    }
    Some(Identities {
        scores,
        classes: classes.len(),
    })
}

impl Merged {
    /// Refuses a folder that holds files of a scene, or files that the running command did not write.
    ///
    /// # Errors
    /// [`crate::Error::Argument`].
    pub fn check_output(out: &Path) -> Result<()> {
        data::check_outputs("--out", &[out], None)?;
        let files = [SCENE, CLASSES, CAMERAS, IDENTITIES, CONFIG];
        files.iter().try_for_each(|name| own::check(out.join(name)))
    }

    /// Writes it into the folder `out` as `coseg train` writes a scene: `coseg eval` scores it.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; as [`SideFiles::check`] and [`write_scene`].
    pub fn write(&self, out: &Path) -> Result<()> {
        let _lock = Lock::new(out)?;
        let scene = out.join(SCENE);
        let beside = SideFiles {
            scenes: &[&scene],
            classes: Some(&self.classes),
            cameras: Cameras::Used(&self.cameras),
        };
        beside.check(None)?;
        let gaussians = (&self.gaussians, self.origin);
        write_scene(&scene, gaussians, self.labels.as_deref(), &beside)?;
        match &self.identities {
            Some(identities) => identities.write(&out.join(IDENTITIES))?,
            None => atomic::remove(out.join(IDENTITIES))?,
        }
        atomic::write_bytes(out.join(CONFIG), self.config.to_toml()?.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_settings_of_the_whole_scene_exist() {
        let config = serde_json::json!(Config::default());
        for key in SHARED {
            assert!(config.pointer(&pointer(key)).is_some(), "{key}");
        }
    }
}
