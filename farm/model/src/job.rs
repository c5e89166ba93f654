//! What is asked for: a scene, its settings, its frames.

use serde::{Deserialize, Serialize};

use crate::{Digest, Graph, GraphError, Grid, JobNotes, NotesError, Scope, Stage};

/// A job as it was submitted; it never changes, but for its priority.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobSpec {
    /// Name for people and for file names: the scene file's stem.
    pub name: String,
    /// The scene in the artifact store: a [`Manifest`](crate::Manifest), which names the artifacts that hold its files.
    pub bundle: Digest,
    /// Path of the scene file within the bundle.
    pub entry: String,
    /// The render settings as JSON; only the worker and the command line look inside. The coordinator reads the error that frames are
    /// to reach, to show it.
    pub settings: String,
    /// Frame numbers, strictly ascending.
    pub frames: Vec<u32>,
    /// Film and tiles.
    pub grid: Grid,
    /// Its stages.
    pub graph: Graph,
    /// The keys of its frames' contents: up to this place in [`JobSpec::frames`] (exclusive) they have this one. Empty where no
    /// stage is of a content. A key is a digest of all that the results of these stages depend on; workers compute it again.
    pub contents: Vec<(u32, Digest)>,
    /// 0..=100; greater goes first.
    pub priority: u8,
    /// Name of the owner who submitted the job.
    pub owner: String,
    /// A worker must have all of these.
    pub tags: Vec<String>,
    /// Comment, labels, and the address that is told of its end.
    #[serde(deserialize_with = "crate::since_version_11")]
    pub notes: JobNotes,
}

impl JobSpec {
    /// Most tiles of a frame.
    pub const MAX_TILES: u32 = Graph::MAX_TASKS;
    /// Most frames of a job.
    pub const MAX_FRAMES: usize = 1 << 20;
    /// Most pixels along a side of the film.
    pub const MAX_SIDE: u32 = 1 << 16;
    /// Most tags.
    pub const MAX_TAGS: usize = 64;
    /// Most bytes of settings.
    pub const MAX_SETTINGS: usize = 1 << 20;
    /// Specs of jobs that a session keeps: a coordinator sends a spec again once it has sent this many others.
    pub const SESSION_SPECS: usize = 1024;
    /// Most bytes of a name, an owner, a tag, a path.
    pub const MAX_NAME: usize = 1 << 10;

    /// Refuses what no scheduler should see.
    pub fn check(&self) -> Result<(), SpecError> {
        let Grid { film, tile } = self.grid;
        if film.iter().any(|&side| side == 0 || side > Self::MAX_SIDE) || tile == 0 {
            return Err(SpecError::Film { width: film[0], height: film[1], tile });
        }
        let tiles = u64::from(film[0].div_ceil(tile)) * u64::from(film[1].div_ceil(tile));
        if tiles > u64::from(Self::MAX_TILES) {
            return Err(SpecError::Tiles { tiles, limit: Self::MAX_TILES });
        }
        if self.frames.is_empty()
            || self.frames.len() > Self::MAX_FRAMES
            || self.frames[0] == Stage::OF_JOB
            || self.frames.windows(2).any(|pair| pair[0] >= pair[1])
        {
            return Err(SpecError::Frames { frames: self.frames.len() });
        }
        self.graph.check()?;
        self.graph.check_frames(self.frames.len() as u64)?;
        if self.graph.most_inputs(self.frames.len() as u64) > Graph::MAX_INPUTS {
            return Err(GraphError::TooMany { what: "outputs that a task reads", limit: Graph::MAX_INPUTS }.into());
        }
        let named = self.contents.last().map_or(0, |(end, _)| *end as usize);
        let wanted = if self.graph.has_content() { self.frames.len() } else { 0 };
        let ascends = self.contents.windows(2).all(|pair| pair[0].0 < pair[1].0);
        if named != wanted || !ascends || self.contents.first().is_some_and(|(end, _)| *end == 0) {
            return Err(SpecError::Contents { named, wanted });
        }
        if self.priority > 100 {
            return Err(SpecError::Priority { priority: self.priority });
        }
        let names = [("name", &self.name), ("entry", &self.entry), ("owner", &self.owner)];
        let tags = self.tags.iter().map(|tag| ("tags", tag));
        if let Some((field, _)) = names.into_iter().chain(tags).find(|(_, text)| text.len() > Self::MAX_NAME) {
            return Err(SpecError::TooLong { field });
        }
        if self.tags.len() > Self::MAX_TAGS {
            return Err(SpecError::TooLong { field: "tags" });
        }
        if !Self::names_files(&self.name) {
            return Err(SpecError::Name);
        }
        let shown = [&self.entry, &self.owner].into_iter().chain(&self.tags);
        if shown.into_iter().any(|text| text.contains(char::is_control)) {
            return Err(SpecError::Control);
        }
        self.notes.check()?;
        if self.settings.len() > Self::MAX_SETTINGS {
            return Err(SpecError::TooLong { field: "settings" });
        }
        Ok(())
    }

    /// Whether files may be called so that lie in a folder of somebody else's choice: one part of a path, and no part that
    /// leads anywhere.
    pub fn names_files(name: &str) -> bool {
        let is_odd = |c: char| matches!(c, '/' | '\\' | ':') || c.is_control();
        !name.contains(is_odd) && !matches!(name, "" | "." | "..")
    }

    /// The key of the content that the frame at this place of [`JobSpec::frames`] has.
    pub fn content(&self, place: usize) -> Option<Digest> {
        let run = self.contents.partition_point(|(end, _)| *end as usize <= place);
        self.contents.get(run).map(|(_, key)| *key)
    }

    /// Tasks of all its frames and rounds, and of the job as a whole.
    pub fn tasks(&self) -> u64 {
        self.graph.tasks(Scope::Frame).saturating_mul(self.frames.len() as u64) + self.graph.tasks(Scope::Job)
    }

    /// Samples a pixel at the end of each round, as planned.
    pub fn rounds(&self) -> &[u32] {
        self.graph.main().map_or(&[], |(_, template)| &template.steps)
    }

    /// Samples a pixel that round `round` adds, as planned, as a range of sample indices; empty beyond the last round.
    pub fn samples(&self, round: u32) -> std::ops::Range<u32> {
        self.graph.main().map_or(0..0, |(_, template)| template.steps_of(round))
    }

    /// Pixel samples of a frame, if every round runs as planned.
    pub fn samples_of_frame(&self) -> u64 {
        let main = self.graph.main();
        main.map_or(0, |(_, it)| it.sizes.sum().saturating_mul(it.steps.last().copied().unwrap_or(0).into()))
    }

    /// Digest of all that decides the job's pixels: two jobs with one key have the same frames to the bit.
    pub fn key(&self) -> Digest {
        let mut bytes = Vec::new();
        let mut put = |part: &[u8]| {
            bytes.extend((part.len() as u64).to_le_bytes());
            bytes.extend(part);
        };
        put(self.bundle.as_bytes());
        put(self.entry.as_bytes());
        put(self.settings.as_bytes());
        put(&numbers(&self.frames));
        put(&numbers(&[self.grid.film[0], self.grid.film[1], self.grid.tile]));
        put(&self.graph.encode());
        for (end, key) in &self.contents {
            put(&numbers(&[*end]));
            put(key.as_bytes());
        }
        Digest::of(&bytes)
    }
}

fn numbers(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Why a job cannot be taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// A side is 0 or too long, or the tile's side is 0.
    #[error("film of {width} x {height} pixels in tiles of {tile}")]
    Film {
        /// Pixels.
        width: u32,
        /// Pixels.
        height: u32,
        /// Pixels.
        tile: u32,
    },
    /// Too many tiles.
    #[error("{tiles} tiles a frame, at most {limit}")]
    Tiles {
        /// Tiles of a frame.
        tiles: u64,
        /// The most there may be.
        limit: u32,
    },
    /// None, too many, or not ascending from 1.
    #[error("{frames} frames: at least 1, at most {}, ascending from number 1", JobSpec::MAX_FRAMES)]
    Frames {
        /// Number of frames in the specification.
        frames: usize,
    },
    /// Keys of contents for too few frames, or too many, or out of order.
    #[error("the contents of {named} frames are named in order, {wanted} should be")]
    Contents {
        /// Number of frames with a key.
        named: usize,
        /// Number of frames that need a key.
        wanted: usize,
    },
    /// Stages that cannot be run.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// Beyond 100.
    #[error("priority {priority}, at most 100")]
    Priority {
        /// Priority from the specification.
        priority: u8,
    },
    /// Whoever fetches the job's frames names files by it.
    #[error("the name of a job is the name of its files: it is not empty, and has no /, \\, : or control characters")]
    Name,
    /// What is shown on terminals must not steer them.
    #[error("control characters in a path, an owner or a tag")]
    Control,
    /// A comment, a label or an address that cannot be kept.
    #[error(transparent)]
    Notes(#[from] NotesError),
    /// A text beyond its limit.
    #[error("{field} is too long")]
    TooLong {
        /// Name of the field.
        field: &'static str,
    },
}

/// Where a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum JobState {
    /// Nothing of it has been leased yet.
    Queued,
    /// Some task is leased or done.
    Running,
    /// Held by a person; running tasks end.
    Paused,
    /// Every frame is finished.
    Done,
    /// Nothing is left to do, and some frame could not be finished.
    Failed,
    /// Ended by a person.
    Cancelled,
}

impl JobState {
    /// The state in one word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Paused => "paused",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether nothing more will happen by itself.
    pub const fn has_ended(self) -> bool {
        match self {
            Self::Queued | Self::Running | Self::Paused => false,
            Self::Done | Self::Failed | Self::Cancelled => true,
        }
    }
}

/// What a person may do to a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Control {
    /// Lease no more of it.
    Pause,
    /// End a pause.
    Resume,
    /// End it now; what is finished stays.
    Cancel,
    /// Try again what failed, or what a cancel left undone.
    Retry,
    /// Change the priority (0..=100).
    Priority(u8),
    /// Try again what failed of these frames, and nothing else: a pause stays, and so do the failures of other frames. What of
    /// them is shared with others is tried again for all who need it.
    RetryFrames(Vec<u32>),
    /// Forget the job, which has ended, with its frames, its logs and its attempts.
    Delete,
}

#[cfg(test)]
mod tests {
    use crate::{Role, Sizes, StageKind, Template};

    use super::*;

    fn graph(rounds: &[u32]) -> Graph {
        let render = Template::new(StageKind::Render, Scope::Frame, Sizes::even(16, 256), &[Role::Tile]).steps(rounds);
        let image = Template::new(StageKind::Image, Scope::Frame, Sizes::even(1, 1), &[Role::Image])
            .reads(0, Role::Tile, crate::Reach::All)
            .closes(0, rounds.len() as u32);
        Graph { stages: vec![render, image] }
    }

    fn spec() -> JobSpec {
        JobSpec {
            name: "fog".into(),
            bundle: Digest::of(b"scene"),
            entry: "fog.mgf".into(),
            settings: "{}".into(),
            frames: vec![1, 2, 5],
            grid: Grid { film: [64, 64], tile: 16 },
            graph: graph(&[4, 8, 16]),
            contents: vec![],
            priority: 50,
            owner: "me".into(),
            tags: vec![],
            notes: JobNotes::default(),
        }
    }

    #[test]
    fn rounds_cut_the_samples_without_gap_or_overlap() {
        let spec = spec();
        assert_eq!([0, 1, 2, 3].map(|round| spec.samples(round)), [0..4, 4..8, 8..16, 16..16]);
    }

    #[test]
    fn impossible_jobs_are_refused() {
        assert_eq!(spec().check(), Ok(()));
        let grid = Grid { film: [0, 64], tile: 16 };
        assert_eq!(JobSpec { grid, ..spec() }.check(), Err(SpecError::Film { width: 0, height: 64, tile: 16 }));
        let grid = Grid { film: [65536, 65536], tile: 1 };
        assert!(matches!(JobSpec { grid, ..spec() }.check(), Err(SpecError::Tiles { .. })));
        assert!(matches!(JobSpec { frames: vec![], ..spec() }.check(), Err(SpecError::Frames { frames: 0 })));
        assert!(matches!(JobSpec { frames: vec![2, 2], ..spec() }.check(), Err(SpecError::Frames { frames: 2 })));
        assert!(matches!(JobSpec { graph: graph(&[0, 4]), ..spec() }.check(), Err(SpecError::Graph(_))));
        assert_eq!(JobSpec { frames: vec![0, 4], ..spec() }.check(), Err(SpecError::Frames { frames: 2 }));
        assert_eq!(JobSpec { priority: 101, ..spec() }.check(), Err(SpecError::Priority { priority: 101 }));
        let entry = "x".repeat(2000);
        assert_eq!(JobSpec { entry, ..spec() }.check(), Err(SpecError::TooLong { field: "entry" }));
        for name in ["", "..", "../up", "/etc/x", "a/b", "a\\b", "c:x", "a\0b", "a\u{1b}[2Jb"] {
            assert_eq!(JobSpec { name: name.into(), ..spec() }.check(), Err(SpecError::Name), "{name:?}");
        }
        let notes = JobNotes { comment: "me\u{1b}[2J".to_owned(), ..JobNotes::default() };
        assert_eq!(JobSpec { notes, ..spec() }.check(), Err(NotesError::Control { what: "comment" }.into()));
        let owner = "me\u{1b}[2J".to_owned();
        assert_eq!(JobSpec { owner, ..spec() }.check(), Err(SpecError::Control));
        let mut large = graph(&[4, 8, 16]);
        large.stages[0].sizes = Sizes::even(1 << 15, 1);
        let many = GraphError::TooMany { what: "outputs that a task reads", limit: Graph::MAX_INPUTS };
        assert_eq!(JobSpec { graph: large, ..spec() }.check(), Err(many.into()));
        let tags = vec!["a".to_owned(); 65];
        assert_eq!(JobSpec { tags, ..spec() }.check(), Err(SpecError::TooLong { field: "tags" }));
    }

    #[test]
    fn a_stage_of_the_job_has_as_many_tasks_as_the_frames_feed() {
        let joined = |tasks, fan| {
            let mut graph = graph(&[4, 8, 16]);
            let pairs = Template::new(StageKind::Reduce, Scope::Job, Sizes::even(tasks, 1), &[Role::Sums]);
            graph.stages.push(pairs.reads(1, Role::Image, crate::Reach::Fan(fan)));
            JobSpec { graph, ..spec() }.check()
        };
        // Of three frames.
        assert_eq!((joined(3, 1), joined(2, 2), joined(1, 3), joined(1, 9)), (Ok(()), Ok(()), Ok(()), Ok(())));
        for (tasks, fan, wanted) in [(2, 1, 3), (4, 1, 3), (1, 2, 2), (3, 2, 2), (2, 3, 1)] {
            let error = GraphError::Fan { stage: 2, found: tasks, wanted, read: 3, fan };
            assert_eq!(joined(tasks, fan), Err(SpecError::Graph(error)));
        }
    }

    #[test]
    fn the_key_follows_what_decides_the_pixels_and_nothing_else() {
        let notes = JobNotes { comment: "Friday's".into(), ..JobNotes::default() };
        let other =
            JobSpec { priority: 1, owner: "you".into(), name: "x".into(), tags: vec!["a".into()], notes, ..spec() };
        assert_eq!(spec().key(), other.key());
        assert_ne!(spec().key(), JobSpec { frames: vec![1, 2], ..spec() }.key());
        assert_ne!(spec().key(), JobSpec { settings: "{ }".into(), ..spec() }.key());
        assert_ne!(spec().key(), JobSpec { graph: graph(&[4, 8]), ..spec() }.key());
    }
}
