//! A field as bytes: the result of the first pass, for storage and transfer. Equal fields give equal bytes, and decoding restores
//! the field to the bit. All numbers are little-endian.
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCFELD` |
//! | 4 | format version, 8 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 8 x 8 | [`SolveStatistics`]: elements, leaves, links, links with light sources, refused links, rays, iterations, bytes |
//! | 4 | the residual |
//! | 12 x 4 | numbers of instances, primitives of all of them, surfaces, cells, leaves, leaves with direct light (all or 0), errors of leaves, boxes that contain all fog (1 or 0), boxes of fog, leaves with tables of directions (all or 0), boxes of fog with tables (all or 0), tables |
//! | 8 | bytes of the tables below |
//! | rest | zstd frame of the tables |
//!
//! A table is a number of records of equal length, made of words of 4 bytes, and stored in byte planes (the lowest byte of the
//! first word of all records, then the next):
//!
//! | table | words of a record |
//! | --- | --- |
//! | instances | number of primitives |
//! | primitives | surface of the front, of the back |
//! | surfaces | instance, first and last primitive, material, form and side, first cell |
//! | flat surfaces, in order | corner and edges: 9 |
//! | curved surfaces, in order | the shape: 8, unused ones are 0; the pose: 12 |
//! | cells | split, next, corner and edges over the parameters: 6 |
//! | leaves | 0: triangle, 1: rectangle, 2: curved |
//! | triangles, rectangles, curved leaves, in order | 9, 12, 27 |
//! | direct light of the leaves: the same tables, or none | 1, 9, 12, 27 |
//! | errors of the leaves, or none | 1 |
//! | the box that contains all fog | lower corner, upper corner: 6 |
//! | boxes of fog, halves in the order of the split boxes | 0, 1, 2: split across this axis, 3: leaf |
//! | splits, in order | coordinate |
//! | leaves of fog, in order | mean and its changes, anisotropy, scattering and extinction coefficient: 21 |
//! | tables of leaves, of boxes of fog that are leaves | index |
//! | tables | 0: hemisphere, 1: sphere; pole; sums of probabilities by cell: 516 |
//!
//! The checksum is verified first. Decompression never yields more than the header says, and no memory is allocated for data that
//! has not been decompressed. An accepted field can be evaluated anywhere: indices are in their ranges, trees have no cycles, and
//! light and coefficients of fog are finite and not negative.

use crate::{
    Cell, DirectionTable, DirectionTables, Field, FogCell, FogLeaf, FogTree, Form, Harmonics, Leaf, NONE, Outline,
    Side, Split, Surface, TABLE_CELLS, TableExtent,
};
use femc_geometry::{Facing, Quadric};
use femc_math::Rgb;
use femc_math::glam::{Affine3A, Mat3A, Vec2, Vec3A};
use std::io::Read;
use std::mem::discriminant;

const MAGIC: &[u8; 8] = b"FEMCFELD";
const VERSION: u32 = 8;
const CHECKSUM: usize = 16;
const PREFIX: usize = MAGIC.len() + 4 + CHECKSUM;
/// Maximum number of bytes of all tables: 4 GiB.
const MAX_TABLE_BYTES: u64 = 1 << 32;
/// Maximum window of data that is read back. It bounds the memory of the decompressor.
const WINDOW_LOG: u32 = 23;
const COMPRESSION_LEVEL: i32 = 3;

/// Statistics of a first pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SolveStatistics {
    /// Number of parts of surfaces and of fog.
    pub elements: u64,
    /// Number of elements that are not split.
    pub leaves: u64,
    /// Number of links among elements.
    pub links: u64,
    /// Number of links with light sources.
    pub lamp_links: u64,
    /// Number of links that are less exact than requested.
    pub inexact_links: u64,
    /// Number of visibility rays.
    pub rays: u64,
    /// Number of iterations, each of which passes light through all links.
    pub iterations: u64,
    /// Number of bytes of elements, links and rays during the solution.
    pub bytes: u64,
    /// Estimated change of the light that leaves all elements by further iterations, as a share of that light.
    pub residual: f32,
}

/// Reason why bytes cannot be decoded as a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FieldError {
    /// The bytes have another version of the format.
    #[error("the field has format {found}, but this program reads format {expected}")]
    Version {
        /// Version of the bytes.
        found: u32,
        /// Version that this build reads.
        expected: u32,
    },
    /// The bytes are damaged or not a field.
    #[error("invalid field: {0}")]
    Corrupt(&'static str),
}

/// Words of a table of directions.
const TABLE_WORDS: usize = TABLE_CELLS + 4;

const TRUNCATED: FieldError = FieldError::Corrupt("cut short");
const INDEX: FieldError = FieldError::Corrupt("an index is out of its range");

impl Field {
    /// Encodes the field as bytes, with its statistics.
    pub fn encode(&self, statistics: &SolveStatistics) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        out.extend(VERSION.to_le_bytes());
        out.extend([0; CHECKSUM]);
        let SolveStatistics {
            elements,
            leaves,
            links,
            lamp_links,
            inexact_links: refused,
            rays,
            iterations,
            bytes,
            residual,
        } = *statistics;
        let counts = [elements, leaves, links, lamp_links, refused, rays, iterations, bytes];
        counts.iter().for_each(|count| out.extend(count.to_le_bytes()));
        out.extend(residual.to_bits().to_le_bytes());
        let primitives: usize = self.sides.iter().map(Vec::len).sum();
        let lengths = [
            self.sides.len(),
            primitives,
            self.surfaces.len(),
            self.cells.len(),
            self.leaves.len(),
            self.direct.len(),
            self.errors.len(),
            usize::from(!self.fog.is_empty()),
            self.fog.cells().count(),
            self.tables.parts().0.len(),
            self.tables.parts().1.len(),
            self.tables.parts().2.len(),
        ];
        lengths.iter().for_each(|&length| out.extend((length as u32).to_le_bytes()));
        let tables = self.encode_tables();
        out.extend((tables.len() as u64).to_le_bytes());
        // Compression from memory to a growing buffer cannot fail. If it fails nevertheless, the result does not decode.
        out.extend(zstd::bulk::compress(&tables, COMPRESSION_LEVEL).unwrap_or_default());
        let sum = blake3::hash(&out[PREFIX..]);
        out[PREFIX - CHECKSUM..PREFIX].copy_from_slice(&sum.as_bytes()[..CHECKSUM]);
        out
    }

    fn encode_tables(&self) -> Vec<u8> {
        let mut out = Vec::new();
        write_table(&mut out, self.sides.iter().map(|sides| [sides.len() as u32]));
        write_table(&mut out, self.sides.iter().flatten().copied());
        let surface = |(surface, &root): (&Surface, &u32)| {
            let Surface { instance, primitives: [first, last], material, side, form } = surface;
            [*instance, *first, *last, *material, form_tag(form) << 1 | u32::from(*side == Side::Back), root]
        };
        write_table(&mut out, self.surfaces.iter().zip(&self.roots).map(surface));
        let forms = || self.surfaces.iter().map(|surface| &surface.form);
        let flat = |form: &Form| match form {
            Form::Triangle(corner) | Form::Parallelogram(corner) => Some(color_words::<3, 9>(corner)),
            Form::Curved { .. } => None,
        };
        write_table(&mut out, forms().filter_map(flat));
        let curved = |form: &Form| match form {
            Form::Triangle(_) | Form::Parallelogram(_) => None,
            Form::Curved { shape, pose } => {
                let Mat3A { x_axis, y_axis, z_axis } = pose.matrix3;
                let pose: [u32; 12] = color_words(&[x_axis, y_axis, z_axis, pose.translation]);
                let shape = shape_parameters(shape).map(f32::to_bits);
                Some(std::array::from_fn::<u32, 20, _>(|at| if at < 8 { shape[at] } else { pose[at - 8] }))
            }
        };
        write_table(&mut out, forms().filter_map(curved));
        let cell = |cell: &Cell| {
            let split = match cell.split {
                Split::None => 0,
                Split::Half(0) => 1,
                Split::Half(_) => 2,
                Split::Bisection => 3,
            };
            let Outline { corner, edges: [a, b] } = cell.outline;
            let [x, y, ax, ay, bx, by] = [corner.x, corner.y, a.x, a.y, b.x, b.y].map(f32::to_bits);
            [split, cell.next, x, y, ax, ay, bx, by]
        };
        write_table(&mut out, self.cells.iter().map(cell));
        write_leaves(&mut out, &self.leaves);
        write_leaves(&mut out, &self.direct);
        write_table(&mut out, self.errors.iter().map(|error| [error.to_bits()]));
        self.encode_fog_tables(&mut out);
        self.encode_direction_tables(&mut out);
        out
    }

    fn encode_direction_tables(&self, out: &mut Vec<u8>) {
        let (leaves, fog, tables) = self.tables.parts();
        write_table(out, leaves.iter().map(|index| [*index]));
        write_table(out, fog.iter().map(|index| [*index]));
        let words = |table: &DirectionTable| {
            let (kind, pole) = match table.extent() {
                TableExtent::Hemisphere(normal) => (0, normal),
                TableExtent::Sphere => (1, Vec3A::ZERO),
            };
            let sums = table.sums();
            std::array::from_fn::<u32, TABLE_WORDS, _>(|at| match at {
                0 => kind,
                1..4 => pole[at - 1].to_bits(),
                _ => sums[at - 4].to_bits(),
            })
        };
        write_table(out, tables.iter().map(words));
    }

    fn encode_fog_tables(&self, out: &mut Vec<u8>) {
        let fog = &self.fog;
        write_table(out, (!fog.is_empty()).then(|| color_words::<2, 6>(&fog.bounds())).into_iter());
        let kind = |cell| match cell {
            FogCell::Split { axis, .. } => [u32::from(axis)],
            FogCell::Leaf(_) => [3],
        };
        write_table(out, fog.cells().map(kind));
        let cut = |cell| if let FogCell::Split { at, .. } = cell { Some([at.to_bits()]) } else { None };
        write_table(out, fog.cells().filter_map(cut));
        let leaf = |&FogLeaf { mean: [a, b, c, d], anisotropy, sigma_s, sigma_t }: &FogLeaf| {
            color_words::<7, 21>(&[a, b, c, d, anisotropy, sigma_s, sigma_t])
        };
        write_table(out, fog.leaves().map(leaf));
    }

    /// Decodes a field and its statistics. Damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<(Self, SolveStatistics), FieldError> {
        let (prefix, body) = bytes.split_at_checked(PREFIX).ok_or(TRUNCATED)?;
        if prefix[..MAGIC.len()] != MAGIC[..] {
            return Err(FieldError::Corrupt("wrong magic number"));
        }
        let mut front = HeaderReader(&prefix[MAGIC.len()..]);
        let found = front.read_u32()?;
        if found != VERSION {
            return Err(FieldError::Version { found, expected: VERSION });
        }
        if blake3::hash(body).as_bytes()[..CHECKSUM] != *front.0 {
            return Err(FieldError::Corrupt("checksum mismatch"));
        }
        let mut front = HeaderReader(body);
        let statistics = SolveStatistics {
            elements: front.read_u64()?,
            leaves: front.read_u64()?,
            links: front.read_u64()?,
            lamp_links: front.read_u64()?,
            inexact_links: front.read_u64()?,
            rays: front.read_u64()?,
            iterations: front.read_u64()?,
            bytes: front.read_u64()?,
            residual: f32::from_bits(front.read_u32()?),
        };
        let mut lengths = [0; 12];
        for length in &mut lengths {
            *length = front.read_u32()?;
        }
        let plain = front.read_u64()?;
        let tables = decompress(front.0, plain)?;
        Ok((read_tables(TableReader(&tables), lengths)?, statistics))
    }

    /// Checks whether the field belongs to these surfaces.
    /// - `primitives`: number of primitives of each instance of a world.
    pub fn matches_primitives(&self, primitives: impl ExactSizeIterator<Item = usize>) -> bool {
        self.sides.len() == primitives.len() && self.sides.iter().zip(primitives).all(|(sides, of)| sides.len() == of)
    }
}

fn decompress(bytes: &[u8], plain: u64) -> Result<Vec<u8>, FieldError> {
    const LENGTH: FieldError = FieldError::Corrupt("the tables have a wrong length");
    const DAMAGED: FieldError = FieldError::Corrupt("the tables cannot be decompressed");
    if plain > MAX_TABLE_BYTES {
        return Err(LENGTH);
    }
    let mut decoder = zstd::stream::read::Decoder::with_buffer(bytes).map_err(|_| DAMAGED)?;
    decoder.window_log_max(WINDOW_LOG).map_err(|_| DAMAGED)?;
    let mut tables = Vec::new();
    decoder.take(plain + 1).read_to_end(&mut tables).map_err(|_| DAMAGED)?;
    if tables.len() as u64 == plain { Ok(tables) } else { Err(LENGTH) }
}

fn read_tables(mut tables: TableReader<'_>, lengths: [u32; 12]) -> Result<Field, FieldError> {
    let [instances, primitives, surfaces, cells, leaves, direct, errors, roots_of_fog, boxes, counts @ ..] = lengths;
    let instances: Vec<[u32; 1]> = tables.read_table(instances)?;
    if instances.iter().map(|[count]| u64::from(*count)).sum::<u64>() != u64::from(primitives) {
        return Err(FieldError::Corrupt("wrong number of primitives"));
    }
    let primitives: Vec<[u32; 2]> = tables.read_table(primitives)?;
    if primitives.as_flattened().iter().any(|&surface| surface != NONE && surface >= surfaces) {
        return Err(INDEX);
    }
    let mut rest = &primitives[..];
    let sides = instances.iter().map(|[count]| {
        let (own, others) = rest.split_at(*count as usize);
        rest = others;
        own.to_vec()
    });
    let sides: Vec<Vec<[u32; 2]>> = sides.collect();
    let records: Vec<[u32; 6]> = tables.read_table(surfaces)?;
    let tags = || records.iter().map(|record| record[4] >> 1);
    let mut flat = tables.read_table(tags().filter(|tag| *tag < FIRST_CURVED_TAG).count() as u32)?.into_iter();
    let mut curved = tables.read_table(tags().filter(|tag| *tag >= FIRST_CURVED_TAG).count() as u32)?.into_iter();
    let (mut surfaces, mut roots) = (Vec::with_capacity(records.len()), Vec::with_capacity(records.len()));
    for [instance, first, last, material, form, root] in records {
        let of = sides.get(instance as usize).map_or(0, Vec::len);
        if first as usize >= of || last as usize >= of || (root != NONE && root >= cells) {
            return Err(INDEX);
        }
        let side = if form & 1 == 0 { Side::Front } else { Side::Back };
        let form = match form >> 1 {
            tag if tag < FIRST_CURVED_TAG => {
                let corner = vectors_from_words::<3, 9>(&flat.next().ok_or(TRUNCATED)?);
                if tag == 0 { Form::Triangle(corner) } else { Form::Parallelogram(corner) }
            }
            tag => {
                let words: [u32; 20] = curved.next().ok_or(TRUNCATED)?;
                let values = std::array::from_fn(|at| f32::from_bits(words[at]));
                let [x_axis, y_axis, z_axis, translation] =
                    vectors_from_words::<4, 12>(&std::array::from_fn(|at| words[8 + at]));
                let pose = Affine3A { matrix3: Mat3A { x_axis, y_axis, z_axis }, translation };
                Form::Curved { shape: shape_from_tag(tag, &values).ok_or(FieldError::Corrupt("unknown shape"))?, pose }
            }
        };
        surfaces.push(Surface { instance, primitives: [first, last], material, side, form });
        roots.push(root);
    }
    let records: Vec<[u32; 8]> = tables.read_table(cells)?;
    let mut all = Vec::with_capacity(records.len());
    for (index, [split, next, outline @ ..]) in records.into_iter().enumerate() {
        let split = match split {
            0 => Split::None,
            1 => Split::Half(0),
            2 => Split::Half(1),
            3 => Split::Bisection,
            _ => return Err(FieldError::Corrupt("unknown kind of split")),
        };
        let is_sound = if split == Split::None { next < leaves } else { is_below(index, next, cells) };
        if !is_sound {
            return Err(INDEX);
        }
        let [x, y, ax, ay, bx, by] = outline.map(f32::from_bits);
        let outline = Outline { corner: Vec2::new(x, y), edges: [Vec2::new(ax, ay), Vec2::new(bx, by)] };
        all.push(Cell { outline, split, next });
    }
    if direct != 0 && direct != leaves {
        return Err(FieldError::Corrupt("wrong number of leaves with direct light"));
    }
    if errors != 0 && errors != leaves {
        return Err(FieldError::Corrupt("wrong number of errors"));
    }
    let leaves = read_leaves(&mut tables, leaves)?;
    let direct = read_leaves(&mut tables, direct)?;
    let is_same = |(leaf, direct): (&Leaf, &Leaf)| discriminant(leaf) == discriminant(direct);
    if !leaves.iter().zip(&direct).all(is_same) {
        return Err(FieldError::Corrupt("direct light of another kind of leaf"));
    }
    let errors: Vec<f32> = tables.read_table::<1>(errors)?.into_iter().map(|[error]| f32::from_bits(error)).collect();
    if !errors.iter().all(|error| error.is_finite() && *error >= 0.0) {
        return Err(FieldError::Corrupt("an error is not a number of at least 0"));
    }
    let fog = read_fog(&mut tables, roots_of_fog, boxes)?;
    let direction_tables = read_direction_tables(&mut tables, counts, [leaves.len(), fog.leaves().count()])?;
    if !tables.0.is_empty() {
        return Err(FieldError::Corrupt("extra bytes follow the tables"));
    }
    Ok(Field { surfaces, roots, leaves, direct, errors, tables: direction_tables, cells: all, sides, fog })
}

/// Reads tables of directions.
/// - `counts`: numbers of leaves, of leaves of fog, and of tables;
/// - `leaves`: numbers of all leaves, and of all leaves of fog.
fn read_direction_tables(
    tables: &mut TableReader<'_>,
    [of_leaves, of_fog, count]: [u32; 3],
    leaves: [usize; 2],
) -> Result<DirectionTables, FieldError> {
    const INVALID: FieldError = FieldError::Corrupt("invalid tables of directions");
    if [of_leaves, of_fog].iter().zip(leaves).any(|(&count, all)| count != 0 && count as usize != all) {
        return Err(INVALID);
    }
    let [of_leaves, of_fog] = [of_leaves, of_fog].map(|count| tables.read_table::<1>(count));
    let table = |words: [u32; TABLE_WORDS]| {
        let extent = match words[0] {
            0 => TableExtent::Hemisphere(Vec3A::from_array([1, 2, 3].map(|at| f32::from_bits(words[at])))),
            1 => TableExtent::Sphere,
            _ => return None,
        };
        DirectionTable::from_sums(extent, Box::new(std::array::from_fn(|at| f32::from_bits(words[at + 4]))))
    };
    let all: Option<Vec<DirectionTable>> = tables.read_table(count)?.into_iter().map(table).collect();
    DirectionTables::from_indices(
        of_leaves?.into_iter().map(|[index]| index).collect(),
        of_fog?.into_iter().map(|[index]| index).collect(),
        all.ok_or(INVALID)?,
    )
    .ok_or(INVALID)
}

/// Writes the kinds of leaves, and the values of each kind.
fn write_leaves(out: &mut Vec<u8>, leaves: &[Leaf]) {
    let kind = |leaf: &Leaf| match leaf {
        Leaf::Triangle(_) => [0],
        Leaf::Rectangle(_) => [1],
        Leaf::Curved(_) => [2],
    };
    write_table(out, leaves.iter().map(kind));
    let triangle =
        |leaf: &Leaf| if let Leaf::Triangle(values) = leaf { Some(color_words::<3, 9>(values)) } else { None };
    write_table(out, leaves.iter().filter_map(triangle));
    let rectangle =
        |leaf: &Leaf| if let Leaf::Rectangle(values) = leaf { Some(color_words::<4, 12>(values)) } else { None };
    write_table(out, leaves.iter().filter_map(rectangle));
    let curved = |leaf: &Leaf| if let Leaf::Curved(light) = leaf { Some(color_words::<9, 27>(&light.0)) } else { None };
    write_table(out, leaves.iter().filter_map(curved));
}

fn read_leaves(tables: &mut TableReader<'_>, leaves: u32) -> Result<Vec<Leaf>, FieldError> {
    let kinds: Vec<[u32; 1]> = tables.read_table(leaves)?;
    let count = |wanted: u32| kinds.iter().filter(|[kind]| *kind == wanted).count() as u32;
    let mut triangles = tables.read_table::<9>(count(0))?.into_iter();
    let mut rectangles = tables.read_table::<12>(count(1))?.into_iter();
    let mut curved = tables.read_table::<27>(count(2))?.into_iter();
    let leaf = |[kind]: &[u32; 1]| match kind {
        0 => triangles.next().map(|words| Leaf::Triangle(vectors_from_words(&words))),
        1 => rectangles.next().map(|words| Leaf::Rectangle(vectors_from_words(&words))),
        2 => curved.next().map(|words| Leaf::Curved(Harmonics(vectors_from_words(&words)))),
        _ => None,
    };
    kinds.iter().map(leaf).collect::<Option<_>>().ok_or(FieldError::Corrupt("unknown kind of leaf"))
}

fn read_fog(tables: &mut TableReader<'_>, roots: u32, boxes: u32) -> Result<FogTree, FieldError> {
    const NONE: FieldError = FieldError::Corrupt("invalid boxes of fog");
    if roots != u32::from(boxes > 0) {
        return Err(NONE);
    }
    let root: Vec<[u32; 6]> = tables.read_table(roots)?;
    let kinds: Vec<[u32; 1]> = tables.read_table(boxes)?;
    let count = |is_leaf: bool| kinds.iter().filter(|[kind]| (*kind == 3) == is_leaf).count() as u32;
    let mut cuts = tables.read_table::<1>(count(false))?.into_iter();
    let mut leaves = tables.read_table::<21>(count(true))?.into_iter();
    let Some(root) = root.first() else { return Ok(FogTree::default()) };
    let cell = |[kind]: &[u32; 1]| match kind {
        3 => leaves.next().map(|words| {
            let [a, b, c, d, anisotropy, sigma_s, sigma_t] = vectors_from_words::<7, 21>(&words);
            FogCell::Leaf(FogLeaf { mean: [a, b, c, d], anisotropy, sigma_s, sigma_t })
        }),
        _ => {
            let at = cuts.next().map(|[at]| f32::from_bits(at));
            at.zip(u8::try_from(*kind).ok()).map(|(at, axis)| FogCell::Split { axis, at })
        }
    };
    let cells: Vec<FogCell> = kinds.iter().map(cell).collect::<Option<_>>().ok_or(NONE)?;
    FogTree::new(vectors_from_words(root), &cells).ok_or(NONE)
}

/// Checks that the halves of a node come after it, so that no path down the tree has a cycle.
fn is_below(index: usize, next: u32, nodes: u32) -> bool {
    next as usize > index && next < nodes && next + 1 < nodes
}

/// Reader of the header, word by word.
struct HeaderReader<'a>(&'a [u8]);

impl HeaderReader<'_> {
    fn read_u32(&mut self) -> Result<u32, FieldError> {
        let (word, rest) = self.0.split_first_chunk().ok_or(TRUNCATED)?;
        self.0 = rest;
        Ok(u32::from_le_bytes(*word))
    }

    fn read_u64(&mut self) -> Result<u64, FieldError> {
        let (word, rest) = self.0.split_first_chunk().ok_or(TRUNCATED)?;
        self.0 = rest;
        Ok(u64::from_le_bytes(*word))
    }
}

/// Tables that are not read yet, as bytes.
struct TableReader<'a>(&'a [u8]);

impl TableReader<'_> {
    fn read_table<const N: usize>(&mut self, records: u32) -> Result<Vec<[u32; N]>, FieldError> {
        let records = records as usize;
        let bytes = records.checked_mul(4 * N).ok_or(TRUNCATED)?;
        let (planes, rest) = self.0.split_at_checked(bytes).ok_or(TRUNCATED)?;
        self.0 = rest;
        let byte = |record: usize, at: usize| planes[at * records + record];
        let word = |record: usize, at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|k| byte(record, 4 * at + k)));
        Ok((0..records).map(|record| std::array::from_fn(|at| word(record, at))).collect())
    }
}

/// Writes a table in byte planes.
fn write_table<const N: usize>(out: &mut Vec<u8>, records: impl Iterator<Item = [u32; N]>) {
    let records: Vec<[u32; N]> = records.collect();
    out.reserve(4 * N * records.len());
    for at in 0..N {
        for byte in 0..4 {
            out.extend(records.iter().map(|record| record[at].to_le_bytes()[byte]));
        }
    }
}

/// Converts colors to words; `W` is 3 `N`.
fn color_words<const N: usize, const W: usize>(values: &[Rgb; N]) -> [u32; W] {
    std::array::from_fn(|at| values[at / 3][at % 3].to_bits())
}

/// Converts words to vectors; `W` is 3 `N`.
fn vectors_from_words<const N: usize, const W: usize>(words: &[u32; W]) -> [Vec3A; N] {
    std::array::from_fn(|at| Vec3A::from_array(std::array::from_fn(|axis| f32::from_bits(words[3 * at + axis]))))
}

/// Least tag of a curved form.
const FIRST_CURVED_TAG: u32 = 2;

/// Returns the tag of a form. A shape has two tags, one for each facing.
fn form_tag(form: &Form) -> u32 {
    let (shape, facing) = match form {
        Form::Triangle(_) => return 0,
        Form::Parallelogram(_) => return 1,
        Form::Curved { shape: Quadric::Sphere { facing, .. }, .. } => (0, *facing),
        Form::Curved { shape: Quadric::Cone { facing, .. }, .. } => (1, *facing),
        Form::Curved { shape: Quadric::Ring { .. }, .. } => (2, Facing::Outward),
        Form::Curved { shape: Quadric::Torus { facing, .. }, .. } => (3, *facing),
    };
    FIRST_CURVED_TAG + 2 * shape + u32::from(facing == Facing::Inward)
}

/// Returns the parameters of a shape.
fn shape_parameters(shape: &Quadric) -> [f32; 8] {
    match *shape {
        Quadric::Sphere { center: c, radius, .. } => [c.x, c.y, c.z, radius, 0.0, 0.0, 0.0, 0.0],
        Quadric::Cone { start: s, end: e, start_radius, end_radius, .. } => {
            [s.x, s.y, s.z, start_radius, e.x, e.y, e.z, end_radius]
        }
        Quadric::Ring { center: c, normal: n, inner, outer } => [c.x, c.y, c.z, inner, n.x, n.y, n.z, outer],
        Quadric::Torus { center: c, axis: a, major, minor, .. } => [c.x, c.y, c.z, major, a.x, a.y, a.z, minor],
    }
}

fn shape_from_tag(tag: u32, values: &[f32; 8]) -> Option<Quadric> {
    let [x, y, z, first, a, b, c, second] = *values;
    let (center, other) = (Vec3A::new(x, y, z), Vec3A::new(a, b, c));
    let facing = if (tag - FIRST_CURVED_TAG) & 1 == 0 { Facing::Outward } else { Facing::Inward };
    Some(match ((tag - FIRST_CURVED_TAG) >> 1, facing) {
        (0, facing) => Quadric::Sphere { center, radius: first, facing },
        (1, facing) => Quadric::Cone { start: center, end: other, start_radius: first, end_radius: second, facing },
        (2, Facing::Outward) => Quadric::Ring { center, normal: other, inner: first, outer: second },
        (3, facing) => Quadric::Torus { center, axis: other, major: first, minor: second, facing },
        _ => return None,
    })
}

#[cfg(test)]
mod tests;
