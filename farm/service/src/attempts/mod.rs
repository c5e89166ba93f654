//! Resource usage of jobs' attempts: rows for one or several attempts, their columns, and their JSON.

mod column;
mod job_record;
mod json;
mod row;

pub use column::{Cell, Column, Kind, Reader, column, columns};
pub use job_record::{FailureLog, JobRecord};
pub use json::Json;
pub use row::{By, Row, rows, rows_of_page};
