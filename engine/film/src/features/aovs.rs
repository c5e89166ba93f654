//! Data of a tile besides its picture: layers of its light, features, or both.

use super::tile::VERSION;
use super::{FeaturePiece, FeatureTile};
use crate::codec::{read_header, seal, start_header};
use crate::tile::HalfEnds;
use crate::{FilmError, LayerPiece, LayerTile, SampleRange, Tiling};
use std::ops::Range;

const MAGIC: &[u8; 8] = b"FEMCBESD";
const NOTHING: FilmError = FilmError::Corrupt("neither layers nor features");

/// Layers and features of the samples of a tile. At least one of the two exists, and both belong to the same samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AovTile {
    /// Layers of the light.
    pub light: Option<LayerTile>,
    /// Features.
    pub features: Option<FeatureTile>,
}

impl AovTile {
    /// Returns the samples.
    pub fn samples(&self) -> Option<SampleRange> {
        self.light.as_ref().map(LayerTile::samples).or(self.features.as_ref().map(FeatureTile::samples))
    }

    /// Encodes the tile. Equal sums give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        encode_parts([self.light.as_ref().map(LayerTile::encode), self.features.as_ref().map(FeatureTile::encode)])
    }

    /// Decodes a tile; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let [light, features] = split_parts(bytes)?;
        let light = light.map(LayerTile::decode).transpose()?;
        let features = features.map(FeatureTile::decode).transpose()?;
        if let (Some(light), Some(features)) = (&light, &features)
            && (light.rect(), light.samples()) != (features.rect(), features.samples())
        {
            return Err(FilmError::Corrupt("layers and features have different samples"));
        }
        Ok(Self { light, features })
    }

    /// Unites the parts of a tile, like [`LayerTile::from_parts`] and [`FeatureTile::from_parts`].
    /// - errors: those of these functions; some parts lack layers or features that others have.
    pub fn from_parts(parts: Vec<Self>, first_sample: u32, ends: HalfEnds) -> Result<Self, FilmError> {
        let count = parts.len();
        let (light, features): (Vec<_>, Vec<_>) = parts.into_iter().map(|part| (part.light, part.features)).unzip();
        let light: Vec<LayerTile> = light.into_iter().flatten().collect();
        let features: Vec<FeatureTile> = features.into_iter().flatten().collect();
        if [light.len(), features.len()].iter().any(|&some| some != 0 && some != count) {
            return Err(FilmError::Corrupt("one part lacks layers or features that other parts have"));
        }
        let (has_light, has_features) = (!light.is_empty(), !features.is_empty());
        if !has_light && !has_features {
            return Err(NOTHING);
        }
        Ok(Self {
            light: has_light.then(|| LayerTile::from_parts(light, first_sample, ends)).transpose()?,
            features: has_features.then(|| FeatureTile::from_parts(features, first_sample)).transpose()?,
        })
    }
}

/// Resolved layers and features of several tiles of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct AovPiece {
    /// Layers of the light.
    pub light: Option<LayerPiece>,
    /// Features.
    pub features: Option<FeaturePiece>,
    tiling: Tiling,
    tiles: Range<usize>,
    samples: Vec<SampleRange>,
}

impl AovPiece {
    /// Creates a piece without tiles; the first tile added is number `first`.
    pub fn new(tiling: Tiling, first: usize) -> Self {
        Self { light: None, features: None, tiling, tiles: first..first, samples: Vec::new() }
    }

    /// Adds the next tile.
    /// - errors: it is not the next tile, or it has other data than the previous tiles.
    pub fn put(&mut self, tile: &AovTile, ends: HalfEnds) -> Result<(), FilmError> {
        let samples = tile.samples().ok_or(NOTHING)?;
        if self.tiles.is_empty() {
            self.light = tile.light.as_ref().map(|_| LayerPiece::new(self.tiling, self.tiles.start));
            self.features = tile.features.as_ref().map(|_| FeaturePiece::new(self.tiling, self.tiles.start));
        }
        match (&mut self.light, &tile.light) {
            (Some(piece), Some(tile)) => piece.put(tile, ends)?,
            (None, None) => {}
            _ => return Err(FilmError::Corrupt("only some tiles have layers")),
        }
        match (&mut self.features, &tile.features) {
            (Some(piece), Some(tile)) => piece.put(tile)?,
            (None, None) => {}
            _ => return Err(FilmError::Corrupt("only some tiles have features")),
        }
        self.tiles.end += 1;
        self.samples.push(samples);
        Ok(())
    }

    /// Returns the tiling of the film.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// Returns the numbers of the tiles.
    pub fn tiles(&self) -> Range<usize> {
        self.tiles.clone()
    }

    /// Returns the samples of each tile.
    pub fn samples(&self) -> &[SampleRange] {
        &self.samples
    }

    /// Encodes the tiles. Equal pixels give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        encode_parts([self.light.as_ref().map(LayerPiece::encode), self.features.as_ref().map(FeaturePiece::encode)])
    }

    /// Decodes tiles; damage of any kind is an error.
    pub fn decode(bytes: &[u8]) -> Result<Self, FilmError> {
        let [light, features] = split_parts(bytes)?;
        let light = light.map(LayerPiece::decode).transpose()?;
        let features = features.map(FeaturePiece::decode).transpose()?;
        let of_light = light.as_ref().map(|it| (it.tiling(), it.tiles(), it.samples().to_vec()));
        let of_features = features.as_ref().map(|it| (it.tiling(), it.tiles(), it.samples().to_vec()));
        let (tiling, tiles, samples) = match (of_light, of_features) {
            (Some(light), Some(features)) if light != features => {
                return Err(FilmError::Corrupt("layers and features have different tiles"));
            }
            (Some(of), _) | (None, Some(of)) => of,
            (None, None) => return Err(NOTHING),
        };
        Ok(Self { light, features, tiling, tiles, samples })
    }
}

fn encode_parts(parts: [Option<Vec<u8>>; 2]) -> Vec<u8> {
    let mut out = start_header(MAGIC, VERSION);
    let parts = parts.map(Option::unwrap_or_default);
    parts.iter().for_each(|part| out.extend_from_slice(&(part.len() as u32).to_le_bytes()));
    parts.iter().for_each(|part| out.extend_from_slice(part));
    seal(out)
}

fn split_parts(bytes: &[u8]) -> Result<[Option<&[u8]>; 2], FilmError> {
    let mut reader = read_header(MAGIC, VERSION, bytes)?;
    let lengths = reader.words()?.map(|length: u32| length as usize);
    let rest = reader.rest();
    if lengths == [0; 2] {
        return Err(NOTHING);
    }
    if lengths[0].saturating_add(lengths[1]) != rest.len() {
        return Err(FilmError::Corrupt("the data are truncated"));
    }
    let (light, features) = rest.split_at(lengths[0]);
    Ok([light, features].map(|part| (!part.is_empty()).then_some(part)))
}
