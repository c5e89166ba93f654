//! Cache of artifacts that were recently stored or verified: they count as present and sound without asking the medium.

use std::collections::{BTreeMap, VecDeque};

use femc_model::{Artifact, Digest};

/// Sizes of recent artifacts; the oldest entry is evicted first.
#[derive(Debug, Default)]
pub(crate) struct RecentArtifacts {
    sizes: BTreeMap<Digest, u64>,
    order: VecDeque<Digest>,
}

impl RecentArtifacts {
    /// Maximum number of entries: a few megabytes.
    const CAPACITY: usize = 1 << 16;

    pub(crate) fn insert(&mut self, Artifact { digest, bytes }: Artifact) {
        if self.sizes.insert(digest, bytes).is_none() {
            self.order.push_back(digest);
        }
        while self.order.len() > Self::CAPACITY {
            if let Some(oldest) = self.order.pop_front() {
                self.sizes.remove(&oldest);
            }
        }
    }

    pub(crate) fn size(&self, digest: &Digest) -> Option<u64> {
        self.sizes.get(digest).copied()
    }

    pub(crate) fn remove(&mut self, digest: &Digest) {
        // Its entry in `order` stays until it is evicted.
        self.sizes.remove(digest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_are_remembered_and_what_is_removed_is_not() {
        let mut seen = RecentArtifacts::default();
        let artifact = |number: u32| Artifact::from_bytes(&number.to_le_bytes());
        let count = RecentArtifacts::CAPACITY as u32 + 2;
        (0..count).for_each(|number| seen.insert(artifact(number)));
        assert_eq!((seen.size(&artifact(1).digest), seen.size(&artifact(2).digest)), (None, Some(4)));
        seen.remove(&artifact(2).digest);
        assert_eq!(seen.size(&artifact(2).digest), None);
        assert_eq!((seen.sizes.len(), seen.order.len()), (RecentArtifacts::CAPACITY - 1, RecentArtifacts::CAPACITY));
    }
}
