//! Encoding of hits as bytes.

use super::{Sight, Sights};
use crate::bytes::{Damaged, Reader, Writer};

const WHAT: &[u8; 8] = b"sights 1";

impl Sights {
    /// Encodes the hits.
    pub fn encode(&self) -> Vec<u8> {
        let mut writer = Writer::new(WHAT);
        writer.number(u64::from(self.leaf));
        writer.number(self.traced);
        writer.numbers(self.counts.iter().copied());
        let sights = &self.sights;
        writer.numbers(sights.iter().map(|sight| sight.leaf));
        writer.bytes(sights.iter().map(|sight| sight.part));
        for axis in 0..3 {
            writer.bytes(sights.iter().map(|sight| sight.normal[axis] as u8));
            writer.bytes(sights.iter().map(|sight| sight.start[axis] as u8));
            writer.numbers(sights.iter().map(|sight| sight.target[axis].to_bits()));
        }
        writer.numbers(sights.iter().map(|sight| sight.share.to_bits()));
        (0..2).for_each(|end| writer.numbers(sights.iter().map(|sight| sight.density[end].to_bits())));
        writer.finish()
    }

    /// Decodes hits.
    /// - errors: the bytes are not the output of [`Sights::encode`].
    pub fn decode(bytes: &[u8]) -> Result<Self, Damaged> {
        let mut reader = Reader::new(bytes, WHAT)?;
        let leaf = u32::try_from(reader.number()?).map_err(|_| Damaged("the index of its first leaf is too large"))?;
        let traced = reader.number()?;
        let counts = reader.numbers()?;
        let number = counts.iter().map(|&count| u64::from(count)).sum::<u64>();
        let leaves = reader.numbers()?;
        if leaves.len() as u64 != number {
            return Err(Damaged("its number of rays is wrong"));
        }
        let mut sights: Vec<Sight> = leaves.into_iter().map(|leaf| Sight { leaf, ..Sight::NOTHING }).collect();
        fill(&mut sights, reader.bytes()?, |sight, part| sight.part = part)?;
        for axis in 0..3 {
            fill(&mut sights, reader.bytes()?, |sight, normal| sight.normal[axis] = normal as i8)?;
            fill(&mut sights, reader.bytes()?, |sight, start| sight.start[axis] = start as i8)?;
            fill(&mut sights, reader.numbers()?, |sight, bits| sight.target[axis] = f32::from_bits(bits))?;
        }
        fill(&mut sights, reader.numbers()?, |sight, bits| sight.share = f32::from_bits(bits))?;
        for end in 0..2 {
            fill(&mut sights, reader.numbers()?, |sight, bits| sight.density[end] = f32::from_bits(bits))?;
        }
        reader.end()?;
        Ok(Self { leaf, counts, sights, traced })
    }
}

fn fill<T>(sights: &mut [Sight], values: Vec<T>, set: impl Fn(&mut Sight, T)) -> Result<(), Damaged> {
    if values.len() != sights.len() {
        return Err(Damaged("its columns differ in length"));
    }
    sights.iter_mut().zip(values).for_each(|(sight, value)| set(sight, value));
    Ok(())
}
