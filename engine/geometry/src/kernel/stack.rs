//! Stack of the traversal: distances and children packed into u64. The integers are ordered like the distances, because these are
//! not negative.

#![expect(unsafe_code, reason = "measured: clearing the stack would cost as much as a ray")]

use crate::tree::{Child, STACK_CAPACITY, WIDTH};
use femc_simd::Simd;
use std::mem::MaybeUninit;

/// A child and the distance of its box.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Entry(pub u64);

impl Entry {
    #[inline(always)]
    pub fn child(self) -> Child {
        Child(self.0 as u32)
    }

    #[inline(always)]
    pub fn distance(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
}

/// A stack of at most [`STACK_CAPACITY`] entries; the first `len` are initialized.
pub(crate) struct Stack {
    entries: [MaybeUninit<u64>; STACK_CAPACITY],
    len: usize,
}

impl Stack {
    #[inline(always)]
    pub fn new() -> Self {
        Self { entries: [const { MaybeUninit::uninit() }; STACK_CAPACITY], len: 0 }
    }

    /// Pushes the children whose bit in `mask` is set, with their distances. Returns their number.
    #[inline(always)]
    pub fn push<S: Simd>(&mut self, simd: S, mask: u32, distances: S::V, children: &[Child; WIDTH]) -> usize {
        let room = self.entries[self.len..].first_chunk_mut::<WIDTH>().expect("trees are built to fit the stack");
        // SAFETY: a child is transparent over u32.
        let children = unsafe { &*children.as_ptr().cast::<[u32; WIDTH]>() };
        // `compress` initializes `count` entries of the room, and `len` grows by this number.
        let count = simd.compress(mask, distances, children, room);
        self.len += count;
        count
    }

    #[inline(always)]
    pub fn pop(&mut self) -> Option<Entry> {
        self.len = self.len.checked_sub(1)?;
        // SAFETY: `len` was positive, so a push has initialized the entry at the new `len`. It is in bounds because pushes are.
        Some(Entry(unsafe { self.entries.get_unchecked(self.len).assume_init() }))
    }

    /// Sorts the top `count` entries so that the nearest is popped first.
    #[inline(always)]
    pub fn sort_top(&mut self, count: usize) {
        let from = self.len - count;
        // SAFETY: the first `len` entries are initialized, and u64 has the layout of its MaybeUninit.
        let top = unsafe { &mut *(std::ptr::from_mut(&mut self.entries[from..self.len]) as *mut [u64]) };
        for i in 1..top.len() {
            let entry = top[i];
            let mut j = i;
            while j > 0 && top[j - 1] < entry {
                top[j] = top[j - 1];
                j -= 1;
            }
            top[j] = entry;
        }
    }
}
