//! Named contexts: the `id = template` rule of MGF, the same for all kinds.

use super::args::{Args, Result};
use crate::{Fault, Kind};
use std::collections::HashMap;

/// What one context line did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Opened {
    /// The unnamed context, reset.
    Unnamed,
    /// A context chosen again, as it was.
    Again,
    /// A context set to the default or to a template.
    New,
}

/// The contexts of one kind. Slot 0 is the unnamed one.
pub(super) struct Table<T> {
    kind: Kind,
    default: T,
    slots: Vec<T>,
    names: HashMap<String, u32>,
    current: u32,
}

impl<T: Clone> Table<T> {
    pub fn new(kind: Kind, default: T) -> Self {
        Self { kind, slots: vec![default.clone()], default, names: HashMap::new(), current: 0 }
    }

    /// Handles `[id [= [template]]]`.
    pub fn select(&mut self, args: &Args<'_>) -> Result<Opened> {
        args.count(..=3, "[NAME [= [TEMPLATE]]]")?;
        if args.len() == 0 {
            self.slots[0] = self.default.clone();
            self.current = 0;
            return Ok(Opened::Unnamed);
        }
        if args.len() == 1 {
            self.current = self.index(args, 0)?;
            return Ok(Opened::Again);
        }
        if args.raw(1) != b"=" {
            return Err(args.fault_at(1, Fault::Unexpected { found: args.text(1).into_owned(), expected: "`=`" }));
        }
        let value = match args.len() {
            2 => self.default.clone(),
            _ => self.slots[self.index(args, 2)? as usize].clone(),
        };
        let name = args.text(0);
        self.current = match self.names.get(&*name) {
            Some(&index) => {
                self.slots[index as usize] = value;
                index
            }
            None => {
                let index = self.slots.len() as u32;
                self.slots.push(value);
                self.names.insert(name.into_owned(), index);
                index
            }
        };
        Ok(Opened::New)
    }

    /// The slot that argument `i` names.
    pub fn index(&self, args: &Args<'_>, i: usize) -> Result<u32> {
        let name = args.text(i);
        self.names.get(&*name).copied().ok_or_else(|| {
            let nearest = nearest(&name, self.names.keys());
            args.fault_at(i, Fault::Undefined { kind: self.kind, name: name.into_owned(), nearest })
        })
    }

    /// Whether a named context is current.
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

    /// The named contexts in order of first definition.
    pub fn named(&self) -> impl Iterator<Item = &T> {
        self.slots.iter().skip(1)
    }

    pub fn defined(&self, name: &str) -> Option<u32> {
        self.names.get(name).copied()
    }
}

/// Up to three of `names` that are near to `name` by edit distance, nearest first, ties in alphabetical order.
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

/// Levenshtein distance of the first 48 bytes.
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
