//! Named contexts: MGF's rule `id = template`, shared by all kinds of contexts.

use super::{
    args::{Args, Result},
    recovery::Errors,
};
use crate::{EntityKind, ImportFault};
use std::collections::{HashMap, HashSet};

/// Effect of one context line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ContextChange {
    /// The unnamed context was reset and selected.
    Unnamed,
    /// An existing context was selected unchanged.
    Selected,
    /// A context was set to the default or to a template.
    New,
}

/// The contexts of one kind. Slot 0 is the unnamed context.
pub(super) struct ContextTable<T> {
    kind: EntityKind,
    default: T,
    slots: Vec<T>,
    names: HashMap<String, u32>,
    /// Slots whose definition failed.
    faulty: HashSet<u32>,
    current: u32,
}

impl<T: Clone> ContextTable<T> {
    pub fn new(kind: EntityKind, default: T) -> Self {
        Self { kind, slots: vec![default.clone()], default, names: HashMap::new(), faulty: HashSet::new(), current: 0 }
    }

    /// Handles `[id [= [template]]]`.
    pub fn select(&mut self, args: &Args<'_>, errors: &mut Errors) -> Result<ContextChange> {
        args.check_count(..=3, "[NAME [= [TEMPLATE]]]")?;
        if args.len() == 0 {
            self.slots[0] = self.default.clone();
            self.faulty.remove(&0);
            self.current = 0;
            return Ok(ContextChange::Unnamed);
        }
        if args.len() == 1 {
            self.current = self.index(args, 0, errors)?;
            return Ok(ContextChange::Selected);
        }
        if args.raw(1) != b"=" {
            return Err(args.fault_at(1, ImportFault::Unexpected { found: args.text(1).into_owned(), expected: "`=`" }));
        }
        let (value, faulty) = match args.len() {
            2 => (self.default.clone(), false),
            _ => {
                let template = self.index(args, 2, errors)?;
                (self.slots[template as usize].clone(), self.faulty.contains(&template))
            }
        };
        self.current = self.set_slot(&args.text(0), value);
        if faulty {
            self.faulty.insert(self.current);
        } else {
            self.faulty.remove(&self.current);
        }
        Ok(ContextChange::New)
    }

    /// Sets the slot of `name` to a value; creates the slot if it is missing.
    fn set_slot(&mut self, name: &str, value: T) -> u32 {
        if let Some(&index) = self.names.get(name) {
            self.slots[index as usize] = value;
            return index;
        }
        let index = self.slots.len() as u32;
        self.slots.push(value);
        self.names.insert(name.to_owned(), index);
        index
    }

    /// Returns the slot that argument `i` names. An undefined name is reported and defined as faulty.
    pub fn index(&mut self, args: &Args<'_>, i: usize, errors: &mut Errors) -> Result<u32> {
        let name = args.text(i);
        if let Some(&index) = self.names.get(&*name) {
            if self.faulty.contains(&index) {
                errors.taint();
            }
            return Ok(index);
        }
        errors.report_undefined((args.argument_at(i), self.kind, &name), || {
            let sound = self.names.iter().filter(|(_, slot)| !self.faulty.contains(slot));
            nearest(&name, sound.map(|(name, _)| name))
        })?;
        let index = self.set_slot(&name, self.default.clone());
        self.faulty.insert(index);
        Ok(index)
    }

    /// Defines a context whose definition failed, and selects it.
    pub fn define_faulty(&mut self, name: Option<&str>) {
        self.current = match name {
            Some(name) => self.set_slot(name, self.default.clone()),
            None => {
                self.slots.push(self.default.clone());
                self.slots.len() as u32 - 1
            }
        };
        self.mark_faulty();
    }

    /// Marks the current context as faulty.
    pub fn mark_faulty(&mut self) {
        self.faulty.insert(self.current);
    }

    /// Returns whether the current context is faulty.
    pub fn is_faulty(&self) -> bool {
        self.faulty.contains(&self.current)
    }

    /// Returns whether the current context is named.
    pub fn is_named(&self) -> bool {
        self.current != 0
    }

    pub fn current(&self) -> &T {
        &self.slots[self.current as usize]
    }

    pub fn current_mut(&mut self) -> &mut T {
        &mut self.slots[self.current as usize]
    }

    pub fn get_mut(&mut self, index: u32) -> &mut T {
        &mut self.slots[index as usize]
    }

    pub fn get(&self, index: u32) -> &T {
        &self.slots[index as usize]
    }

    /// Iterates over the named contexts in order of first definition.
    pub fn named_contexts(&self) -> impl Iterator<Item = &T> {
        self.slots.iter().skip(1)
    }

    /// Iterates over the named contexts whose definition did not fail.
    pub fn valid_contexts(&self) -> impl Iterator<Item = &T> {
        let named = self.slots.iter().enumerate().skip(1);
        named.filter(|(i, _)| !self.faulty.contains(&(*i as u32))).map(|(_, value)| value)
    }

    pub fn slot_of(&self, name: &str) -> Option<u32> {
        self.names.get(name).copied()
    }
}

/// Returns up to three of `names` with the least edit distance to `name`, nearest first; ties are in alphabetical order.
pub(super) fn nearest<'n>(name: &str, names: impl Iterator<Item = &'n String>) -> Vec<String> {
    let mut ranked: Vec<(usize, &String)> = Vec::new();
    for other in names {
        ranked.push((distance(name, other), other));
        if ranked.len() > 64 {
            ranked.sort();
            ranked.truncate(3);
        }
    }
    ranked.sort();
    ranked.truncate(3);
    ranked.into_iter().map(|(_, name)| name.clone()).collect()
}

/// Returns the Levenshtein distance of the first 48 bytes.
fn distance(a: &str, b: &str) -> usize {
    let (a, b) = (&a.as_bytes()[..a.len().min(48)], &b.as_bytes()[..b.len().min(48)]);
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_names_come_nearest_first_and_at_most_three() {
        let names: Vec<String> = ["v1", "v10", "vv2", "wheel", "vv"].map(String::from).to_vec();
        assert_eq!(nearest("vv1", names.iter()), ["v1", "vv", "vv2"]);
        assert!(nearest("x", [].iter()).is_empty());
    }

    #[test]
    fn the_distance_is_the_number_of_edits() {
        assert_eq!(distance("kitten", "sitting"), 3);
        assert_eq!(distance("", "abc"), 3);
        assert_eq!(distance("same", "same"), 0);
    }
}
