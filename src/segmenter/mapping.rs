//! From the network's classes to those of the labels.

use super::contract::{Contract, nearest_first};
use crate::data::Classes;
use crate::data::labels::classes::plain;
use crate::error::{Result, bail, ensure, invalid};
use crate::files;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The id of unlabelled pixels.
const UNLABELLED_ID: u16 = 0;

/// The user's classes: a TOML with one table `[classes]` from names to lists of the network's names.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassFile {
    /// Names of the network's classes that make up each class.
    pub classes: BTreeMap<String, Vec<String>>,
    /// Where it was read from.
    #[serde(skip)]
    pub file: PathBuf,
}

impl ClassFile {
    /// Reads the file.
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] naming the line: malformed TOML, other keys.
    pub fn read(file: &Path) -> Result<Self> {
        let expected = "[classes] with lines such as sofa = [\"sofa\", \"armchair\"]";
        let read: Self = files::toml(&files::text(file)?, file, expected)?;
        Ok(Self {
            file: file.to_owned(),
            ..read
        })
    }
}

/// Which class of the labels each of a network's classes becomes.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// The class table of the labels. It has all classes that may occur.
    pub classes: Classes,
    /// Whether only those classes are kept that occur.
    pub keeps_occurring: bool,
    /// Id of each channel of mapped scores.
    pub(super) ids: Vec<u16>,
    /// Channel of mapped scores of each of the network's classes; `None` for classes that are dropped.
    pub(super) channels: Vec<Option<usize>>,
}

impl Mapping {
    /// The network's class of each channel of mapped scores; `None` for channels of several classes.
    pub(super) fn only_classes(&self) -> Vec<Option<usize>> {
        let only = |channel| {
            let mut classes =
                (0..self.channels.len()).filter(|class| self.channels[*class] == Some(channel));
            classes.next().filter(|_| classes.next().is_none())
        };
        (0..self.ids.len()).map(only).collect()
    }

    /// Every class of the network is a label. Ids count from 1; the class by which the network names
    /// none of the others is 0.
    pub fn all(contract: &Contract) -> Self {
        let names = &contract.classes.names;
        let first = u16::from(contract.output.none != Some(0));
        let id = |index: usize| match contract.output.none {
            Some(none) if none == index => UNLABELLED_ID,
            _ => index as u16 + first,
        };
        let ids: Vec<u16> = (0..names.len()).map(id).collect();
        let named = ids.iter().copied().zip(names.iter().cloned());
        Self {
            classes: Classes::from_names(UNLABELLED_ID, named),
            keeps_occurring: true,
            channels: (0..names.len()).map(Some).collect(),
            ids,
        }
    }

    /// The user's classes. Names on the left are those of `scene`, the class table of the scene, where it has one.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for names that the network or the scene does not have, listing those that it has, and for a
    /// class of the network that is in two lists.
    pub fn of_user(contract: &Contract, user: &ClassFile, scene: &Classes) -> Result<Self> {
        let mut mapping = Self {
            classes: Classes {
                entries: Vec::new(),
                ignore: scene.ignore,
            },
            keeps_occurring: false,
            ids: Vec::new(),
            channels: vec![None; contract.classes.names.len()],
        };
        for (name, members) in &user.classes {
            let channel = mapping.ids.len();
            let id = if scene.is_empty() {
                channel as u16 + 1
            } else {
                scene_class(user, name, scene)?
            };
            ensure!(!mapping.ids.contains(&id),
                &user.file, "classes"; found "{name:?} twice"; expected "each class once"; help "join the two lists");
            mapping.ids.push(id);
            for member in members {
                let index = network_class(contract, user, name, member)?;
                if let Some(other) = mapping.channels[index].replace(channel) {
                    let other = user.classes.keys().nth(other).map_or("", String::as_str);
                    bail!(&user.file, "classes.{name}"; found "{member:?}, which {other} has too";
                        expected "each class of the network once"; help "remove it from one of them");
                }
            }
        }
        ensure!(mapping.channels.iter().any(Option::is_some), &user.file, "classes"; found "no class of the network";
            expected "one or more"; help "list names of the network's classes");
        mapping.classes = if scene.is_empty() {
            let ids = mapping.ids.iter().copied();
            Classes::from_names(UNLABELLED_ID, ids.zip(user.classes.keys().cloned()))
        } else {
            let mut classes = scene.clone();
            classes
                .entries
                .retain(|class| mapping.ids.contains(&class.id));
            classes
        };
        Ok(mapping)
    }

    /// All that labels follow from, as text.
    pub(super) fn text(&self) -> String {
        format!("{:?} {:?} {}", self.ids, self.channels, self.classes.ignore)
    }
}

/// The id of the class `name` of the scene.
fn scene_class(user: &ClassFile, name: &str, scene: &Classes) -> Result<u16> {
    scene.id_of(name).ok_or_else(|| {
        let names = scene.entries.iter().map(|class| class.name.as_str());
        invalid!(&user.file, "classes"; found "{name:?}";
            expected "on the left a class of the scene: {}", nearest_first(name, names).join(", ");
            help "correct the name, or add the class to classes.json")
    })
}

/// The index of the class `member` of the network.
fn network_class(contract: &Contract, user: &ClassFile, name: &str, member: &str) -> Result<usize> {
    let names = &contract.classes.names;
    let index = names.iter().position(|other| plain(other) == plain(member));
    index.ok_or_else(|| {
        let mut names = nearest_first(member, names.iter().map(String::as_str));
        let nearest = names.first().copied().unwrap_or_default();
        names.sort_unstable();
        invalid!(&user.file, "classes.{name}"; found "{member:?}"; expected "a class of the network, perhaps {nearest:?}";
            help "correct the name; the network has: {}", names.join("; "))
    })
}
