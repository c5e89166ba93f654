//! Rows and columns of the tables of `femc paths`.

use super::files::FrameSet;
use crate::attempts::{Audience, Cell, Column, Kind, column};
use femc_pipeline::paths::histogram::{Counts, Histograms, Table};
use femc_pipeline::paths::octree::{Octree, Root, Voxel};
use femc_pipeline::paths::pixels::{Pixel, PixelMaps};
use femc_pipeline::paths::query::Selection;
use femc_pipeline::paths::statistics::IMAGE_BITS;
use femc_pipeline::paths::{Intersection, LightPath, LightRecord, LightStatistics, Name};

/// A path that matches a query.
pub struct Match<'a> {
    /// Position of the path in the file.
    pub number: u32,
    /// Record of the path.
    pub path: &'a LightPath,
    /// Selected intersections and lights of the path.
    pub selection: Selection,
    /// Weight of the path among the representative paths.
    pub weight: Option<f64>,
}

/// A file with the results of a query.
pub struct QueriedFrame<'a> {
    /// Name of the file.
    pub file: &'a str,
    /// All statistics of the file.
    pub statistics: &'a LightStatistics,
    /// Paths that match the query.
    pub matches: Vec<Match<'a>>,
}

impl<'a> QueriedFrame<'a> {
    fn row<T>(&self, matching: &Match<'a>, item: T) -> PathItem<'a, T> {
        PathItem { file: self.file, statistics: self.statistics, number: matching.number, path: matching.path, item }
    }
}

/// A path with an item of it.
pub struct PathItem<'a, T> {
    file: &'a str,
    statistics: &'a LightStatistics,
    number: u32,
    path: &'a LightPath,
    item: T,
}

impl<T> PathItem<'_, T> {
    fn text(&self, name: Name) -> Cell {
        self.statistics.names.get(&name).map(|(_, text)| text.clone()).into()
    }

    fn pixel(&self) -> [u32; 2] {
        let (pixel, width) = (self.path.key.pixel, self.statistics.scope.film[0].max(1));
        [pixel % width, pixel / width]
    }

    fn weight(&self) -> Cell {
        Cell::Real(image_pixels(self.statistics.image_weight(self.path.key)))
    }
}

/// Converts units of a part of the image to pixels.
fn image_pixels(units: u64) -> f64 {
    units as f64 / (1u64 << IMAGE_BITS) as f64
}

fn number(value: u32) -> Cell {
    Cell::Count(u64::from(value))
}

fn real(value: f32) -> Cell {
    Cell::Real(f64::from(value))
}

fn word(text: &str) -> Cell {
    Cell::Text(text.to_owned())
}

use Audience::{Comparing, Everyone, Programs};
use Kind::{Count, Number, Text};

/// A path with the number of its matching intersections, the first of them, and the path's weight.
pub type PathRow<'a> = PathItem<'a, (usize, Option<&'a Intersection>, Option<f64>)>;

/// Returns the rows of matching paths.
pub fn path_rows<'a>(frame: &'a QueriedFrame<'a>) -> Vec<PathRow<'a>> {
    let row = |it: &Match<'a>| {
        let selected = &it.selection.intersections;
        let first = selected.first().map(|index| &it.path.intersections[*index as usize]);
        frame.row(it, (selected.len(), first, it.weight))
    };
    frame.matches.iter().map(row).collect()
}

/// Returns the columns of paths.
pub fn path_columns<'a>() -> Vec<Column<PathRow<'a>>> {
    vec![
        column("file", "file", Text, Comparing, |row| word(row.file)),
        column("frame", "frame", Count, Comparing, |row| number(row.statistics.scope.frame)),
        column("path", "path", Count, Programs, |row| number(row.number)),
        column("pixel_x", "x", Count, Everyone, |row| number(row.pixel()[0])),
        column("pixel_y", "y", Count, Everyone, |row| number(row.pixel()[1])),
        column("sample", "sample", Count, Everyone, |row| number(row.path.key.sample)),
        column("radiance_r", "red cd/m2", Number, Everyone, |row| real(row.path.radiance[0])),
        column("radiance_g", "green", Number, Everyone, |row| real(row.path.radiance[1])),
        column("radiance_b", "blue", Number, Everyone, |row| real(row.path.radiance[2])),
        column("throughput_r", "throughput r", Number, Programs, |row| real(row.path.throughput[0])),
        column("throughput_g", "throughput", Number, Everyone, |row| real(row.path.throughput[1])),
        column("throughput_b", "throughput b", Number, Programs, |row| real(row.path.throughput[2])),
        column("depth", "depth", Count, Everyone, |row| number(row.path.depth)),
        column("end", "end", Text, Everyone, |row| word(row.path.end.word())),
        column("matches", "matches", Count, Everyone, |row| Cell::Count(row.item.0 as u64)),
        column("bounce", "first at bounce", Count, Everyone, |row| row.item.1.map(|it| u64::from(it.bounce)).into()),
        column("object", "object", Text, Everyone, |row| row.item.1.map_or(Cell::Empty, |it| row.text(it.object))),
        column("material", "material", Text, Everyone, |row| {
            row.item.1.map_or(Cell::Empty, |it| row.text(it.material))
        }),
        column("interaction", "interaction", Text, Everyone, |row| {
            row.item.1.map_or(Cell::Empty, |it| word(it.interaction.word()))
        }),
        column("pixels", "pixels", Number, Programs, PathItem::weight),
        column("weight", "weight", Number, Programs, |row| row.item.2.map_or(Cell::Empty, Cell::Real)),
    ]
}

/// An intersection and its position in the path.
pub type IntersectionRow<'a> = PathItem<'a, (usize, &'a Intersection)>;

/// Returns the rows of matching intersections.
pub fn intersection_rows<'a>(frame: &'a QueriedFrame<'a>) -> Vec<IntersectionRow<'a>> {
    let rows = frame.matches.iter().flat_map(|it| {
        it.selection.intersections.iter().map(move |&index| {
            let index = index as usize;
            frame.row(it, (index, &it.path.intersections[index]))
        })
    });
    rows.collect()
}

/// Returns the columns of intersections.
pub fn intersection_columns<'a>() -> Vec<Column<IntersectionRow<'a>>> {
    vec![
        column("file", "file", Text, Comparing, |row| word(row.file)),
        column("frame", "frame", Count, Comparing, |row| number(row.statistics.scope.frame)),
        column("path", "path", Count, Everyone, |row| number(row.number)),
        column("vertex", "vertex", Count, Everyone, |row| Cell::Count(row.item.0 as u64 + 1)),
        column("parent", "parent", Count, Programs, |row| number(row.item.1.parent)),
        column("bounce", "bounce", Count, Everyone, |row| number(row.item.1.bounce)),
        column("x", "x m", Number, Everyone, |row| Cell::Real(row.item.1.position[0])),
        column("y", "y", Number, Everyone, |row| Cell::Real(row.item.1.position[1])),
        column("z", "z", Number, Everyone, |row| Cell::Real(row.item.1.position[2])),
        column("radiance_r", "red cd/m2", Number, Everyone, |row| real(row.item.1.radiance[0])),
        column("radiance_g", "green", Number, Everyone, |row| real(row.item.1.radiance[1])),
        column("radiance_b", "blue", Number, Everyone, |row| real(row.item.1.radiance[2])),
        column("throughput_r", "throughput r", Number, Programs, |row| real(row.item.1.throughput[0])),
        column("throughput_g", "throughput", Number, Everyone, |row| real(row.item.1.throughput[1])),
        column("throughput_b", "throughput b", Number, Programs, |row| real(row.item.1.throughput[2])),
        column("object", "object", Text, Everyone, |row| row.text(row.item.1.object)),
        column("material", "material", Text, Everyone, |row| row.text(row.item.1.material)),
        column("interaction", "interaction", Text, Everyone, |row| word(row.item.1.interaction.word())),
        column("pixels", "pixels", Number, Programs, PathItem::weight),
    ]
}

/// A light of a path.
pub type LightRow<'a> = PathItem<'a, &'a LightRecord>;

/// Returns the rows of lights that the paths sampled or hit.
pub fn light_rows<'a>(frame: &'a QueriedFrame<'a>) -> Vec<LightRow<'a>> {
    let selected = |it: &'a Match<'a>| {
        it.selection.lights.iter().map(move |&index| frame.row(it, &it.path.lights[index as usize]))
    };
    frame.matches.iter().flat_map(selected).collect()
}

/// Returns the columns of lights.
pub fn light_columns<'a>() -> Vec<Column<LightRow<'a>>> {
    vec![
        column("file", "file", Text, Comparing, |row| word(row.file)),
        column("frame", "frame", Count, Comparing, |row| number(row.statistics.scope.frame)),
        column("path", "path", Count, Everyone, |row| number(row.number)),
        column("vertex", "vertex", Count, Everyone, |row| number(row.item.vertex)),
        column("light", "light", Text, Everyone, |row| row.text(row.item.light)),
        column("medium", "medium", Text, Programs, |row| row.text(row.item.medium)),
        column("radiance_r", "red cd/m2", Number, Everyone, |row| real(row.item.radiance[0])),
        column("radiance_g", "green", Number, Everyone, |row| real(row.item.radiance[1])),
        column("radiance_b", "blue", Number, Everyone, |row| real(row.item.radiance[2])),
        column("is_hidden", "hidden", Count, Programs, |row| Cell::Count(u64::from(row.item.occluder.is_some()))),
        column("occluder", "hidden by", Text, Everyone, |row| row.item.occluder.map_or(Cell::Empty, |it| row.text(it))),
        column("found", "found by", Text, Everyone, |row| word(row.item.technique.word())),
        column("pixels", "pixels", Number, Programs, PathItem::weight),
    ]
}

/// A bin of an attribute's histogram.
pub struct BinRow<'a> {
    file: &'a str,
    table: Table,
    attribute: &'static str,
    bin: u8,
    lower: Option<f64>,
    samples: u64,
    image: u64,
}

/// Returns the bins of all histograms.
pub fn bin_rows(set: &FrameSet) -> Vec<BinRow<'_>> {
    let (file, mut rows) = (&set.file[..], Vec::new());
    for table in Table::ALL {
        let of = |all: &LightStatistics| {
            Histograms::attributes_of_all_samples(all, table)
                .unwrap_or_else(|| Histograms::from_statistics(all, table).attributes)
        };
        let histograms = sum_counts(set.frames.iter().map(of));
        for (attribute, counts) in table.attributes().iter().zip(&histograms) {
            for (bin, (samples, image)) in (0u8..).zip(counts.samples.iter().zip(&counts.image)) {
                let lower = set.frames.first().and_then(|all| attribute.scale.lower_edge(&all.scope, bin));
                let (samples, image) = (*samples, *image);
                rows.push(BinRow { file, table, attribute: attribute.name, bin, lower, samples, image });
            }
        }
    }
    rows
}

/// Sums the counts of frames with equal bins.
fn sum_counts(mut frames: impl Iterator<Item = Vec<Counts>>) -> Vec<Counts> {
    let mut all = frames.next().unwrap_or_default();
    for counts in frames {
        all.iter_mut().zip(&counts).for_each(|(all, counts)| all.merge(counts));
    }
    all
}

/// Returns the columns of bins.
pub fn bin_columns<'a>() -> Vec<Column<BinRow<'a>>> {
    vec![
        column("file", "file", Text, Comparing, |row| word(row.file)),
        column("table", "table", Text, Everyone, |row| word(row.table.name())),
        column("attribute", "attribute", Text, Everyone, |row| word(row.attribute)),
        column("bin", "bin", Count, Everyone, |row| number(row.bin.into())),
        column("lower", "from", Number, Everyone, |row| row.lower.map_or(Cell::Empty, Cell::Real)),
        column("samples", "records", Count, Everyone, |row| Cell::Count(row.samples)),
        column("pixels", "pixels", Number, Everyone, |row| Cell::Real(image_pixels(row.image))),
    ]
}

/// A bin of two attributes that is not empty.
pub struct PairRow<'a> {
    file: &'a str,
    table: Table,
    attributes: [&'static str; 2],
    bins: [u32; 2],
    samples: u64,
    image: u64,
}

/// Returns the non-empty bins of all histograms of two attributes.
pub fn pair_rows(set: &FrameSet) -> Vec<PairRow<'_>> {
    let (file, mut rows) = (&set.file[..], Vec::new());
    for table in Table::ALL {
        let pairs = sum_counts(set.frames.iter().map(|all| Histograms::from_statistics(all, table).pairs));
        for (attributes, counts) in table.pairs().zip(&pairs) {
            for (place, (&samples, &image)) in (0u32..).zip(counts.samples.iter().zip(&counts.image)) {
                if samples > 0 {
                    rows.push(PairRow { file, table, attributes, bins: [place / 64, place % 64], samples, image });
                }
            }
        }
    }
    rows
}

/// Returns the columns of bins of two attributes.
pub fn pair_columns<'a>() -> Vec<Column<PairRow<'a>>> {
    vec![
        column("file", "file", Text, Comparing, |row| word(row.file)),
        column("table", "table", Text, Everyone, |row| word(row.table.name())),
        column("a", "a", Text, Everyone, |row| word(row.attributes[0])),
        column("b", "b", Text, Everyone, |row| word(row.attributes[1])),
        column("bin_a", "bin of a", Count, Everyone, |row| number(row.bins[0])),
        column("bin_b", "bin of b", Count, Everyone, |row| number(row.bins[1])),
        column("samples", "records", Count, Everyone, |row| Cell::Count(row.samples)),
        column("pixels", "pixels", Number, Everyone, |row| Cell::Real(image_pixels(row.image))),
    ]
}

/// A voxel of one bounce.
pub struct VoxelRow<'a> {
    file: &'a str,
    bounce: u32,
    lower: [f64; 3],
    width: f64,
    voxel: Voxel,
}

/// Number of times that the scene's box is halved.
pub const OCTREE_LEVELS: u8 = 6;

fn octree(frames: &[QueriedFrame<'_>], root: Root) -> Octree {
    Octree::from_paths(root, frames.iter().flat_map(|frame| &frame.matches).map(|it| it.path))
}

/// Returns the voxels of the frames of one file.
pub fn voxel_rows<'a>(frames: &[QueriedFrame<'a>], root: Root) -> Vec<VoxelRow<'a>> {
    let file = frames.first().map_or("", |frame| frame.file);
    let row = |(&(bounce, code), &voxel): (&(u32, u64), &Voxel)| {
        let (lower, width) = root.voxel(OCTREE_LEVELS, code);
        VoxelRow { file, bounce, lower, width, voxel }
    };
    octree(frames, root).leaves.iter().map(row).collect()
}

/// Comparison of a voxel between two sets of frames.
pub struct DifferenceRow {
    lower: [f64; 3],
    width: f64,
    here: Voxel,
    there: Voxel,
    /// Mean here minus mean there, cd/m2.
    difference: f64,
}

/// Compares voxels over all bounces. The greatest difference comes first.
pub fn difference_rows(here: &[QueriedFrame<'_>], there: &[QueriedFrame<'_>], root: Root) -> Vec<DifferenceRow> {
    let [here, there] = [here, there].map(|frames| octree(frames, root));
    let [own, others] = [&here, &there].map(|tree| tree.level(OCTREE_LEVELS, None));
    // Both trees have the same root, so the difference exists.
    let differences = here.difference(&there, OCTREE_LEVELS, None).unwrap_or_default();
    let row = |(code, difference): (u64, f64)| {
        let (lower, width) = root.voxel(OCTREE_LEVELS, code);
        let [here, there] = [&own, &others].map(|voxels| voxels.get(&code).copied().unwrap_or_default());
        DifferenceRow { lower, width, here, there, difference }
    };
    let mut rows: Vec<DifferenceRow> = differences.into_iter().map(row).collect();
    rows.sort_by(|a, b| b.difference.abs().total_cmp(&a.difference.abs()));
    rows
}

/// Returns the columns of differences between voxels.
pub fn difference_columns() -> Vec<Column<DifferenceRow>> {
    vec![
        column("x", "from x m", Number, Everyone, |row| Cell::Real(row.lower[0])),
        column("y", "y", Number, Everyone, |row| Cell::Real(row.lower[1])),
        column("z", "z", Number, Everyone, |row| Cell::Real(row.lower[2])),
        column("width", "width m", Number, Everyone, |row| Cell::Real(row.width)),
        column("intersections", "intersections", Count, Everyone, |row| Cell::Count(row.here.count)),
        column("energy", "mean cd/m2", Number, Everyone, |row| Cell::Real(row.here.mean())),
        column("intersections_there", "there", Count, Everyone, |row| Cell::Count(row.there.count)),
        column("energy_there", "mean there", Number, Everyone, |row| Cell::Real(row.there.mean())),
        column("difference", "difference", Number, Everyone, |row| Cell::Real(row.difference)),
    ]
}

/// Returns the columns of voxels.
pub fn voxel_columns<'a>() -> Vec<Column<VoxelRow<'a>>> {
    vec![
        column("file", "file", Text, Comparing, |row| word(row.file)),
        column("bounce", "bounce", Count, Everyone, |row| number(row.bounce)),
        column("x", "from x m", Number, Everyone, |row| Cell::Real(row.lower[0])),
        column("y", "y", Number, Everyone, |row| Cell::Real(row.lower[1])),
        column("z", "z", Number, Everyone, |row| Cell::Real(row.lower[2])),
        column("width", "width m", Number, Everyone, |row| Cell::Real(row.width)),
        column("intersections", "intersections", Count, Everyone, |row| Cell::Count(row.voxel.count)),
        column("energy", "mean cd/m2", Number, Everyone, |row| Cell::Real(row.voxel.mean())),
    ]
}

/// A pixel and its position.
pub struct PixelRow<'a> {
    file: &'a str,
    frame: u32,
    position: [u32; 2],
    pixel: Pixel,
}

/// Returns the pixels of a frame.
pub fn pixel_rows<'a>(frame: &'a QueriedFrame<'a>) -> Vec<PixelRow<'a>> {
    let maps = PixelMaps::from_statistics(frame.statistics);
    let width = maps.film[0].max(1);
    let row = |(number, pixel): (u32, Pixel)| PixelRow {
        file: frame.file,
        frame: frame.statistics.scope.frame,
        position: [number % width, number / width],
        pixel,
    };
    (0..).zip(maps.pixels()).map(row).collect()
}

/// Returns the columns of pixels.
pub fn pixel_columns<'a>() -> Vec<Column<PixelRow<'a>>> {
    vec![
        column("file", "file", Text, Comparing, |row| word(row.file)),
        column("frame", "frame", Count, Comparing, |row| number(row.frame)),
        column("pixel_x", "x", Count, Everyone, |row| number(row.position[0])),
        column("pixel_y", "y", Count, Everyone, |row| number(row.position[1])),
        column("samples", "samples", Count, Everyone, |row| Cell::Count(row.pixel.samples)),
        column("luminance", "cd/m2", Number, Everyone, |row| Cell::Real(row.pixel.luminance)),
        column("variance", "variance of a sample", Number, Everyone, |row| Cell::Real(row.pixel.variance)),
        column("depth", "depth", Number, Everyone, |row| Cell::Real(row.pixel.depth)),
        column("throughput", "throughput", Number, Everyone, |row| Cell::Real(row.pixel.throughput)),
    ]
}
