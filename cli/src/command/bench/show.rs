//! Prints the tables on stdout.

use crate::output::{Printer, human};
use femc_reports::bench::setup::Setup;
use femc_reports::bench::summary::Summary;
use femc_reports::bench::table::{self, Table};

/// Prints the tables of a summary.
pub fn print(setup: &Setup, summary: &Summary, printer: Printer) {
    for (name, fact) in table::facts(setup, summary) {
        printer.result(format!("{}: {fact}", name.to_lowercase()));
    }
    for scene in &summary.scenes {
        section(&scene.scene, table::points(scene), printer);
        table::notes(scene).iter().for_each(|note| printer.result(note));
    }
    let methods = table::methods(summary);
    if !methods.1.is_empty() {
        section("geometric means over scenes", methods, printer);
    }
}

fn section(title: &str, (titles, rows): Table, printer: Printer) {
    printer.result(format!("\n{}\n{}", printer.style_heading(title), human::table(&titles, &rows)));
}
