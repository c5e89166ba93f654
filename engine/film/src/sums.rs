//! Encoding of a frame's sums as one artifact: the encoded tiles one after the other.
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCSUMS` |
//! | 4 | format version, 1 |
//! | 4 | number of tiles |
//! | each | length (8), the encoded tile |

use crate::{FilmError, Frame, Tile};
use rayon::prelude::*;

const MAGIC: &[u8; 8] = b"FEMCSUMS";
const VERSION: u32 = 1;

/// Encodes all tiles of `frame` that hold samples, in their order. Equal sums give equal bytes.
pub fn encode(frame: &Frame) -> Vec<u8> {
    let tiles: Vec<Vec<u8>> =
        (0..frame.tiling().count()).into_par_iter().filter_map(|index| frame.tile(index).map(Tile::encode)).collect();
    let mut bytes = Vec::with_capacity(16 + tiles.iter().map(|tile| tile.len() + 8).sum::<usize>());
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend((tiles.len() as u32).to_le_bytes());
    for tile in tiles {
        bytes.extend((tile.len() as u64).to_le_bytes());
        bytes.extend(tile);
    }
    bytes
}

/// Decodes the tiles of encoded sums.
pub fn decode(bytes: &[u8]) -> Result<Vec<Tile>, FilmError> {
    let mut rest = bytes;
    if take::<8>(&mut rest)? != *MAGIC {
        return Err(FilmError::Corrupt("the sums have wrong magic bytes"));
    }
    if u32::from_le_bytes(take(&mut rest)?) != VERSION {
        return Err(FilmError::Corrupt("sums of another format version"));
    }
    let count = u32::from_le_bytes(take(&mut rest)?);
    let mut pieces = Vec::new();
    for _ in 0..count {
        let length = u64::from_le_bytes(take(&mut rest)?);
        let cut = usize::try_from(length).ok().and_then(|length| rest.split_at_checked(length));
        let (piece, tail) = cut.ok_or(CUT)?;
        pieces.push(piece);
        rest = tail;
    }
    if !rest.is_empty() {
        return Err(FilmError::Corrupt("bytes after the end of the sums"));
    }
    pieces.into_par_iter().map(Tile::decode).collect()
}

const CUT: FilmError = FilmError::Corrupt("the sums end early");

fn take<const N: usize>(rest: &mut &[u8]) -> Result<[u8; N], FilmError> {
    let (head, tail) = rest.split_first_chunk::<N>().ok_or(CUT)?;
    *rest = tail;
    Ok(*head)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tiling;

    fn frame() -> Frame {
        let tiling = Tiling::new(40, 20, 16).unwrap();
        let mut frame = Frame::new(tiling);
        for rect in tiling.rects() {
            frame.insert(Tile::new(rect, 0..4).unwrap()).unwrap();
        }
        frame
    }

    #[test]
    fn sums_come_back_as_they_were() {
        let frame = frame();
        let mut again = Frame::new(frame.tiling());
        for tile in decode(&encode(&frame)).unwrap() {
            again.insert(tile).unwrap();
        }
        assert_eq!(again, frame);
    }

    #[test]
    fn sums_cut_anywhere_are_refused() {
        let bytes = encode(&frame());
        for end in 0..bytes.len() {
            assert!(decode(&bytes[..end]).is_err(), "cut at {end}");
        }
        let mut longer = bytes;
        longer.push(0);
        assert!(decode(&longer).is_err());
    }
}
