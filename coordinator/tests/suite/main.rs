//! Tests of the coordinator through its public interface, one module per topic.

mod common;
mod damage;
mod garbage;
mod health;
mod room;
mod several;
mod snapshots;
mod transfer;
mod wire;
