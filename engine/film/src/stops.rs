//! Where the halves of a frame's tiles end, and what dark blocks are measured against: what one decision leaves to the next.
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCSTOP` |
//! | 4 | format version, 1 |
//! | 16 | BLAKE3 of everything after this field, first half |
//! | 2 x 8 | for each half its floor, a double |
//! | rest | zstd frame of the ends, 2 x 4 bytes a tile, in byte planes |

use crate::codec::{begin, finish, open, to_planes};
use crate::convergence::FLOOR;
use crate::tile::{Ends, HALVES, OPEN};
use crate::{FilmError, TileErrors};

const MAGIC: &[u8; 8] = b"FEMCSTOP";
const VERSION: u32 = 1;

/// Where the halves of a frame's tiles end.
#[derive(Clone, Debug, PartialEq)]
pub struct Stops {
    /// For the errors that each half tells: luminance that darker blocks are measured against, cd/m2, by the first round's samples of
    /// the same half.
    pub floors: [f64; HALVES],
    /// Of each tile, in order.
    pub ends: Vec<Ends>,
}

impl Stops {
    /// After the first round, of which these are the errors: nothing has ended, and the floor is a hundredth of the frame's mean.
    pub fn first(tiles: &[TileErrors]) -> Self {
        let blocks = || tiles.iter().flat_map(|tile| &tile.blocks);
        let pixels = blocks().map(|it| it.block.rect.area()).sum::<u64>().max(1) as f64;
        let floor = |half: usize| FLOOR * blocks().map(|it| it.halves[half].sum).sum::<f64>() / pixels;
        Self { floors: std::array::from_fn(floor), ends: vec![OPEN; tiles.len()] }
    }

    /// The stops as bytes: the same bytes for the same stops.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = begin(MAGIC, VERSION);
        self.floors.iter().for_each(|floor| out.extend_from_slice(&floor.to_le_bytes()));
        finish(out, &to_planes(&self.ends, |[a, b]| (u64::from(*a) | (u64::from(*b) << 32)).to_le_bytes()))
    }

    /// The stops from their bytes; damage of any kind is an error.
    /// - `tiles`: of the frame.
    pub fn decode(bytes: &[u8], tiles: usize) -> Result<Self, FilmError> {
        let mut reader = open(MAGIC, VERSION, bytes)?;
        let mut floors = [0.0; HALVES];
        for floor in &mut floors {
            let [low, high] = reader.words()?;
            *floor = f64::from_bits(u64::from(low) | (u64::from(high) << 32));
        }
        if floors.iter().any(|floor| !(0.0..=f64::MAX).contains(floor)) {
            return Err(FilmError::Corrupt("impossible floors"));
        }
        let ends = reader.planes(tiles, |bytes: &[u8; 8]| {
            let both = u64::from_le_bytes(*bytes);
            [both as u32, (both >> 32) as u32]
        })?;
        Ok(Self { floors, ends })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stops_come_back_as_they_were_and_damaged_ones_are_refused() {
        let stops = Stops { floors: [0.25, 0.0], ends: vec![OPEN, [16, u32::MAX], [24, 32]] };
        let bytes = stops.encode();
        assert_eq!(Stops::decode(&bytes, 3).unwrap(), stops);
        assert!(Stops::decode(&bytes, 2).is_err() && Stops::decode(&bytes, 4).is_err());
        assert!((0..bytes.len()).all(|end| Stops::decode(&bytes[..end], 3).is_err()));
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(Stops::decode(&damaged, 3).is_err(), "bit {bit}");
        }
        for floor in [f64::NAN, -1.0, f64::INFINITY] {
            assert!(Stops::decode(&Stops { floors: [0.0, floor], ..stops.clone() }.encode(), 3).is_err(), "{floor}");
        }
    }
}
