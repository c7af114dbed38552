//! Grey maps whose ids are those of a class table beside them, as `coseg label` writes both.

use super::Vocabulary;
use crate::data::labels::scores::ScoreIds;
use crate::data::photos::image_file::ImageFile;
use crate::data::{Classes, LabelMap};
use crate::error::{Result, ensure};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The class table of a folder of maps, where it has one of its own. The maps of the scene folder `dir` itself are in the
/// scene's table.
pub(super) fn table(dir: &Path, maps: &Path) -> Option<PathBuf> {
    let file = maps.join(Classes::FILE);
    let is_scene = || crate::files::atomic::same_file(&file, &dir.join(Classes::FILE));
    (file.is_file() && !is_scene()).then_some(file)
}

/// The table of the maps, next to the scene's.
pub(super) struct OwnClasses {
    classes: Classes,
    /// Class id in the scene of each id of the maps, where the scene has the class.
    ids: HashMap<u16, u16>,
    /// Ids of classes that only scores name.
    unseen: Vec<u16>,
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
        for id in &mut map.ids {
            *id = self.ids.get(id).copied().unwrap_or(unlabelled);
        }
        Ok(map)
    }
}
