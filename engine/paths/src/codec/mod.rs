//! Statistics as bytes. Equal statistics give equal bytes, and decoding restores the statistics to the bit. All numbers are
//! little-endian.
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCPATH` |
//! | 4 | format version, 4; 3 is read, too |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 4 | version of the attributes and their bins ([`schema`]) |
//! | 8 | seed |
//! | 7 x 4 | frame, width, height, tile, maximum number of records, maximum number of records of a sketch, 1 if all samples are in the histograms, else 0 |
//! | 6 x 8 | corners of the box, m |
//! | 8 | threshold |
//! | 7 x 4 | numbers of portions, paths, brightest, deepest, intersections, lights, names |
//! | 8 | bytes of the tables below |
//! | rest | zstd frame of the tables |
//!
//! A table is a number of records of equal length, made of words of 4 bytes, and stored in byte planes (the lowest byte of the
//! first word of all records, then the next). Numbers of 8 bytes are two words, the lower one first.
//!
//! | table | words of a record |
//! | --- | --- |
//! | portions | tile, half, begin, end; the counters, two each |
//! | bins, those of all attributes for each portion, if all samples are in them | count: 2 |
//! | pixels, portion by portion | samples, depth, throughput, luminance: 2, its squares: 4 ([`crate::pixels`]) |
//! | names | kind, bytes of the text |
//!
//! The texts follow, one after the other, and then the tables of the records (`codec/records.rs`). Names are written as their
//! indices in the table of names, from 1; 0 is no name.
//!
//! The checksum is verified first. Decompression never yields more than the header says, and no memory is allocated for data that
//! has not been decompressed. Accepted bytes obey all invariants of [`LightStatistics`]: order, ranges, disjoint portions, finite
//! numbers.

mod columns;
mod records;

use crate::attribute::ALL_BINS;
use crate::pixels::{self, PixelSums};
use crate::record::{Name, NameKind, Names};
use crate::schema;
use crate::statistics::{ENDS, LightStatistics, PortionKey, SampleCounters, Scope, is_disjoint};
use columns::{TableReader, join_u64, put_table, split_u64};
use records::{count_items, put_records};
use std::collections::BTreeMap;
use std::io::Read;

const MAGIC: &[u8; 8] = b"FEMCPATH";
const VERSION: u32 = 4;
/// Version without branches of paths.
const VERSION_WITHOUT_BRANCHES: u32 = 3;
const CHECKSUM: usize = 16;
const PREFIX: usize = MAGIC.len() + 4 + CHECKSUM;
/// Maximum number of bytes of all tables: 4 GiB. A film of 8192 x 4320 pixels needs 2.4 GiB.
const MAX_TABLE_BYTES: u64 = 1 << 32;
/// Maximum window of data that is read back. It bounds the memory of the decompressor.
const WINDOW_LOG: u32 = 23;
const COMPRESSION_LEVEL: i32 = 1;

/// Number of words of a portion.
const PORTION_WORDS: usize = 4 + 2 * (1 + 2 * schema::FINE_BINS + ENDS);

/// Reason why bytes cannot be decoded as light statistics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PathsError {
    /// The bytes have another version of the format.
    #[error("light statistics have format {found}, but this program reads format {expected}")]
    Version {
        /// Version of the bytes.
        found: u32,
        /// Version that this build reads.
        expected: u32,
    },
    /// The counts use bins of another version.
    #[error("light statistics have bins of version {found}, but this program reads version {expected}")]
    Schema {
        /// Version of the bytes.
        found: u32,
        /// Version that this build reads.
        expected: u32,
    },
    /// The bytes are damaged or not light statistics.
    #[error("invalid light statistics: {0}")]
    Corrupt(&'static str),
}

const TRUNCATED: PathsError = PathsError::Corrupt("cut short");
const OUT_OF_ORDER: PathsError = PathsError::Corrupt("records are out of order");
const OUT_OF_RANGE: PathsError = PathsError::Corrupt("a number is out of its range");

impl LightStatistics {
    /// Encodes the statistics as bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        out.extend(VERSION.to_le_bytes());
        out.extend([0; CHECKSUM]);
        let Scope {
            seed,
            frame,
            film: [width, height],
            tile_size: edge,
            lower,
            upper,
            max_records: keep,
            sketch_size: top,
            has_full_histograms: is_full,
        } = self.scope;
        out.extend(schema::VERSION.to_le_bytes());
        out.extend(seed.to_le_bytes());
        [frame, width, height, edge, keep, top, u32::from(is_full)]
            .iter()
            .for_each(|word| out.extend(word.to_le_bytes()));
        lower.iter().chain(&upper).for_each(|axis| out.extend(axis.to_bits().to_le_bytes()));
        out.extend(self.threshold.to_le_bytes());
        let all = [&self.paths, &self.brightest, &self.deepest].into_iter().flat_map(|records| records.values());
        let [intersections, lights] = count_items(all);
        let [paths, brightest, deepest] = [&self.paths, &self.brightest, &self.deepest].map(BTreeMap::len);
        let lengths = [self.portions.len(), paths, brightest, deepest, intersections, lights, self.names.len()];
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
        put_table(
            &mut out,
            &self.portions.iter().map(|(key, counters)| encode_portion(key, counters)).collect::<Vec<_>>(),
        );
        if self.scope.has_full_histograms {
            let bins = |counters: &SampleCounters| {
                // A portion without samples has bins of 0.
                (0..ALL_BINS).map(|bin| counters.bins.get(bin).copied().unwrap_or(0)).collect::<Vec<u64>>()
            };
            put_table(&mut out, &self.portions.values().flat_map(bins).map(split_u64).collect::<Vec<_>>());
        }
        let pixels = self.portions.values().flat_map(|counters| &counters.pixels);
        put_table(&mut out, &pixels.map(PixelSums::words).collect::<Vec<_>>());
        let names = self.names.values().map(|(kind, text)| [*kind as u32, text.len() as u32]);
        put_table(&mut out, &names.collect::<Vec<_>>());
        self.names.values().for_each(|(_, text)| out.extend(text.as_bytes()));
        put_records(&mut out, [&self.paths, &self.brightest, &self.deepest], &self.names, &self.scope);
        out
    }

    /// Decodes statistics from bytes. Damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, PathsError> {
        let (prefix, body) = bytes.split_at_checked(PREFIX).ok_or(TRUNCATED)?;
        if prefix[..MAGIC.len()] != MAGIC[..] {
            return Err(PathsError::Corrupt("wrong magic number"));
        }
        let mut front = HeaderReader(&prefix[MAGIC.len()..]);
        let version = front.word()?;
        if ![VERSION_WITHOUT_BRANCHES, VERSION].contains(&version) {
            return Err(PathsError::Version { found: version, expected: VERSION });
        }
        if blake3::hash(body).as_bytes()[..CHECKSUM] != *front.0 {
            return Err(PathsError::Corrupt("checksum mismatch"));
        }
        let mut front = HeaderReader(body);
        let found = front.word()?;
        if found != schema::VERSION {
            return Err(PathsError::Schema { found, expected: schema::VERSION });
        }
        let seed = front.long()?;
        let [frame, width, height, edge, keep, top, full] = front.words()?;
        let mut corners = [0.0; 6];
        for corner in &mut corners {
            *corner = f64::from_bits(front.long()?);
        }
        let [a, b, c, d, e, f] = corners;
        let (film, lower, upper, is_full) = ([width, height], [a, b, c], [d, e, f], full == 1);
        let scope = Scope {
            seed,
            frame,
            film,
            tile_size: edge,
            lower,
            upper,
            max_records: keep,
            sketch_size: top,
            has_full_histograms: is_full,
        };
        if !scope.is_valid() || full > 1 {
            return Err(PathsError::Corrupt("invalid film or settings"));
        }
        let threshold = front.long()?;
        let lengths = front.words()?;
        let plain = front.long()?;
        let tables = decompress(front.0, plain)?;
        read_tables(TableReader(&tables), scope, threshold, lengths, version)
    }
}

fn encode_portion(key: &PortionKey, counters: &SampleCounters) -> [u32; PORTION_WORDS] {
    let mut words = WordWriter::new(key.tile);
    [u32::from(key.half), key.begin, key.end].into_iter().for_each(|number| words.push_word(number));
    counters.words().for_each(|count| words.push_long(count));
    words.finish()
}

fn decompress(bytes: &[u8], plain: u64) -> Result<Vec<u8>, PathsError> {
    const LENGTH: PathsError = PathsError::Corrupt("the tables have a wrong length");
    const DAMAGED: PathsError = PathsError::Corrupt("the tables cannot be decompressed");
    if plain > MAX_TABLE_BYTES {
        return Err(LENGTH);
    }
    let mut decoder = zstd::stream::read::Decoder::with_buffer(bytes).map_err(|_| DAMAGED)?;
    decoder.window_log_max(WINDOW_LOG).map_err(|_| DAMAGED)?;
    let mut tables = Vec::new();
    decoder.take(plain + 1).read_to_end(&mut tables).map_err(|_| DAMAGED)?;
    if tables.len() as u64 == plain { Ok(tables) } else { Err(LENGTH) }
}

fn read_tables(
    mut tables: TableReader<'_>,
    scope: Scope,
    threshold: u64,
    lengths: [u32; 7],
    version: u32,
) -> Result<LightStatistics, PathsError> {
    let [portions, paths, brightest, deepest, intersections, lights, names] = lengths;
    let portions = read_portions(&mut tables, portions, &scope)?;
    let names = read_names(&mut tables, names)?;
    let heads = [paths, brightest, deepest];
    let [paths, brightest, deepest] =
        records::read_records(&mut tables, heads, [intersections, lights], &names, &scope, version)?;
    if !tables.0.is_empty() {
        return Err(PathsError::Corrupt("extra bytes follow the tables"));
    }
    let mut read = LightStatistics { scope, threshold, portions, paths, brightest, deepest, names };
    // Settling drops records that the scope does not allow or that no portion counted. Valid statistics have no such records.
    let extent =
        |it: &LightStatistics| (it.threshold, it.paths.len(), it.brightest.len(), it.deepest.len(), it.names.len());
    let before = extent(&read);
    read.trim();
    if extent(&read) != before || !read.paths.keys().all(|(_, key)| read.portion_of(*key).is_some()) {
        return Err(PathsError::Corrupt("records do not match the settings or portions"));
    }
    Ok(read)
}

fn read_portions(
    tables: &mut TableReader<'_>,
    records: u32,
    scope: &Scope,
) -> Result<BTreeMap<PortionKey, SampleCounters>, PathsError> {
    let records: Vec<[u32; PORTION_WORDS]> = tables.read_table(records as usize)?;
    let [_, tiles] = scope.tile_counts();
    let (mut portions, mut all_pixels) = (BTreeMap::<PortionKey, SampleCounters>::new(), 0u64);
    for words in records {
        let [tile, half, begin, end, ref counts @ ..] = words;
        let mut counters = SampleCounters::default();
        let longs = counts.as_chunks::<2>().0.iter().copied().map(join_u64);
        counters.words_mut().zip(longs).for_each(|(count, value)| *count = value);
        let key = PortionKey { tile, half: half.min(2) as u8, begin, end };
        if u64::from(tile) >= tiles || half > 1 || begin >= end {
            return Err(OUT_OF_RANGE);
        }
        // The portion's key must agree with the number of counted samples.
        if counters.samples() != u64::from(key.samples()) * scope.tile_area(tile) {
            return Err(PathsError::Corrupt("wrong number of samples"));
        }
        if portions.last_key_value().is_some_and(|(last, _)| *last >= key) || !is_disjoint(&portions, key) {
            return Err(OUT_OF_ORDER);
        }
        all_pixels = all_pixels.saturating_add(scope.tile_area(tile));
        portions.insert(key, counters);
    }
    if scope.has_full_histograms {
        let bins: Vec<[u32; 2]> = tables.read_table(portions.len().saturating_mul(ALL_BINS))?;
        for (counters, bins) in portions.values_mut().zip(bins.chunks(ALL_BINS)) {
            let own = bins.iter().copied().map(join_u64);
            counters.bins = if counters.ends.iter().all(|count| *count == 0) { Vec::new() } else { own.collect() };
            if counters.bins.is_empty() && bins.iter().any(|count| *count != [0; 2]) {
                return Err(OUT_OF_RANGE);
            }
        }
    }
    let pixels: Vec<[u32; pixels::WORDS]> = tables.read_table(usize::try_from(all_pixels).map_err(|_| TRUNCATED)?)?;
    let mut rest = &pixels[..];
    for (key, counters) in &mut portions {
        let area = scope.tile_area(key.tile);
        let (own, others) = rest.split_at_checked(area as usize).ok_or(TRUNCATED)?;
        rest = others;
        counters.pixels = own.iter().map(|words| PixelSums::from_words(*words)).collect();
        if !counters.is_valid(*key, scope) {
            return Err(OUT_OF_RANGE);
        }
    }
    Ok(portions)
}

fn read_names(tables: &mut TableReader<'_>, records: u32) -> Result<Names, PathsError> {
    let records: Vec<[u32; 2]> = tables.read_table(records as usize)?;
    let mut names = Names::new();
    for [kind, bytes] in records {
        let (text, rest) = tables.0.split_at_checked(bytes as usize).ok_or(TRUNCATED)?;
        tables.0 = rest;
        let text = std::str::from_utf8(text).map_err(|_| PathsError::Corrupt("a name is not valid UTF-8"))?;
        let kind = enum_from_number(&NameKind::ALL, kind)?;
        let name = Name::new(kind, text);
        if names.last_key_value().is_some_and(|(last, _)| *last >= name) || name == Name::NONE {
            return Err(OUT_OF_ORDER);
        }
        names.insert(name, (kind, text.to_owned()));
    }
    Ok(names)
}

fn enum_from_number<T: Copy>(all: &[T], number: u32) -> Result<T, PathsError> {
    all.get(number as usize).copied().ok_or(OUT_OF_RANGE)
}

/// Writer of a record, word by word.
struct WordWriter<const N: usize> {
    words: [u32; N],
    next: usize,
}

impl<const N: usize> WordWriter<N> {
    fn new(first: u32) -> Self {
        let mut words = Self { words: [0; N], next: 0 };
        words.push_word(first);
        words
    }

    fn push_word(&mut self, word: u32) {
        self.words[self.next] = word;
        self.next += 1;
    }

    fn push_long(&mut self, long: u64) {
        self.push_word(long as u32);
        self.push_word((long >> 32) as u32);
    }

    fn finish(self) -> [u32; N] {
        debug_assert_eq!(self.next, N);
        self.words
    }
}

/// Reader of the header, word by word.
struct HeaderReader<'a>(&'a [u8]);

impl HeaderReader<'_> {
    fn word(&mut self) -> Result<u32, PathsError> {
        let (word, rest) = self.0.split_first_chunk().ok_or(TRUNCATED)?;
        self.0 = rest;
        Ok(u32::from_le_bytes(*word))
    }

    fn words<const N: usize>(&mut self) -> Result<[u32; N], PathsError> {
        let mut words = [0; N];
        for word in &mut words {
            *word = self.word()?;
        }
        Ok(words)
    }

    fn long(&mut self) -> Result<u64, PathsError> {
        let (word, rest) = self.0.split_first_chunk().ok_or(TRUNCATED)?;
        self.0 = rest;
        Ok(u64::from_le_bytes(*word))
    }
}
