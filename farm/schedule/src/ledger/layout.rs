//! How the work on a round of a frame is cut.

use std::num::NonZeroU32;
use std::ops::Range;

use femc_model::Grains;

/// Grains of tiles, which are rendered, and groups of tiles, which are gathered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) grains: Grains,
    group: Option<NonZeroU32>,
}

impl Layout {
    /// `group`: tiles that are gathered before the merge; `None`: the merge reads the tiles.
    pub(super) fn new(grains: Grains, group: Option<NonZeroU32>) -> Self {
        Self { grains, group }
    }

    /// Tiles of a frame.
    pub(crate) fn tiles(&self) -> u32 {
        self.grains.tiles()
    }

    /// Groups of a frame; 0 where the merge reads the tiles.
    pub(crate) fn groups(&self) -> u32 {
        self.group.map_or(0, |group| self.tiles().div_ceil(group.get()))
    }

    /// The tiles of a group.
    pub(crate) fn span(&self, group: u32) -> Range<u32> {
        let edge = |group: u32| self.group.map_or(0, |size| group.saturating_mul(size.get()).min(self.tiles()));
        edge(group)..edge(group.saturating_add(1))
    }

    /// The keys of the grains of consecutive tiles.
    pub(crate) fn keys(&self, tiles: &Range<u32>) -> Range<u32> {
        tiles.start * self.grains.per_tile()..tiles.end * self.grains.per_tile()
    }

    /// The group of the tile that a grain belongs to.
    pub(crate) fn group_of(&self, key: u32) -> Option<u32> {
        self.group.map(|group| self.grains.tile(key) / group.get())
    }
}

#[cfg(test)]
mod tests {
    use femc_model::{Cut, Digest, Grid, JobSpec};

    use super::*;

    fn layout(tiles: u32, group: u32) -> Layout {
        let spec = JobSpec {
            name: "fog".into(),
            bundle: Digest::of(b"scene"),
            entry: "fog.mgf".into(),
            settings: "{}".into(),
            frames: vec![1],
            grid: Grid { film: [8 * tiles, 8], tile: 8 },
            rounds: vec![12],
            priority: 50,
            owner: "me".into(),
            tags: vec![],
        };
        let cut = std::num::NonZeroU64::new(8 * 8 * 4).map_or(Cut::Whole, Cut::Grains);
        Layout::new(Grains::of(&spec, 0, cut), NonZeroU32::new(group))
    }

    #[test]
    fn the_groups_hold_every_tile_and_every_grain_once() {
        for (tiles, size) in [(1, 1), (7, 3), (9, 3), (10, 16)] {
            let layout = layout(tiles, size);
            let all: Vec<u32> = (0..layout.groups()).flat_map(|group| layout.span(group)).collect();
            assert_eq!(all, (0..tiles).collect::<Vec<_>>());
            for group in 0..layout.groups() {
                let keys = layout.keys(&layout.span(group));
                assert_eq!(keys.len(), 3 * layout.span(group).len());
                assert!(keys.into_iter().all(|key| layout.group_of(key) == Some(group)));
            }
            assert!(layout.span(layout.groups()).is_empty());
        }
        let whole = layout(9, 0);
        assert_eq!((whole.groups(), whole.group_of(3)), (0, None));
    }
}
