//! Tests of the coordinator through its public interface, one module per topic.

mod common;
mod damage;
mod full_disk;
mod garbage;
mod health;
mod several;
mod snapshots;
mod transfer;
mod wire;
