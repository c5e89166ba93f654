//! Farm usage by owner and month: columns of the tables and keys of the JSON.

use femc_model::OwnerUsage;

use crate::attempts::{Audience, Cell, Column, Kind, column};

/// Returns the columns of a usage table.
pub fn usage_columns() -> Vec<Column<OwnerUsage>> {
    let column = column::<OwnerUsage>;
    vec![
        column("month", "month", Kind::Text, Audience::Everyone, |row| Cell::Text(row.month.to_string())),
        column("owner", "owner", Kind::Text, Audience::Everyone, |row| Cell::Text(row.owner.clone())),
        column("jobs", "jobs", Kind::Count, Audience::Everyone, |row| Cell::Count(row.sums.jobs)),
        column("frames", "frames", Kind::Count, Audience::Everyone, |row| Cell::Count(row.sums.frames)),
        column("tasks", "tasks", Kind::Count, Audience::Everyone, |row| Cell::Count(row.sums.tasks)),
        column("samples", "samples", Kind::Count, Audience::Everyone, |row| Cell::Count(row.sums.samples)),
        column("worker_seconds", "worker time", Kind::Seconds, Audience::Everyone, |row| {
            Cell::Real(row.sums.worker_ms as f64 / 1e3)
        }),
        column("processor_seconds", "processor time", Kind::Seconds, Audience::Everyone, |row| {
            Cell::Real(row.sums.processor_us as f64 / 1e6)
        }),
    ]
}
