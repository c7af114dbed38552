//! How a segmenter's own classes become those of the scene.

use crate::data::{Classes, first_names};
use crate::error::{Result, bail};
use std::cmp::Reverse;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// How a segmenter's own classes become those of the scene.
#[derive(Clone)]
pub(crate) struct Vocabulary {
    /// The class table of the scene.
    pub classes: Classes,
    /// Class id of each of the segmenter's classes, in its order.
    pub(super) ids: Vec<Option<u16>>,
    /// What is left out, apart from classes.
    pub notice: Option<String>,
    /// The classes that are left out.
    pub(super) unmatched: Option<Arc<Unmatched>>,
}

impl Vocabulary {
    /// Matches the segmenter's classes `names` to the table `classes` by name. An empty table is replaced by the segmenter's, with
    /// the ids that come with the names.
    ///
    /// # Errors
    /// No name is in the table.
    pub(super) fn new<'a>(
        file: &Path,
        classes: &Classes,
        names: impl IntoIterator<Item = (u16, &'a str)>,
    ) -> Result<Self> {
        let names: Vec<(u16, &str)> = names.into_iter().collect();
        if classes.is_empty() {
            return Ok(Self {
                ids: names.iter().map(|(id, _)| Some(*id)).collect(),
                classes: Classes::from_names(0, names),
                notice: None,
                unmatched: None,
            });
        }
        let ids: Vec<Option<u16>> = names.iter().map(|(_, name)| classes.id_of(name)).collect();
        let found = ids.iter().flatten().count();
        let all = names.len();
        if found == 0 {
            let listed: Vec<_> = names.iter().take(5).map(|(_, name)| *name).collect();
            bail!(file, "categories"; found "{} ..", listed.join(", ");
                expected "names of the class table, such as {}", classes.entries[0].name;
                help "rename the classes of classes.json, or remove it if there are no true labels");
        }
        let unmatched = (found < all).then(|| {
            let matched = format!(
                "{found} of the {all} classes of {} are in the class table by name",
                file.display()
            );
            let names = names.iter().map(|(_, name)| *name);
            Arc::new(Unmatched::new(matched, names.zip(&ids)))
        });
        Ok(Self {
            classes: classes.clone(),
            ids,
            notice: None,
            unmatched,
        })
    }
}

/// Classes of the segmenter that the scene does not have. Their pixels are counted as maps are read, where maps tell them apart.
pub(crate) struct Unmatched {
    /// How many classes the scene has.
    matched: String,
    /// Index in the vocabulary, and name.
    names: Vec<(usize, String)>,
    /// Pixels of each class of the vocabulary.
    pixels: Vec<AtomicU64>,
    /// Pixels of all maps.
    all: AtomicU64,
}

impl Unmatched {
    fn new<'a>(matched: String, classes: impl Iterator<Item = (&'a str, &'a Option<u16>)>) -> Self {
        let all: Vec<_> = classes.enumerate().collect();
        let names = all.iter().filter(|(_, (_, id))| id.is_none());
        Self {
            matched,
            names: names.map(|(i, (name, _))| (*i, (*name).into())).collect(),
            pixels: all.iter().map(|_| AtomicU64::new(0)).collect(),
            all: AtomicU64::new(0),
        }
    }

    /// Counts the pixels of a map: those of each class of the vocabulary, and `all` of them.
    pub(super) fn count(&self, of_classes: &[u64], all: usize) {
        self.all.fetch_add(all as u64, Ordering::Relaxed);
        for (sum, count) in self.pixels.iter().zip(of_classes) {
            sum.fetch_add(*count, Ordering::Relaxed);
        }
    }

    /// A sentence on them, the largest first, once maps were read. `help` says what the user can do.
    pub(super) fn notice(&self, help: &str) -> String {
        let all = self.all.load(Ordering::Relaxed).max(1) as f64;
        let pixels = |i: usize| self.pixels[i].load(Ordering::Relaxed);
        let mut names: Vec<&(usize, String)> = self.names.iter().collect();
        names.sort_by_key(|(i, _)| Reverse(pixels(*i)));
        let percent = |pixels: u64| format!("{:.1} %", 100.0 * pixels as f64 / all);
        let named = names.iter().map(|(i, name)| match pixels(*i) {
            0 => name.clone(),
            some => format!("{name} {}", percent(some)),
        });
        let listed = first_names(&named.collect::<Vec<_>>());
        let sum = match names.iter().map(|(i, _)| pixels(*i)).sum() {
            0 => String::new(),
            sum => format!(" ({} of all)", percent(sum)),
        };
        let matched = &self.matched;
        format!("{matched}; pixels of the others{sum} are unlabelled: {listed}; {help}")
    }
}
