//! Ids and names for the pieces of a label.

use crate::data::{Classes, ObjectOf};
use crate::error::{Result, ensure};
use std::collections::{BTreeSet, HashMap, HashSet};

/// Hands out free ids and names.
pub(super) struct Naming {
    /// The class table so far.
    pub classes: Classes,
    names: HashSet<String>,
    /// The last number used after each name.
    numbers: HashMap<String, u32>,
    /// Unused ids, taken from the back: first those above all used ones, then the rest.
    free: Vec<u16>,
}

impl Naming {
    pub fn new(labels: &[u16], classes: &Classes) -> Self {
        // Without a class table 0 is unlabelled, as in every file that the commands write.
        let mut classes = classes.clone();
        if classes.is_empty() {
            classes.ignore = 0;
        }
        let entries = classes.entries.iter().map(|c| c.id);
        let used: BTreeSet<u16> = labels
            .iter()
            .copied()
            .chain(entries)
            .chain([classes.ignore, 0])
            .collect();
        let largest = used
            .iter()
            .rfind(|id| **id != classes.ignore)
            .copied()
            .unwrap_or(0);
        let order = (1..=largest).rev().chain((largest..=u16::MAX).rev());
        let free = order.filter(|id| !used.contains(id)).collect();
        let names = classes.entries.iter().map(|c| c.name.clone()).collect();
        Self {
            classes,
            names,
            numbers: HashMap::new(),
            free,
        }
    }

    /// Ids of the `pieces` of `id`; the first is `id`. Pieces are things, whatever the whole was.
    pub fn divide(&mut self, id: u16, pieces: usize) -> Result<Vec<u16>> {
        ensure!(pieces - 1 <= self.free.len(), limit "label ids for the pieces of label {id}";
            found "{pieces} pieces"; expected "{} ids that are free", self.free.len();
            help "separate fewer labels, or call more pieces strays");
        let whole = self.classes.entry(id).clone();
        let base = whole.base_name();
        let object_of = Some(ObjectOf {
            class: whole.object_of.map_or(id, |of| of.class),
            thing: true,
        });
        if base == whole.name {
            let name = self.next_name(base);
            self.classes.entry(id).name = name;
        }
        let mut ids = vec![id];
        ids.extend((1..pieces).filter_map(|_| self.free.pop()));
        for &next in &ids[1..] {
            let name = self.next_name(base);
            self.classes.entry(next).name = name;
        }
        for &piece in &ids {
            self.classes.entry(piece).object_of = object_of;
        }
        Ok(ids)
    }

    fn next_name(&mut self, base: &str) -> String {
        loop {
            let number = self.numbers.entry(base.to_owned()).or_default();
            *number += 1;
            let name = format!("{base} {number}");
            if self.names.insert(name.clone()) {
                return name;
            }
        }
    }
}
