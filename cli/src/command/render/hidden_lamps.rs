//! Warnings of lamps whose light no method finds.

use crate::output::{Say, human};
use crate::request::Asked;

/// Lamps that are named one by one; `femc check` has all.
const NAMED: usize = 4;

/// Warns before anything is rendered.
pub fn warn(asked: &Asked, say: Say) {
    if say.quiet() {
        return;
    }
    let lines = asked.lamps_without_light();
    lines.iter().take(NAMED).for_each(|line| say.note(format!("warning: {line}")));
    if let more @ 1.. = lines.len().saturating_sub(NAMED) {
        let more = human::count(more as u64, "more lamp");
        say.note(format!(
            "warning: the light of {more} is not found; `femc check {}` lists them",
            asked.path.display()
        ));
    }
}
