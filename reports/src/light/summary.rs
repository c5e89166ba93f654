//! Light in numbers, of one set of frames or of two: the table of `femc paths --by`.

use super::files::FrameSet;
use crate::ReportError;
use crate::attempts::{Audience, Cell, Column, Kind, column};
use femc_pipeline::paths::query::Query;
use femc_pipeline::paths::summary::{Estimate, Group, LightAmount, LightSummary, RowSubject};
use femc_pipeline::paths::{FrameStatistics, RecordedPaths};
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

/// Number of standard errors from the middle to the ends of a 95 % interval.
const INTERVAL_95: f64 = 1.96;

/// Number of standard errors beyond which a difference is marked: fewer than 3 of 1000 rows without a difference are.
pub const MARKED_ERRORS: f64 = 3.0;

/// Returns the light of the selected paths of united frames in numbers.
/// - errors: the frames cannot be united.
pub fn summarize(set: &FrameSet, query: &Query) -> Result<LightSummary, ReportError> {
    let frames = FrameStatistics::from_statistics(set.frames.iter().cloned());
    let frames = frames.map_err(|cause| ReportError::MergedFrames { file: set.file.clone(), cause })?;
    let (paths, running) = (RecordedPaths::new(frames), AtomicBool::new(false));
    let is_whole = *query == Query::default();
    let selected = (!is_whole).then(|| paths.select(query, &running)).transpose();
    let summary = selected.and_then(|selected| paths.summarize(selected.as_ref(), &running));
    Ok(summary.expect("the flag is never set"))
}

/// Comparison of two estimates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Difference {
    /// A minus B, with its standard error. A and B are taken for independent.
    pub difference: Estimate,
    /// A divided by B; `None`: B is 0.
    pub ratio: Option<f64>,
    /// Bounds of the 95 % interval of the ratio.
    pub ratio_bounds: Option<[f64; 2]>,
}

impl Difference {
    /// Compares two amounts of light.
    pub fn new(a: &LightAmount, b: &LightAmount) -> Self {
        Self::between(a, a.light, b, b.light)
    }

    /// Compares the mean energies of intersections. `None`: one of the amounts has no intersections.
    pub fn between_energies(a: &LightAmount, b: &LightAmount) -> Option<Self> {
        Some(Self::between(a, a.energy?, b, b.energy?))
    }

    /// Compares estimates of two amounts. An amount without recorded paths is 0.
    fn between(a: &LightAmount, x: Estimate, b: &LightAmount, y: Estimate) -> Self {
        let known = |it: &LightAmount, of: Estimate| if it.paths == 0 { Some(0.0) } else { of.standard_error };
        let errors = known(a, x).zip(known(b, y));
        let (x, y) = (x.value, y.value);
        let standard_error = errors.map(|(x, y)| x.hypot(y)).filter(|error| *error > 0.0);
        let ratio = (y > 0.0).then(|| x / y);
        let ratio_bounds = ratio.zip(errors).filter(|(ratio, _)| *ratio > 0.0).map(|(ratio, (of_x, of_y))| {
            let factor = (INTERVAL_95 * (of_x / x).hypot(of_y / y)).exp();
            [ratio / factor, ratio * factor]
        });
        Self { difference: Estimate { value: x - y, standard_error }, ratio, ratio_bounds }
    }

    /// Returns the difference in standard errors.
    pub fn standard_errors(&self) -> Option<f64> {
        self.difference.standard_error.map(|error| self.difference.value / error)
    }
}

/// A row: light of frames, and of other frames.
#[derive(Clone, Debug)]
pub struct SummaryRow {
    file: String,
    group: &'static str,
    subject: String,
    here: LightAmount,
    there: Option<LightAmount>,
}

impl SummaryRow {
    fn difference(&self) -> Option<Difference> {
        self.there.as_ref().map(|there| Difference::new(&self.here, there))
    }

    fn energy_difference(&self) -> Option<Difference> {
        self.there.as_ref().and_then(|there| Difference::between_energies(&self.here, there))
    }
}

/// Returns the rows of groups, after a row of all selected paths.
/// - `there`: other frames to compare with.
pub fn summary_rows(
    file: &str,
    groups: &[Group],
    here: &LightSummary,
    there: Option<&LightSummary>,
) -> Vec<SummaryRow> {
    let row = |group, subject: &RowSubject, here: &LightAmount, there: Option<LightAmount>| SummaryRow {
        file: file.to_owned(),
        group,
        subject: subject.text(),
        here: *here,
        there,
    };
    let mut rows = vec![row("all", &RowSubject::All, &here.total, there.map(|it| it.total))];
    for group in groups {
        let at = Group::ALL.iter().position(|it| it == group).unwrap_or_default();
        let mut others: BTreeMap<&RowSubject, LightAmount> = BTreeMap::new();
        if let Some(there) = there {
            others = there.groups[at].iter().map(|(subject, amount)| (subject, *amount)).collect();
        }
        for (subject, amount) in &here.groups[at] {
            let other = others.remove(subject);
            rows.push(row(group.word(), subject, amount, there.map(|_| other.unwrap_or_default())));
        }
        let of_others_alone = there.into_iter().flat_map(|there| &there.groups[at]);
        for (subject, amount) in of_others_alone.filter(|(subject, _)| others.contains_key(subject)) {
            rows.push(row(group.word(), subject, &LightAmount::default(), Some(*amount)));
        }
    }
    rows
}

use Audience::{Comparing, Everyone, Programs};
use Kind::{Count, Number, Text};

fn real(value: Option<f64>) -> Cell {
    value.map_or(Cell::Empty, Cell::Real)
}

fn half_width(estimate: Estimate) -> Cell {
    real(estimate.standard_error.map(|error| INTERVAL_95 * error))
}

fn energy(amount: Option<&LightAmount>) -> Option<Estimate> {
    amount.and_then(|amount| amount.energy)
}

/// Returns the columns of light in numbers.
pub fn summary_columns() -> Vec<Column<SummaryRow>> {
    vec![
        column("file", "file", Text, Comparing, |row| Cell::Text(row.file.clone())),
        column("by", "by", Text, Everyone, |row| Cell::Text(row.group.to_owned())),
        column("name", "name", Text, Everyone, |row| Cell::Text(row.subject.clone())),
        column("paths", "paths", Count, Everyone, |row| Cell::Count(row.here.paths.into())),
        column("light", "light cd/m2", Number, Everyone, |row| Cell::Real(row.here.light.value)),
        column("light_error", "+-", Number, Everyone, |row| half_width(row.here.light)),
        column("records", "records", Count, Everyone, |row| Cell::Count(row.here.records)),
        column("per_path", "a path", Number, Everyone, |row| Cell::Real(row.here.per_path.value)),
        column("per_path_error", "+- of it", Number, Programs, |row| half_width(row.here.per_path)),
        column("energy", "mean energy", Number, Everyone, |row| real(row.here.energy.map(|it| it.value))),
        column("energy_error", "+- of energy", Number, Programs, |row| row.here.energy.map_or(Cell::Empty, half_width)),
    ]
}

fn there(row: &SummaryRow) -> LightAmount {
    row.there.unwrap_or_default()
}

/// Returns the columns of light in numbers, compared with other frames.
pub fn compared_columns() -> Vec<Column<SummaryRow>> {
    let others = vec![
        column("paths_there", "there", Count, Everyone, |row| Cell::Count(there(row).paths.into())),
        column("light_there", "light there", Number, Everyone, |row| Cell::Real(there(row).light.value)),
        column("light_error_there", "+-", Number, Everyone, |row| half_width(there(row).light)),
        column("records_there", "records there", Count, Programs, |row| Cell::Count(there(row).records)),
        column("per_path_there", "a path there", Number, Programs, |row| Cell::Real(there(row).per_path.value)),
        column("per_path_error_there", "+- of it", Number, Programs, |row| half_width(there(row).per_path)),
        column("energy_there", "energy there", Number, Everyone, |row| {
            real(energy(row.there.as_ref()).map(|it| it.value))
        }),
        column("energy_error_there", "+- of it", Number, Programs, |row| {
            energy(row.there.as_ref()).map_or(Cell::Empty, half_width)
        }),
        column("difference", "difference", Number, Everyone, |row| {
            real(row.difference().map(|it| it.difference.value))
        }),
        column("difference_error", "+-", Number, Everyone, |row| {
            row.difference().map_or(Cell::Empty, |it| half_width(it.difference))
        }),
        column("ratio", "ratio", Number, Everyone, |row| real(row.difference().and_then(|it| it.ratio))),
        column("ratio_low", "from", Number, Programs, |row| {
            real(row.difference().and_then(|it| it.ratio_bounds).map(|bounds| bounds[0]))
        }),
        column("ratio_high", "to", Number, Programs, |row| {
            real(row.difference().and_then(|it| it.ratio_bounds).map(|bounds| bounds[1]))
        }),
        column("standard_errors", "z", Number, Everyone, |row| {
            real(row.difference().and_then(|it| it.standard_errors()))
        }),
        column("differs", "beyond noise", Text, Everyone, |row| {
            let z = row.difference().and_then(|it| it.standard_errors());
            z.map_or(Cell::Empty, |z| Cell::Text(if z.abs() > MARKED_ERRORS { "yes" } else { "no" }.to_owned()))
        }),
        column("energy_difference", "difference of energy", Number, Programs, |row| {
            real(row.energy_difference().map(|it| it.difference.value))
        }),
        column("energy_difference_error", "+-", Number, Programs, |row| {
            row.energy_difference().map_or(Cell::Empty, |it| half_width(it.difference))
        }),
        column("energy_ratio", "ratio of energy", Number, Programs, |row| {
            real(row.energy_difference().and_then(|it| it.ratio))
        }),
        column("energy_ratio_low", "from", Number, Programs, |row| {
            real(row.energy_difference().and_then(|it| it.ratio_bounds).map(|bounds| bounds[0]))
        }),
        column("energy_ratio_high", "to", Number, Programs, |row| {
            real(row.energy_difference().and_then(|it| it.ratio_bounds).map(|bounds| bounds[1]))
        }),
    ];
    [summary_columns(), others].concat()
}
