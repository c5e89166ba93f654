//! Tables of records of equal length, made of words of 4 bytes and stored in byte planes: the lowest byte of the first word of all
//! records, then the next byte. This places similar bytes next to each other.

use super::{PathsError, TRUNCATED};

/// Writes a table in byte planes.
pub(super) fn put_table<const N: usize>(out: &mut Vec<u8>, records: &[[u32; N]]) {
    out.reserve(4 * N * records.len());
    let any = records.iter().fold([0u32; N], |any, record| std::array::from_fn(|at| any[at] | record[at]));
    let mut column = vec![0u32; records.len()];
    for at in 0..N {
        column.iter_mut().zip(records).for_each(|(word, record)| *word = record[at]);
        for byte in 0..4 {
            // Most planes contain only zeros.
            if any[at].to_le_bytes()[byte] == 0 {
                out.resize(out.len() + records.len(), 0);
            } else {
                out.extend(column.iter().map(|word| (word >> (8 * byte)) as u8));
            }
        }
    }
}

/// Tables that are not read yet, as bytes.
pub(super) struct TableReader<'a>(pub(super) &'a [u8]);

impl TableReader<'_> {
    /// Reads the next table. It allocates no more memory than the bytes present justify.
    pub(super) fn read_table<const N: usize>(&mut self, records: usize) -> Result<Vec<[u32; N]>, PathsError> {
        let bytes = records.checked_mul(4 * N).ok_or(TRUNCATED)?;
        let (planes, rest) = self.0.split_at_checked(bytes).ok_or(TRUNCATED)?;
        self.0 = rest;
        let mut table = vec![[0u32; N]; records];
        if records > 0 {
            for (number, plane) in planes.chunks_exact(records).enumerate() {
                let (at, shift) = (number / 4, 8 * (number % 4));
                if plane.iter().any(|byte| *byte != 0) {
                    table.iter_mut().zip(plane).for_each(|(record, byte)| record[at] |= u32::from(*byte) << shift);
                }
            }
        }
        Ok(table)
    }
}

/// Splits a number of 8 bytes into two words, the lower one first.
pub(super) fn split_u64(long: u64) -> [u32; 2] {
    [long as u32, (long >> 32) as u32]
}

/// Joins two words to a number, the lower one first.
pub(super) fn join_u64([low, high]: [u32; 2]) -> u64 {
    u64::from(low) | u64::from(high) << 32
}
