//! Answers about recorded light, for the light view.
//!
//! [`open_light`] is the function that [`femc_service::Site`] takes. It decodes and unites the light statistics of frames.

mod columns;
mod representatives;
mod rows;
mod schema;
mod summary;
#[cfg(test)]
mod tests;

use columns::Columns;
use femc_paths::histogram::Table;
use femc_paths::octree::{Root, Voxel, voxel_place};
use femc_paths::query::{Condition, Query};
use femc_paths::recorded::{Bounds, CountedSamples, HistogramRequest, PairKey, Weighting};
use femc_paths::selection::{Cancelled, SelectedRecords};
use femc_paths::{FrameStatistics, LightStatistics, MergeError, RecordedPaths};
use femc_service::{
    Corners, EarlierRows, LightAnswer, LightCall, LightCallKind, LightData, LightError, LightFault, LightSource,
    VoxelLevel,
};
use serde_json::{Value, json};
use std::fmt::Display;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Decodes recorded light and unites its frames. `None`: no path is recorded yet.
/// - `tag`: identifies the sources; all answers contain it.
pub fn open_light(tag: &str, sources: Vec<LightSource>) -> Result<Option<Arc<dyn LightData>>, LightFault> {
    let is_growing = sources.iter().any(|source| source.is_growing);
    let names: Vec<String> = sources.iter().map(|source| source.name.clone()).collect();
    let mut frames = FrameCollector::default();
    let mut has_parts = false;
    for source in sources {
        let own = || vec![source.name.clone()];
        let decoded = decode_source(&source).map_err(|(part, message)| LightFault { sources: own(), part, message })?;
        has_parts |= !decoded.is_empty();
        let fault = |error: MergeError| LightFault { sources: own(), part: None, message: error.to_string() };
        frames.add(decoded).map_err(fault)?;
    }
    let fault = |message: String| LightFault { sources: names.clone(), part: None, message };
    let paths = RecordedPaths::new(frames.finish().map_err(|error| fault(error.to_string()))?);
    if !paths.paths().is_empty() {
        return Ok(Some(Arc::new(RecordedLight { tag: tag.to_owned(), is_growing, paths })));
    }
    if !has_parts || is_growing {
        return Ok(None);
    }
    Err(fault("no recorded paths; render the frame again with --stats".into()))
}

/// Decodes the parts of a source: united frames, or parts of one frame. An error has the index of the part, if there are several.
fn decode_source(source: &LightSource) -> Result<Vec<LightStatistics>, (Option<usize>, String)> {
    let mut frames = Vec::new();
    let mut unfinished: Option<LightStatistics> = None;
    for (at, bytes) in source.parts.iter().enumerate() {
        let fault = |fault: &dyn Display| ((source.parts.len() > 1).then_some(at), fault.to_string());
        if FrameStatistics::has_magic(bytes) {
            let united = FrameStatistics::decode(bytes).map_err(|error| fault(&error))?;
            frames.extend(united.into_frames().into_iter().map(without_maps));
            continue;
        }
        let part = without_maps(LightStatistics::decode(bytes).map_err(|error| fault(&error))?);
        match &mut unfinished {
            Some(all) => all.merge_untrimmed(part).map_err(|error| fault(&error))?,
            None => unfinished = Some(part),
        }
    }
    if let Some(mut frame) = unfinished {
        frame.trim();
        frames.push(frame);
    }
    Ok(frames)
}

/// Removes data that no answer needs: sums of pixels, which take more memory than all the rest, and the deepest paths.
fn without_maps(mut frame: LightStatistics) -> LightStatistics {
    frame.portions.values_mut().for_each(|counters| counters.pixels = Vec::new());
    frame.deepest.clear();
    frame
}

/// Number of records of frames that are held in memory before the frames are united.
const MAX_PENDING_RECORDS: usize = 1 << 18;

/// Union of frames. Frames are united in groups: all at once would need much memory, and one by one would take long.
#[derive(Default)]
struct FrameCollector {
    frames: Vec<LightStatistics>,
    bounds: Option<Bounds>,
    has_several_boxes: bool,
    /// Number of records of frames that are not united yet.
    pending: usize,
}

impl FrameCollector {
    fn add(&mut self, frames: Vec<LightStatistics>) -> Result<(), MergeError> {
        for frame in frames {
            let own = [frame.scope.lower, frame.scope.upper];
            self.has_several_boxes |= *self.bounds.get_or_insert(own) != own;
            self.pending += frame.paths.len() + frame.brightest.len();
            self.frames.push(frame);
        }
        if self.pending > MAX_PENDING_RECORDS {
            self.frames = self.unite()?.into_frames();
        }
        Ok(())
    }

    fn unite(&mut self) -> Result<FrameStatistics, MergeError> {
        let mut frames = std::mem::take(&mut self.frames);
        self.pending = 0;
        if self.has_several_boxes {
            // The counts of all samples cannot be converted to another box. Recorded samples can be counted again.
            for frame in &mut frames {
                frame.scope.has_full_histograms = false;
                frame.portions.values_mut().for_each(|counters| counters.bins = Vec::new());
            }
        }
        FrameStatistics::from_statistics(frames)
    }

    fn finish(mut self) -> Result<FrameStatistics, MergeError> {
        self.unite()
    }
}

/// Decoded recorded light.
struct RecordedLight {
    tag: String,
    is_growing: bool,
    paths: RecordedPaths,
}

impl LightData for RecordedLight {
    fn memory_bytes(&self) -> usize {
        size_of::<Self>() + self.paths.memory_bytes()
    }

    fn answer(
        &self,
        call: &LightCall,
        earlier: Option<&EarlierRows>,
        is_cancelled: &AtomicBool,
    ) -> Result<LightAnswer, LightError> {
        let query = parse_query(call)?;
        let bounds = call.bounds.map(Corners::get);
        let answer = Answer { light: self, query: query.as_ref(), bounds, earlier, is_cancelled };
        match &call.kind {
            LightCallKind::Schema => Ok(LightAnswer::Json(schema::encode_schema(self))),
            LightCallKind::Paths { count, brightest: true } => answer.brightest(*count),
            LightCallKind::Paths { count, brightest: false } => answer.representatives(*count),
            LightCallKind::Histograms { pairs, by_image } => {
                answer.histograms(pairs.as_slice(), if *by_image { Weighting::Image } else { Weighting::Samples })
            }
            LightCallKind::Voxels { level, bounce } => answer.voxels(*level, *bounce),
            LightCallKind::Summary => answer.summary(),
            LightCallKind::Selection { with_density: true } => answer.selection(Density::ByPixel),
            LightCallKind::Selection { with_density: false } => answer.selection(Density::Omitted),
        }
    }
}

fn invalid(field: &'static str, message: impl Into<String>) -> LightError {
    LightError::Invalid { field, message: message.into() }
}

fn cancelled(_: Cancelled) -> LightError {
    LightError::Cancelled
}

/// Parses the condition of a call.
fn parse_query(call: &LightCall) -> Result<Option<Query>, LightError> {
    let Some(text) = &call.condition else { return Ok(None) };
    let condition = Condition::parse(text).map_err(|error| invalid("where", error.to_string()))?;
    Ok(Some(Query { condition: Some(condition), ..Query::default() }))
}

/// Part of a selection's answer about pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Density {
    ByPixel,
    Omitted,
}

/// Evaluation of one call.
struct Answer<'a> {
    light: &'a RecordedLight,
    query: Option<&'a Query>,
    bounds: Option<Bounds>,
    /// Rows that the client has.
    earlier: Option<&'a EarlierRows>,
    is_cancelled: &'a AtomicBool,
}

impl<'a> Answer<'a> {
    fn paths(&self) -> &'a RecordedPaths {
        &self.light.paths
    }

    /// Creates an answer without columns.
    fn columns(&self) -> Columns {
        let mut columns = Columns::new();
        columns.set("tag", json!(self.light.tag));
        columns.set("recorded", json!(self.paths().totals()[0]));
        columns
    }

    /// Returns the selected records; `None`: all.
    fn selected(&self) -> Result<Option<SelectedRecords>, LightError> {
        self.query.map(|query| self.paths().select(query, self.is_cancelled).map_err(cancelled)).transpose()
    }

    fn selection(&self, density: Density) -> Result<LightAnswer, LightError> {
        let (Some(query), Some(selected)) = (self.query, self.selected()?) else {
            return Err(invalid("where", "give a condition"));
        };
        let paths = self.paths();
        let mut columns = self.columns();
        columns.set("text", json!(query.to_condition().map(|condition| condition.to_string())));
        columns.set("counts", counts_by_table(selected.counts()));
        columns.set("totals", counts_by_table(paths.totals()));
        columns.set("light_share", json!(paths.light_share(&selected.paths)));
        columns.set("samples", json!(paths.estimate_samples(selected.counts()[0])));
        for table in Table::ALL {
            columns.add_u8(&format!("{}.mask", table.name()), selected.mask(table).as_bytes());
        }
        if density == Density::ByPixel {
            match paths.density(&selected.paths) {
                Ok(pixels) => {
                    columns.add_u32("density.pixel", pixels.iter().map(|it| it.pixel));
                    columns.add_f32("density.count", pixels.iter().map(|it| it.count as f32));
                    columns.add_f32("density.light", pixels.iter().map(|it| it.contribution as f32));
                    columns.add_f32("density.luminance", pixels.iter().map(|it| it.mean_luminance as f32));
                }
                Err(error) => columns.set("density_fault", json!(error.to_string())),
            }
        }
        Ok(LightAnswer::Columns(columns.finish()))
    }

    fn summary(&self) -> Result<LightAnswer, LightError> {
        let (paths, selected) = (self.paths(), self.selected()?);
        let found = paths.summarize(selected.as_ref(), self.is_cancelled).map_err(cancelled)?;
        Ok(LightAnswer::Json(summary::encode_summary(self.light, self.query, &found)))
    }

    fn histograms(&self, pairs: &[[usize; 3]], weighting: Weighting) -> Result<LightAnswer, LightError> {
        let pairs: Vec<PairKey> = pairs.iter().map(|pair| parse_pair(*pair)).collect::<Result<_, _>>()?;
        let selected = self.selected()?;
        let request = HistogramRequest { selected: selected.as_ref(), pairs: &pairs, weighting, bounds: self.bounds };
        let found = self.paths().histograms(&request, self.is_cancelled).map_err(cancelled)?;
        let mut columns = self.columns();
        let counted = match found.counted {
            CountedSamples::Recorded => "recorded",
            CountedSamples::All => "all samples",
        };
        columns.set("counted", json!(counted));
        let categories = self.paths().categories().iter().map(|it| {
            let name = it.table.attributes()[it.attribute].name;
            (format!("{}.{name}", it.table.name()), json!(it.names))
        });
        columns.set("categories", Value::Object(categories.collect()));
        for table in Table::ALL {
            for (axis, counts) in found.single[table as usize].iter().enumerate() {
                columns.add_f64(&format!("{}.{axis}", table.name()), counts);
            }
        }
        for (pair, counts) in pairs.iter().zip(&found.pairs) {
            let name = format!("{}.{}-{}", pair.table.name(), pair.row, pair.column);
            columns.add_f32(&name, counts.iter().copied());
        }
        Ok(LightAnswer::Columns(columns.finish()))
    }

    fn voxels(&self, level: VoxelLevel, bounce: Option<u32>) -> Result<LightAnswer, LightError> {
        let level = level.get();
        let [lower, upper] = self.bounds.unwrap_or_else(|| self.paths().bounds());
        let root = Root::around(lower, upper, level as u8);
        let selected = self.selected()?;
        let found = self.paths().voxels(root, selected.as_ref(), bounce, self.is_cancelled).map_err(cancelled)?;
        let index = |code: u64| {
            let [x, y, z] = voxel_place(code);
            (x | y << level | z << (2 * level)) as u32
        };
        let voxel = |(code, voxel): (u64, Voxel)| (index(code), voxel.count, voxel.energy.value());
        let mut voxels: Vec<(u32, u64, f64)> = found.into_iter().map(voxel).collect();
        voxels.sort_unstable_by_key(|(index, ..)| *index);
        let mut columns = self.columns();
        columns.set("cube", json!([lower, lower.map(|axis| axis + root.width)]));
        columns.set("level", json!(level));
        columns.add_u32("voxels.index", voxels.iter().map(|(index, ..)| *index));
        columns.add_u32("voxels.count", voxels.iter().map(|(_, count, _)| *count as u32));
        columns.add_f32("voxels.energy", voxels.iter().map(|(.., energy)| *energy as f32));
        Ok(LightAnswer::Columns(columns.finish()))
    }
}

/// Returns an object with a number for each table.
fn counts_by_table(counts: [u32; 3]) -> Value {
    Value::Object(
        Table::ALL.into_iter().zip(counts).map(|(table, count)| (table.name().to_owned(), json!(count))).collect(),
    )
}

fn parse_pair([table, row, column]: [usize; 3]) -> Result<PairKey, LightError> {
    let table =
        *Table::ALL.get(table).ok_or_else(|| invalid("pairs", "the tables are paths, intersections and lights"))?;
    let axes = table.attributes().len();
    if row >= axes || column >= axes {
        let fault = format!("{}:{row}-{column}: its attributes are 0 to {}", table.name(), axes - 1);
        return Err(invalid("pairs", fault));
    }
    Ok(PairKey { table, row, column })
}
