//! Light of a picture in numbers: by object, by bounce and by lamp.
//!
//! The light of some records is their part of the mean luminance of the picture. It is estimated as the mean of their contributions
//! to the recorded samples. Each sample has the weight of its part of the image. An estimate has a standard error: the recorded
//! paths are taken for independent random samples of the picture. So the error contains both the noise of the picture and the
//! choice of the recorded paths. It is too large rather than too small, because the samples are spread evenly over the pixels.
//!
//! Few bright paths say little about their own spread. So the errors are wider by a factor sqrt(1 + 10 / n), where n is the effective
//! number of paths: the square of the sum of their contributions, divided by the sum of the squares. Intervals of skewed
//! contributions keep their level with it (test `intervals_of_95_percent_contain_the_truth_as_often`). An estimate that depends on
//! fewer than [`MIN_EFFECTIVE_PATHS`] paths has no error.
//!
//! The light by object is the light that came by it: the selected lights that a path found at a selected intersection with the
//! object, or behind one. The light by object overlaps: light that came by two objects counts for both. The light by bounce and the
//! light by lamp add up to the selected lights.

use crate::attribute::Attribute;
use crate::query::{CompareOp, Condition, EqualityOp, Quantity};
use crate::record::{InteractionKind, LightPath, Name, NameKind, luminance};
use crate::recorded::RecordedPaths;
use crate::selection::{CancelCheck, Cancelled, SelectedRecords};
use crate::statistics::IMAGE_BITS;
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

/// Minimum effective number of paths for an estimate with an error.
pub const MIN_EFFECTIVE_PATHS: f64 = 30.0;

/// Maximum number of rows of a group.
pub const MAX_ROWS: usize = 1000;

/// An estimate from recorded paths.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Standard error. `None`: too few paths for an error.
    pub standard_error: Option<f64>,
}

/// Light of some records of recorded paths.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightAmount {
    /// Number of recorded paths that have such records.
    pub paths: u32,
    /// Part of the mean luminance of the picture, cd/m2.
    pub light: Estimate,
    /// Number of records: lights in the group of lamps, otherwise intersections.
    pub records: u64,
    /// Mean number of these records of a recorded path.
    pub per_path: Estimate,
    /// Mean energy of the intersections, cd/m2: the mean of the three channels of the radiance that leaves an intersection along
    /// its path. `None`: there are no intersections.
    pub energy: Option<Estimate>,
}

/// Subject of a row.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RowSubject {
    /// All selected records.
    All,
    /// An object with all objects in it.
    Object(String),
    /// A medium: intersections in it, or its emission.
    Medium(String),
    /// A lamp.
    Lamp(String),
    /// Surfaces without a name.
    Nameless,
    /// Light found at the camera: no intersection lies between it and the lamp.
    Camera,
    /// Intersections of this bounce, and light found there: sampled from there, or by a path that hit the lamp next.
    Bounce(u32),
    /// Light of a first pass.
    FirstPass,
}

impl RowSubject {
    /// Returns the text of the row's subject.
    pub fn text(&self) -> String {
        match self {
            Self::All => "all".into(),
            Self::Object(name) | Self::Lamp(name) => name.clone(),
            Self::Medium(name) => format!("{name} (medium)"),
            Self::Nameless => "(no name)".into(),
            Self::Camera => "camera".into(),
            Self::Bounce(bounce) => bounce.to_string(),
            Self::FirstPass => "(first pass)".into(),
        }
    }

    /// Returns a condition that selects the records of the row. `None`: there is no such condition.
    /// - `group`: group of the row.
    pub fn condition(&self, group: Group) -> Option<Condition> {
        let field = |field: &str| Attribute::all().find(|it| it.field == field);
        let is = |name: &str, value: &str| Some(Condition::Word(field(name)?, EqualityOp::Is, value.to_owned()));
        let light = |condition: Condition| Condition::Lights(Quantity::Any, Box::new(condition));
        match self {
            Self::All | Self::Nameless | Self::Camera | Self::FirstPass => None,
            Self::Object(name) => is("object", name),
            Self::Medium(name) if group == Group::Lamp => is("light", name).map(light),
            Self::Medium(name) => is("material", name),
            Self::Lamp(name) => is("light", name).map(light),
            Self::Bounce(bounce) => {
                Some(light(Condition::Number(field("bounce")?, CompareOp::Equal, f64::from(*bounce))))
            }
        }
    }
}

/// Groups of rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// Light that came by an object.
    Object,
    /// Light by the bounce of the intersection where it was found.
    Bounce,
    /// Light by lamp.
    Lamp,
}

impl Group {
    /// All groups.
    pub const ALL: [Self; 3] = [Self::Object, Self::Bounce, Self::Lamp];

    /// Returns the word for the group.
    pub fn word(self) -> &'static str {
        match self {
            Self::Object => "object",
            Self::Bounce => "bounce",
            Self::Lamp => "lamp",
        }
    }
}

/// Light of recorded paths in numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightSummary {
    /// Light of all selected paths, and their selected intersections.
    pub total: LightAmount,
    /// Rows of each group in the order of [`Group::ALL`]: bounces ascending, others by falling light. At most [`MAX_ROWS`].
    pub groups: [Vec<(RowSubject, LightAmount)>; 3],
    /// Number of rows that were left out of each group.
    pub left_out: [usize; 3],
}

/// Sums over paths.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    paths: u32,
    records: u64,
    /// Sums of w x, (w x)^2 and w^2 x. x: luminance, w: weight of the sample.
    light: f64,
    light_squares: f64,
    light_weights: f64,
    /// Number of intersections.
    intersections: u64,
    /// Sums of n, n^2, e, e^2 and n e. n: number of the path's records, e: sum of the energies of its intersections.
    count: f64,
    count_squares: f64,
    energy: f64,
    energy_squares: f64,
    products: f64,
}

impl Sums {
    fn add(&mut self, own: &OwnSums, weight: f64) {
        self.paths += 1;
        self.records += u64::from(own.records);
        let light = weight * own.light;
        self.light += light;
        self.light_squares += light * light;
        self.light_weights += weight * light;
        self.intersections += u64::from(own.intersections);
        let (n, e) = (f64::from(own.records), own.energy);
        self.count += n;
        self.count_squares += n * n;
        self.energy += e;
        self.energy_squares += e * e;
        self.products += n * e;
    }

    fn amount(&self, weights: &WeightSums) -> LightAmount {
        let mean = self.light / weights.sum;
        let square = self.light_squares - 2.0 * mean * self.light_weights + mean * mean * weights.squares;
        let per_path = self.count / weights.paths;
        let spread = self.count_squares - per_path * self.count;
        let energy = (self.intersections > 0).then(|| {
            let ratio = self.energy / self.count;
            let square = self.energy_squares - 2.0 * ratio * self.products + ratio * ratio * self.count_squares;
            let error = standard_error(square, self.count, self.energy, self.energy_squares);
            Estimate { value: ratio, standard_error: error }
        });
        LightAmount {
            paths: self.paths,
            light: Estimate {
                value: mean,
                standard_error: standard_error(square, weights.sum, self.light, self.light_squares),
            },
            records: self.records,
            per_path: Estimate {
                value: per_path,
                standard_error: standard_error(spread, weights.paths, self.count, self.count_squares),
            },
            energy,
        }
    }
}

/// Returns the standard error of a mean. `None`: it depends on too few paths.
/// - `square`: sum of the squared deviations of the terms;
/// - `divisor`: divisor of the sum of terms;
/// - `sum`, `squares`: sums of the terms of all paths and of their squares.
fn standard_error(square: f64, divisor: f64, sum: f64, squares: f64) -> Option<f64> {
    let effective = if squares > 0.0 { sum * sum / squares } else { 0.0 };
    (effective >= MIN_EFFECTIVE_PATHS).then(|| (square.max(0.0) * (1.0 + 10.0 / effective)).sqrt() / divisor)
}

/// Sums over all recorded samples.
struct WeightSums {
    /// Number of samples.
    paths: f64,
    sum: f64,
    squares: f64,
}

/// Sums over the records of one path.
#[derive(Clone, Copy, Debug, Default)]
struct OwnSums {
    is_open: bool,
    light: f64,
    records: u32,
    intersections: u32,
    energy: f64,
}

/// Rows of a group while paths are added.
#[derive(Default)]
struct Rows {
    sums: Vec<Sums>,
    own: Vec<OwnSums>,
    /// Rows of the current path.
    open: Vec<usize>,
}

impl Rows {
    fn new(count: usize) -> Self {
        Self { sums: vec![Sums::default(); count], own: vec![OwnSums::default(); count], open: Vec::new() }
    }

    fn row(&mut self, row: usize) -> &mut OwnSums {
        if row >= self.own.len() {
            self.own.resize(row + 1, OwnSums::default());
            self.sums.resize(row + 1, Sums::default());
        }
        let own = &mut self.own[row];
        if !own.is_open {
            own.is_open = true;
            self.open.push(row);
        }
        own
    }

    /// Adds the sums of the current path.
    fn close(&mut self, weight: f64) {
        for row in self.open.drain(..) {
            self.sums[row].add(&self.own[row], weight);
            self.own[row] = OwnSums::default();
        }
    }
}

/// Rows of named things: the rows to which each name adds.
struct NamedRows {
    subjects: Vec<RowSubject>,
    by_number: Vec<Vec<usize>>,
    nameless: usize,
}

impl NamedRows {
    /// Creates the rows of objects with all their parents, and of media.
    fn objects(paths: &RecordedPaths) -> Self {
        Self::new(paths, NameKind::Object, RowSubject::Object, RowSubject::Nameless, outer_names)
    }

    /// Creates the rows of lamps and of media that emit.
    fn lamps(paths: &RecordedPaths) -> Self {
        Self::new(paths, NameKind::Lamp, RowSubject::Lamp, RowSubject::FirstPass, |_| Vec::new())
    }

    fn new(
        paths: &RecordedPaths,
        kind: NameKind,
        subject: fn(String) -> RowSubject,
        nameless: RowSubject,
        parents: fn(&str) -> Vec<&str>,
    ) -> Self {
        let entries = paths.names().entries();
        let mut rows: BTreeMap<RowSubject, usize> = BTreeMap::new();
        let mut add = |subject: RowSubject| {
            let next = rows.len();
            *rows.entry(subject).or_insert(next)
        };
        let nameless = add(nameless);
        for (own, text) in entries {
            if *own == kind {
                parents(text).into_iter().chain([&text[..]]).for_each(|name| _ = add(subject(name.to_owned())));
            } else if *own == NameKind::Medium {
                add(RowSubject::Medium(text.clone()));
            }
        }
        let mut by_number = vec![vec![nameless]];
        for (own, text) in entries {
            let own_rows: Vec<usize> = if *own == kind {
                let all = parents(text).into_iter().chain([&text[..]]);
                all.filter_map(|name| rows.get(&subject(name.to_owned())).copied()).collect()
            } else {
                rows.get(&RowSubject::Medium(text.clone())).copied().into_iter().collect()
            };
            by_number.push(if own_rows.is_empty() { vec![nameless] } else { own_rows });
        }
        let mut subjects = vec![RowSubject::All; rows.len()];
        rows.into_iter().for_each(|(subject, row)| subjects[row] = subject);
        Self { subjects, by_number, nameless }
    }

    fn rows(&self, number: u32) -> &[usize] {
        self.by_number.get(number as usize).map_or(std::slice::from_ref(&self.nameless), |rows| rows)
    }
}

/// Returns the names of the objects that contain an object, the outermost first.
fn outer_names(text: &str) -> Vec<&str> {
    let ends = text.char_indices().filter(|(at, letter)| *at > 0 && matches!(letter, '.' | '/'));
    ends.map(|(at, _)| &text[..at]).collect()
}

impl RecordedPaths {
    /// Returns the light of the selected records in numbers.
    /// - `selected`: `None`: all records.
    pub fn summarize(
        &self,
        selected: Option<&SelectedRecords>,
        is_cancelled: &AtomicBool,
    ) -> Result<LightSummary, Cancelled> {
        let (objects, lamps) = (NamedRows::objects(self), NamedRows::lamps(self));
        let mut all = SummarySums {
            paths: self,
            total: Rows::new(1),
            objects: Rows::new(objects.subjects.len()),
            bounces: Rows::default(),
            bounce_rows: BTreeMap::new(),
            lamps: Rows::new(lamps.subjects.len()),
            names: [&objects, &lamps],
        };
        let mut weights = WeightSums { paths: f64::from(self.totals()[0]), sum: 0.0, squares: 0.0 };
        let mut check = CancelCheck::new(is_cancelled);
        for (number, (path, weight)) in (0u32..).zip(self.paths().iter().zip(self.image_weights())) {
            let length = path.intersections.len();
            check.add(1 + length * length + path.lights.len())?;
            let weight = *weight as f64 / (1u64 << IMAGE_BITS) as f64;
            weights.sum += weight;
            weights.squares += weight * weight;
            if selected.is_none_or(|selected| selected.paths.contains(number)) {
                all.add(number, path, selected);
                all.close(weight);
            }
        }
        if weights.sum == 0.0 {
            // Without samples, all sums are 0.
            weights = WeightSums { paths: 1.0, sum: 1.0, squares: 0.0 };
        }
        Ok(all.finish(&weights))
    }
}

/// Sums of all groups.
struct SummarySums<'a> {
    paths: &'a RecordedPaths,
    total: Rows,
    objects: Rows,
    bounces: Rows,
    /// Rows of bounces; `None`: the camera.
    bounce_rows: BTreeMap<Option<u32>, usize>,
    lamps: Rows,
    /// Rows of objects and of lamps.
    names: [&'a NamedRows; 2],
}

impl SummarySums<'_> {
    /// Adds the selected records of a selected path.
    fn add(&mut self, number: u32, path: &LightPath, selected: Option<&SelectedRecords>) {
        let Self { paths, total, objects, bounces, bounce_rows, lamps, names: [object_names, lamp_names] } = self;
        let mut bounce_row = |bounce: Option<u32>| {
            let next = bounce_rows.len();
            *bounce_rows.entry(bounce).or_insert(next)
        };
        total.row(0).light = f64::from(path.luminance());
        // Selected light found at each intersection or behind it.
        let mut found = vec![0.0; path.intersections.len()];
        for (at, it) in paths.lights_of(number).zip(&path.lights) {
            if selected.is_some_and(|selected| !selected.lights.contains(at)) {
                continue;
            }
            let light = f64::from(luminance(it.radiance));
            let vertex = (it.vertex as usize).min(path.intersections.len()).checked_sub(1);
            let bounce = vertex.map(|at| path.intersections[at].bounce);
            bounces.row(bounce_row(bounce)).light += light;
            if let Some(vertex) = vertex {
                found[vertex] += light;
            }
            for row in lamp_names.rows(paths.names().number(it.light)) {
                let own = lamps.row(*row);
                own.light += light;
                own.records += 1;
            }
        }
        for (index, it) in path.intersections.iter().enumerate().rev() {
            if let Some(parent) = (it.parent as usize).checked_sub(1).filter(|parent| *parent < index) {
                found[parent] += found[index];
            }
        }
        let first = paths.intersections_of(number).start;
        let rows_at = |index: usize| -> &[usize] {
            if selected.is_some_and(|selected| !selected.intersections.contains(first + index as u32)) {
                return &[];
            }
            let it = &path.intersections[index];
            let is_in_medium = it.object == Name::NONE && it.interaction == InteractionKind::Volume;
            object_names.rows(paths.names().number(if is_in_medium { it.material } else { it.object }))
        };
        for (index, it) in path.intersections.iter().enumerate() {
            let rows = rows_at(index);
            if rows.is_empty() {
                continue;
            }
            let energy = it.radiance.iter().map(|value| f64::from(*value)).sum::<f64>() / 3.0;
            let add = |own: &mut OwnSums| {
                own.records += 1;
                own.intersections += 1;
                own.energy += energy;
            };
            add(total.row(0));
            add(bounces.row(bounce_row(Some(it.bounce))));
            for row in rows {
                let own = objects.row(*row);
                add(own);
                // The first intersection of a branch with the object has the light of all later ones.
                let parent = |index: &usize| (path.intersections[*index].parent as usize).checked_sub(1);
                let mut before = std::iter::successors(parent(&index), parent);
                if before.all(|index| !rows_at(index).contains(row)) {
                    own.light += found[index];
                }
            }
        }
    }

    fn close(&mut self, weight: f64) {
        [&mut self.total, &mut self.objects, &mut self.bounces, &mut self.lamps]
            .into_iter()
            .for_each(|rows| rows.close(weight));
    }

    fn finish(self, weights: &WeightSums) -> LightSummary {
        let amounts = |rows: &Rows, subjects: &mut dyn Iterator<Item = (RowSubject, usize)>| {
            let all = subjects.map(|(subject, row)| (subject, &rows.sums[row])).filter(|(_, sums)| sums.paths > 0);
            all.map(|(subject, sums)| (subject, sums.amount(weights))).collect::<Vec<_>>()
        };
        let named = |names: &NamedRows| names.subjects.clone().into_iter().zip(0..);
        let bounce =
            |(bounce, row): (&Option<u32>, &usize)| (bounce.map_or(RowSubject::Camera, RowSubject::Bounce), *row);
        let mut groups = [
            amounts(&self.objects, &mut named(self.names[0])),
            amounts(&self.bounces, &mut self.bounce_rows.iter().map(bounce)),
            amounts(&self.lamps, &mut named(self.names[1])),
        ];
        let mut left_out = [0; 3];
        for (group, (rows, left_out)) in Group::ALL.into_iter().zip(groups.iter_mut().zip(&mut left_out)) {
            if group != Group::Bounce {
                rows.sort_by(|(a, x), (b, y)| y.light.value.total_cmp(&x.light.value).then_with(|| a.cmp(b)));
            }
            *left_out = rows.len().saturating_sub(MAX_ROWS);
            rows.truncate(MAX_ROWS);
        }
        LightSummary { total: self.total.sums[0].amount(weights), groups, left_out }
    }
}
