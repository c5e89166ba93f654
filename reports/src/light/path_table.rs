//! Rows and columns of the tables of `femc paths`.

use super::files::Unit;
use crate::attempts::{Cell, Column, Kind, Reader, column};
use femc_pipeline::paths::histogram::{Counts, Histograms, Table};
use femc_pipeline::paths::octree::{Octree, Root, Voxel};
use femc_pipeline::paths::pixels::{Maps, Pixel};
use femc_pipeline::paths::schema::{Scale, radiance_edge, throughput_edge};
use femc_pipeline::paths::statistics::IMAGE_BITS;
use femc_pipeline::paths::{Intersection, Light, Name, Path, Scope, Statistics};
use std::collections::BTreeSet;

/// A path that matches a query.
pub struct Match<'a> {
    /// Position of the path in the file.
    pub number: u32,
    /// Record of the path.
    pub path: &'a Path,
    /// Positions of the intersections that match the query.
    pub places: BTreeSet<usize>,
    /// Weight of the path among the representative paths.
    pub weight: Option<f64>,
}

/// A file with the results of a query.
pub struct Frame<'a> {
    /// Name of the file.
    pub file: &'a str,
    /// All statistics of the file.
    pub all: &'a Statistics,
    /// Paths that match the query.
    pub found: Vec<Match<'a>>,
}

impl<'a> Frame<'a> {
    fn of<T>(&self, found: &Match<'a>, it: T) -> Of<'a, T> {
        Of { file: self.file, all: self.all, number: found.number, path: found.path, it }
    }
}

/// A path with an item of it.
pub struct Of<'a, T> {
    file: &'a str,
    all: &'a Statistics,
    number: u32,
    path: &'a Path,
    it: T,
}

impl<T> Of<'_, T> {
    fn text(&self, name: Name) -> Cell {
        self.all.names.get(&name).map(|(_, text)| text.clone()).into()
    }

    fn pixel(&self) -> [u32; 2] {
        let (pixel, width) = (self.path.key.pixel, self.all.scope.film[0].max(1));
        [pixel % width, pixel / width]
    }

    fn weight(&self) -> Cell {
        Cell::Real(part(self.all.image_weight(self.path.key)))
    }
}

/// Converts units of a part of the image to pixels.
fn part(units: u64) -> f64 {
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

use Kind::{Count, Number, Text};
use Reader::{Anybody, Programs, WhoCompares};

/// A path with the number of its matching intersections, the first of them, and the path's weight.
pub type PathRow<'a> = Of<'a, (usize, Option<&'a Intersection>, Option<f64>)>;

/// Returns the rows of matching paths.
pub fn path_rows<'a>(frame: &'a Frame<'a>) -> Vec<PathRow<'a>> {
    let row = |it: &Match<'a>| {
        let first = it.places.first().map(|place| &it.path.intersections[*place]);
        frame.of(it, (it.places.len(), first, it.weight))
    };
    frame.found.iter().map(row).collect()
}

/// Returns the columns of paths.
pub fn paths<'a>() -> Vec<Column<PathRow<'a>>> {
    vec![
        column("file", "file", Text, WhoCompares, |row| word(row.file)),
        column("frame", "frame", Count, WhoCompares, |row| number(row.all.scope.frame)),
        column("path", "path", Count, Programs, |row| number(row.number)),
        column("pixel_x", "x", Count, Anybody, |row| number(row.pixel()[0])),
        column("pixel_y", "y", Count, Anybody, |row| number(row.pixel()[1])),
        column("sample", "sample", Count, Anybody, |row| number(row.path.key.sample)),
        column("radiance_r", "red cd/m2", Number, Anybody, |row| real(row.path.radiance[0])),
        column("radiance_g", "green", Number, Anybody, |row| real(row.path.radiance[1])),
        column("radiance_b", "blue", Number, Anybody, |row| real(row.path.radiance[2])),
        column("throughput_r", "throughput r", Number, Programs, |row| real(row.path.throughput[0])),
        column("throughput_g", "throughput", Number, Anybody, |row| real(row.path.throughput[1])),
        column("throughput_b", "throughput b", Number, Programs, |row| real(row.path.throughput[2])),
        column("depth", "depth", Count, Anybody, |row| number(row.path.depth)),
        column("end", "end", Text, Anybody, |row| word(row.path.end.word())),
        column("matches", "matches", Count, Anybody, |row| Cell::Count(row.it.0 as u64)),
        column("bounce", "first at bounce", Count, Anybody, |row| row.it.1.map(|it| u64::from(it.bounce)).into()),
        column("object", "object", Text, Anybody, |row| row.it.1.map_or(Cell::Gap, |it| row.text(it.object))),
        column("material", "material", Text, Anybody, |row| row.it.1.map_or(Cell::Gap, |it| row.text(it.material))),
        column("interaction", "interaction", Text, Anybody, |row| {
            row.it.1.map_or(Cell::Gap, |it| word(it.interaction.word()))
        }),
        column("pixels", "pixels", Number, Programs, Of::weight),
        column("weight", "weight", Number, Programs, |row| row.it.2.map_or(Cell::Gap, Cell::Real)),
    ]
}

/// An intersection and its position in the path.
pub type IntersectionRow<'a> = Of<'a, (usize, &'a Intersection)>;

/// Returns the rows of matching intersections.
pub fn intersection_rows<'a>(frame: &'a Frame<'a>) -> Vec<IntersectionRow<'a>> {
    let rows = frame
        .found
        .iter()
        .flat_map(|it| it.places.iter().map(move |&place| frame.of(it, (place, &it.path.intersections[place]))));
    rows.collect()
}

/// Returns the columns of intersections.
pub fn intersections<'a>() -> Vec<Column<IntersectionRow<'a>>> {
    vec![
        column("file", "file", Text, WhoCompares, |row| word(row.file)),
        column("frame", "frame", Count, WhoCompares, |row| number(row.all.scope.frame)),
        column("path", "path", Count, Anybody, |row| number(row.number)),
        column("vertex", "vertex", Count, Anybody, |row| Cell::Count(row.it.0 as u64 + 1)),
        column("bounce", "bounce", Count, Anybody, |row| number(row.it.1.bounce)),
        column("x", "x m", Number, Anybody, |row| Cell::Real(row.it.1.position[0])),
        column("y", "y", Number, Anybody, |row| Cell::Real(row.it.1.position[1])),
        column("z", "z", Number, Anybody, |row| Cell::Real(row.it.1.position[2])),
        column("radiance_r", "red cd/m2", Number, Anybody, |row| real(row.it.1.radiance[0])),
        column("radiance_g", "green", Number, Anybody, |row| real(row.it.1.radiance[1])),
        column("radiance_b", "blue", Number, Anybody, |row| real(row.it.1.radiance[2])),
        column("throughput_r", "throughput r", Number, Programs, |row| real(row.it.1.throughput[0])),
        column("throughput_g", "throughput", Number, Anybody, |row| real(row.it.1.throughput[1])),
        column("throughput_b", "throughput b", Number, Programs, |row| real(row.it.1.throughput[2])),
        column("object", "object", Text, Anybody, |row| row.text(row.it.1.object)),
        column("material", "material", Text, Anybody, |row| row.text(row.it.1.material)),
        column("interaction", "interaction", Text, Anybody, |row| word(row.it.1.interaction.word())),
        column("pixels", "pixels", Number, Programs, Of::weight),
    ]
}

/// A light of a path.
pub type LightRow<'a> = Of<'a, &'a Light>;

/// Returns the rows of lights that the paths sampled or hit.
pub fn light_rows<'a>(frame: &'a Frame<'a>) -> Vec<LightRow<'a>> {
    frame.found.iter().flat_map(|it| it.path.lights.iter().map(move |light| frame.of(it, light))).collect()
}

/// Returns the columns of lights.
pub fn lights<'a>() -> Vec<Column<LightRow<'a>>> {
    vec![
        column("file", "file", Text, WhoCompares, |row| word(row.file)),
        column("frame", "frame", Count, WhoCompares, |row| number(row.all.scope.frame)),
        column("path", "path", Count, Anybody, |row| number(row.number)),
        column("vertex", "vertex", Count, Anybody, |row| number(row.it.vertex)),
        column("light", "light", Text, Anybody, |row| row.text(row.it.light)),
        column("medium", "medium", Text, Programs, |row| row.text(row.it.medium)),
        column("radiance_r", "red cd/m2", Number, Anybody, |row| real(row.it.radiance[0])),
        column("radiance_g", "green", Number, Anybody, |row| real(row.it.radiance[1])),
        column("radiance_b", "blue", Number, Anybody, |row| real(row.it.radiance[2])),
        column("is_hidden", "hidden", Count, Programs, |row| Cell::Count(u64::from(row.it.occluder.is_some()))),
        column("occluder", "hidden by", Text, Anybody, |row| row.it.occluder.map_or(Cell::Gap, |it| row.text(it))),
        column("found", "found by", Text, Anybody, |row| word(row.it.found.word())),
        column("pixels", "pixels", Number, Programs, Of::weight),
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
pub fn bin_rows(unit: &Unit) -> Vec<BinRow<'_>> {
    let (file, mut rows) = (&unit.file[..], Vec::new());
    for table in Table::ALL {
        let of =
            |all: &Statistics| Histograms::of_all(all, table).unwrap_or_else(|| Histograms::of(all, table).attributes);
        let histograms = summed(unit.frames.iter().map(of));
        for (attribute, counts) in table.attributes().iter().zip(&histograms) {
            for (bin, (samples, image)) in (0u8..).zip(counts.samples.iter().zip(&counts.image)) {
                let lower = unit.frames.first().and_then(|all| lower(&all.scope, attribute.name, attribute.scale, bin));
                let (samples, image) = (*samples, *image);
                rows.push(BinRow { file, table, attribute: attribute.name, bin, lower, samples, image });
            }
        }
    }
    rows
}

/// Sums the counts of frames with equal bins.
fn summed(mut frames: impl Iterator<Item = Vec<Counts>>) -> Vec<Counts> {
    let mut all = frames.next().unwrap_or_default();
    for counts in frames {
        all.iter_mut().zip(&counts).for_each(|(all, counts)| all.merge(counts));
    }
    all
}

/// Returns the lower end of a bin; `None`: the bin stands for words, names or missing values.
fn lower(scope: &Scope, name: &str, scale: Scale, bin: u8) -> Option<f64> {
    let axis = || "xyz".find(&name[name.len() - 1..]);
    match scale {
        Scale::Radiance => Some(radiance_edge(bin)),
        Scale::Throughput => Some(throughput_edge(bin)),
        Scale::Count => Some(f64::from(bin)),
        Scale::Film => axis().map(|axis| f64::from(scope.film[axis]) * f64::from(bin) / 64.0),
        Scale::World => {
            let (axis, bin) = (axis()?, bin.checked_sub(1)?);
            Some(scope.lower[axis] + (scope.upper[axis] - scope.lower[axis]) * f64::from(bin) / 63.0)
        }
        Scale::Class | Scale::Name => None,
    }
}

/// Returns the columns of bins.
pub fn histograms<'a>() -> Vec<Column<BinRow<'a>>> {
    vec![
        column("file", "file", Text, WhoCompares, |row| word(row.file)),
        column("table", "table", Text, Anybody, |row| word(row.table.name())),
        column("attribute", "attribute", Text, Anybody, |row| word(row.attribute)),
        column("bin", "bin", Count, Anybody, |row| number(row.bin.into())),
        column("lower", "from", Number, Anybody, |row| row.lower.map_or(Cell::Gap, Cell::Real)),
        column("samples", "records", Count, Anybody, |row| Cell::Count(row.samples)),
        column("pixels", "pixels", Number, Anybody, |row| Cell::Real(part(row.image))),
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
pub fn pair_rows(unit: &Unit) -> Vec<PairRow<'_>> {
    let (file, mut rows) = (&unit.file[..], Vec::new());
    for table in Table::ALL {
        let pairs = summed(unit.frames.iter().map(|all| Histograms::of(all, table).pairs));
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
pub fn pairs<'a>() -> Vec<Column<PairRow<'a>>> {
    vec![
        column("file", "file", Text, WhoCompares, |row| word(row.file)),
        column("table", "table", Text, Anybody, |row| word(row.table.name())),
        column("a", "a", Text, Anybody, |row| word(row.attributes[0])),
        column("b", "b", Text, Anybody, |row| word(row.attributes[1])),
        column("bin_a", "bin of a", Count, Anybody, |row| number(row.bins[0])),
        column("bin_b", "bin of b", Count, Anybody, |row| number(row.bins[1])),
        column("samples", "records", Count, Anybody, |row| Cell::Count(row.samples)),
        column("pixels", "pixels", Number, Anybody, |row| Cell::Real(part(row.image))),
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
pub const LEVELS: u8 = 6;

fn octree(frames: &[Frame<'_>], root: Root) -> Octree {
    Octree::of(root, frames.iter().flat_map(|frame| &frame.found).map(|it| it.path))
}

/// Returns the voxels of the frames of one file.
pub fn voxel_rows<'a>(frames: &[Frame<'a>], root: Root) -> Vec<VoxelRow<'a>> {
    let file = frames.first().map_or("", |frame| frame.file);
    let row = |(&(bounce, code), &voxel): (&(u32, u64), &Voxel)| {
        let (lower, width) = root.voxel(LEVELS, code);
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
pub fn difference_rows(here: &[Frame<'_>], there: &[Frame<'_>], root: Root) -> Vec<DifferenceRow> {
    let [here, there] = [here, there].map(|frames| octree(frames, root));
    let [own, others] = [&here, &there].map(|tree| tree.level(LEVELS, None));
    // Both trees have the same root, so the difference exists.
    let differences = here.difference(&there, LEVELS, None).unwrap_or_default();
    let row = |(code, difference): (u64, f64)| {
        let (lower, width) = root.voxel(LEVELS, code);
        let [here, there] = [&own, &others].map(|voxels| voxels.get(&code).copied().unwrap_or_default());
        DifferenceRow { lower, width, here, there, difference }
    };
    let mut rows: Vec<DifferenceRow> = differences.into_iter().map(row).collect();
    rows.sort_by(|a, b| b.difference.abs().total_cmp(&a.difference.abs()));
    rows
}

/// Returns the columns of differences between voxels.
pub fn differences() -> Vec<Column<DifferenceRow>> {
    vec![
        column("x", "from x m", Number, Anybody, |row| Cell::Real(row.lower[0])),
        column("y", "y", Number, Anybody, |row| Cell::Real(row.lower[1])),
        column("z", "z", Number, Anybody, |row| Cell::Real(row.lower[2])),
        column("width", "width m", Number, Anybody, |row| Cell::Real(row.width)),
        column("intersections", "intersections", Count, Anybody, |row| Cell::Count(row.here.count)),
        column("energy", "mean cd/m2", Number, Anybody, |row| Cell::Real(row.here.mean())),
        column("intersections_there", "there", Count, Anybody, |row| Cell::Count(row.there.count)),
        column("energy_there", "mean there", Number, Anybody, |row| Cell::Real(row.there.mean())),
        column("difference", "difference", Number, Anybody, |row| Cell::Real(row.difference)),
    ]
}

/// Returns the columns of voxels.
pub fn voxels<'a>() -> Vec<Column<VoxelRow<'a>>> {
    vec![
        column("file", "file", Text, WhoCompares, |row| word(row.file)),
        column("bounce", "bounce", Count, Anybody, |row| number(row.bounce)),
        column("x", "from x m", Number, Anybody, |row| Cell::Real(row.lower[0])),
        column("y", "y", Number, Anybody, |row| Cell::Real(row.lower[1])),
        column("z", "z", Number, Anybody, |row| Cell::Real(row.lower[2])),
        column("width", "width m", Number, Anybody, |row| Cell::Real(row.width)),
        column("intersections", "intersections", Count, Anybody, |row| Cell::Count(row.voxel.count)),
        column("energy", "mean cd/m2", Number, Anybody, |row| Cell::Real(row.voxel.mean())),
    ]
}

/// A pixel and its position.
pub struct PixelRow<'a> {
    file: &'a str,
    frame: u32,
    place: [u32; 2],
    pixel: Pixel,
}

/// Returns the pixels of a frame.
pub fn pixel_rows<'a>(frame: &'a Frame<'a>) -> Vec<PixelRow<'a>> {
    let maps = Maps::of(frame.all);
    let width = maps.film[0].max(1);
    let row = |(number, pixel): (u32, Pixel)| PixelRow {
        file: frame.file,
        frame: frame.all.scope.frame,
        place: [number % width, number / width],
        pixel,
    };
    (0..).zip(maps.pixels()).map(row).collect()
}

/// Returns the columns of pixels.
pub fn pixels<'a>() -> Vec<Column<PixelRow<'a>>> {
    vec![
        column("file", "file", Text, WhoCompares, |row| word(row.file)),
        column("frame", "frame", Count, WhoCompares, |row| number(row.frame)),
        column("pixel_x", "x", Count, Anybody, |row| number(row.place[0])),
        column("pixel_y", "y", Count, Anybody, |row| number(row.place[1])),
        column("samples", "samples", Count, Anybody, |row| Cell::Count(row.pixel.samples)),
        column("luminance", "cd/m2", Number, Anybody, |row| Cell::Real(row.pixel.luminance)),
        column("variance", "variance of a sample", Number, Anybody, |row| Cell::Real(row.pixel.variance)),
        column("depth", "depth", Number, Anybody, |row| Cell::Real(row.pixel.depth)),
        column("throughput", "throughput", Number, Anybody, |row| Cell::Real(row.pixel.throughput)),
    ]
}
