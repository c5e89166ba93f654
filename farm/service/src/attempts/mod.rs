//! Resource usage of jobs' attempts: rows for one or several attempts, their columns, and their JSON.

mod column;
mod job_record;
mod json;
mod row;

pub use column::{Audience, Cell, Column, Kind, column, columns};
pub use job_record::{FailureLog, JobRecord};
pub use json::RowsAsJson;
pub use row::{GroupBy, Row, rows, rows_of_page};
