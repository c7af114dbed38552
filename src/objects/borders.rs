//! Objects of neighbouring blocks that are one: their Gaussians coincide where both blocks were trained.

use crate::data::{Class, Classes, class_color};
use crate::error::{Result, ensure};
use crate::segmentation::neighbours::PointIndex;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use union_find::{QuickUnionUf, UnionBySize, UnionFind};

/// Two objects are one when more than this part of the pairs of Gaussians with either object has both. Above one half each
/// object has one partner in a block at most.
const MIN_OVERLAP: f64 = 0.5;
/// Fewer pairs say nothing.
const MIN_PAIRS: usize = 4;

/// The labelled Gaussians of a block.
#[derive(Clone, Copy, Debug)]
pub struct BlockObjects<'a> {
    /// Centres, relative to an origin that all blocks have.
    pub means: &'a [[f32; 3]],
    /// One id for each.
    pub labels: &'a [u16],
    /// The Gaussians that stay: an object without any gets no id.
    pub kept: &'a [u32],
    /// What the ids of this block mean.
    pub classes: &'a Classes,
}

/// Objects of several blocks with common ids.
#[derive(Clone, Debug, Default)]
pub struct JoinedObjects {
    /// For each block its ids, and what they are in [`JoinedObjects::classes`].
    pub ids: Vec<BTreeMap<u16, u16>>,
    /// All objects.
    pub classes: Classes,
    /// How many objects of blocks were joined with one of another block.
    pub joined: usize,
}

/// An object of a block: the number of the block, and the id there.
type BlockObject = (usize, u16);

/// Joins the objects of `blocks`. `shared` has pairs of blocks, and of each the Gaussians in the region that both were trained on.
///
/// Two objects are joined if they are of one class and most of their Gaussians there are each other's nearest: pairs of such
/// Gaussians vote. All stuff of a class is one object.
///
/// # Errors
/// [`crate::Error::Limit`] for more objects than u16 has ids; those of [`PointIndex::new`].
pub fn join_objects(
    blocks: &[BlockObjects<'_>],
    shared: &[([usize; 2], [Vec<u32>; 2])],
) -> Result<JoinedObjects> {
    let entries = blocks.iter().enumerate().flat_map(|(block, of)| {
        let entries = of.classes.entries.iter();
        entries.map(move |class| ((block, class.id), class))
    });
    let entries: BTreeMap<BlockObject, &Class> = entries.collect();
    let set_of = object_sets(&entries, blocks, shared)?;
    let present = present_sets(blocks, &set_of);
    ensure!(present.len() < usize::from(u16::MAX), limit "objects of all blocks"; found "{}", present.len();
        expected "{}", u16::MAX - 1; help "merge fewer blocks, or give a segmentation of larger things");
    let labelled = blocks.iter().find(|block| !block.classes.is_empty());
    let mut classes = Classes {
        entries: Vec::new(),
        ignore: labelled.map_or(0, |block| block.classes.ignore),
    };
    let mut ids = vec![BTreeMap::new(); blocks.len()];
    let mut id_of: HashMap<usize, u16> = HashMap::new();
    let mut counts = HashMap::new();
    for (object, class) in &entries {
        let set = set_of[object];
        if !present.contains(&set) {
            continue;
        }
        let id = *id_of.entry(set).or_insert_with(|| {
            let id = next_id(&classes);
            classes.entries.push(Class {
                id,
                name: renumbered(class, &mut counts),
                color: class_color(id),
                object_of: class.object_of,
            });
            id
        });
        let &(block, own) = object;
        ids[block].insert(own, id);
    }
    Ok(JoinedObjects {
        joined: ids.iter().map(BTreeMap::len).sum::<usize>() - classes.len(),
        ids,
        classes,
    })
}

/// The number of the set that each object is in: objects of one set are one.
fn object_sets(
    entries: &BTreeMap<BlockObject, &Class>,
    blocks: &[BlockObjects<'_>],
    shared: &[([usize; 2], [Vec<u32>; 2])],
) -> Result<HashMap<BlockObject, usize>> {
    let numbers: HashMap<BlockObject, usize> = entries.keys().copied().zip(0..).collect();
    let mut sets = QuickUnionUf::<UnionBySize>::new(entries.len());
    for (pair, rows) in shared {
        for one in overlapping(blocks, *pair, rows)? {
            let [Some(a), Some(b)] = one.map(|object| entries.get(&object)) else {
                continue;
            };
            if a.object_of == b.object_of {
                sets.union(numbers[&one[0]], numbers[&one[1]]);
            }
        }
    }
    let mut stuff: HashMap<u16, usize> = HashMap::new();
    for (object, class) in entries {
        if let Some(of) = class.object_of.filter(|of| !of.thing) {
            let first = *stuff.entry(of.class).or_insert(numbers[object]);
            sets.union(first, numbers[object]);
        }
    }
    let found = numbers
        .into_iter()
        .map(|(object, number)| (object, sets.find(number)));
    Ok(found.collect())
}

/// The sets of the objects that have Gaussians which stay.
fn present_sets(
    blocks: &[BlockObjects<'_>],
    set_of: &HashMap<BlockObject, usize>,
) -> BTreeSet<usize> {
    let mut present: BTreeSet<usize> = BTreeSet::new();
    for (number, block) in blocks.iter().enumerate() {
        let ids = block.kept.iter().map(|&row| block.labels[row as usize]);
        let ids: BTreeSet<u16> = ids.collect();
        let sets = ids.into_iter().filter_map(|id| set_of.get(&(number, id)));
        present.extend(sets);
    }
    present
}

/// The id of the next entry: ids count from 1 and leave out that of unlabelled pixels. There are fewer entries than u16 has values.
fn next_id(classes: &Classes) -> u16 {
    let next = 1 + classes.len() as u16;
    let skips = classes.ignore != 0 && next >= classes.ignore;
    next + u16::from(skips)
}

/// The name of an object of a block with a number that is its own in all blocks: `chair 7` for `chair 2`.
fn renumbered(class: &Class, counts: &mut HashMap<String, usize>) -> String {
    let is_number = |text: &str| text.parse::<u32>().is_ok();
    match class
        .name
        .rsplit_once(' ')
        .filter(|(_, number)| is_number(number))
    {
        Some((what, _)) if class.object_of.is_none_or(|of| of.thing) => {
            let count = counts.entry(what.to_owned()).or_default();
            *count += 1;
            format!("{what} {count}")
        }
        _ => class.name.clone(),
    }
}

/// Pairs of objects of two blocks that overlap enough.
fn overlapping(
    blocks: &[BlockObjects<'_>],
    pair: [usize; 2],
    rows: &[Vec<u32>; 2],
) -> Result<Vec<[BlockObject; 2]>> {
    let [a, b] = pair.map(|block| blocks[block]);
    let mut both: BTreeMap<[u16; 2], usize> = BTreeMap::new();
    let mut each = [BTreeMap::<u16, usize>::new(), BTreeMap::new()];
    for [i, j] in mutual([a.means, b.means], rows)? {
        let ids = [a.labels[i as usize], b.labels[j as usize]];
        *both.entry(ids).or_default() += 1;
        for (counts, id) in each.iter_mut().zip(ids) {
            *counts.entry(id).or_default() += 1;
        }
    }
    let is_one = |(ids, common): (&[u16; 2], &usize)| {
        let [of_a, of_b] = [each[0][&ids[0]], each[1][&ids[1]]];
        let either = of_a + of_b - common;
        let is_object = ids[0] != a.classes.ignore && ids[1] != b.classes.ignore;
        is_object && *common >= MIN_PAIRS && *common as f64 > MIN_OVERLAP * either as f64
    };
    let found = both.iter().filter(|pair| is_one(*pair));
    Ok(found
        .map(|(ids, _)| [(pair[0], ids[0]), (pair[1], ids[1])])
        .collect())
}

/// Pairs of the rows of two point sets that are each other's nearest.
fn mutual(means: [&[[f32; 3]]; 2], rows: &[Vec<u32>; 2]) -> Result<Vec<[u32; 2]>> {
    let [a, b] = [0, 1].map(|side| {
        let at = rows[side].iter().map(|&row| means[side][row as usize]);
        at.collect::<Vec<[f32; 3]>>()
    });
    if a.is_empty() || b.is_empty() {
        return Ok(Vec::new());
    }
    let (to_b, _) = PointIndex::new(&b)?.nearest(&a, 1)?;
    let (to_a, _) = PointIndex::new(&a)?.nearest(&b, 1)?;
    let nearest = (0..).zip(&to_b.indices);
    let mutual = nearest.filter(|(i, j)| to_a.indices[**j as usize] == *i);
    let pair = |(i, j): (u32, &u32)| [rows[0][i as usize], rows[1][*j as usize]];
    Ok(mutual.map(pair).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::ObjectOf;

    fn table(things: &[(u16, &str, Option<ObjectOf>)]) -> Classes {
        let entry = |&(id, name, object_of): &(u16, &str, _)| Class {
            id,
            name: name.to_owned(),
            color: [0; 3],
            object_of,
        };
        Classes {
            entries: things.iter().map(entry).collect(),
            ignore: 0,
        }
    }

    #[test]
    fn a_table_on_the_border_becomes_one_and_what_is_on_it_stays_apart() {
        let thing = |class| Some(ObjectOf { class, thing: true });
        let floor = Some(ObjectOf {
            class: 9,
            thing: false,
        });
        let left = table(&[
            (1, "table 1", thing(5)),
            (2, "cup 1", thing(6)),
            (3, "floor", floor),
        ]);
        let right = table(&[
            (1, "cup 1", thing(6)),
            (2, "table 1", thing(5)),
            (3, "table 2", thing(5)),
            (4, "floor", floor),
        ]);
        // A row of Gaussians: ten of the table, five of the cup, five of the floor; the blocks place theirs a little apart.
        let row = |shift: f32| {
            (0..20)
                .map(|i| [i as f32 + shift, 0.0, 0.0])
                .collect::<Vec<_>>()
        };
        let (means, mut others) = (row(0.0), row(0.1));
        let labels: Vec<u16> = (0..20).map(|i| [1, 1, 2, 3][i / 5]).collect();
        // The right block takes two of the table for the cup, and has another table far away.
        let mut their: Vec<u16> = (0..20)
            .map(|i| if i < 8 { 2 } else { [1, 4][i / 15] })
            .collect();
        others.push([100.0, 0.0, 0.0]);
        their.push(3);
        let all = || (0..20).collect::<Vec<u32>>();
        let rows: Vec<u32> = (0..21).collect();
        let blocks = [
            BlockObjects {
                means: &means,
                labels: &labels,
                kept: &rows[..20],
                classes: &left,
            },
            BlockObjects {
                means: &others,
                labels: &their,
                kept: &rows,
                classes: &right,
            },
        ];
        let joined = join_objects(&blocks, &[([0, 1], [all(), all()])]).expect("joined");
        let names: Vec<&str> = joined.classes.entries.iter().map(|c| &*c.name).collect();
        assert_eq!(names, ["table 1", "cup 1", "floor", "table 2"]);
        assert_eq!(
            joined.ids[1],
            BTreeMap::from([(1, 2), (2, 1), (3, 4), (4, 3)])
        );
        assert_eq!(joined.joined, 3);
        // An object without remaining Gaussians has no id.
        let without = [
            blocks[0],
            BlockObjects {
                kept: &rows[..20],
                ..blocks[1]
            },
        ];
        let joined = join_objects(&without, &[([0, 1], [all(), all()])]).expect("joined");
        assert_eq!((joined.classes.len(), joined.ids[1].get(&3)), (3, None));
        // Nothing is joined across a border without shared Gaussians, except for the floor.
        let apart = join_objects(&blocks, &[]).expect("joined");
        assert_eq!((apart.classes.len(), apart.joined), (6, 1));
        // Nor things of different classes.
        let other = table(&[
            (1, "cup 1", thing(6)),
            (2, "chair 1", thing(7)),
            (3, "table 2", thing(5)),
            (4, "floor", floor),
        ]);
        let blocks = [
            blocks[0],
            BlockObjects {
                classes: &other,
                ..blocks[1]
            },
        ];
        let joined = join_objects(&blocks, &[([0, 1], [all(), all()])]).expect("joined");
        assert_eq!(joined.joined, 2);
    }
}
