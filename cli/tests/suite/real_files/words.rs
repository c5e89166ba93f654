//! Messages that send a user the wrong way.
