//! Costs of jobs' attempts, as files for other programs and tables for people.

mod files;
mod job_record;
mod parquet;

pub use femc_service::attempts::{
    Audience, Cell, Column, FailureLog, GroupBy, JobRecord, Kind, Row, RowsAsJson, column, columns, rows,
};
pub use files::{csv, text_table, visible_cells};
pub use job_record::{read_all, write as write_record};
pub use parquet::write as write_parquet;
