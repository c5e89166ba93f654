//! Compatibility with earlier versions of the farm's log: fields that later versions added.
//!
//! The log is postcard, which stores fields by position. A field that version N added is marked with
//! `#[serde(deserialize_with = "since_version_N")]`. While content of an earlier version is read ([`with_log_version`]), the field
//! takes no bytes and has its default value. The price is a thread-local variable; the alternative is a second set of all structs.

use std::cell::Cell;

use serde::{Deserialize, Deserializer};

thread_local! {
    /// Version of the log that this thread reads.
    static READING: Cell<u8> = const { Cell::new(u8::MAX) };
}

/// Runs `read` with all fields that are newer than `version` absent, and returns its result.
pub fn with_log_version<T>(version: u8, read: impl FnOnce() -> T) -> T {
    /// Restores the version on drop, also when `read` panics.
    struct Restore(u8);
    impl Drop for Restore {
        fn drop(&mut self) {
            READING.set(self.0);
        }
    }
    let _restore = Restore(READING.replace(version));
    read()
}

/// Reads a field that version 9 of the log added.
///
/// # Errors
/// The field is damaged.
pub fn since_version_9<'de, T: Deserialize<'de> + Default, D: Deserializer<'de>>(from: D) -> Result<T, D::Error> {
    deserialize_since(9, from)
}

/// Reads a field that version 10 of the log added.
///
/// # Errors
/// The field is damaged.
pub fn since_version_10<'de, T: Deserialize<'de> + Default, D: Deserializer<'de>>(from: D) -> Result<T, D::Error> {
    deserialize_since(10, from)
}

/// Reads a field that version 11 of the log added.
///
/// # Errors
/// The field is damaged.
pub fn since_version_11<'de, T: Deserialize<'de> + Default, D: Deserializer<'de>>(from: D) -> Result<T, D::Error> {
    deserialize_since(11, from)
}

fn deserialize_since<'de, T: Deserialize<'de> + Default, D: Deserializer<'de>>(
    version: u8,
    from: D,
) -> Result<T, D::Error> {
    if READING.get() < version { Ok(T::default()) } else { T::deserialize(from) }
}
