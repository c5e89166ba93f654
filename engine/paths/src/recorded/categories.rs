//! Categories of names: the most frequent names of an attribute have a bin of their own.

use crate::attribute::{Attribute, Table};
use crate::record::{LightPath, Name, NameEntry, NameMap, Names};
use crate::schema::{FINE_BINS, Scale, Value};
use crate::statistics::Scope;

/// Maximum number of categories of an attribute.
pub const MAX_CATEGORIES: usize = FINE_BINS - 2;
/// Bin of all names that are not categories.
pub const OTHERS_BIN: u8 = FINE_BINS as u8 - 1;

/// Names in the records of frames, numbered from 1 in order of kind and text. Number 0 stands for a missing name.
#[derive(Clone, Debug, Default)]
pub struct NameTable {
    entries: Vec<NameEntry>,
    numbers: NameMap<u32>,
    keys: Vec<Name>,
}

impl NameTable {
    /// Collects the names of frames.
    pub fn new<'a>(frames: impl IntoIterator<Item = &'a Names>) -> Self {
        let mut all: Vec<(&NameEntry, Name)> =
            frames.into_iter().flatten().map(|(name, entry)| (entry, *name)).collect();
        all.sort_unstable();
        all.dedup();
        let keys: Vec<Name> = all.iter().map(|(_, name)| *name).collect();
        let numbers = keys.iter().copied().zip(1..).collect();
        Self { entries: all.into_iter().map(|(entry, _)| entry.clone()).collect(), numbers, keys }
    }

    /// Returns kinds and texts in order. Number k has index k - 1.
    pub fn entries(&self) -> &[NameEntry] {
        &self.entries
    }

    /// Returns the keys of the names in order.
    pub(super) fn keys(&self) -> &[Name] {
        &self.keys
    }

    /// Returns the number of a name; 0: no name, or unknown.
    pub fn number(&self, name: Name) -> u32 {
        self.numbers.get(&name).copied().unwrap_or(0)
    }
}

/// Categories of an attribute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Categories {
    /// Table of the attribute.
    pub table: Table,
    /// Index of the attribute in its table.
    pub attribute: usize,
    /// Indices of the most frequent names, by falling number of records. Category k is in bin k + 1.
    pub names: Vec<u32>,
    /// Numbers of records, by number of the name.
    pub(super) counts: Vec<u64>,
    /// Bins by number of the name.
    bins: Vec<u8>,
}

impl Categories {
    /// Returns the bin of a name.
    /// - `number`: its number in the [`NameTable`].
    pub fn bin(&self, number: u32) -> u8 {
        self.bins.get(number as usize).copied().unwrap_or(OTHERS_BIN)
    }
}

/// Returns the tables, indices and descriptors of the attributes that are names.
pub(super) fn name_axes() -> impl Iterator<Item = (Table, usize, &'static Attribute)> {
    Table::ALL.into_iter().flat_map(|table| {
        let attributes = table.attributes().iter().enumerate();
        attributes.filter(|(_, it)| it.scale == Scale::Name).map(move |(index, it)| (table, index, it))
    })
}

/// Returns the names of an attribute for the records of a path, in order; [`Name::NONE`] where there is none.
pub(super) fn names_in(attribute: &Attribute, path: &LightPath) -> Vec<Name> {
    // No name depends on the frame.
    let scope = Scope::default();
    let values = attribute.values(&scope, path);
    values.map(|value| if let Some(Value::Name(name)) = value { name } else { Name::NONE }).collect()
}

/// Chooses the categories of each attribute that is a name. Names with equal numbers of records are in order of the table.
pub(super) fn choose_categories(names: &NameTable, paths: &[LightPath]) -> Vec<Categories> {
    let choose = |(table, attribute, descriptor): (Table, usize, &Attribute)| {
        let mut counts = vec![0u64; names.entries.len() + 1];
        for name in paths.iter().flat_map(|path| names_in(descriptor, path)) {
            counts[names.number(name) as usize] += 1;
        }
        let mut ranked: Vec<u32> = (1..counts.len() as u32).filter(|number| counts[*number as usize] > 0).collect();
        ranked.sort_by_key(|number| std::cmp::Reverse(counts[*number as usize]));
        ranked.truncate(MAX_CATEGORIES);
        let mut bins = vec![OTHERS_BIN; counts.len()];
        bins[0] = 0;
        (1u8..).zip(&ranked).for_each(|(bin, number)| bins[*number as usize] = bin);
        Categories { table, attribute, names: ranked.into_iter().map(|number| number - 1).collect(), counts, bins }
    };
    name_axes().map(choose).collect()
}
