//! Class tables: `classes.json` in and out, and the colours of legends.

use crate::data::class_color;
use crate::error::{Result, bail, ensure, invalid};
use crate::files::{self, atomic};
use serde::{Deserialize, Deserializer, Serialize, de};
use serde_json::Value;
use std::collections::HashSet;
use std::path::Path;

/// The id that `classes.json` maps to a name that [`is_void`].
const VOID: u16 = 0;
/// Names of id 0 that mean 'unlabelled', separated by blanks.
const VOID_NAMES: &str = "void ignore ignored unlabelled unlabeled unknown undefined";

/// One class of a scene.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Class {
    /// Id in the label maps.
    pub id: u16,
    /// Name for people.
    pub name: String,
    /// Colour in legends and pictures, 8-bit sRGB.
    pub color: [u8; 3],
    /// What it is, where the entry is an object that association found and its segments have classes.
    pub object_of: Option<ObjectOf>,
}

/// What an object is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub struct ObjectOf {
    /// Id in the class table of the scene's true labels.
    pub class: u16,
    /// Whether it is one of several things, and not all stuff of its class.
    pub thing: bool,
}

/// The class table: id, name, colour, and the id that means 'unlabelled'.
///
/// *Class indices* (0..len, the channels of logits) are positions in [`Classes::entries`]; *ids* are what files hold.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Classes {
    /// All classes but the ignored one, ascending by id.
    pub entries: Vec<Class>,
    /// The id of unlabelled pixels: never counted, never trained on.
    pub ignore: u16,
}

impl Classes {
    /// The name of the file with the table of a folder.
    pub(crate) const FILE: &str = "classes.json";

    /// Number of classes, the ignored one not counted.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether the table is empty.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Class index of an id; `None` for the ignored id and for ids not in the table.
    pub fn index(&self, id: u16) -> Option<usize> {
        self.entries.binary_search_by_key(&id, |c| c.id).ok()
    }

    /// Table from id to class index, `u16::MAX` where there is none; length 65536.
    pub fn lookup(&self) -> Vec<u16> {
        let mut table = vec![u16::MAX; 1 << 16];
        for (i, c) in self.entries.iter().enumerate() {
            table[c.id as usize] = i as u16;
        }
        table
    }

    /// A table of classes with colours from [`class_color`], ascending by id. Entries with the ignored id and repeated
    /// ids (after the first) are left out.
    pub fn from_names<S: Into<String>>(
        ignore: u16,
        names: impl IntoIterator<Item = (u16, S)>,
    ) -> Self {
        let mut entries: Vec<Class> = names
            .into_iter()
            .filter(|(id, _)| *id != ignore)
            .map(|(id, name)| Class::new(id, name.into()))
            .collect();
        entries.sort_by_key(|c| c.id);
        entries.dedup_by_key(|c| c.id);
        Self { entries, ignore }
    }

    /// Colour of a label id, 8-bit sRGB; black for the ignored one and for ids not in the table.
    pub fn color(&self, id: u16) -> [u8; 3] {
        self.index(id).map_or([0; 3], |i| self.entries[i].color)
    }

    /// Colour of a label id, 8-bit sRGB: [`Classes::color`], or [`class_color`] where no class is known.
    pub fn legend_color(&self, id: u16) -> [u8; 3] {
        if self.is_empty() {
            class_color(id)
        } else {
            self.color(id)
        }
    }

    /// Name of a label id: that of its class, or `void` for the ignored id. `None` for ids that are not in the table.
    pub fn known_name(&self, id: u16) -> Option<&str> {
        let known = self.index(id).is_some() || (id == self.ignore && !self.is_empty());
        known.then(|| self.name(id))
    }

    /// Name of a label id; `void` for the ignored one and for ids not in the table.
    pub fn name(&self, id: u16) -> &str {
        self.index(id).map_or("void", |i| &self.entries[i].name)
    }

    /// Whether both tables have the same ids with the same names.
    pub fn has_names_of(&self, other: &Self) -> bool {
        let mut pairs = self.entries.iter().zip(&other.entries);
        self.len() == other.len() && pairs.all(|(a, b)| a.id == b.id && a.name == b.name)
    }

    /// Adds the classes of `other`, in place of those with the same id. Unlabelled is what it is there.
    pub fn put(&mut self, other: &Self) {
        self.ignore = other.ignore;
        self.entries.retain(|class| other.index(class.id).is_none());
        self.entries.extend(other.entries.iter().cloned());
        self.entries.sort_by_key(|class| class.id);
    }

    /// The labels of `count` unlabelled Gaussians.
    pub fn unlabelled(&self, count: usize) -> Vec<u16> {
        vec![self.ignore; count]
    }

    /// The id of the class that is called `name`, apart from case, blanks at the ends, and `-` or `_` for blanks.
    pub(crate) fn id_of(&self, name: &str) -> Option<u16> {
        let wanted = plain(name);
        let class = self.entries.iter().find(|c| plain(&c.name) == wanted);
        class.map(|class| class.id)
    }

    /// The entry of `id`. A missing one is added as `label ID`.
    pub(crate) fn entry(&mut self, id: u16) -> &mut Class {
        let i = self.entries.partition_point(|c| c.id < id);
        if self.entries.get(i).is_none_or(|c| c.id != id) {
            self.entries
                .insert(i, Class::new(id, format!("label {id}")));
        }
        &mut self.entries[i]
    }

    /// Reads `classes.json`, in either form:
    /// `{"0": "void", "1": "wall", ...}`, where id 0 must be absent or mean 'unlabelled' and is ignored;
    /// `{"ignore": 0, "classes": [{"id": 1, "name": "wall", "color": [r, g, b]}, ...]}` as [`Classes::write`] makes it
    /// (`color` may be absent; objects have `class` and `thing` besides, see [`ObjectOf`]).
    ///
    /// # Errors
    /// [`crate::Error::Io`]; [`crate::Error::Input`] naming line or id: malformed JSON, ids that are not u16 or appear twice, names with
    /// control characters.
    pub fn read(path: &Path) -> Result<Self> {
        let text = files::text(path)?;
        let expected = "{\"0\": \"void\", \"1\": \"NAME\", ..} or {\"ignore\": 0, \"classes\": [{\"id\": 1, \"name\": ..}, ..]}";
        let malformed = |e: serde_json::Error| files::json_error(path, &e, expected);
        let Pairs(pairs) = serde_json::from_str(&text).map_err(malformed)?;
        if pairs.iter().any(|(key, _)| key == "classes") {
            let file: ClassFile = serde_json::from_str(&text).map_err(malformed)?;
            return file.into_classes(path);
        }
        let mut named = Vec::with_capacity(pairs.len());
        for (key, value) in pairs {
            let id: u16 = key.parse().map_err(|_| {
                invalid!(path, "id"; found "{key:?}"; expected "a whole number from 0 to 65535";
                    help "renumber the classes")
            })?;
            let Value::String(name) = value else {
                bail!(path, "id {id}"; found "{value}"; expected "a name"; help "put it in quotes");
            };
            if id == VOID && !is_void(&name) {
                bail!(path, "id 0"; found "{name:?}";
                    expected "\"void\": id 0 is the ignored one in this form of the file";
                    help "use the form with \"ignore\" and \"classes\", or add one to all ids");
            }
            named.push((id, name));
        }
        check(path, &named)?;
        Ok(Self::from_names(VOID, named))
    }

    /// Writes `{"ignore": .., "classes": [{"id", "name", "color"}, ..]}`, of objects `class` and `thing` too.
    ///
    /// # Errors
    /// [`crate::Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        atomic::write_bytes(path, self.text().as_bytes())
    }

    /// The ids that [`Classes::text_with_unseen`] was given for the file; none in other files.
    ///
    /// # Errors
    /// As [`Classes::read`].
    pub(crate) fn read_unseen(path: &Path) -> Result<Vec<u16>> {
        let expected = "{\"unseen\": [ID, ..], ..}";
        files::json::<Unseen>(path, expected).map(|file| file.unseen)
    }

    /// The content of the file that [`Classes::write`] writes.
    pub(crate) fn text(&self) -> String {
        self.text_with_unseen(&[])
    }

    /// [`Classes::text`] with the ids of classes that scores name but no label map.
    pub(crate) fn text_with_unseen(&self, unseen: &[u16]) -> String {
        let file = ClassFile {
            ignore: self.ignore,
            classes: self.entries.iter().map(ClassEntry::from).collect(),
            unseen: unseen.to_vec(),
        };
        // Plain data always has a JSON form.
        serde_json::to_string_pretty(&file).unwrap_or_default()
    }
}

impl Class {
    /// With the colour of its id.
    fn new(id: u16, name: String) -> Self {
        Self {
            id,
            name,
            color: class_color(id),
            object_of: None,
        }
    }

    /// The name without the number of a thing: `chair` for `chair 2`.
    pub fn base_name(&self) -> &str {
        let is_thing = self.object_of.is_some_and(|of| of.thing);
        match self.name.rsplit_once(' ') {
            Some((base, number)) if is_thing && number.parse::<u32>().is_ok() => base,
            _ => &self.name,
        }
    }
}

/// A name of a class as it is compared.
pub(crate) fn plain(name: &str) -> String {
    name.trim().to_lowercase().replace(['-', '_'], " ")
}

/// Whether a name means 'unlabelled'.
pub(crate) fn is_void(name: &str) -> bool {
    let name = name.trim().to_lowercase();
    VOID_NAMES.split(' ').any(|void| void == name)
}

/// Refuses ids that appear twice, and names with line ends or other control characters.
fn check(path: &Path, named: &[(u16, String)]) -> Result<()> {
    let mut first = HashSet::new();
    for (id, name) in named {
        ensure!(first.insert(id), path, "id {id}"; found "two entries"; expected "one entry for each id";
            help "give each class an id of its own");
        ensure!(!name.chars().any(char::is_control), path, "id {id}"; found "{name:?}";
            expected "a name without control characters"; help "rename the class");
    }
    Ok(())
}

/// The file's second form.
#[derive(Serialize, Deserialize)]
struct ClassFile {
    ignore: u16,
    classes: Vec<ClassEntry>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    unseen: Vec<u16>,
}

/// A part of the file's second form.
#[derive(Deserialize)]
struct Unseen {
    #[serde(default)]
    unseen: Vec<u16>,
}

#[derive(Serialize, Deserialize)]
struct ClassEntry {
    id: u16,
    name: String,
    color: Option<[u8; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    class: Option<u16>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    thing: Option<bool>,
}

impl From<&Class> for ClassEntry {
    fn from(c: &Class) -> Self {
        let (class, thing) = c.object_of.map(|of| (of.class, of.thing)).unzip();
        Self {
            id: c.id,
            name: c.name.clone(),
            color: Some(c.color),
            class,
            thing,
        }
    }
}

impl ClassFile {
    fn into_classes(self, path: &Path) -> Result<Classes> {
        let names = self.classes.iter().map(|c| (c.id, c.name.clone()));
        let names: Vec<(u16, String)> = names.collect();
        check(path, &names)?;
        let mut classes = Classes::from_names(self.ignore, names);
        for entry in self.classes {
            if let Some(i) = classes.index(entry.id) {
                let class = &mut classes.entries[i];
                class.color = entry.color.unwrap_or(class.color);
                let thing = entry.thing.unwrap_or(true);
                class.object_of = entry.class.map(|class| ObjectOf { class, thing });
            }
        }
        Ok(classes)
    }
}

/// The entries of a JSON object in order, with repeated keys.
struct Pairs(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Pairs {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = Pairs;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a JSON object")
            }
            fn visit_map<A: de::MapAccess<'de>>(self, mut map: A) -> Result<Pairs, A::Error> {
                let mut pairs = Vec::new();
                while let Some(pair) = map.next_entry()? {
                    pairs.push(pair);
                }
                Ok(Pairs(pairs))
            }
        }
        deserializer.deserialize_map(Visitor)
    }
}
