//! Prints the tables on stdout.

use crate::output::{Say, human};
use femc_reports::bench::setup::Setup;
use femc_reports::bench::summary::Summary;
use femc_reports::bench::table::{self, Table};

/// Prints the tables of a summary.
pub fn print(setup: &Setup, summary: &Summary, say: Say) {
    for (name, fact) in table::facts(setup, summary) {
        say.result(format!("{}: {fact}", name.to_lowercase()));
    }
    for scene in &summary.scenes {
        section(&scene.scene, table::points(scene), say);
        table::notes(scene).iter().for_each(|note| say.result(note));
    }
    let methods = table::methods(summary);
    if !methods.1.is_empty() {
        section("geometric means over scenes", methods, say);
    }
}

fn section(title: &str, (titles, rows): Table, say: Say) {
    say.result(format!("\n{}\n{}", say.heading(title), human::table(&titles, &rows)));
}
