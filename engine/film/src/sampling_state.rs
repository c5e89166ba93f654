//! State that one decision on a frame's samples passes to the next: the ends of the tiles' halves, and the reference luminance of
//! dark blocks.
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCSTOP` |
//! | 4 | format version, 2 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 2 x 8 | floor of each half, a double |
//! | 4 + 4 x 8 | the first sample that counts; seconds until this decision, a double, and rays until then; seconds and rays of the pilot |
//! | rest | zstd frame of the ends, 2 x 4 bytes per tile, and the shares, a double per tile, in byte planes |

use crate::codec::{compress_and_seal, read_header, start_header, to_planes, to_words};
use crate::convergence::FLOOR;
use crate::tile::{HALVES, HalfEnds, NONE_HELD};
use crate::{FilmError, TileErrors};

const MAGIC: &[u8; 8] = b"FEMCSTOP";
const VERSION: u32 = 2;

/// State that one decision on a frame's samples passes to the next.
#[derive(Clone, Debug, PartialEq)]
pub struct SamplingState {
    /// Reference luminance of darker blocks in the errors of each half, cd/m2, from the first round's samples of the same half.
    pub floors: [f64; HALVES],
    /// Ends of the halves of each tile, in order.
    pub ends: Vec<HalfEnds>,
    /// Progress of a frame with a time limit.
    pub progress: TimedProgress,
}

/// Progress of a frame with a time limit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimedProgress {
    /// First sample that counts in the image. Earlier samples were a pilot, which only determined how to divide the others.
    pub first_sample: u32,
    /// Seconds from the frame's first lease until the decision.
    pub seconds: f64,
    /// Rays traced until the decision for the samples that count.
    pub rays: u64,
    /// Seconds of the round that ended the pilot, and its rays; zeros before that, and without a pilot.
    pub pilot: (f64, u64),
    /// Samples of each tile as a fraction of the mean over tiles; empty until this is decided.
    pub shares: Vec<f64>,
}

impl SamplingState {
    /// Creates the state after the first round from its errors: nothing has ended, and the floor is a hundredth of the frame's
    /// mean.
    pub fn after_first_round(tiles: &[TileErrors]) -> Self {
        let blocks = || tiles.iter().flat_map(|tile| &tile.blocks);
        let pixels = blocks().map(|it| it.block.rect.area()).sum::<u64>().max(1) as f64;
        let floor = |half: usize| FLOOR * blocks().map(|it| it.halves[half].sum).sum::<f64>() / pixels;
        Self {
            floors: std::array::from_fn(floor),
            ends: vec![NONE_HELD; tiles.len()],
            progress: TimedProgress::default(),
        }
    }

    /// Encodes the stops. Equal stops give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let TimedProgress { first_sample: first, seconds, rays: work, pilot, shares } = &self.progress;
        let mut out = start_header(MAGIC, VERSION);
        self.floors.iter().for_each(|floor| out.extend_from_slice(&floor.to_le_bytes()));
        let long = [seconds.to_bits(), *work, pilot.0.to_bits(), pilot.1];
        let words = [*first].into_iter().chain(long.into_iter().flat_map(to_words));
        words.for_each(|word| out.extend_from_slice(&word.to_le_bytes()));
        // Shares that are not decided yet are written as zeros.
        let share = |tile: usize| shares.get(tile).copied().unwrap_or(0.0);
        let tiles: Vec<(HalfEnds, f64)> =
            self.ends.iter().enumerate().map(|(tile, ends)| (*ends, share(tile))).collect();
        compress_and_seal(out, &to_planes(&tiles, to_bytes))
    }

    /// Decodes stops; damage of any kind is an error.
    /// - `tiles`: number of tiles of the frame.
    pub fn decode(bytes: &[u8], tiles: usize) -> Result<Self, FilmError> {
        let mut reader = read_header(MAGIC, VERSION, bytes)?;
        let mut floors = [0.0; HALVES];
        for floor in &mut floors {
            *floor = f64::from_bits(reader.long()?);
        }
        let ([begin], seconds, work) = (reader.words()?, f64::from_bits(reader.long()?), reader.long()?);
        let pilot = (f64::from_bits(reader.long()?), reader.long()?);
        let is_possible = |value: &f64| (0.0..=f64::MAX).contains(value);
        let (ends, mut shares): (Vec<HalfEnds>, Vec<f64>) = reader.planes(tiles, from_bytes)?.into_iter().unzip();
        if !floors.iter().chain([&seconds, &pilot.0]).chain(&shares).all(is_possible) {
            return Err(FilmError::Corrupt("invalid floors, seconds or shares"));
        }
        if shares.iter().all(|share| *share == 0.0) {
            shares.clear();
        }
        Ok(Self { floors, ends, progress: TimedProgress { first_sample: begin, seconds, rays: work, pilot, shares } })
    }
}

const TILE_BYTES: usize = 4 * HALVES + 8;

fn to_bytes((ends, share): &(HalfEnds, f64)) -> [u8; TILE_BYTES] {
    let mut bytes = [0; TILE_BYTES];
    let words = ends.iter().copied().chain(to_words(share.to_bits()));
    bytes.chunks_exact_mut(4).zip(words).for_each(|(field, word)| field.copy_from_slice(&word.to_le_bytes()));
    bytes
}

fn from_bytes(bytes: &[u8; TILE_BYTES]) -> (HalfEnds, f64) {
    let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[4 * at + i]));
    let share = u64::from(word(HALVES)) | (u64::from(word(HALVES + 1)) << 32);
    (std::array::from_fn(word), f64::from_bits(share))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stops_come_back_as_they_were_and_damaged_ones_are_refused() {
        let ends = vec![NONE_HELD, [16, u32::MAX], [24, 32]];
        let early = SamplingState { floors: [0.25, 0.0], ends, progress: TimedProgress::default() };
        assert_eq!(SamplingState::decode(&early.encode(), 3).unwrap(), early);
        let pace = TimedProgress {
            first_sample: 4,
            seconds: 1.25,
            rays: 1 << 40,
            pilot: (0.5, 7),
            shares: vec![0.25, 2.0, 0.75],
        };
        let stops = SamplingState { progress: pace, ..early };
        let bytes = stops.encode();
        assert_eq!(SamplingState::decode(&bytes, 3).unwrap(), stops);
        assert!(SamplingState::decode(&bytes, 2).is_err() && SamplingState::decode(&bytes, 4).is_err());
        assert!((0..bytes.len()).all(|end| SamplingState::decode(&bytes[..end], 3).is_err()));
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(SamplingState::decode(&damaged, 3).is_err(), "bit {bit}");
        }
        for floor in [f64::NAN, -1.0, f64::INFINITY] {
            assert!(
                SamplingState::decode(&SamplingState { floors: [0.0, floor], ..stops.clone() }.encode(), 3).is_err(),
                "{floor}"
            );
            let progress = TimedProgress { seconds: floor, ..stops.progress.clone() };
            assert!(
                SamplingState::decode(&SamplingState { progress, ..stops.clone() }.encode(), 3).is_err(),
                "{floor}"
            );
        }
    }
}
