//! Tables of `femc bottlenecks`.

use super::bottlenecks::{FireflyRow, LampRow, PartRow};
use crate::attempts::{Audience, Cell, Column, Kind, column};

use Audience::{Everyone, Programs};
use Kind::{Count, Number, Share, Text};

fn word(text: Option<&'static str>) -> Cell {
    text.map(str::to_owned).into()
}

fn shares() -> Vec<Column<PartRow>> {
    vec![
        column("noise", "noise", Share, Everyone, |row| Cell::Real(row.noise)),
        column("light", "light", Share, Everyone, |row| Cell::Real(row.light)),
        column("work", "work", Share, Everyone, |row| Cell::Real(row.work)),
        column("deep", "deep", Share, Everyone, |row| Cell::Real(row.deep)),
        column("begun", "seen", Share, Everyone, |row| Cell::Real(row.begun)),
        column("depth", "depth", Number, Everyone, |row| row.depth.map_or(Cell::Empty, Cell::Real)),
        column("left", "left", Share, Everyone, |row| row.left.map_or(Cell::Empty, Cell::Real)),
        column("depth_of_others", "depth of others", Number, Programs, |row| Cell::Real(row.depth_of_others)),
        column("left_of_others", "left to others", Share, Programs, |row| Cell::Real(row.left_of_others)),
        column("records", "records", Count, Everyone, |row| Cell::Count(row.records)),
    ]
}

fn object() -> Column<PartRow> {
    column("object", "object", Text, Everyone, |row| row.object.clone().into())
}

fn material() -> Column<PartRow> {
    column("material", "material", Text, Everyone, |row| row.material.clone().into())
}

/// Returns the columns by object, material and interaction.
pub fn part_columns() -> Vec<Column<PartRow>> {
    let interaction = column("interaction", "interaction", Text, Everyone, |row: &PartRow| word(row.interaction));
    [vec![object(), material(), interaction], shares()].concat()
}

/// Returns the columns by object.
pub fn object_columns() -> Vec<Column<PartRow>> {
    [vec![object()], shares()].concat()
}

/// Returns the columns by material.
pub fn material_columns() -> Vec<Column<PartRow>> {
    [vec![material()], shares()].concat()
}

/// Returns the columns by lamp.
pub fn lamp_columns() -> Vec<Column<LampRow>> {
    vec![
        column("lamp", "lamp", Text, Everyone, |row| row.lamp.clone().into()),
        column("noise", "noise", Share, Everyone, |row| Cell::Real(row.noise)),
        column("light", "light", Share, Everyone, |row| Cell::Real(row.light)),
        column("hidden", "hidden", Share, Everyone, |row| Cell::Real(row.hidden)),
        column("records", "records", Count, Everyone, |row| Cell::Count(row.records)),
    ]
}

/// Returns the columns of fireflies.
pub fn firefly_columns() -> Vec<Column<FireflyRow>> {
    vec![
        column("file", "file", Text, Programs, |row| Cell::Text(row.file.clone())),
        column("x", "x", Count, Everyone, |row| Cell::Count(row.x.into())),
        column("y", "y", Count, Everyone, |row| Cell::Count(row.y.into())),
        column("sample", "sample", Count, Everyone, |row| Cell::Count(row.sample.into())),
        column("luminance", "cd/m2", Number, Everyone, |row| Cell::Real(row.luminance)),
        column("others", "others", Number, Everyone, |row| Cell::Real(row.others)),
        column("noise", "noise", Share, Everyone, |row| Cell::Real(row.noise)),
        column("object", "object", Text, Everyone, |row| row.object.clone().into()),
        column("material", "material", Text, Everyone, |row| row.material.clone().into()),
        column("interaction", "interaction", Text, Everyone, |row| word(row.interaction)),
        column("lamp", "lamp", Text, Everyone, |row| row.lamp.clone().into()),
        column("found", "found by", Text, Programs, |row| Cell::Text(row.found.to_owned())),
    ]
}
