//! Rows as JSON.

use serde::ser::{Serialize, SerializeMap, SerializeSeq, Serializer};

use super::column::{Cell, Column};
use super::row::Row;

/// Array with one object per row. Its keys are in the order of the columns.
pub struct RowsAsJson<'a, R = Row>(pub &'a [Column<R>], pub &'a [R]);

impl<R> Serialize for RowsAsJson<'_, R> {
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
            match (column.value)(self.1) {
                Cell::Text(text) => object.serialize_entry(column.name, &text)?,
                Cell::Count(count) => object.serialize_entry(column.name, &count)?,
                Cell::Real(real) => object.serialize_entry(column.name, &real)?,
                Cell::Empty => object.serialize_entry(column.name, &())?,
            }
        }
        object.end()
    }
}
