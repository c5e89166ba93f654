//! Tables of `femc bottlenecks`.

use super::bottlenecks::{FireflyRow, LampRow, Row};
use crate::attempts::{Cell, Column, Kind, Reader, column};

use Kind::{Count, Number, Share, Text};
use Reader::{Anybody, Programs};

fn word(text: Option<&'static str>) -> Cell {
    text.map(str::to_owned).into()
}

fn shares() -> Vec<Column<Row>> {
    vec![
        column("noise", "noise", Share, Anybody, |row| Cell::Real(row.noise)),
        column("light", "light", Share, Anybody, |row| Cell::Real(row.light)),
        column("work", "work", Share, Anybody, |row| Cell::Real(row.work)),
        column("deep", "deep", Share, Anybody, |row| Cell::Real(row.deep)),
        column("begun", "seen", Share, Anybody, |row| Cell::Real(row.begun)),
        column("depth", "depth", Number, Anybody, |row| row.depth.map_or(Cell::Gap, Cell::Real)),
        column("left", "left", Share, Anybody, |row| row.left.map_or(Cell::Gap, Cell::Real)),
        column("depth_of_others", "depth of others", Number, Programs, |row| Cell::Real(row.depth_of_others)),
        column("left_of_others", "left to others", Share, Programs, |row| Cell::Real(row.left_of_others)),
        column("records", "records", Count, Anybody, |row| Cell::Count(row.records)),
    ]
}

fn object() -> Column<Row> {
    column("object", "object", Text, Anybody, |row| row.object.clone().into())
}

fn material() -> Column<Row> {
    column("material", "material", Text, Anybody, |row| row.material.clone().into())
}

/// Returns the columns by object, material and interaction.
pub fn parts() -> Vec<Column<Row>> {
    let interaction = column("interaction", "interaction", Text, Anybody, |row: &Row| word(row.interaction));
    [vec![object(), material(), interaction], shares()].concat()
}

/// Returns the columns by object.
pub fn objects() -> Vec<Column<Row>> {
    [vec![object()], shares()].concat()
}

/// Returns the columns by material.
pub fn materials() -> Vec<Column<Row>> {
    [vec![material()], shares()].concat()
}

/// Returns the columns by lamp.
pub fn lamps() -> Vec<Column<LampRow>> {
    vec![
        column("lamp", "lamp", Text, Anybody, |row| row.lamp.clone().into()),
        column("noise", "noise", Share, Anybody, |row| Cell::Real(row.noise)),
        column("light", "light", Share, Anybody, |row| Cell::Real(row.light)),
        column("hidden", "hidden", Share, Anybody, |row| Cell::Real(row.hidden)),
        column("records", "records", Count, Anybody, |row| Cell::Count(row.records)),
    ]
}

/// Returns the columns of fireflies.
pub fn fireflies() -> Vec<Column<FireflyRow>> {
    vec![
        column("file", "file", Text, Programs, |row| Cell::Text(row.file.clone())),
        column("x", "x", Count, Anybody, |row| Cell::Count(row.x.into())),
        column("y", "y", Count, Anybody, |row| Cell::Count(row.y.into())),
        column("sample", "sample", Count, Anybody, |row| Cell::Count(row.sample.into())),
        column("luminance", "cd/m2", Number, Anybody, |row| Cell::Real(row.luminance)),
        column("others", "others", Number, Anybody, |row| Cell::Real(row.others)),
        column("noise", "noise", Share, Anybody, |row| Cell::Real(row.noise)),
        column("object", "object", Text, Anybody, |row| row.object.clone().into()),
        column("material", "material", Text, Anybody, |row| row.material.clone().into()),
        column("interaction", "interaction", Text, Anybody, |row| word(row.interaction)),
        column("lamp", "lamp", Text, Anybody, |row| row.lamp.clone().into()),
        column("found", "found by", Text, Programs, |row| Cell::Text(row.found.to_owned())),
    ]
}
