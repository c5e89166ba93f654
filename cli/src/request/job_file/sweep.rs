//! `[sweep]`: the axes, and how they are combined.

use super::axis::{Axis, AxisValue};
use super::fault::Fault;
use super::range::MAX_VARIANTS;
use super::variant_names::variant_names;
use crate::args::SettingsArgs;
use crate::values::TextPosition;
use std::collections::BTreeSet;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The axes of a sweep, in the order of the file, and how they are combined.
#[derive(Debug)]
pub struct Sweep {
    /// Axes, at least one.
    pub axes: Vec<Axis>,
    /// Combination of the axes.
    pub mode: SweepMode,
    position: TextPosition,
}

/// Combination of axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SweepMode {
    /// All combinations; the last axis varies fastest.
    #[default]
    Grid,
    /// The first values of all axes, then the second ones, and so on.
    Zip,
}

/// A variant of a sweep: one choice of each axis.
#[derive(Clone, Debug)]
pub struct Variant<'a> {
    /// Name of the folder: short, unique in the sweep, and unchanged when the sweep gets more values.
    pub name: String,
    /// Choices in the order of the axes.
    pub values: Vec<&'a AxisValue>,
}

impl Sweep {
    /// Reads `[sweep]`, which is a part of `text`.
    pub fn read(table: &Spanned<DeValue<'_>>, text: &str) -> Result<Self, Fault> {
        let begin = table.span().start;
        let DeValue::Table(entries) = table.get_ref() else {
            return Err(Fault::new(begin, "sweep must be a table: [sweep], then a line for each axis"));
        };
        let mode = mode(entries)?;
        let mut keys: Vec<_> = entries.iter().filter(|(key, _)| key.get_ref() != "mode").collect();
        keys.sort_by_key(|(key, _)| key.span().start);
        let axes = keys.into_iter().map(|(key, value)| Axis::read(key, value, text)).collect::<Result<Vec<_>, _>>()?;
        if axes.is_empty() {
            return Err(Fault::new(
                begin,
                "the sweep has no axis; write one like \"medium.fog.sigma_s\" = [0.01, 0.02]",
            ));
        }
        let sweep = Self { axes, mode, position: TextPosition::from_offset(text, begin) };
        sweep.check(begin)?;
        Ok(sweep)
    }

    /// Returns the location of the table.
    pub fn position(&self) -> TextPosition {
        self.position
    }

    fn check(&self, begin: usize) -> Result<(), Fault> {
        let mut stops = self.axes.iter().filter(|axis| ["spp", "error", "time"].contains(&axis.name.as_str()));
        if let (Some(first), Some(second)) = (stops.next(), stops.next()) {
            return Err(Fault::new(second.offset, format!("{} and {} exclude each other", first.name, second.name)));
        }
        match self.mode {
            SweepMode::Grid => self.check_grid(begin),
            SweepMode::Zip => self.check_zip(),
        }
    }

    fn check_grid(&self, begin: usize) -> Result<(), Fault> {
        for axis in &self.axes {
            let mut seen = BTreeSet::new();
            if let Some(twice) = axis.values.iter().find(|choice| !seen.insert(choice.text.as_str())) {
                return Err(Fault::new(twice.offset, format!("`{}` has the value {} twice", axis.name, twice.text)));
            }
        }
        let count = self.axes.iter().try_fold(1usize, |count, axis| count.checked_mul(axis.values.len()));
        match count {
            Some(count) if count <= MAX_VARIANTS => Ok(()),
            count => {
                let count = count.map_or("far more".to_owned(), |count| count.to_string());
                Err(Fault::new(begin, format!("the grid has {count} variants; a sweep has at most {MAX_VARIANTS}")))
            }
        }
    }

    fn check_zip(&self) -> Result<(), Fault> {
        let first = &self.axes[0];
        if let Some(other) = self.axes.iter().find(|axis| axis.values.len() != first.values.len()) {
            let [a, b] = [first, other].map(|axis| axis.values.len());
            let what = format!(
                "mode = \"zip\" pairs values: `{}` has {a} values, but `{}` has {b}; give both the same number",
                first.name, other.name
            );
            return Err(Fault::new(other.offset, what));
        }
        let mut seen = BTreeSet::new();
        for (at, choice) in first.values.iter().enumerate() {
            if !seen.insert(self.axes.iter().map(|axis| axis.values[at].text.as_str()).collect::<Vec<_>>()) {
                return Err(Fault::new(choice.offset, "the same combination of values occurs twice"));
            }
        }
        Ok(())
    }

    /// Returns all variants. In a grid, the last axis varies fastest.
    pub fn variants(&self) -> Vec<Variant<'_>> {
        let labels = self.labels();
        let rows: Vec<Vec<&AxisValue>> = match self.mode {
            SweepMode::Grid => self.axes.iter().fold(vec![Vec::new()], |rows, axis| {
                let with = |row: Vec<_>| axis.values.iter().map(move |choice| [row.as_slice(), &[choice]].concat());
                rows.into_iter().flat_map(with).collect()
            }),
            SweepMode::Zip => {
                let row = |at: usize| self.axes.iter().map(|axis| &axis.values[at]).collect();
                (0..self.axes[0].values.len()).map(row).collect()
            }
        };
        let texts = rows.iter().map(|row| labels.iter().zip(row).map(|(l, c)| format!("{l}={}", c.text)).collect());
        let names = variant_names(&texts.collect::<Vec<Vec<String>>>());
        rows.into_iter().zip(names).map(|(choices, name)| Variant { name, values: choices }).collect()
    }

    /// Returns the axes' names, shortened as far as they stay unique: `sigma_s` for `medium.fog.sigma_s`.
    pub fn labels(&self) -> Vec<String> {
        let tail = |name: &str, parts: usize| {
            let all: Vec<&str> = name.split('.').collect();
            all[all.len().saturating_sub(parts)..].join(".")
        };
        let label = |name: &str| {
            let alone = |parts: &usize| {
                let same = |axis: &&Axis| tail(&axis.name, *parts) == tail(name, *parts);
                self.axes.iter().filter(same).count() == 1
            };
            (1..=name.split('.').count()).find(alone).map_or(name.to_owned(), |parts| tail(name, parts))
        };
        self.axes.iter().map(|axis| label(&axis.name)).collect()
    }
}

impl Variant<'_> {
    /// Returns these settings with the variant's choices.
    pub fn apply(&self, settings: &SettingsArgs) -> SettingsArgs {
        let mut settings = settings.clone();
        self.values.iter().for_each(|choice| choice.change.apply(&mut settings));
        settings
    }
}

fn mode(entries: &DeTable<'_>) -> Result<SweepMode, Fault> {
    let Some(value) = entries.get("mode") else { return Ok(SweepMode::default()) };
    match value.get_ref() {
        DeValue::String(text) if text == "grid" => Ok(SweepMode::Grid),
        DeValue::String(text) if text == "zip" => Ok(SweepMode::Zip),
        _ => {
            Err(Fault::new(value.span().start, "mode must be \"grid\" (all combinations) or \"zip\" (value by value)"))
        }
    }
}
