//! Laws that every member obeys.
