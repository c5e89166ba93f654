//! Serialized state of a painted frame, from which the painting of the next frame starts.
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCBRSH` |
//! | 4 | version, 1 |
//! | 5 x 4 | width and height of the target, those of the source, width of a patch |
//! | 1 | 1: motion and depth follow the patches; 2: motion alone; 0: neither |
//! | 4 each | numbers of the source patches, by number of the target patch |
//! | 4 each | motion along x, all pixels, then along y; depth: floats |
//!
//! All numbers are little-endian. Everything after the version is zstd-compressed.

use crate::{ChannelImage, PatchField, PatchGrid, PreviousFrame, StylizeError};
use femc_film::rect::MAX_FILM_PIXELS;

/// Source patches that painted a frame, and the frame's motion and depth toward the next frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Brushwork {
    /// Columns and rows of the target.
    target: [u32; 2],
    /// Columns and rows of the source.
    source: [u32; 2],
    /// Width of a patch.
    patch: u32,
    patches: Vec<u32>,
    motion: Option<[Vec<f32>; 2]>,
    depth: Option<Vec<f32>>,
}

const MAGIC: &[u8; 8] = b"FEMCBRSH";
const VERSION: u32 = 1;
const COMPRESSION_LEVEL: i32 = 3;

impl Brushwork {
    /// Creates the brushwork of a painted frame.
    /// - `motion`, `depth`: as in [`PreviousFrame::new`], one value per pixel.
    pub fn new(field: &PatchField, motion: Option<[&[f32]; 2]>, depth: Option<&[f32]>) -> Self {
        let size = |grid: PatchGrid| [grid.columns(), grid.rows()].map(|count| (count + grid.patch() - 1) as u32);
        Self {
            target: size(field.target),
            source: size(field.source),
            patch: field.target.patch() as u32,
            patches: field.patches.clone(),
            motion: motion.map(|motion| motion.map(<[f32]>::to_vec)),
            depth: depth.filter(|_| motion.is_some()).map(<[f32]>::to_vec),
        }
    }

    /// Creates the brushwork of a missing frame: the next frame is painted from scratch.
    pub fn empty() -> Self {
        let grid = PatchGrid::new(3, 3, 3);
        Self::new(&PatchField { target: grid, source: grid, patches: vec![0] }, None, None)
    }

    /// Reprojects the painting into the next frame; `None`: the motion is unknown.
    /// - `style`: the painting that the frame was painted with;
    /// - errors: `style` has another size.
    pub fn reproject(&self, style: &ChannelImage) -> Option<Result<PreviousFrame, StylizeError>> {
        let motion = self.motion.as_ref()?;
        if style.size() != self.source {
            return Some(Err(StylizeError::StyleSize { style: style.size(), source_size: self.source }));
        }
        let grid = |[width, height]: [u32; 2]| PatchGrid::new(width as usize, height as usize, self.patch as usize);
        let field = PatchField { target: grid(self.target), source: grid(self.source), patches: self.patches.clone() };
        let [x, y] = motion;
        Some(PreviousFrame::from_field(&field.vote(style), field, [x, y], self.depth.as_deref()))
    }

    /// Encodes the brushwork. Equal brushwork gives equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut plain: Vec<u8> = Vec::new();
        let head = [self.target[0], self.target[1], self.source[0], self.source[1], self.patch];
        plain.extend(head.iter().flat_map(|number| number.to_le_bytes()));
        plain.push(match (&self.motion, &self.depth) {
            (None, _) => 0,
            (Some(_), Some(_)) => 1,
            (Some(_), None) => 2,
        });
        plain.extend(self.patches.iter().flat_map(|number| number.to_le_bytes()));
        let floats = self.motion.iter().flatten().chain(&self.depth).flatten();
        plain.extend(floats.flat_map(|value| value.to_le_bytes()));
        let mut bytes = [&MAGIC[..], &VERSION.to_le_bytes()].concat();
        // Compression into memory does not fail.
        bytes.extend(zstd::bulk::compress(&plain, COMPRESSION_LEVEL).unwrap_or_default());
        bytes
    }

    /// Decodes brushwork; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, StylizeError> {
        Self::parse(bytes).ok_or(StylizeError::Brushwork)
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let rest = bytes.strip_prefix(MAGIC)?.strip_prefix(&VERSION.to_le_bytes())?;
        let most = 21 + 16 * usize::try_from(MAX_FILM_PIXELS).ok()?;
        let mut plain = Vec::new();
        let reader = zstd::stream::read::Decoder::new(rest).ok()?;
        std::io::Read::read_to_end(&mut std::io::Read::take(reader, most as u64 + 1), &mut plain).ok()?;
        let (head, rest) = plain.split_at_checked(20)?;
        let (&form, rest) = rest.split_first()?;
        let numbers: Vec<u32> = head.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        let &[width, height, source_width, source_height, patch] = &numbers[..] else { return None };
        let is_sound = |size: [u32; 2]| {
            size.iter().all(|&side| side >= patch) && u64::from(size[0]) * u64::from(size[1]) <= MAX_FILM_PIXELS
        };
        let (target, source) = ([width, height], [source_width, source_height]);
        if !(3..=15).contains(&patch) || patch % 2 == 0 || !is_sound(target) || !is_sound(source) {
            return None;
        }
        let count = |[width, height]: [u32; 2]| (width + 1 - patch) as usize * (height + 1 - patch) as usize;
        let planes = match form {
            0 => 0,
            1 => 3,
            2 => 2,
            _ => return None,
        };
        let (words, []) = rest.as_chunks::<4>() else { return None };
        let pixels = width as usize * height as usize;
        let (patches, floats) = words.split_at_checked(count(target))?;
        let patches: Vec<u32> = patches.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        if floats.len() != planes * pixels || patches.iter().any(|&p| p as usize >= count(source)) {
            return None;
        }
        let mut planes =
            floats.chunks(pixels).map(|plane| plane.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect());
        let motion = planes.next().zip(planes.next()).map(|(x, y)| [x, y]);
        Some(Self { target, source, patch, patches, motion, depth: planes.next() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brushwork_comes_back_and_damage_is_refused() {
        let (target, source) = (PatchGrid::new(7, 5, 3), PatchGrid::new(6, 6, 3));
        let field = PatchField { target, source, patches: (0..15).collect() };
        let plane = |of: f32| (0..35).map(|at| of + at as f32).collect::<Vec<f32>>();
        let [x, y, z] = [0.5, -3.0, 7.0].map(plane);
        for (motion, depth) in [(None, None), (Some([&x[..], &y]), None), (Some([&x[..], &y]), Some(&z[..]))] {
            let brushwork = Brushwork::new(&field, motion, depth);
            let bytes = brushwork.encode();
            let back = Brushwork::decode(&bytes).expect("sound");
            assert_eq!(back, brushwork);
            let style = ChannelImage::new(6, 6, 3, vec![0.5; 108]).expect("an image");
            assert_eq!(back.reproject(&style).map(|before| before.is_ok()), motion.map(|_| true));
            for end in [0, 8, 12, bytes.len() - 1] {
                assert_eq!(Brushwork::decode(&bytes[..end]), Err(StylizeError::Brushwork), "{end} bytes");
            }
        }
        let foreign = PatchField { target, source, patches: vec![16; 15] };
        assert!(Brushwork::decode(&Brushwork::new(&foreign, None, None).encode()).is_err(), "there are 16 patches");
    }
}
