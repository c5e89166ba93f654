//! The traversal's stack: distances and children packed into u64, ordered like the distances, which are not negative.

use crate::tree::{Child, STACK, WIDTH};
use std::mem::MaybeUninit;

/// A child and the distance of its box.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Entry(pub u64);

impl Entry {
    #[inline(always)]
    pub fn new(distance: f32, child: Child) -> Self {
        Self(u64::from(distance.to_bits()) << 32 | u64::from(child.0))
    }

    #[inline(always)]
    pub fn child(self) -> Child {
        Child(self.0 as u32)
    }

    #[inline(always)]
    pub fn distance(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
}

/// A stack of at most [`STACK`] entries; the first `len` are initialised.
pub(crate) struct Stack {
    entries: [MaybeUninit<u64>; STACK],
    len: usize,
}

impl Stack {
    #[inline(always)]
    pub fn new() -> Self {
        Self { entries: [const { MaybeUninit::uninit() }; STACK], len: 0 }
    }

    #[inline(always)]
    pub fn push(&mut self, entry: Entry) {
        self.entries[self.len].write(entry.0);
        self.len += 1;
    }

    /// Room for [`WIDTH`] entries at the top.
    #[inline(always)]
    pub fn room(&mut self) -> &mut [MaybeUninit<u64>; WIDTH] {
        self.entries[self.len..].first_chunk_mut::<WIDTH>().expect("trees are built to fit the stack")
    }

    /// Takes the first `count` entries of the room into the stack.
    ///
    /// # Safety
    /// They must have been initialised, and `count` be at most [`WIDTH`].
    #[inline(always)]
    pub unsafe fn take(&mut self, count: usize) {
        self.len += count;
    }

    #[inline(always)]
    pub fn pop(&mut self) -> Option<Entry> {
        self.len = self.len.checked_sub(1)?;
        // SAFETY: `len` was positive, so the entry at the new `len` has been initialised by a push; it is in bounds because pushes are.
        Some(Entry(unsafe { self.entries.get_unchecked(self.len).assume_init() }))
    }

    /// Sorts the top `count` entries so that the nearest is popped first.
    #[inline(always)]
    pub fn sort_top(&mut self, count: usize) {
        let from = self.len - count;
        // SAFETY: the first `len` entries are initialised and u64 has the layout of its MaybeUninit.
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
