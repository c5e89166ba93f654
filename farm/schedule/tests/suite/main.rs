//! Tests of the scheduler as a pure function, one module per topic.

mod accounts;
mod affinity;
mod attempts;
mod builds;
mod chains;
mod chunks;
mod common;
mod copies;
mod deaths;
mod graphs;
mod groups;
mod guarantees;
mod hints;
mod identity;
mod images;
mod machine;
mod queues;
mod quota;
mod retries;
mod shared;
mod shares;
mod snapshots;
mod tables;
mod tags;
mod tickets;
