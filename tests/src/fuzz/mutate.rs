//! Mutates bytes.

use crate::rng::Rng;

/// Size limit of mutated bytes.
const MAX_SIZE: usize = 1 << 16;

/// Applies some mutations to `bytes`, one after the other. Sometimes applies none.
pub(super) fn mutate(rng: &mut Rng, mut bytes: Vec<u8>, other: &[u8]) -> Vec<u8> {
    for _ in 0..rng.below(6) {
        mutate_once(rng, &mut bytes, other);
    }
    bytes
}

fn mutate_once(rng: &mut Rng, bytes: &mut Vec<u8>, other: &[u8]) {
    let at = rng.below(bytes.len() + 1);
    let length = rng.below(bytes.len() - at + 1).min(1 + rng.below(64));
    match rng.below(9) {
        0 => bytes.truncate(at),
        1 => drop(bytes.drain(at..at + length)),
        2 if bytes.len() < MAX_SIZE => {
            let again = bytes[at..at + length].to_vec();
            bytes.splice(at..at, again);
        }
        3 => {
            let number = rng.number().to_le_bytes();
            let width = (*rng.pick(&[1, 2, 4, 8])).min(bytes.len() - at);
            bytes[at..at + width].copy_from_slice(&number[..width]);
        }
        4 if bytes.len() < MAX_SIZE => {
            let from = rng.below(other.len() + 1);
            let to = (from + rng.below(256)).min(other.len());
            bytes.splice(at..at + length, other[from..to].iter().copied());
        }
        5 => bytes.push(rng.bits() as u8),
        6 if at < bytes.len() => bytes[at] = rng.bits() as u8,
        _ if at < bytes.len() => bytes[at] ^= 1 << rng.below(8),
        _ => {}
    }
}
