//! Costs of jobs' attempts, as files for other programs and tables for people.

mod files;
mod job_record;
mod parquet;

pub use femc_service::attempts::{
    By, Cell, Column, FailureLog, JobRecord, Json, Kind, Reader, Row, column, columns, rows,
};
pub use files::{csv, human, shown};
pub use job_record::{read_all, write as write_record};
pub use parquet::write as write_parquet;
