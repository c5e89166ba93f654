//! Columns of rows. Tables for display and all files use the same list.

use super::row::{GroupBy, Row};

/// Value in a column; `Empty`: no value.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Value of a [`Kind::Text`] column.
    Text(String),
    /// Value of a column of whole numbers.
    Count(u64),
    /// Value of a column of any other kind.
    Real(f64),
    /// No value.
    Empty,
}

/// Kind of the values of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Text.
    Text,
    /// Whole numbers: counts or indices.
    Count,
    /// Whole numbers: bytes.
    Bytes,
    /// Seconds.
    Seconds,
    /// Fraction of one.
    Share,
    /// Other numbers.
    Number,
}

/// Audience of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Audience {
    /// Users and programs.
    Everyone,
    /// Programs only.
    Programs,
    /// Programs; also users, if the rows differ in the column.
    Comparing,
}

/// A column of rows.
pub struct Column<R = Row> {
    /// Name for programs, with the unit.
    pub name: &'static str,
    /// Title for users.
    pub title: &'static str,
    /// Kind of its values.
    pub kind: Kind,
    /// Audience of the column.
    pub audience: Audience,
    /// Returns the value of a row.
    pub value: fn(&R) -> Cell,
}

impl<R> Clone for Column<R> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<R> Copy for Column<R> {}

impl From<Option<String>> for Cell {
    fn from(value: Option<String>) -> Self {
        value.map_or(Self::Empty, Self::Text)
    }
}

impl From<Option<u64>> for Cell {
    fn from(value: Option<u64>) -> Self {
        value.map_or(Self::Empty, Self::Count)
    }
}

/// Makes a column.
pub const fn column<R>(
    name: &'static str,
    title: &'static str,
    kind: Kind,
    audience: Audience,
    value: fn(&R) -> Cell,
) -> Column<R> {
    Column { name, title, kind, audience, value }
}

/// Returns the columns shown for this grouping.
pub fn columns(group_by: GroupBy) -> Vec<Column> {
    use Audience::{Comparing, Everyone, Programs};
    use Kind::{Bytes, Count, Seconds, Share, Text};
    let column = column::<Row>;
    let source = [
        column("job", "job", Count, Comparing, |row| Cell::Count(row.job)),
        column("variant", "variant", Text, Comparing, |row| row.variant.clone().into()),
    ];
    let task =
        column("task", "task", Text, Everyone, |row| row.task.map_or(Cell::Empty, |task| Cell::Text(task.to_string())));
    let frame =
        |reader| column("frame", "frame", Count, reader, |row| row.task.map(|task| u64::from(task.stage.frame)).into());
    let stage = [
        column("round", "round", Count, Programs, |row| row.task.map(|task| u64::from(task.stage.round)).into()),
        column("stage", "stage", Text, Programs, |row| row.task.map(|task| task.stage.kind.name().to_owned()).into()),
        column("tile", "tile", Count, Programs, |row| row.tile.map(u64::from).into()),
    ];
    let worker = [
        column("worker", "worker", Text, Everyone, |row| Cell::Text(row.worker.clone())),
        column("instance", "instance", Text, Programs, |row| Cell::Text(format!("{:016x}", row.instance))),
    ];
    let ending = column("ending", "ended", Text, Everyone, |row| {
        row.ending.map_or(Cell::Empty, |ending| Cell::Text(ending.name().to_owned()))
    });
    let tasks = column("tasks", "tasks", Count, Everyone, |row| Cell::Count(row.tasks));
    let attempts = column("attempts", "attempts", Count, Everyone, |row| Cell::Count(row.attempts));
    let failed = column("failed", "failed", Count, Everyone, |row| Cell::Count(row.failed));
    let workers = column("workers", "workers", Count, Everyone, |row| Cell::Count(row.workers));
    let mut all = match group_by {
        GroupBy::Attempt => {
            let attempt = column("attempt", "attempt", Count, Everyone, |row| Cell::Count(row.attempt));
            let epoch = column("epoch", "epoch", Count, Programs, |row| Cell::Count(row.epoch));
            [&source[..], &[task, frame(Programs)], &stage, &[attempt, epoch], &worker, &[ending]].concat()
        }
        GroupBy::Task => [&source[..], &[task, frame(Programs)], &stage, &worker, &[ending, attempts, failed]].concat(),
        GroupBy::Frame => [&source[..], &[frame(Everyone), tasks, attempts, failed, workers]].concat(),
        GroupBy::Variant => [&source[..], &[tasks, attempts, failed, workers]].concat(),
        GroupBy::Worker => [&worker[..], &[tasks, attempts, failed]].concat(),
    };
    all.extend([
        column("began_seconds", "began", Seconds, Programs, |row| Cell::Real(row.began)),
        column("ended_seconds", "ended", Seconds, Programs, |row| Cell::Real(row.ended)),
        column("wait_seconds", "wait", Seconds, Everyone, |row| Cell::Real(row.wait)),
        column("wall_seconds", "wall", Seconds, Everyone, |row| Cell::Real(row.wall)),
        column("preparation_seconds", "preparation", Seconds, Programs, |row| Cell::Real(row.preparation)),
        column("cpu_seconds", "CPU", Seconds, Everyone, |row| Cell::Real(row.cpu)),
        column("peak_memory_bytes", "memory", Bytes, Everyone, |row| row.peak.into()),
        column("samples", "samples", Count, Everyone, |row| Cell::Count(row.samples)),
        column("samples_taken", "taken", Count, Programs, |row| Cell::Count(row.samples_taken)),
        column("rays", "rays", Count, Everyone, |row| Cell::Count(row.rays)),
        column("fetched_bytes", "fetched", Bytes, Everyone, |row| Cell::Count(row.fetched)),
        column("sent_bytes", "sent", Bytes, Everyone, |row| Cell::Count(row.sent)),
    ]);
    if !matches!(group_by, GroupBy::Worker | GroupBy::Variant) {
        let audience = if group_by == GroupBy::Attempt { Programs } else { Everyone };
        all.push(column("waiting_seconds", "waiting", Seconds, audience, |row| Cell::Real(row.waiting)));
        all.push(column("relative_error", "error", Share, Everyone, |row| {
            row.relative_error.map_or(Cell::Empty, Cell::Real)
        }));
    }
    all
}
