//! Choice of the paths of an answer: representative ones, or the brightest.

use super::columns::Columns;
use super::rows::{Row, RowTable, kept_rows};
use super::{Answer, cancelled};
use femc_paths::LightPath;
use femc_paths::histogram::Table;
use femc_paths::query::Selection;
use femc_paths::selection::CancelCheck;
use femc_service::{LightAnswer, LightError, PathCount, RowIdentity};
use serde_json::{Value, json};
use std::sync::Arc;

impl<'a> Answer<'a> {
    /// Returns paths that represent all selected paths.
    pub fn representatives(&self, count: PathCount) -> Result<LightAnswer, LightError> {
        let (paths, count) = (self.paths(), count.get() as usize);
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
        let (mut columns, identities) = self.columns_of_rows(&RowTable::new(paths, &rows));
        header.into_iter().for_each(|(field, value)| columns.set(field, value));
        Ok(self.answer_with_rows(columns, identities))
    }

    /// Returns the brightest of all samples, with marks at what is selected of them.
    pub fn brightest(&self, count: PathCount) -> Result<LightAnswer, LightError> {
        let paths = self.paths();
        let shown = &paths.brightest()[..paths.brightest().len().min(count.get() as usize)];
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
        let (mut columns, identities) = self.columns_of_rows(&RowTable::new(paths, &rows));
        header.into_iter().for_each(|(field, value)| columns.set(field, value));
        columns.set("selected", json!(marks[0].iter().filter(|mark| **mark == 1).count()));
        for (table, marks) in Table::ALL.into_iter().zip(&marks) {
            columns.add_u8(&format!("{}.selected", table.name()), marks);
        }
        Ok(self.answer_with_rows(columns, identities))
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

    /// Writes the columns of rows, or only what differs from the rows that the client has. Returns the identities of rows that may
    /// change.
    fn columns_of_rows(&self, rows: &RowTable) -> (Columns, Option<Arc<[RowIdentity]>>) {
        let mut columns = self.columns();
        columns.set("set", json!(rows.len()));
        columns.set("growing", json!(self.light.is_growing));
        // Rows of finished data do not change. Their answers are kept by the client's cache.
        let identities: Option<Arc<[RowIdentity]>> =
            (self.light.is_growing || self.earlier.is_some()).then(|| rows.identities());
        let kept = identities.as_ref().zip(self.earlier).and_then(|(own, earlier)| kept_rows(own, earlier));
        match (kept, self.earlier) {
            (Some(kept), Some(earlier)) => {
                columns.set("since", json!(earlier.tag));
                rows.write_difference(&mut columns, &kept);
            }
            _ => rows.write(&mut columns),
        }
        (columns, identities.filter(|_| self.light.is_growing))
    }

    fn answer_with_rows(&self, columns: Columns, identities: Option<Arc<[RowIdentity]>>) -> LightAnswer {
        match identities {
            Some(identities) => LightAnswer::Rows { columns: columns.finish(), identities },
            None => LightAnswer::Columns(columns.finish()),
        }
    }
}
