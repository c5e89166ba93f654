//! Laws about several clients of one farm. An answer depends on its request, its caller and the farm, and never on other clients.
//!
//! The expected answers are written by hand in these tests, or they come from a server that answers one request and ends.

mod answers;
mod common;
mod documentation;
mod feed;
mod identities;
mod world;
