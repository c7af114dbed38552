//! Ids and names for what a label is divided into.

use crate::data::{Class, Classes, ObjectOf, class_color};
use crate::error::{Error, Result};
use std::collections::{BTreeSet, HashMap, HashSet};

/// Gives them out.
pub(super) struct Naming {
    /// The table so far.
    pub classes: Classes,
    names: HashSet<String>,
    /// Last number given after a name.
    numbers: HashMap<String, u32>,
    /// Ids that nothing has, the largest that were in use below the first of them.
    free: Vec<u16>,
}

impl Naming {
    pub fn new(labels: &[u16], classes: &Classes) -> Self {
        // No table says which id stands for nothing: 0 is what every command writes.
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
        // Above all others first, then what is left below; taken from the back.
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

    /// Ids of the `pieces` of `id`, itself the first. Pieces are things, whatever the whole was.
    pub fn divide(&mut self, id: u16, pieces: usize) -> Result<Vec<u16>> {
        if pieces - 1 > self.free.len() {
            return Err(Error::Limit {
                what: format!("label ids for the pieces of label {id}"),
                found: format!("{pieces} pieces"),
                limit: format!("{} ids that are free", self.free.len()),
                help: "separate fewer labels, or call more pieces strays".into(),
            });
        }
        let i = self.entry(id);
        let whole = self.classes.entries[i].clone();
        // A thing is numbered on: `chair 2` has the class name `chair`.
        let numbered = whole
            .object_of
            .filter(|of| of.thing)
            .and_then(|_| whole.name.rsplit_once(' '));
        let base = numbered
            .filter(|(_, number)| number.parse::<u32>().is_ok())
            .map_or(&*whole.name, |(base, _)| base);
        let of = ObjectOf {
            class: whole.object_of.map_or(id, |of| of.class),
            thing: true,
        };
        let mut ids = vec![id];
        self.classes.entries[i].object_of = Some(of);
        if base == whole.name {
            self.classes.entries[i].name = self.next_name(base);
        }
        ids.extend((1..pieces).filter_map(|_| self.free.pop()));
        for &next in &ids[1..] {
            let name = self.next_name(base);
            let at = self.classes.entries.partition_point(|c| c.id < next);
            self.classes.entries.insert(
                at,
                Class {
                    id: next,
                    name,
                    color: class_color(next),
                    object_of: Some(of),
                },
            );
        }
        Ok(ids)
    }

    /// Where `id` stands in the table, which it is added to where it is missing.
    pub fn entry(&mut self, id: u16) -> usize {
        let i = self.classes.entries.partition_point(|c| c.id < id);
        if self.classes.entries.get(i).is_none_or(|c| c.id != id) {
            let name = format!("label {id}");
            self.classes.entries.insert(
                i,
                Class {
                    id,
                    name,
                    color: class_color(id),
                    object_of: None,
                },
            );
        }
        i
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
