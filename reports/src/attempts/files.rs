//! Formats rows as text: as CSV, and as a table for people.

use crate::human;
use femc_service::attempts::{Audience, Cell, Column, Kind};
use std::borrow::Cow;

/// Formats rows as CSV with a header line. A gap becomes an empty field.
pub fn csv<R>(columns: &[Column<R>], rows: &[R]) -> String {
    let names: Vec<Cow<'_, str>> = columns.iter().map(|column| column.name.into()).collect();
    let mut text = names.join(",");
    for row in rows {
        text.push('\n');
        for (place, column) in columns.iter().enumerate() {
            if place > 0 {
                text.push(',');
            }
            match (column.value)(row) {
                Cell::Text(field) => text.push_str(&quoted(&field)),
                Cell::Count(count) => text.push_str(&count.to_string()),
                Cell::Real(real) => text.push_str(&real.to_string()),
                Cell::Empty => {}
            }
        }
    }
    text
}

/// Quotes a field if needed (RFC 4180).
fn quoted(field: &str) -> Cow<'_, str> {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\"")).into()
    } else {
        field.into()
    }
}

/// Formats rows for people: returns the columns' titles, and the text of each row's cells.
pub fn visible_cells<R>(columns: &[Column<R>], rows: &[R]) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let shown: Vec<&Column<R>> = columns.iter().filter(|column| is_visible(column, rows)).collect();
    let cells = |row: &R| shown.iter().map(|column| cell(column.kind, &(column.value)(row))).collect();
    (shown.iter().map(|column| column.title).collect(), rows.iter().map(cells).collect())
}

fn is_visible<R>(column: &Column<R>, rows: &[R]) -> bool {
    match column.audience {
        Audience::Everyone => true,
        Audience::Programs => false,
        Audience::Comparing => rows.windows(2).any(|pair| (column.value)(&pair[0]) != (column.value)(&pair[1])),
    }
}

/// Formats rows as a table for people.
pub fn text_table<R>(columns: &[Column<R>], rows: &[R]) -> String {
    let (titles, cells) = visible_cells(columns, rows);
    human::table(&titles, &cells)
}

fn cell(kind: Kind, cell: &Cell) -> String {
    match (kind, cell) {
        (_, Cell::Empty) => "-".to_owned(),
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
