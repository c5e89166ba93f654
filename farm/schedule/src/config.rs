//! The scheduler's times and limits.

use std::collections::BTreeMap;
use std::num::NonZeroU64;

use femc_model::Grid;

/// Times in milliseconds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Config {
    /// A lease ends so long after its last renewal.
    pub lease: u64,
    /// Workers are asked to send heartbeats so often; several fit into a lease.
    pub heartbeat: u64,
    /// A task that shows no progress for so long is not renewed any more.
    pub stall: u64,
    /// The same while a scene is prepared, which shows no progress.
    pub preparation_stall: u64,
    /// First rest of a worker after a failure of its surroundings; it doubles from failure to failure.
    pub rest: u64,
    /// Longest such rest.
    pub longest_rest: u64,
    /// After a restart with unfinished jobs nothing is dealt for so long: workers that have lived on come back with what they
    /// still work on, and that shall not be given to others.
    pub regroup: u64,
    /// A worker on which three tasks of a job have failed in a row gets no more of that job for so long, then one task as a
    /// probe; it doubles from probe to failed probe.
    pub shun: u64,
    /// Longest such time.
    pub longest_shun: u64,
    /// Tasks that a worker holds beyond those that it runs: one that it can begin at once, and one whose result is on its
    /// way and counts as held until it is durable.
    pub prefetch: u32,
    /// Where tasks take less than this, a worker holds more of them, up to so many milliseconds of work and at most
    /// [`Config::DEEPEST`] tasks: then none waits for the next one's way.
    pub ahead: u64,
    /// A task is meant to take so long, where a tile can be cut.
    pub task: u64,
    /// And so long at least, where there is too little for everybody.
    pub least_task: u64,
    /// A task that takes longer than this, and twice as long as expected, may be given to a second worker that is idle.
    pub late: u64,
    /// Pixel samples of a tile below which it is not cut; of jobs that are submitted from now on.
    pub grain: NonZeroU64,
    /// A worker that was gone in mid-task and has not come back for so long is taken for dead: longer than one that lives takes
    /// to notice and to try again.
    pub presumed: u64,
    /// A frame begins anew when no worker of its build of the engine has been there for so long, and others are.
    pub orphaned: u64,
    /// Most tiles that are gathered at a time before the merge, in frames of more than so many; of large tiles fewer. 0: the
    /// merge reads all tiles.
    pub group: u32,
    /// A job that ended so long ago is forgotten; `None`: never.
    pub keep_ended: Option<u64>,
    /// Weights of owners in the fair share of time; who is not named has 1.
    pub weights: BTreeMap<String, u32>,
    /// What one owner may have waiting.
    pub quota: Quota,
}

/// What the jobs of one owner that have not ended may add up to; a job beyond is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quota {
    /// Jobs: 10 000.
    pub jobs: u64,
    /// Their frames, which have memory each once they are begun: 2^22.
    pub frames: u64,
    /// Their tiles in all frames and rounds: 2^32.
    pub tiles: u64,
}

impl Default for Quota {
    fn default() -> Self {
        Self { jobs: 10_000, frames: 1 << 22, tiles: 1 << 32 }
    }
}

impl Config {
    /// Most tasks that a worker holds beyond `prefetch`.
    pub const DEEPEST: u64 = 64;

    /// Tasks that a worker holds beyond `prefetch`, where each takes so many milliseconds.
    pub(crate) fn depth(&self, milliseconds: u64) -> usize {
        (self.ahead / milliseconds.max(1)).min(Self::DEEPEST) as usize
    }

    /// Pixel samples of a grain: some tenths of a second of one processor, seconds where light is hard to find.
    pub const GRAIN: NonZeroU64 = NonZeroU64::new(1 << 15).unwrap();

    /// Heartbeats in a lease.
    const HEARTBEATS: u64 = 10;

    /// Leases of so many milliseconds and heartbeats to match.
    pub fn with_lease(lease: u64) -> Self {
        Self { lease, heartbeat: lease / Self::HEARTBEATS, ..Self::default() }
    }

    /// Most pixels of a group: a worker unites their sums, 144 bytes each, in about a second.
    const GATHERED: u64 = 1 << 18;

    /// Tiles of a group in a frame of this grid; `None`: its merge reads all tiles.
    pub(crate) fn group_of(&self, grid: &Grid) -> Option<u32> {
        let tile = u64::from(grid.tile) * u64::from(grid.tile);
        let group = u64::from(self.group).min((Self::GATHERED / tile.max(1)).max(1)) as u32;
        (group > 0 && grid.tiles() > group).then_some(group)
    }

    /// An owner's weight.
    pub fn weight(&self, owner: &str) -> u32 {
        self.weights.get(owner).copied().unwrap_or(1)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            lease: 4_500,
            heartbeat: 500,
            stall: 120_000,
            preparation_stall: 900_000,
            rest: 1_000,
            longest_rest: 60_000,
            regroup: 500,
            shun: 60_000,
            longest_shun: 3_600_000,
            prefetch: 2,
            ahead: 200,
            task: 8_000,
            least_task: 1_500,
            late: 2_000,
            grain: Self::GRAIN,
            presumed: 15_000,
            orphaned: 60_000,
            group: 256,
            keep_ended: None,
            weights: BTreeMap::new(),
            quota: Quota::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_has_a_number_of_tiles_and_of_pixels_that_it_does_not_exceed() {
        let group = |film, tile| Config::default().group_of(&Grid { film, tile });
        assert_eq!(group([3840, 2160], 16), Some(256));
        assert_eq!(group([3840, 2160], 64), Some(64), "64 x 64 x 64 pixels");
        assert_eq!(group([3840, 2160], 1024), Some(1));
        assert_eq!((group([512, 512], 64), group([256, 256], 16)), (None, None), "one group is none");
        assert_eq!(Config { group: 0, ..Config::default() }.group_of(&Grid { film: [3840, 2160], tile: 16 }), None);
    }
}
