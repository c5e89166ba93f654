//! Encoding of hits as bytes.

use super::{MAX_PARTS, RayHit, RayHits};
use crate::bytes::{Reader, StepDecodeError, Writer};

const MAGIC: &[u8; 8] = b"sights 5";

impl RayHits {
    /// Encodes the hits.
    pub fn encode(&self) -> Vec<u8> {
        let mut writer = Writer::new(MAGIC);
        writer.number(u64::from(self.first_leaf));
        writer.number(self.traced);
        writer.numbers(self.counts.iter().copied());
        let hits = &self.hits;
        writer.numbers(hits.iter().map(|sight| sight.leaf));
        writer.bytes(hits.iter().map(|sight| sight.part));
        writer.bytes(hits.iter().map(|sight| u8::from(sight.is_two_way)));
        for axis in 0..3 {
            writer.bytes(hits.iter().map(|sight| sight.normal[axis] as u8));
            writer.bytes(hits.iter().map(|sight| sight.origin_normal[axis] as u8));
        }
        writer.numbers(hits.iter().map(|sight| sight.share.to_bits()));
        (0..3).for_each(|channel| writer.numbers(hits.iter().map(|sight| sight.direct[channel].to_bits())));
        (0..2).for_each(|end| writer.numbers(hits.iter().map(|sight| sight.density[end].to_bits())));
        writer.finish()
    }

    /// Decodes hits.
    /// - errors: the bytes are not the output of [`RayHits::encode`].
    pub fn decode(bytes: &[u8]) -> Result<Self, StepDecodeError> {
        let mut reader = Reader::new(bytes, MAGIC)?;
        let leaf = u32::try_from(reader.number()?)
            .map_err(|_| StepDecodeError::Damaged("the index of its first leaf is too large"))?;
        let traced = reader.number()?;
        let counts = reader.numbers()?;
        let number = counts.iter().map(|&count| u64::from(count)).sum::<u64>();
        let leaves = reader.numbers()?;
        if leaves.len() as u64 != number {
            return Err(StepDecodeError::Damaged("its number of rays is wrong"));
        }
        let mut hits: Vec<RayHit> = leaves.into_iter().map(|leaf| RayHit { leaf, ..RayHit::MISS }).collect();
        fill(&mut hits, reader.bytes()?, |sight, part| sight.part = part)?;
        if hits.iter().any(|hit| usize::from(hit.part) >= MAX_PARTS) {
            return Err(StepDecodeError::Damaged("a hit is on an unknown part of a leaf"));
        }
        fill(&mut hits, reader.bytes()?, |sight, both| sight.is_two_way = both != 0)?;
        for axis in 0..3 {
            fill(&mut hits, reader.bytes()?, |sight, normal| sight.normal[axis] = normal as i8)?;
            fill(&mut hits, reader.bytes()?, |sight, start| sight.origin_normal[axis] = start as i8)?;
        }
        fill(&mut hits, reader.numbers()?, |sight, bits| sight.share = f32::from_bits(bits))?;
        for channel in 0..3 {
            fill(&mut hits, reader.numbers()?, |sight, bits| sight.direct[channel] = f32::from_bits(bits))?;
        }
        for end in 0..2 {
            fill(&mut hits, reader.numbers()?, |sight, bits| sight.density[end] = f32::from_bits(bits))?;
        }
        reader.expect_end()?;
        Ok(Self { first_leaf: leaf, counts, hits, traced })
    }
}

fn fill<T>(hits: &mut [RayHit], values: Vec<T>, set: impl Fn(&mut RayHit, T)) -> Result<(), StepDecodeError> {
    if values.len() != hits.len() {
        return Err(StepDecodeError::Damaged("its columns differ in length"));
    }
    hits.iter_mut().zip(values).for_each(|(sight, value)| set(sight, value));
    Ok(())
}
