//! Prints the tables on stdout.

use crate::output::decisions::DecisionsReport;
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

/// Prints the parts of the variance of a method by decision.
pub fn print_decisions(scene: &str, method: &str, report: &DecisionsReport, printer: Printer) {
    printer.result(format!("\n{}", printer.style_heading(&format!("{scene}, {method}: variance by decision"))));
    report.table().into_iter().for_each(|line| printer.result(line));
}

fn section(title: &str, (titles, rows): Table, printer: Printer) {
    printer.result(format!("\n{}\n{}", printer.style_heading(title), human::table(&titles, &rows)));
}
