//! Tags of workers that know the later kinds of stages and roles of outputs. Workers of earlier versions cannot read a graph with a
//! kind or role that is new to them, so all stages of such a graph require its tags
//! ([`Graph::add_known_tags`](crate::Graph::add_known_tags)).

/// Tag of workers that support first passes.
pub const FIRST_PASS: &str = "first-pass";

/// Tag of workers that support first passes in blocks. Only graphs of earlier versions require it.
pub const FIRST_PASS_BLOCKS: &str = "first-pass-blocks";

/// Tag of workers that support light statistics.
pub const STATISTICS: &str = "statistics";

/// Tag of workers that support layers.
pub const LAYERS: &str = "layers";

/// Tag of workers that support features and the layer format with room for them.
pub const FEATURES: &str = "features";

/// Tag of workers that support painted styles.
pub const PAINTING: &str = "painting";

/// Tag of workers that know one kind for each thing that a task does, where earlier versions chose by the role of the outputs.
pub const TASK_KINDS: &str = "task-kinds";

/// Tag of workers that support scene geometry for viewers.
pub const GEOMETRY: &str = "geometry";

/// Tag of workers that support finite-element solutions for viewers.
pub const SOLUTION: &str = "solution";

/// Tag of workers that support measurements of light.
pub const MEASUREMENTS: &str = "measurements";

/// Tag of workers that support paths guided as in the method of 1998. It is required by the settings, not by a kind or a role.
pub const GUIDE_1998: &str = "guide-1998";

/// Tag of workers that know stages that learn the targets of a frame's paths.
pub const TARGETS: &str = "targets";

/// All these tags. A worker of this version offers them.
pub const ALL: [&str; 12] = [
    FIRST_PASS,
    FIRST_PASS_BLOCKS,
    STATISTICS,
    LAYERS,
    FEATURES,
    PAINTING,
    TASK_KINDS,
    GEOMETRY,
    SOLUTION,
    MEASUREMENTS,
    GUIDE_1998,
    TARGETS,
];
