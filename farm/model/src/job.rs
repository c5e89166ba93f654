//! Jobs: scene, settings and frames, their limits and states, and the actions on them.

use serde::{Deserialize, Deserializer, Serialize};

use crate::{
    Digest, Graph, GraphError, Grid, JobNotes, NotesError, Scope, Stage, check_graph, check_graph_frames, encode_graph,
    max_graph_inputs,
};

/// A job as submitted. Only its priority can change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobSpec {
    /// Name for display and for file names: the stem of the scene file.
    pub name: String,
    /// Scene in the artifact store: a [`Manifest`](crate::Manifest), which names the artifacts that hold the scene's files.
    pub bundle: Digest,
    /// Path of the scene file within the bundle.
    pub entry: String,
    /// Render settings as JSON. Only the worker and the command line interpret them, except that the coordinator reads the error
    /// target of frames, to show it.
    pub settings: String,
    /// Frame numbers, strictly ascending.
    pub frames: Vec<u32>,
    /// Film and tiles.
    pub grid: Grid,
    /// Stages of the job. Kinds and roles of earlier versions are replaced when it is read.
    #[serde(deserialize_with = "updated_graph")]
    pub graph: Graph,
    /// Keys of the shared contents of the frames. An entry holds the position in [`JobSpec::frames`] at which its run of frames
    /// ends (exclusive), and the key of these frames. Empty if no stage belongs to a shared content. A key is a digest of
    /// everything that the results of these stages depend on. Workers recompute it.
    pub contents: Vec<(u32, Digest)>,
    /// Priority, 0..=100. Jobs with a greater priority go first.
    pub priority: u8,
    /// Name of the owner who submitted the job.
    pub owner: String,
    /// Tags that a worker must have, all of them.
    pub tags: Vec<String>,
    /// Comment, labels, and the address that is notified when the job ends.
    #[serde(deserialize_with = "crate::since_version_11")]
    pub notes: JobNotes,
}

impl JobSpec {
    /// Maximum number of tiles of a frame.
    pub const MAX_TILES: u32 = Graph::MAX_TASKS;
    /// Maximum number of frames of a job.
    pub const MAX_FRAMES: usize = 1 << 20;
    /// Maximum side of the film in pixels.
    pub const MAX_SIDE: u32 = 1 << 16;
    /// Maximum number of tags.
    pub const MAX_TAGS: usize = 64;
    /// Maximum length of the settings in bytes.
    pub const MAX_SETTINGS: usize = 1 << 20;
    /// Number of job specs that a session remembers. A coordinator resends a spec after it has sent this many others.
    pub const SESSION_SPECS: usize = 1024;
    /// Maximum length in bytes of a name, an owner, a tag, or a path.
    pub const MAX_NAME: usize = 1 << 10;

    /// Checks that a scheduler can run the job.
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
            || self.frames[0] == Stage::JOB_FRAME
            || self.frames.windows(2).any(|pair| pair[0] >= pair[1])
        {
            return Err(SpecError::Frames { frames: self.frames.len() });
        }
        check_graph(&self.graph)?;
        check_graph_frames(&self.graph, self.frames.len() as u64)?;
        if max_graph_inputs(&self.graph, self.frames.len() as u64) > Graph::MAX_INPUTS {
            return Err(GraphError::TooMany { what: "outputs that a task reads", limit: Graph::MAX_INPUTS }.into());
        }
        let named = self.contents.last().map_or(0, |(end, _)| *end as usize);
        let wanted = if self.graph.has_content_stages() { self.frames.len() } else { 0 };
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
        if !Self::is_valid_name(&self.name) {
            return Err(SpecError::Name);
        }
        let shown = [&self.entry, &self.owner].into_iter().chain(&self.tags);
        if shown.into_iter().any(|text| text.contains(char::is_control)) {
            return Err(SpecError::ControlCharacters);
        }
        self.notes.check()?;
        if self.settings.len() > Self::MAX_SETTINGS {
            return Err(SpecError::TooLong { field: "settings" });
        }
        Ok(())
    }

    /// Returns whether `name` can be a file name in any folder that a user chooses: a single path component that does not lead to
    /// another folder.
    pub fn is_valid_name(name: &str) -> bool {
        let is_odd = |c: char| matches!(c, '/' | '\\' | ':') || c.is_control();
        !name.contains(is_odd) && !matches!(name, "" | "." | "..")
    }

    /// Returns the key of the shared content of the frame at this position in [`JobSpec::frames`].
    pub fn content_key(&self, index: usize) -> Option<Digest> {
        let run = self.contents.partition_point(|(end, _)| *end as usize <= index);
        self.contents.get(run).map(|(_, key)| *key)
    }

    /// Returns the number of tasks in all frames and rounds, including those of the job itself.
    pub fn tasks(&self) -> u64 {
        self.graph.tasks(Scope::Frame).saturating_mul(self.frames.len() as u64) + self.graph.tasks(Scope::Job)
    }

    /// Returns the planned samples per pixel at the end of each round.
    pub fn rounds(&self) -> &[u32] {
        self.graph.main_stage().map_or(&[], |(_, template)| &template.steps)
    }

    /// Returns the planned samples per pixel that round `round` adds, as a range of sample indices. Empty past the last round.
    pub fn samples(&self, round: u32) -> std::ops::Range<u32> {
        self.graph.main_stage().map_or(0..0, |(_, template)| template.steps_of(round))
    }

    /// Returns the pixel samples of a frame if every round runs as planned.
    pub fn samples_of_frame(&self) -> u64 {
        let main = self.graph.main_stage();
        main.map_or(0, |(_, it)| it.sizes.sum().saturating_mul(it.steps.last().copied().unwrap_or(0).into()))
    }

    /// Returns a digest of everything that decides the job's pixels. Jobs with equal keys have frames that are equal to the bit.
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
        put(&encode_graph(&self.graph));
        for (end, key) in &self.contents {
            put(&numbers(&[*end]));
            put(key.as_bytes());
        }
        Digest::compute(&bytes)
    }
}

fn updated_graph<'de, D: Deserializer<'de>>(from: D) -> Result<Graph, D::Error> {
    Graph::deserialize(from).map(Graph::updated)
}

fn numbers(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Reason why a job is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// A side is 0 or too long, or the tile's side is 0.
    #[error("invalid film: {width} x {height} pixels in tiles of {tile}")]
    Film {
        /// Size in pixels.
        width: u32,
        /// Size in pixels.
        height: u32,
        /// Size in pixels.
        tile: u32,
    },
    /// There are too many tiles.
    #[error("a frame has {tiles} tiles, at most {limit} are possible")]
    Tiles {
        /// Number of tiles of a frame.
        tiles: u64,
        /// Maximum permitted value.
        limit: u32,
    },
    /// The frame numbers are empty, too many, or not ascending from 1.
    #[error(
        "invalid frame numbers: {frames} frames; a job needs 1 to {} frames with ascending numbers from 1",
        JobSpec::MAX_FRAMES
    )]
    Frames {
        /// Number of frames in the specification.
        frames: usize,
    },
    /// The keys of shared contents are too few, too many, or out of order.
    #[error("{named} frames have content keys in ascending order, expected {wanted}")]
    Contents {
        /// Number of frames with a key.
        named: usize,
        /// Number of frames that need a key.
        wanted: usize,
    },
    /// The stages cannot run.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The priority is above 100.
    #[error("the priority is {priority}, at most 100 is possible")]
    Priority {
        /// Priority from the specification.
        priority: u8,
    },
    /// The name of the job cannot be a file name. Files of the job's frames are named after it.
    #[error(
        "invalid job name: files are named after the job, so its name must not be empty, `.` or `..`, \
             or contain /, \\, : or control characters"
    )]
    Name,
    /// A text contains control characters. Texts are shown on terminals and must not control them.
    #[error("a path, an owner or a tag contains control characters")]
    ControlCharacters,
    /// A comment, a label or an address is not valid.
    #[error(transparent)]
    Notes(#[from] NotesError),
    /// A text is longer than its limit.
    #[error("{field} is too long")]
    TooLong {
        /// Name of the field.
        field: &'static str,
    },
}

/// State of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum JobState {
    /// No task of the job has been leased yet.
    Queued,
    /// Some task is leased or done.
    Running,
    /// Paused by a user. Running tasks are finished.
    Paused,
    /// Every frame is finished.
    Done,
    /// Nothing is left to run, and some frame could not be finished.
    Failed,
    /// Cancelled by a user.
    Cancelled,
}

impl JobState {
    /// Returns the state in one word.
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

    /// Returns whether the job has ended: nothing more happens without a user's action.
    pub const fn has_ended(self) -> bool {
        match self {
            Self::Queued | Self::Running | Self::Paused => false,
            Self::Done | Self::Failed | Self::Cancelled => true,
        }
    }
}

/// Action of a user on a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Control {
    /// Lease no more tasks of the job.
    Pause,
    /// End a pause.
    Resume,
    /// End the job now. Finished frames are kept.
    Cancel,
    /// Retry everything that failed or that a cancellation left undone.
    Retry,
    /// Change the priority (0..=100).
    Priority(u8),
    /// Retry the failures of these frames only. A paused job stays paused, and failures of other frames remain. Failures in shared
    /// results are retried for all jobs that need them.
    RetryFrames(Vec<u32>),
    /// Delete an ended job with its frames, logs and attempts.
    Delete,
}

#[cfg(test)]
mod tests {
    use crate::{Role, StageKind, StageTemplate, TaskSizes};

    use super::*;

    fn graph(rounds: &[u32]) -> Graph {
        let render = StageTemplate::new(StageKind::Render, Scope::Frame, TaskSizes::even(16, 256), &[Role::Tile])
            .with_steps(rounds);
        let image = StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image])
            .with_input(0, Role::Tile, crate::Reach::All)
            .with_loop(0, rounds.len() as u32);
        Graph { stages: vec![render, image] }
    }

    fn spec() -> JobSpec {
        JobSpec {
            name: "fog".into(),
            bundle: Digest::compute(b"scene"),
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
        assert_eq!(JobSpec { notes, ..spec() }.check(), Err(NotesError::ControlCharacters { what: "comment" }.into()));
        let owner = "me\u{1b}[2J".to_owned();
        assert_eq!(JobSpec { owner, ..spec() }.check(), Err(SpecError::ControlCharacters));
        let mut large = graph(&[4, 8, 16]);
        large.stages[0].sizes = TaskSizes::even(1 << 15, 1);
        let many = GraphError::TooMany { what: "outputs that a task reads", limit: Graph::MAX_INPUTS };
        assert_eq!(JobSpec { graph: large, ..spec() }.check(), Err(many.into()));
        let tags = vec!["a".to_owned(); 65];
        assert_eq!(JobSpec { tags, ..spec() }.check(), Err(SpecError::TooLong { field: "tags" }));
    }

    #[test]
    fn a_stage_of_the_job_has_as_many_tasks_as_the_frames_feed() {
        let joined = |tasks, fan| {
            let mut graph = graph(&[4, 8, 16]);
            let pairs = StageTemplate::new(StageKind::Reduce, Scope::Job, TaskSizes::even(tasks, 1), &[Role::Sums]);
            graph.stages.push(pairs.with_input(1, Role::Image, crate::Reach::Fan(fan)));
            JobSpec { graph, ..spec() }.check()
        };
        // The job has three frames.
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
