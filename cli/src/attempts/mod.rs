//! What jobs' attempts took: as rows, one an attempt or one of many, as columns of these, and as files for other programs.

mod column;
mod files;
mod job_record;
mod parquet;
mod row;

pub use column::{Cell, Column, Kind, Reader, column, columns};
pub use files::{Json, csv, human, shown};
pub use job_record::{FailureLog, JobRecord};
pub use parquet::write as write_parquet;
pub use row::{By, Row, rows};
