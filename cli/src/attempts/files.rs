//! Rows as text: JSON, CSV, and a table for people.

use super::column::{Cell, Column, Kind, Reader};
use super::row::Row;
use crate::output::human;
use serde::ser::{Serialize, SerializeMap, SerializeSeq, Serializer};
use std::borrow::Cow;

/// An array of an object a row, its keys in the order of the columns.
pub struct Json<'a, R = Row>(pub &'a [Column<R>], pub &'a [R]);

impl<R> Serialize for Json<'_, R> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut rows = serializer.serialize_seq(Some(self.1.len()))?;
        for row in self.1 {
            rows.serialize_element(&Object(self.0, row))?;
        }
        rows.end()
    }
}

struct Object<'a, R>(&'a [Column<R>], &'a R);

impl<R> Serialize for Object<'_, R> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut object = serializer.serialize_map(Some(self.0.len()))?;
        for column in self.0 {
            match (column.of)(self.1) {
                Cell::Text(text) => object.serialize_entry(column.name, &text)?,
                Cell::Count(count) => object.serialize_entry(column.name, &count)?,
                Cell::Real(real) => object.serialize_entry(column.name, &real)?,
                Cell::Gap => object.serialize_entry(column.name, &())?,
            }
        }
        object.end()
    }
}

/// Lines of fields with commas between, the names first; a gap is an empty field.
pub fn csv<R>(columns: &[Column<R>], rows: &[R]) -> String {
    let names: Vec<Cow<'_, str>> = columns.iter().map(|column| column.name.into()).collect();
    let mut text = names.join(",");
    for row in rows {
        text.push('\n');
        for (place, column) in columns.iter().enumerate() {
            if place > 0 {
                text.push(',');
            }
            match (column.of)(row) {
                Cell::Text(field) => text.push_str(&quoted(&field)),
                Cell::Count(count) => text.push_str(&count.to_string()),
                Cell::Real(real) => text.push_str(&real.to_string()),
                Cell::Gap => {}
            }
        }
    }
    text
}

/// A field in quotes where it needs them (RFC 4180).
fn quoted(field: &str) -> Cow<'_, str> {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\"")).into()
    } else {
        field.into()
    }
}

/// What people read of it: the columns' titles, and each row's cells in words.
pub fn shown<R>(columns: &[Column<R>], rows: &[R]) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let shown: Vec<&Column<R>> = columns.iter().filter(|column| is_shown(column, rows)).collect();
    let cells = |row: &R| shown.iter().map(|column| cell(column.kind, &(column.of)(row))).collect();
    (shown.iter().map(|column| column.title).collect(), rows.iter().map(cells).collect())
}

fn is_shown<R>(column: &Column<R>, rows: &[R]) -> bool {
    match column.reader {
        Reader::Anybody => true,
        Reader::Programs => false,
        Reader::WhoCompares => rows.windows(2).any(|pair| (column.of)(&pair[0]) != (column.of)(&pair[1])),
    }
}

/// A table.
pub fn human<R>(columns: &[Column<R>], rows: &[R]) -> String {
    let (titles, cells) = shown(columns, rows);
    human::table(&titles, &cells)
}

fn cell(kind: Kind, cell: &Cell) -> String {
    match (kind, cell) {
        (_, Cell::Gap) => "-".to_owned(),
        (_, Cell::Text(text)) => text.clone(),
        (Kind::Bytes, Cell::Count(bytes)) => human::bytes(*bytes),
        (_, Cell::Count(count)) => human::quantity(*count as f64),
        (Kind::Share, Cell::Real(share)) => human::percent(*share),
        (Kind::Number, Cell::Real(real)) => human::number(*real),
        (_, Cell::Real(seconds)) => human::seconds(*seconds),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_that_could_be_taken_for_two_is_in_quotes() {
        assert_eq!([quoted("lab 1"), quoted("a,b"), quoted("a \"b\"")], ["lab 1", "\"a,b\"", "\"a \"\"b\"\"\""]);
    }
}
