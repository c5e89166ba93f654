//! Paths with their intersections and lights, as columns.

use super::columns::{Columns, NO_RECORD};
use super::{Answer, cancelled};
use femc_paths::histogram::Table;
use femc_paths::query::Selection;
use femc_paths::record::luminance;
use femc_paths::schema::{INTERSECTION_ATTRIBUTES, LIGHT_ATTRIBUTES, PATH_ATTRIBUTES};
use femc_paths::selection::CancelCheck;
use femc_paths::{Intersection, LightPath, LightRecord, Name};
use femc_service::{LightAnswer, LightError};
use serde_json::{Value, json};

/// Path of an answer.
struct Row<'a> {
    path: &'a LightPath,
    /// Index of its frame.
    frame: usize,
    /// Number among the recorded paths.
    number: Option<u32>,
    weight: f64,
}

impl<'a> Answer<'a> {
    /// Returns paths that represent all selected paths.
    pub fn representatives(&self, count: usize) -> Result<LightAnswer, LightError> {
        let paths = self.paths();
        let selected = self.selected()?;
        let mask = selected.as_ref().map(|it| &it.paths);
        let found = paths.choose_representatives(mask, self.bounds, count, self.is_cancelled).map_err(cancelled)?;
        let row = |(&number, &weight): (&u32, &f64)| Row {
            path: &paths.paths()[number as usize],
            frame: paths.frame_of(number),
            number: Some(number),
            weight,
        };
        let rows: Vec<Row<'_>> = found.numbers.iter().zip(&found.weights).map(row).collect();
        let header = [
            ("candidates", json!(found.represented)),
            ("d", json!(found.distance.single)),
            ("dj", json!(found.distance.joint)),
            ("effective_size", json!(found.effective_size)),
        ];
        Ok(LightAnswer::Columns(self.rows(&rows, header).finish()))
    }

    /// Returns the brightest of all samples, with marks at what is selected of them.
    pub fn brightest(&self, count: usize) -> Result<LightAnswer, LightError> {
        let paths = self.paths();
        let shown = &paths.brightest()[..paths.brightest().len().min(count)];
        let marks = self.mark_selected(shown)?;
        let numbers = paths.numbers_of(shown.iter().map(|(frame, path)| (*frame, path.key)));
        let row = |((frame, path), number): (&'a (u32, LightPath), Option<u32>)| Row {
            path,
            frame: *frame as usize,
            number,
            weight: 1.0,
        };
        let rows: Vec<Row<'_>> = shown.iter().zip(numbers).map(row).collect();
        let header = [
            ("candidates", json!(paths.brightest().len())),
            ("d", Value::Null),
            ("dj", Value::Null),
            ("effective_size", json!(rows.len())),
        ];
        let mut columns = self.rows(&rows, header);
        columns.set("selected", json!(marks[0].iter().filter(|mark| **mark == 1).count()));
        for (table, marks) in Table::ALL.into_iter().zip(&marks) {
            columns.add_u8(&column_name(table, "selected"), marks);
        }
        Ok(LightAnswer::Columns(columns.finish()))
    }

    /// Returns a mark for each path, intersection and light of some samples: 1 if it is selected, else 0.
    fn mark_selected(&self, samples: &[(u32, LightPath)]) -> Result<[Vec<u8>; 3], LightError> {
        // First intersection and first light of each sample, and of one past the last.
        let mut firsts = vec![[0, 0]];
        for (at, (_, path)) in samples.iter().enumerate() {
            let [intersections, lights] = firsts[at];
            firsts.push([intersections + path.intersections.len(), lights + path.lights.len()]);
        }
        let [intersections, lights] = firsts[samples.len()];
        let lengths = [samples.len(), intersections, lights];
        let Some(query) = self.query else { return Ok(lengths.map(|length| vec![1; length])) };
        let mut marks = lengths.map(|length| vec![0; length]);
        let (mut check, mut own) = (CancelCheck::new(self.is_cancelled), Selection::default());
        for (index, frame) in (0u32..).zip(self.paths().frames()) {
            let mut of_frame = (0..).zip(samples).filter(|(_, (frame, _))| *frame == index).peekable();
            if of_frame.peek().is_none() {
                continue;
            }
            check.look().map_err(cancelled)?;
            let matcher = query.compile(&frame.scope, &frame.names);
            for (at, (_, path)) in of_frame {
                check.add(matcher.work(path)).map_err(cancelled)?;
                if matcher.select_into(path, &mut own) {
                    let [intersection, light]: [usize; 2] = firsts[at];
                    marks[0][at] = 1;
                    own.intersections.iter().for_each(|it| marks[1][intersection + *it as usize] = 1);
                    own.lights.iter().for_each(|it| marks[2][light + *it as usize] = 1);
                }
            }
        }
        Ok(marks)
    }

    fn rows(&self, rows: &[Row<'_>], header: [(&str, Value); 4]) -> Columns {
        let paths = self.paths();
        let mut columns = self.columns();
        columns.set("set", json!(rows.len()));
        header.into_iter().for_each(|(field, value)| columns.set(field, value));
        let values: Vec<[f32; PATH_ATTRIBUTES.len()]> = rows.iter().map(|row| self.path_values(row)).collect();
        for (axis, attribute) in PATH_ATTRIBUTES.iter().enumerate() {
            columns.add_f32(&column_name(Table::Paths, attribute.name), values.iter().map(|row| row[axis]));
        }
        columns.add_u32("paths.number", rows.iter().map(|row| row.number.unwrap_or(NO_RECORD)));
        columns.add_f32("paths.weight", rows.iter().map(|row| row.weight as f32));
        columns.add_u32("paths.frame", rows.iter().map(|row| row.path.key.frame));
        columns.add_u32("paths.sample", rows.iter().map(|row| row.path.key.sample));

        let mut intersections = Vec::new();
        let (mut owners, mut parents, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
        let mut lights = Vec::new();
        let (mut light_owners, mut light_parents, mut light_numbers) = (Vec::new(), Vec::new(), Vec::new());
        for (at, row) in (0u32..).zip(rows) {
            let first = intersections.len() as u32;
            let number = |base: Option<u32>, index: u32| base.map_or(NO_RECORD, |base| base + index);
            let base = row.number.map(|own| paths.intersections_of(own).start);
            for (index, it) in (0u32..).zip(&row.path.intersections) {
                intersections.push(self.intersection_values(it));
                owners.push(at);
                parents.push(index.checked_sub(1).map_or(NO_RECORD, |before| first + before));
                numbers.push(number(base, index));
            }
            let base = row.number.map(|own| paths.lights_of(own).start);
            for (index, it) in (0u32..).zip(&row.path.lights) {
                lights.push(self.light_values(it));
                light_owners.push(at);
                light_parents.push(row.path.parent(it).map_or(NO_RECORD, |parent| first + parent));
                light_numbers.push(number(base, index));
            }
        }
        for (axis, attribute) in INTERSECTION_ATTRIBUTES.iter().enumerate() {
            let name = column_name(Table::Intersections, attribute.name);
            columns.add_f32(&name, intersections.iter().map(|row| row[axis]));
        }
        columns.add_u32("intersections.path", owners);
        columns.add_u32("intersections.parent", parents);
        columns.add_u32("intersections.number", numbers);
        for (axis, attribute) in LIGHT_ATTRIBUTES.iter().enumerate() {
            columns.add_f32(&column_name(Table::Lights, attribute.name), lights.iter().map(|row| row[axis]));
        }
        columns.add_u32("lights.path", light_owners);
        columns.add_u32("lights.intersection", light_parents);
        columns.add_u32("lights.number", light_numbers);
        columns
    }

    fn name_value(&self, name: Name) -> f32 {
        self.paths().names().number(name) as f32
    }

    /// Returns the attributes of a path, in the order of the schema. Positions without an intersection are not a number.
    fn path_values(&self, row: &Row<'_>) -> [f32; PATH_ATTRIBUTES.len()] {
        let path = row.path;
        let width = self.paths().frames()[row.frame].scope.film[0].max(1);
        let ([r, g, b], [tr, tg, tb]) = (path.radiance, path.throughput);
        let (first, last) = (path.intersections.first(), path.intersections.last());
        let position = |it: Option<&Intersection>| it.map_or([f32::NAN; 3], |it| it.position.map(|axis| axis as f32));
        let ([fx, fy, fz], [lx, ly, lz]) = (position(first), position(last));
        let brightest = path.brightest_light();
        [
            (path.key.pixel % width) as f32,
            (path.key.pixel / width) as f32,
            r,
            g,
            b,
            tr,
            tg,
            tb,
            path.depth as f32,
            f32::from(path.end as u8 + 1),
            fx,
            fy,
            fz,
            first.map_or(0.0, |it| f32::from(it.interaction as u8 + 1)),
            first.map_or(0.0, |it| self.name_value(it.object)),
            lx,
            ly,
            lz,
            brightest.map_or(0.0, |it| luminance(it.radiance)),
            brightest.map_or(0.0, |it| self.name_value(it.light)),
        ]
    }

    fn intersection_values(&self, it: &Intersection) -> [f32; INTERSECTION_ATTRIBUTES.len()] {
        let ([x, y, z], [r, g, b]) = (it.position.map(|axis| axis as f32), it.radiance);
        let (object, material) = (self.name_value(it.object), self.name_value(it.material));
        [it.bounce as f32, x, y, z, r, g, b, object, material, f32::from(it.interaction as u8 + 1)]
    }

    fn light_values(&self, it: &LightRecord) -> [f32; LIGHT_ATTRIBUTES.len()] {
        let [r, g, b] = it.radiance;
        let occluder = it.occluder.map_or(0.0, |name| self.name_value(name));
        [r, g, b, self.name_value(it.light), occluder, f32::from(it.technique as u8 + 1)]
    }
}

fn column_name(table: Table, attribute: &str) -> String {
    format!("{}.{attribute}", table.name())
}
