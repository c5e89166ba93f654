//! The coordinator behind its interface, a module a topic.

mod common;
mod damage;
mod garbage;
mod health;
mod room;
mod several;
mod snapshots;
mod transfer;
mod wire;
