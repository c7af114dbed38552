//! Grey maps whose ids are those of a class table beside them, as `coseg label` writes both.

use super::{INDEX_FILE, Unmatched, Vocabulary};
use crate::data::labels::scores::ScoreIds;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap};
use crate::error::{Result, bail, ensure};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The class table of a folder of maps, where it has one of its own. The maps of the scene folder `dir` itself are in the
/// scene's table.
pub(super) fn table(dir: &Path, maps: &Path) -> Option<PathBuf> {
    let file = maps.join(Classes::FILE);
    let is_scene = || crate::files::atomic::same_file(&file, &dir.join(Classes::FILE));
    (file.is_file() && !is_scene()).then_some(file)
}

/// The index of a folder that `coseg label` began and did not finish: it writes the class table last.
pub(super) fn unfinished_index(maps: &Path) -> Option<PathBuf> {
    index(maps).filter(|_| !maps.join(Classes::FILE).is_file())
}

/// The index of a folder that `coseg label` wrote.
fn index(maps: &Path) -> Option<PathBuf> {
    let file = maps.join(INDEX_FILE);
    let is_index = |text: String| text.contains("\"made_from\"");
    let is_ours = file.is_file() && crate::files::text(&file).is_ok_and(is_index);
    is_ours.then_some(file)
}

/// Refuses a folder that `coseg label` did not finish: its ids would be taken for those of the scene.
pub(super) fn expect_finished(maps: &Path) -> Result<()> {
    if let Some(index) = unfinished_index(maps) {
        bail!(index, "{}", Classes::FILE; found "no such file beside it: labelling was stopped";
            expected "the class table, which `coseg label` writes when all photos are labelled";
            help "give the same `coseg label` command again: it goes on");
    }
    Ok(())
}

/// The table of the maps, next to the scene's.
pub(super) struct OwnClasses {
    classes: Classes,
    /// Class id in the scene of each id of the maps, where the scene has the class.
    ids: HashMap<u16, u16>,
    /// Ids of classes that only scores name.
    unseen: Vec<u16>,
    /// The classes that the scene does not have.
    unmatched: Option<Arc<Unmatched>>,
    /// Whether `coseg label` wrote the maps.
    pub is_by_label: bool,
}

impl OwnClasses {
    /// Reads the table in `file` and matches it by name with `classes`, the scene's, which may be empty.
    ///
    /// # Errors
    /// As [`Classes::read`]; no class of the table is one of the scene.
    pub fn read(file: &Path, classes: &Classes) -> Result<(Self, Vocabulary)> {
        let own = Classes::read(file)?;
        ensure!(!own.is_empty(), file, "classes"; found "no class"; expected "the classes of the maps beside it";
            help "list them, or remove the file");
        let names = own.entries.iter().map(|class| (class.id, &*class.name));
        let mut vocabulary = Vocabulary::new(file, classes, names)?;
        if classes.is_empty() {
            vocabulary.classes = own.clone();
        }
        let matched = own.entries.iter().zip(&vocabulary.ids);
        let ids = matched
            .filter_map(|(class, id)| Some((class.id, (*id)?)))
            .collect();
        let own = Self {
            classes: own,
            ids,
            unseen: Classes::read_unseen(file)?,
            unmatched: vocabulary.unmatched.clone(),
            is_by_label: file.parent().and_then(index).is_some(),
        };
        Ok((own, vocabulary))
    }

    /// What ids in scores beside the maps mean.
    pub fn score_ids(&self) -> ScoreIds {
        let seen = self.classes.entries.iter().map(|class| class.id);
        let ids = seen.chain(self.unseen.iter().copied());
        let in_scene = |id: u16| (id, self.ids.get(&id).copied());
        ScoreIds::new(self.classes.ignore, ids.map(in_scene))
    }

    /// The map in class ids of the scene; classes that the scene lacks become `unlabelled`.
    pub fn decode(&self, path: &Path, file: &ImageFile, unlabelled: u16) -> Result<LabelMap> {
        let mut map = LabelMap::decode(path, file)?;
        map.check_ids(path, &self.classes, "")?;
        self.count(&map);
        for id in &mut map.ids {
            *id = self.ids.get(id).copied().unwrap_or(unlabelled);
        }
        Ok(map)
    }

    /// Counts the pixels of each class, where some are not in the scene.
    fn count(&self, map: &LabelMap) {
        let Some(unmatched) = &self.unmatched else {
            return;
        };
        let mut of_ids = vec![0; 1 << 16];
        map.ids.iter().for_each(|&id| of_ids[usize::from(id)] += 1);
        let classes = self.classes.entries.iter();
        let pixels: Vec<u64> = classes.map(|class| of_ids[usize::from(class.id)]).collect();
        unmatched.count(&pixels, map.ids.len());
    }
}
