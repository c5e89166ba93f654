//! Records as tables. A value that can be predicted from the rest of its record is written as the bits in which it differs from the
//! prediction, which are almost always 0. The order of the tables is that of the records: first those chosen by hash, then the
//! brightest, then the deepest. Within a record it is the order of its intersections and lights.
//!
//! | table | words of a record |
//! | --- | --- |
//! | heads | pixel, sample, radiance: 3, predicted by the sum of the lights; throughput: 3; depth minus that of the kept intersections; end; numbers of kept intersections and of lights |
//! | intersections | bounce, minus that of the intersection before; place: 6; radiance: 3, predicted from the lights; throughput: 3; class; object; material; distance from the intersection after the parent |
//! | places off the grid | 6 |
//! | lights | class; order, minus that of the light before; lamp; order minus vertex |
//! | occluders, of hidden lights | 1 |
//! | radiances, of lights with radiance | 3 |
//! | media, of light scattered in a medium | 1 |
//!
//! - A coordinate is written as its index on the [grid](Scope::grid_spacing), in two words, zigzag encoded: `2 i` for i >= 0 and
//!   `-2 i - 1` for negative i. If a coordinate of a place is not such an index below 2^52, all three are 2^64 - 1 and the place is
//!   in the next table.
//! - For three channels, the second and third are the bits in which they differ from the first.
//! - The class of an intersection is its interaction, plus 8 if its radiance includes the light of the lamp that the path hit there
//!   ([`LightPath::outgoing_radiance`]). Its material is 0 if it equals the material of the latest intersection with the same
//!   object, else one more than its index among the names.
//! - Format 3 has no branches: the last words of intersections and lights are missing and count as 0.
//! - The class of a light is the technique that found it, plus 8 if it is hidden, plus 16 if it has radiance.

use super::columns::{TableReader, join_u64, put_table, split_u64};
use super::{OUT_OF_ORDER, OUT_OF_RANGE, PathsError, TRUNCATED, VERSION_WITHOUT_BRANCHES, enum_from_number};
use crate::record::{
    InteractionKind, Intersection, LightPath, LightRecord, LightTechnique, MAX_INTERSECTIONS, MAX_LIGHTS, Name,
    NameMap, Names, PathEnd, PathKey,
};
use crate::statistics::{Records, Scope};
use std::collections::HashMap;
use std::slice::Iter;

const HEAD_WORDS: usize = 12;
const INTERSECTION_WORDS: usize = 17;
const LIGHT_WORDS: usize = 4;
/// Marker of a coordinate that is not on the grid.
const OFF_GRID: u64 = u64::MAX;
/// Flag of an intersection whose radiance includes the light of the lamp hit there.
const EMITS: u32 = 8;
const OCCLUDED: u32 = 8;
const LIT: u32 = 16;

/// Counts the intersections and lights of records.
pub(super) fn count_items<'a>(records: impl Iterator<Item = &'a LightPath>) -> [usize; 2] {
    records.fold([0, 0], |[a, b], path| [a + path.intersections.len(), b + path.lights.len()])
}

/// Writes the records.
pub(super) fn put_records(out: &mut Vec<u8>, all: [&Records; 3], names: &Names, scope: &Scope) {
    let places: NameMap<u32> = names.keys().copied().zip(1..).collect();
    let mut columns = Columns { grid: scope.grid_spacing(), name_indices: places, ..Columns::default() };
    all.into_iter().flat_map(|records| records.values()).for_each(|path| columns.add(path));
    columns.put(out);
}

#[derive(Default)]
struct Columns {
    grid: f64,
    /// Written index of each name.
    name_indices: NameMap<u32>,
    /// Latest material of each object, both by index.
    materials: HashMap<u32, u32>,
    heads: Vec<[u32; HEAD_WORDS]>,
    intersections: Vec<[u32; INTERSECTION_WORDS]>,
    off_grid: Vec<[u32; 6]>,
    lights: Vec<[u32; LIGHT_WORDS]>,
    occluders: Vec<[u32; 1]>,
    radiances: Vec<[u32; 3]>,
    media: Vec<[u32; 1]>,
}

impl Columns {
    /// Returns the index of a name. A name without a text is written as no name.
    fn name_index(&self, name: Name) -> u32 {
        self.name_indices.get(&name).copied().unwrap_or(0)
    }

    fn add(&mut self, path: &LightPath) {
        let (kept, found) = (path.intersections.len() as u32, path.lights.len() as u32);
        let [r, g, b] = xor_bits(path.radiance, path.sum_of_lights());
        let [s, t, u] = xor_with_first(path.throughput);
        let PathKey { pixel, sample, .. } = path.key;
        let deeper = path.depth.wrapping_sub(longest_branch(path));
        self.heads.push([pixel, sample, r, g, b, s, t, u, deeper, path.end as u32, kept, found]);
        let sent = path.outgoing_radiance(|_| false);
        let has_emitter_hit = path.lights.iter().any(|light| light.technique == LightTechnique::EmitterHit);
        let emitted = if has_emitter_hit { path.outgoing_radiance(|_| true) } else { sent.clone() };
        let mut before = 0;
        for (index, (it, (sent, emitted))) in (0..).zip(path.intersections.iter().zip(sent.into_iter().zip(emitted))) {
            let emits = xor_bits(it.radiance, sent) != [0; 3] && xor_bits(it.radiance, emitted) == [0; 3];
            let (sent, class) = if emits { (emitted, EMITS) } else { (sent, 0) };
            let bounce = it.bounce.wrapping_sub(before);
            self.intersection(it, [bounce, u32::wrapping_sub(index, it.parent)], xor_bits(it.radiance, sent), class);
            before = it.bounce;
        }
        let mut before = 0;
        for light in &path.lights {
            self.light(light, light.order.wrapping_sub(before));
            before = light.order;
        }
    }

    fn intersection(&mut self, it: &Intersection, [bounce, back]: [u32; 2], [r, g, b]: [u32; 3], class: u32) {
        let [[x, x2], [y, y2], [z, z2]] = grid_indices(it.position, self.grid).map(split_u64);
        if [x, x2] == split_u64(OFF_GRID) {
            let [[x, x2], [y, y2], [z, z2]] = it.position.map(|axis| split_u64(axis.to_bits()));
            self.off_grid.push([x, x2, y, y2, z, z2]);
        }
        let [s, t, u] = xor_with_first(it.throughput);
        let class = class | it.interaction as u32;
        let (object, material) = (self.name_index(it.object), self.name_index(it.material));
        let latest = self.materials.insert(object, material);
        let material = if latest == Some(material) { 0 } else { 1 + material };
        self.intersections.push([bounce, x, x2, y, y2, z, z2, r, g, b, s, t, u, class, object, material, back]);
    }

    fn light(&mut self, light: &LightRecord, order: u32) {
        let radiance = light.radiance.map(f32::to_bits);
        let mut class = light.technique as u32;
        if let Some(occluder) = light.occluder {
            class |= OCCLUDED;
            self.occluders.push([self.name_index(occluder)]);
        }
        if radiance != [0; 3] {
            class |= LIT;
            self.radiances.push(xor_with_first(light.radiance));
        }
        if light.technique == LightTechnique::Airlight {
            self.media.push([self.name_index(light.medium)]);
        }
        self.lights.push([class, order, self.name_index(light.light), light.order.wrapping_sub(light.vertex)]);
    }

    fn put(&self, out: &mut Vec<u8>) {
        put_table(out, &self.heads);
        put_table(out, &self.intersections);
        put_table(out, &self.off_grid);
        put_table(out, &self.lights);
        put_table(out, &self.occluders);
        put_table(out, &self.radiances);
        put_table(out, &self.media);
    }
}

/// Returns the number of intersections of the longest recorded branch.
fn longest_branch(path: &LightPath) -> u32 {
    path.levels().into_iter().max().unwrap_or(0)
}

/// Returns the bits in which the channels differ from the predicted ones.
fn xor_bits(own: [f32; 3], other: [f32; 3]) -> [u32; 3] {
    std::array::from_fn(|channel| own[channel].to_bits() ^ other[channel].to_bits())
}

/// Returns the first channel, and the bits in which the second and third differ from it.
fn xor_with_first(color: [f32; 3]) -> [u32; 3] {
    let [r, g, b] = color.map(f32::to_bits);
    [r, g ^ r, b ^ r]
}

/// Inverse of [`xor_with_first`].
fn color_from_xor([r, g, b]: [u32; 3]) -> [f32; 3] {
    [r, g ^ r, b ^ r].map(f32::from_bits)
}

fn grid_indices(position: [f64; 3], grid: f64) -> [u64; 3] {
    const MAX_INDEX: f64 = (1u64 << 52) as f64;
    let grid_index = |axis: f64| {
        let number = axis / grid;
        let is_there = number.fract() == 0.0
            && number.abs() < MAX_INDEX
            && (number as i64 as f64 * grid).to_bits() == axis.to_bits();
        let number = number as i64;
        is_there.then_some(((number << 1) ^ (number >> 63)) as u64)
    };
    match position.map(grid_index) {
        [Some(x), Some(y), Some(z)] => [x, y, z],
        _ => [OFF_GRID; 3],
    }
}

/// Inverse of [`grid_indices`], for one coordinate.
fn grid_coordinate(index: u64, grid: f64) -> f64 {
    let number = (index >> 1) as i64 ^ -((index & 1) as i64);
    number as f64 * grid
}

/// Reads the records chosen by hash, the brightest and the deepest.
/// - `heads`: number of records of each kind;
/// - `[intersections, lights]`: numbers of intersections and lights of all records;
/// - `version`: version of the format.
pub(super) fn read_records(
    tables: &mut TableReader<'_>,
    heads: [u32; 3],
    [intersections, lights]: [u32; 2],
    names: &Names,
    scope: &Scope,
    version: u32,
) -> Result<[Records; 3], PathsError> {
    let numbers = heads;
    let heads = numbers.map(|number| number as usize).iter().try_fold(0usize, |sum, number| sum.checked_add(*number));
    let heads: Vec<[u32; HEAD_WORDS]> = tables.read_table(heads.ok_or(TRUNCATED)?)?;
    let intersections: Vec<[u32; INTERSECTION_WORDS]> =
        read_padded::<{ INTERSECTION_WORDS - 1 }, _>(tables, intersections, version)?;
    let off_grid = intersections.iter().filter(|words| join_u64([words[1], words[2]]) == OFF_GRID).count();
    let off_grid = tables.read_table(off_grid)?;
    let lights: Vec<[u32; LIGHT_WORDS]> = read_padded::<{ LIGHT_WORDS - 1 }, _>(tables, lights, version)?;
    let of_class = |is: fn(u32) -> bool| lights.iter().filter(|light| is(light[0])).count();
    let occluders = tables.read_table(of_class(|class| class & OCCLUDED != 0))?;
    let radiances = tables.read_table(of_class(|class| class & LIT != 0))?;
    let media = tables.read_table(of_class(|class| class & 7 == LightTechnique::Airlight as u32))?;
    let mut rest = RecordReader {
        scope,
        grid: scope.grid_spacing(),
        names: [Name::NONE].into_iter().chain(names.keys().copied()).collect(),
        materials: NameMap::default(),
        intersections: intersections.iter(),
        off_grid: off_grid.iter(),
        lights: lights.iter(),
        occluders: occluders.iter(),
        radiances: radiances.iter(),
        media: media.iter(),
    };
    let (mut heads, mut all) = (heads.iter(), <[Records; 3]>::default());
    for (records, number) in all.iter_mut().zip(numbers) {
        let mut latest = None;
        let paths = heads.by_ref().take(number as usize).map(|head| {
            let path = rest.path(head)?;
            let order = (path.key.hash(scope.seed), path.key);
            if latest.replace(order).is_some_and(|latest| latest >= order) {
                Err(OUT_OF_ORDER)
            } else {
                Ok((order, path))
            }
        });
        *records = paths.collect::<Result<_, PathsError>>()?;
    }
    if rest.intersections.next().is_some() || rest.lights.next().is_some() {
        return Err(PathsError::Corrupt("the tables contain unused records"));
    }
    Ok(all)
}

/// Reads a table of records of `N` words. In the version without branches, they have only the first `M`, and the last one is 0.
fn read_padded<const M: usize, const N: usize>(
    tables: &mut TableReader<'_>,
    records: u32,
    version: u32,
) -> Result<Vec<[u32; N]>, PathsError> {
    if version != VERSION_WITHOUT_BRANCHES {
        return tables.read_table(records as usize);
    }
    let short: Vec<[u32; M]> = tables.read_table(records as usize)?;
    Ok(short.iter().map(|words| std::array::from_fn(|at| words.get(at).copied().unwrap_or(0))).collect())
}

/// Reader of the parts of the tables that are not read yet.
struct RecordReader<'a> {
    scope: &'a Scope,
    grid: f64,
    names: Vec<Name>,
    materials: NameMap<Name>,
    intersections: Iter<'a, [u32; INTERSECTION_WORDS]>,
    off_grid: Iter<'a, [u32; 6]>,
    lights: Iter<'a, [u32; LIGHT_WORDS]>,
    occluders: Iter<'a, [u32; 1]>,
    radiances: Iter<'a, [u32; 3]>,
    media: Iter<'a, [u32; 1]>,
}

impl RecordReader<'_> {
    fn name(&self, index: u32) -> Result<Name, PathsError> {
        self.names.get(index as usize).copied().ok_or(OUT_OF_RANGE)
    }

    fn path(&mut self, head: &[u32; HEAD_WORDS]) -> Result<LightPath, PathsError> {
        let &[pixel, sample, r, g, b, s, t, u, deeper, end, kept, found] = head;
        let (kept, found) = (kept as usize, found as usize);
        if kept > MAX_INTERSECTIONS || found > MAX_LIGHTS || u64::from(pixel) >= self.scope.pixel_count() {
            return Err(OUT_OF_RANGE);
        }
        let mut path = LightPath {
            key: PathKey { frame: self.scope.frame, pixel, sample },
            radiance: [0.0; 3],
            throughput: color_from_xor([s, t, u]),
            depth: 0,
            end: enum_from_number(PathEnd::ALL, end)?,
            intersections: Vec::with_capacity(kept.min(self.intersections.len())),
            lights: Vec::with_capacity(found.min(self.lights.len())),
        };
        let (mut bounce, mut order) = (0, 0);
        // Differences from the predicted radiances, and the flags of emission.
        let mut differences = Vec::with_capacity(path.intersections.capacity());
        for index in 0..kept as u32 {
            let (it, difference) = self.intersection(index, &mut bounce)?;
            path.intersections.push(it);
            differences.push(difference);
        }
        for _ in 0..found {
            let light = self.light(&mut order)?;
            path.lights.push(light);
        }
        path.depth = deeper.wrapping_add(longest_branch(&path));
        path.radiance = apply_xor(path.sum_of_lights(), [r, g, b]);
        let sent = path.outgoing_radiance(|index| differences[index].1);
        for (it, (sent, (difference, _))) in path.intersections.iter_mut().zip(sent.into_iter().zip(&differences)) {
            it.radiance = apply_xor(sent, *difference);
        }
        if path.is_valid() { Ok(path) } else { Err(OUT_OF_RANGE) }
    }

    fn intersection(&mut self, index: u32, latest: &mut u32) -> Result<(Intersection, ([u32; 3], bool)), PathsError> {
        let &[bounce, x, x2, y, y2, z, z2, r, g, b, s, t, u, class, object, material, back] =
            self.intersections.next().ok_or(TRUNCATED)?;
        *latest = latest.wrapping_add(bounce);
        let places = [[x, x2], [y, y2], [z, z2]].map(join_u64);
        let position = if places[0] == OFF_GRID {
            let &[x, x2, y, y2, z, z2] = self.off_grid.next().ok_or(TRUNCATED)?;
            [[x, x2], [y, y2], [z, z2]].map(|words| f64::from_bits(join_u64(words)))
        } else {
            places.map(|place| grid_coordinate(place, self.grid))
        };
        let object = self.name(object)?;
        let material = match material {
            0 => *self.materials.get(&object).ok_or(OUT_OF_RANGE)?,
            _ => self.name(material - 1)?,
        };
        self.materials.insert(object, material);
        let it = Intersection {
            parent: index.checked_sub(back).ok_or(OUT_OF_RANGE)?,
            bounce: *latest,
            position,
            radiance: [0.0; 3],
            throughput: color_from_xor([s, t, u]),
            object,
            material,
            interaction: enum_from_number(InteractionKind::ALL, class & !EMITS)?,
        };
        Ok((it, ([r, g, b], class & EMITS != 0)))
    }

    fn light(&mut self, latest: &mut u32) -> Result<LightRecord, PathsError> {
        let &[class, order, light, back] = self.lights.next().ok_or(TRUNCATED)?;
        *latest = latest.wrapping_add(order);
        let vertex = latest.checked_sub(back).ok_or(OUT_OF_RANGE)?;
        let found = enum_from_number(LightTechnique::ALL, class & !(OCCLUDED | LIT))?;
        let occluder = match class & OCCLUDED {
            0 => None,
            _ => {
                let [place] = *self.occluders.next().ok_or(TRUNCATED)?;
                Some(self.name(place)?)
            }
        };
        let radiance = match class & LIT {
            0 => [0.0; 3],
            _ => color_from_xor(*self.radiances.next().ok_or(TRUNCATED)?),
        };
        let medium = match found {
            LightTechnique::Airlight => {
                let [place] = *self.media.next().ok_or(TRUNCATED)?;
                self.name(place)?
            }
            _ => Name::NONE,
        };
        let light = self.name(light)?;
        Ok(LightRecord { vertex, order: *latest, light, medium, radiance, occluder, technique: found })
    }
}

/// Inverse of [`xor_bits`].
fn apply_xor(other: [f32; 3], bits: [u32; 3]) -> [f32; 3] {
    std::array::from_fn(|channel| f32::from_bits(other[channel].to_bits() ^ bits[channel]))
}
