//! Columns of rows. Tables for display and all files use the same list.

use super::row::{By, Row};

/// Value in a column; `Gap`: no value.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Value of a [`Kind::Text`] column.
    Text(String),
    /// Value of a column of whole numbers.
    Count(u64),
    /// Value of a column of any other kind.
    Real(f64),
    /// No value.
    Gap,
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
pub enum Reader {
    /// Users and programs.
    Anybody,
    /// Programs only.
    Programs,
    /// Programs; also users, if the rows differ in the column.
    WhoCompares,
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
    pub reader: Reader,
    /// Returns the value of a row.
    pub of: fn(&R) -> Cell,
}

impl<R> Clone for Column<R> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<R> Copy for Column<R> {}

impl From<Option<String>> for Cell {
    fn from(value: Option<String>) -> Self {
        value.map_or(Self::Gap, Self::Text)
    }
}

impl From<Option<u64>> for Cell {
    fn from(value: Option<u64>) -> Self {
        value.map_or(Self::Gap, Self::Count)
    }
}

/// Makes a column.
pub const fn column<R>(
    name: &'static str,
    title: &'static str,
    kind: Kind,
    reader: Reader,
    of: fn(&R) -> Cell,
) -> Column<R> {
    Column { name, title, kind, reader, of }
}

/// Returns the columns shown for this grouping.
pub fn columns(by: By) -> Vec<Column> {
    use Kind::{Bytes, Count, Seconds, Share, Text};
    use Reader::{Anybody, Programs, WhoCompares};
    let column = column::<Row>;
    let source = [
        column("job", "job", Count, WhoCompares, |row| Cell::Count(row.job)),
        column("variant", "variant", Text, WhoCompares, |row| row.variant.clone().into()),
    ];
    let task =
        column("task", "task", Text, Anybody, |row| row.task.map_or(Cell::Gap, |task| Cell::Text(task.to_string())));
    let frame =
        |reader| column("frame", "frame", Count, reader, |row| row.task.map(|task| u64::from(task.stage.frame)).into());
    let stage = [
        column("round", "round", Count, Programs, |row| row.task.map(|task| u64::from(task.stage.round)).into()),
        column("stage", "stage", Text, Programs, |row| row.task.map(|task| task.stage.kind.name().to_owned()).into()),
        column("tile", "tile", Count, Programs, |row| row.tile.map(u64::from).into()),
    ];
    let worker = [
        column("worker", "worker", Text, Anybody, |row| Cell::Text(row.worker.clone())),
        column("instance", "instance", Text, Programs, |row| Cell::Text(format!("{:016x}", row.instance))),
    ];
    let ending = column("ending", "ended", Text, Anybody, |row| {
        row.ending.map_or(Cell::Gap, |ending| Cell::Text(ending.name().to_owned()))
    });
    let tasks = column("tasks", "tasks", Count, Anybody, |row| Cell::Count(row.tasks));
    let attempts = column("attempts", "attempts", Count, Anybody, |row| Cell::Count(row.attempts));
    let failed = column("failed", "failed", Count, Anybody, |row| Cell::Count(row.failed));
    let workers = column("workers", "workers", Count, Anybody, |row| Cell::Count(row.workers));
    let mut all = match by {
        By::Attempt => {
            let attempt = column("attempt", "attempt", Count, Anybody, |row| Cell::Count(row.attempt));
            let epoch = column("epoch", "epoch", Count, Programs, |row| Cell::Count(row.epoch));
            [&source[..], &[task, frame(Programs)], &stage, &[attempt, epoch], &worker, &[ending]].concat()
        }
        By::Task => [&source[..], &[task, frame(Programs)], &stage, &worker, &[ending, attempts, failed]].concat(),
        By::Frame => [&source[..], &[frame(Anybody), tasks, attempts, failed, workers]].concat(),
        By::Variant => [&source[..], &[tasks, attempts, failed, workers]].concat(),
        By::Worker => [&worker[..], &[tasks, attempts, failed]].concat(),
    };
    all.extend([
        column("began_seconds", "began", Seconds, Programs, |row| Cell::Real(row.began)),
        column("ended_seconds", "ended", Seconds, Programs, |row| Cell::Real(row.ended)),
        column("wait_seconds", "wait", Seconds, Anybody, |row| Cell::Real(row.wait)),
        column("wall_seconds", "wall", Seconds, Anybody, |row| Cell::Real(row.wall)),
        column("preparation_seconds", "preparation", Seconds, Programs, |row| Cell::Real(row.preparation)),
        column("cpu_seconds", "CPU", Seconds, Anybody, |row| Cell::Real(row.cpu)),
        column("peak_memory_bytes", "memory", Bytes, Anybody, |row| row.peak.into()),
        column("samples", "samples", Count, Anybody, |row| Cell::Count(row.samples)),
        column("samples_taken", "taken", Count, Programs, |row| Cell::Count(row.taken)),
        column("rays", "rays", Count, Anybody, |row| Cell::Count(row.rays)),
        column("fetched_bytes", "fetched", Bytes, Anybody, |row| Cell::Count(row.fetched)),
        column("sent_bytes", "sent", Bytes, Anybody, |row| Cell::Count(row.sent)),
    ]);
    if !matches!(by, By::Worker | By::Variant) {
        let reader = if by == By::Attempt { Programs } else { Anybody };
        all.push(column("waiting_seconds", "waiting", Seconds, reader, |row| Cell::Real(row.waiting)));
        all.push(column("relative_error", "error", Share, Anybody, |row| {
            row.relative_error.map_or(Cell::Gap, Cell::Real)
        }));
    }
    all
}
