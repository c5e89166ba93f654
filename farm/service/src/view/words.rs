//! Helpers for texts that users read.

/// Returns a count with its noun: `1 frame`, `3 frames`.
pub fn counted_noun(n: u64, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}
