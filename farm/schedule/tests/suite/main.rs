//! Tests of the scheduler as a pure function, one module per topic.

mod accounts;
mod affinity;
mod attempts;
mod builds;
mod chains;
mod common;
mod copies;
mod deaths;
mod grains;
mod graphs;
mod groups;
mod hints;
mod identity;
mod images;
mod machine;
mod queues;
mod quota;
mod retries;
mod sentences;
mod shared;
mod shares;
mod snapshots;
mod tables;
