//! Rows of an answer: paths with their intersections and lights, as columns. An answer has all rows, or only those that the client
//! lacks.

use super::columns::{Columns, NO_RECORD};
use femc_model::Digest;
use femc_paths::attribute::{Attribute, INTERSECTION_ATTRIBUTES, LIGHT_ATTRIBUTES, PATH_ATTRIBUTES};
use femc_paths::histogram::Table;
use femc_paths::schema::{Scale, Value};
use femc_paths::{LightPath, RecordedPaths};
use femc_service::{EarlierRows, RowIdentity};
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

/// Path of an answer.
pub struct Row<'a> {
    /// The path.
    pub path: &'a LightPath,
    /// Index of its frame.
    pub frame: usize,
    /// Number among the recorded paths.
    pub number: Option<u32>,
    /// Weight in the representative set.
    pub weight: f64,
}

/// Values of the rows of an answer.
pub struct RowTable {
    paths: Vec<PathRow>,
    intersections: Vec<RecordValues<{ INTERSECTION_ATTRIBUTES.len() }>>,
    lights: Vec<RecordValues<{ LIGHT_ATTRIBUTES.len() }>>,
}

struct PathRow {
    values: [f32; PATH_ATTRIBUTES.len()],
    frame: u32,
    sample: u32,
    number: u32,
    weight: f32,
    /// Its rows of intersections.
    intersections: Range<usize>,
    /// Its rows of lights.
    lights: Range<usize>,
    /// Numbers of its first intersection and its first light among the recorded ones.
    first_numbers: [u32; 2],
}

/// Values of an intersection or a light.
struct RecordValues<const N: usize> {
    values: [f32; N],
    /// Index of the parent intersection in its path.
    parent: u32,
}

impl RowTable {
    /// Collects the values of rows.
    pub fn new(paths: &RecordedPaths, rows: &[Row<'_>]) -> Self {
        let source = ValueSource { paths };
        let mut all = Self { paths: Vec::with_capacity(rows.len()), intersections: Vec::new(), lights: Vec::new() };
        for row in rows {
            let Row { path, number, .. } = row;
            let first_rows = [all.intersections.len(), all.lights.len()];
            let intersections = path.intersections.iter().zip(source.rows(&INTERSECTION_ATTRIBUTES, row));
            all.intersections.extend(intersections.map(|(it, values)| {
                let parent = it.parent.checked_sub(1).unwrap_or(NO_RECORD);
                RecordValues { values, parent }
            }));
            let lights = path.lights.iter().zip(source.rows(&LIGHT_ATTRIBUTES, row));
            all.lights.extend(lights.map(|(it, values)| {
                let parent = path.parent(it).unwrap_or(NO_RECORD);
                RecordValues { values, parent }
            }));
            let first_numbers = |number| [paths.intersections_of(number).start, paths.lights_of(number).start];
            all.paths.push(PathRow {
                values: source.rows(&PATH_ATTRIBUTES, row).concat().try_into().expect("one row for each path"),
                frame: path.key.frame,
                sample: path.key.sample,
                number: number.unwrap_or(NO_RECORD),
                weight: row.weight as f32,
                intersections: first_rows[0]..all.intersections.len(),
                lights: first_rows[1]..all.lights.len(),
                first_numbers: number.map_or([NO_RECORD; 2], first_numbers),
            });
        }
        all
    }

    /// Returns the number of paths.
    pub fn len(&self) -> usize {
        self.paths.len()
    }

    /// Returns the identities of all rows.
    pub fn identities(&self) -> Arc<[RowIdentity]> {
        let mut bytes = Vec::new();
        let identity = |row: &PathRow| {
            bytes.clear();
            let counts = [row.intersections.len() as u32, row.lights.len() as u32];
            [row.frame, row.sample].into_iter().chain(counts).for_each(|it| bytes.extend(it.to_le_bytes()));
            row.values.iter().for_each(|it| bytes.extend(it.to_le_bytes()));
            self.intersections[row.intersections.clone()].iter().for_each(|it| it.write(&mut bytes));
            self.lights[row.lights.clone()].iter().for_each(|it| it.write(&mut bytes));
            let mut identity = RowIdentity::default();
            let length = identity.len();
            identity.copy_from_slice(&Digest::compute(&bytes).as_bytes()[..length]);
            identity
        };
        self.paths.iter().map(identity).collect()
    }

    /// Writes the columns of all rows.
    pub fn write(&self, columns: &mut Columns) {
        let all: Vec<&PathRow> = self.paths.iter().collect();
        self.write_values(columns, &all);
        self.write_numbers(columns);
        let numbers = |kind: usize, rows: fn(&PathRow) -> &Range<usize>| {
            all.iter().flat_map(move |row| {
                let first = row.first_numbers[kind];
                (0..rows(row).len() as u32).map(move |at| if first == NO_RECORD { NO_RECORD } else { first + at })
            })
        };
        columns.add_u32("intersections.number", numbers(0, |row| &row.intersections));
        columns.add_u32("lights.number", numbers(1, |row| &row.lights));
    }

    /// Writes the values of new rows, and for all rows what changes when data grow.
    /// - `kept`: for each row, its row in the earlier answer, or [`NO_RECORD`] for a new row.
    pub fn write_difference(&self, columns: &mut Columns, kept: &[u32]) {
        let new = self.paths.iter().zip(kept).filter(|(_, kept)| **kept == NO_RECORD);
        let new: Vec<&PathRow> = new.map(|(row, _)| row).collect();
        self.write_values(columns, &new);
        self.write_numbers(columns);
        columns.add_u32("paths.kept", kept.iter().copied());
        columns.add_u32("paths.first_intersection", self.paths.iter().map(|row| row.first_numbers[0]));
        columns.add_u32("paths.first_light", self.paths.iter().map(|row| row.first_numbers[1]));
    }

    /// Writes the numbers and weights of all paths.
    fn write_numbers(&self, columns: &mut Columns) {
        columns.add_u32("paths.number", self.paths.iter().map(|row| row.number));
        columns.add_f32("paths.weight", self.paths.iter().map(|row| row.weight));
    }

    /// Writes the values of some rows. Intersections and lights refer to these rows.
    fn write_values(&self, columns: &mut Columns, rows: &[&PathRow]) {
        for (axis, attribute) in PATH_ATTRIBUTES.iter().enumerate() {
            columns.add_f32(&column_name(Table::Paths, attribute.name), rows.iter().map(|row| row.values[axis]));
        }
        columns.add_u32("paths.frame", rows.iter().map(|row| row.frame));
        columns.add_u32("paths.sample", rows.iter().map(|row| row.sample));
        let intersections = || rows.iter().flat_map(|row| &self.intersections[row.intersections.clone()]);
        for (axis, attribute) in INTERSECTION_ATTRIBUTES.iter().enumerate() {
            let name = column_name(Table::Intersections, attribute.name);
            columns.add_f32(&name, intersections().map(|it| it.values[axis]));
        }
        let lights = || rows.iter().flat_map(|row| &self.lights[row.lights.clone()]);
        for (axis, attribute) in LIGHT_ATTRIBUTES.iter().enumerate() {
            columns.add_f32(&column_name(Table::Lights, attribute.name), lights().map(|it| it.values[axis]));
        }
        let owners = |records: fn(&PathRow) -> &Range<usize>| {
            (0u32..).zip(rows).flat_map(move |(at, row)| records(row).clone().map(move |_| at))
        };
        columns.add_u32("intersections.path", owners(|row| &row.intersections));
        columns.add_u32("lights.path", owners(|row| &row.lights));
        // First row of the intersections of each path.
        let firsts = rows.iter().scan(0, |next, row| {
            let first = *next;
            *next += row.intersections.len() as u32;
            Some((first, *row))
        });
        let parent = |first: u32, parent: u32| if parent == NO_RECORD { NO_RECORD } else { first + parent };
        let of_intersections = firsts.clone().flat_map(|(first, row)| {
            self.intersections[row.intersections.clone()].iter().map(move |it| parent(first, it.parent))
        });
        columns.add_u32("intersections.parent", of_intersections);
        let of_lights = firsts
            .flat_map(|(first, row)| self.lights[row.lights.clone()].iter().map(move |it| parent(first, it.parent)));
        columns.add_u32("lights.intersection", of_lights);
    }
}

impl<const N: usize> RecordValues<N> {
    fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend(self.parent.to_le_bytes());
        self.values.iter().for_each(|it| bytes.extend(it.to_le_bytes()));
    }
}

/// Smallest share of kept rows for which an answer refers to an earlier one. With fewer, it would save nothing.
const MIN_KEPT_SHARE: f64 = 0.1;

/// Finds rows in an earlier answer. Returns the earlier row of each row, or [`NO_RECORD`]; `None` if too few are found.
pub fn kept_rows(rows: &[RowIdentity], earlier: &EarlierRows) -> Option<Vec<u32>> {
    let known: HashMap<&RowIdentity, u32> = earlier.identities.iter().zip(0u32..).collect();
    let kept: Vec<u32> = rows.iter().map(|row| known.get(row).copied().unwrap_or(NO_RECORD)).collect();
    let count = kept.iter().filter(|row| **row != NO_RECORD).count();
    (count > 0 && count as f64 >= MIN_KEPT_SHARE * rows.len() as f64).then_some(kept)
}

/// Conversion of records to the values of columns.
struct ValueSource<'a> {
    paths: &'a RecordedPaths,
}

impl ValueSource<'_> {
    /// Returns the value of an attribute. Missing positions are not a number, other missing values are 0, and words count from 1.
    fn column_value(&self, attribute: &Attribute, value: Option<Value>) -> f32 {
        match value {
            Some(Value::Number(number)) => number as f32,
            Some(Value::Word(index)) => f32::from(index + 1),
            Some(Value::Name(name)) => self.paths.names().number(name) as f32,
            None if matches!(attribute.scale, Scale::World(_)) => f32::NAN,
            None => 0.0,
        }
    }

    /// Returns the values of all records of a path, one row per record, in the order of the schema.
    fn rows<const N: usize>(&self, attributes: &[Attribute; N], row: &Row<'_>) -> Vec<[f32; N]> {
        let scope = &self.paths.frames()[row.frame].scope;
        let mut columns = attributes.each_ref().map(|it| (it, it.values(scope, row.path)));
        let mut next = || {
            let mut values = [0.0; N];
            for (value, (attribute, column)) in values.iter_mut().zip(&mut columns) {
                *value = self.column_value(attribute, column.next()?);
            }
            Some(values)
        };
        std::iter::from_fn(&mut next).collect()
    }
}

fn column_name(table: Table, attribute: &str) -> String {
    format!("{}.{attribute}", table.name())
}
