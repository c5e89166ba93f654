//! Cache of artifacts that were recently stored or verified: they count as present and sound without asking the medium.

use std::collections::{BTreeMap, VecDeque};

use femc_model::{Artifact, Digest};

/// Sizes of recent artifacts; the oldest entry is evicted first.
#[derive(Debug, Default)]
pub(crate) struct Seen {
    sizes: BTreeMap<Digest, u64>,
    order: VecDeque<Digest>,
}

impl Seen {
    /// Maximum number of entries: a few megabytes.
    const MOST: usize = 1 << 16;

    pub(crate) fn note(&mut self, Artifact { digest, bytes }: Artifact) {
        if self.sizes.insert(digest, bytes).is_none() {
            self.order.push_back(digest);
        }
        while self.order.len() > Self::MOST {
            if let Some(oldest) = self.order.pop_front() {
                self.sizes.remove(&oldest);
            }
        }
    }

    pub(crate) fn size(&self, digest: &Digest) -> Option<u64> {
        self.sizes.get(digest).copied()
    }

    pub(crate) fn forget(&mut self, digest: &Digest) {
        // Its entry in `order` stays until it is evicted.
        self.sizes.remove(digest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_are_remembered_and_what_is_removed_is_not() {
        let mut seen = Seen::default();
        let artifact = |number: u32| Artifact::of(&number.to_le_bytes());
        let count = Seen::MOST as u32 + 2;
        (0..count).for_each(|number| seen.note(artifact(number)));
        assert_eq!((seen.size(&artifact(1).digest), seen.size(&artifact(2).digest)), (None, Some(4)));
        seen.forget(&artifact(2).digest);
        assert_eq!(seen.size(&artifact(2).digest), None);
        assert_eq!((seen.sizes.len(), seen.order.len()), (Seen::MOST - 1, Seen::MOST));
    }
}
