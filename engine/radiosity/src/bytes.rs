//! Messages between machines that share a first pass: columns of numbers.
//!
//! A column holds one number of every row, byte by byte: all first bytes, then all second ones, because those of neighbors are
//! alike. All columns are compressed together. The numbers are exact, so the reader continues with the same bits.

use femc_math::Rgb;
use std::io::Read as _;

/// Level of zstd. It is fast, since everything is read only once or twice.
const COMPRESSION_LEVEL: i32 = 1;
/// Maximum number of bytes of all columns.
const MAX_BYTES: u64 = 1 << 33;

/// First bytes of all messages. The version follows, 4 bytes.
const MAGIC: &[u8; 8] = b"FEMCSTEP";
/// Version of all messages.
const VERSION: u32 = 1;

/// Error: the bytes are not the output of a step of a first pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StepDecodeError {
    /// The bytes are damaged, or belong to another step or world.
    #[error("the solver state of a first-pass step is damaged: {0}")]
    Damaged(&'static str),
    /// A program of another version wrote them.
    #[error("the solver state of a first-pass step has version {0}, and this program reads only version {VERSION}")]
    Version(u32),
}

/// Writer of columns.
#[derive(Debug, Default)]
pub struct Writer(Vec<u8>);

impl Writer {
    /// Creates a writer.
    /// - `magic`: eight letters and digits that identify the content.
    pub fn new(magic: &[u8; 8]) -> Self {
        Self(magic.to_vec())
    }

    pub fn number(&mut self, number: u64) {
        self.0.extend(number.to_le_bytes());
    }

    pub fn bytes(&mut self, bytes: impl ExactSizeIterator<Item = u8>) {
        self.number(bytes.len() as u64);
        self.0.extend(bytes);
    }

    pub fn numbers(&mut self, numbers: impl ExactSizeIterator<Item = u32>) {
        let (count, first) = (numbers.len(), self.0.len() + 8);
        self.number(count as u64);
        self.0.resize(first + 4 * count, 0);
        let planes = &mut self.0[first..];
        for (at, number) in numbers.enumerate() {
            number.to_le_bytes().into_iter().enumerate().for_each(|(plane, byte)| planes[plane * count + at] = byte);
        }
    }

    /// Writes rows of `N` numbers.
    pub fn rows<const N: usize>(&mut self, rows: &[[f32; N]]) {
        (0..N).for_each(|column| self.numbers(rows.iter().map(|row| row[column].to_bits())));
    }

    pub fn finish(self) -> Vec<u8> {
        // Writing to memory does not fail.
        let columns = zstd::bulk::compress(&self.0, COMPRESSION_LEVEL).unwrap_or_default();
        [&MAGIC[..], &VERSION.to_le_bytes(), &columns].concat()
    }
}

/// Reader of columns.
#[derive(Debug)]
pub struct Reader {
    bytes: Vec<u8>,
    position: usize,
}

impl Reader {
    pub fn new(bytes: &[u8], magic: &[u8; 8]) -> Result<Self, StepDecodeError> {
        let header = bytes.strip_prefix(MAGIC).and_then(|rest| rest.split_first_chunk::<4>());
        let (version, columns) = header.ok_or(StepDecodeError::Damaged("it is not a solver state"))?;
        let version = u32::from_le_bytes(*version);
        if version != VERSION {
            return Err(StepDecodeError::Version(version));
        }
        let decoder = zstd::stream::read::Decoder::with_buffer(columns)
            .map_err(|_| StepDecodeError::Damaged("its columns cannot be decompressed"))?;
        let mut all = Vec::new();
        decoder
            .take(MAX_BYTES)
            .read_to_end(&mut all)
            .map_err(|_| StepDecodeError::Damaged("its columns cannot be decompressed"))?;
        if !all.starts_with(magic) {
            return Err(StepDecodeError::Damaged("it belongs to another step"));
        }
        Ok(Self { bytes: all, position: magic.len() })
    }

    fn take(&mut self, count: usize) -> Result<&[u8], StepDecodeError> {
        let end = self
            .position
            .checked_add(count)
            .filter(|&end| end <= self.bytes.len())
            .ok_or(StepDecodeError::Damaged("it ends early"))?;
        let taken = &self.bytes[self.position..end];
        self.position = end;
        Ok(taken)
    }

    pub fn number(&mut self) -> Result<u64, StepDecodeError> {
        let bytes = self.take(8)?.first_chunk::<8>().copied();
        bytes.map(u64::from_le_bytes).ok_or(StepDecodeError::Damaged("it ends early"))
    }

    pub fn bytes(&mut self) -> Result<Vec<u8>, StepDecodeError> {
        let count = self.number()?;
        Ok(self.take(usize::try_from(count).unwrap_or(usize::MAX))?.to_vec())
    }

    pub fn numbers(&mut self) -> Result<Vec<u32>, StepDecodeError> {
        let count = usize::try_from(self.number()?).unwrap_or(usize::MAX);
        let planes = self.take(count.saturating_mul(4))?;
        let of = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|plane| planes[plane * count + at]));
        Ok((0..count).map(of).collect())
    }

    /// Reads `count` rows.
    pub fn rows<const N: usize>(&mut self, count: usize) -> Result<Vec<[f32; N]>, StepDecodeError> {
        if count.saturating_mul(4 * N) > self.bytes.len() - self.position {
            return Err(StepDecodeError::Damaged("it ends early"));
        }
        let mut rows = vec![[0.0; N]; count];
        for column in 0..N {
            let numbers = self.numbers()?;
            if numbers.len() != count {
                return Err(StepDecodeError::Damaged("its columns differ in length"));
            }
            rows.iter_mut().zip(numbers).for_each(|(row, bits)| row[column] = f32::from_bits(bits));
        }
        Ok(rows)
    }

    /// Checks that nothing follows.
    pub fn expect_end(self) -> Result<(), StepDecodeError> {
        if self.position == self.bytes.len() {
            Ok(())
        } else {
            Err(StepDecodeError::Damaged("extra bytes follow its end"))
        }
    }
}

/// Converts colors to numbers.
pub fn to_floats<const N: usize, const M: usize>(colors: &[Rgb; N]) -> [f32; M] {
    std::array::from_fn(|at| colors[at / 3].to_array()[at % 3])
}

pub fn colors_from_floats<const N: usize>(numbers: &[f32]) -> [Rgb; N] {
    std::array::from_fn(|at| Rgb::from_array([0, 1, 2].map(|channel| numbers[3 * at + channel])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_come_back_to_the_bit_and_damage_is_said() {
        let rows = [[1.5f32, -0.0, f32::NAN], [f32::MIN_POSITIVE, 3.0e38, 7.0]];
        let mut writer = Writer::new(b"columns1");
        writer.number(7);
        writer.numbers([1u32, u32::MAX, 3].into_iter());
        writer.rows(&rows);
        writer.bytes([5u8, 6].into_iter());
        let bytes = writer.finish();
        let mut reader = Reader::new(&bytes, b"columns1").unwrap();
        assert_eq!(reader.number(), Ok(7));
        assert_eq!(reader.numbers(), Ok(vec![1, u32::MAX, 3]));
        let back: Vec<[f32; 3]> = reader.rows(2).unwrap();
        assert_eq!(back.map_bits(), rows.to_vec().map_bits());
        assert_eq!(reader.bytes(), Ok(vec![5, 6]));
        assert_eq!(reader.expect_end(), Ok(()));
        assert!(Reader::new(&bytes, b"columns2").is_err());
        for end in 0..bytes.len() {
            let read = Reader::new(&bytes[..end], b"columns1").and_then(|mut it| it.number().map(drop));
            assert!(read.is_err(), "{end} bytes");
        }
        let mut reader = Reader::new(&bytes, b"columns1").unwrap();
        assert_eq!(reader.number(), Ok(7));
        assert_eq!(reader.rows::<3>(2), Err(StepDecodeError::Damaged("its columns differ in length")));
        assert_eq!(reader.rows::<3>(usize::MAX), Err(StepDecodeError::Damaged("it ends early")));
    }

    trait Bits {
        fn map_bits(&self) -> Vec<[u32; 3]>;
    }

    impl Bits for Vec<[f32; 3]> {
        fn map_bits(&self) -> Vec<[u32; 3]> {
            self.iter().map(|row| row.map(f32::to_bits)).collect()
        }
    }
}
