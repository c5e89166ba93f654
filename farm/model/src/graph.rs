//! Rules that a graph must follow so that a scheduler can run it, and its bytes.

use femc_graph::{Graph, Hint, Loop, Need, Reach, Round, Scope, StageTemplate};

use crate::{Chunks, JobSpec};

/// Encodes the graph. Equal graphs give equal bytes.
pub fn encode_graph(graph: &Graph) -> Vec<u8> {
    // Encoding numbers and lists to memory cannot fail.
    postcard::to_stdvec(graph).unwrap_or_default()
}

/// Returns the maximum number of outputs that one task reads in a job of `frames` frames, if every task that can be divided has
/// the maximum number of chunks.
pub fn max_graph_inputs(graph: &Graph, frames: u64) -> u64 {
    let of_need = |template: &StageTemplate, need: &Need| {
        let Some(made) = graph.stage(need.stage) else { return 0 };
        let of_frames = (template.scope, made.scope) == (Scope::Job, Scope::Frame);
        let tasks = u64::from(made.tasks()).saturating_mul(if of_frames { frames } else { 1 });
        let read = match need.reach {
            Reach::All => tasks,
            Reach::Same | Reach::Previous => 1,
            Reach::Fan(n) => tasks.min(u64::from(n)),
        };
        let rounds = if need.round == Round::Every { graph.rounds(need.stage) } else { 1 };
        let parts = if made.kind.is_divided() { Chunks::MAX_PER_TASK } else { 1 };
        read.saturating_mul(u64::from(rounds) * u64::from(parts))
    };
    let of_task = |template: &StageTemplate| {
        template.needs.iter().fold(0, |sum: u64, need| sum.saturating_add(of_need(template, need)))
    };
    graph.stages.iter().map(of_task).max().unwrap_or(0)
}

/// Checks that a scheduler can run the graph.
pub fn check_graph(graph: &Graph) -> Result<(), GraphError> {
    if graph.stages.len() > Graph::MAX_STAGES {
        return Err(GraphError::TooMany { what: "stages", limit: Graph::MAX_STAGES as u64 });
    }
    if graph.stages_of(Scope::Frame).next().is_none() {
        return Err(GraphError::Empty);
    }
    for (stage, template) in graph.iter() {
        check_stage(graph, stage, template)?;
    }
    check_last_or_every(graph)?;
    for scope in Scope::ALL {
        if graph.stages_of(scope).filter(|(_, template)| template.closes.is_some()).count() > 1 {
            return Err(GraphError::Loop { stage: 0, why: "a scope can have only one loop" });
        }
    }
    Ok(())
}

fn check_stage(graph: &Graph, stage: u16, template: &StageTemplate) -> Result<(), GraphError> {
    let StageTemplate { kind, sizes, steps, needs, hints, outputs: makes, options, tags, .. } = template;
    let limits = [
        ("tasks in a stage", u64::from(sizes.tasks()), u64::from(Graph::MAX_TASKS)),
        ("needs in a stage", needs.len() as u64, Graph::MAX_NEEDS as u64),
        ("hints in a stage", hints.len() as u64, Graph::MAX_NEEDS as u64),
        ("different sizes in a stage", sizes.runs().len() as u64, Graph::MAX_RUNS as u64),
        ("rounds", steps.len() as u64, u64::from(Graph::MAX_ROUNDS)),
        ("bytes in the options of a stage", options.len() as u64, Graph::MAX_OPTIONS as u64),
        ("tags in a stage", tags.len() as u64, JobSpec::MAX_TAGS as u64),
        ("bytes in a tag of a stage", tags.iter().map(String::len).max().unwrap_or(0) as u64, JobSpec::MAX_NAME as u64),
    ];
    if let Some(&(what, _, limit)) = limits.iter().find(|(_, found, limit)| found > limit) {
        return Err(GraphError::TooMany { what, limit });
    }
    if sizes.tasks() == 0 || sizes.runs().iter().any(|&(tasks, units)| tasks == 0 || units > u64::from(u32::MAX)) {
        return Err(GraphError::Tasks { stage });
    }
    let ascends = steps.first().is_some_and(|&first| first > 0) && steps.windows(2).all(|pair| pair[0] < pair[1]);
    if kind.is_divided() == steps.is_empty() || (kind.is_divided() && !ascends) {
        return Err(GraphError::Steps { stage });
    }
    if (1..makes.len()).any(|place| makes[..place].contains(&makes[place])) {
        return Err(GraphError::DuplicateRole { stage });
    }
    if tags.iter().chain([options]).any(|text| text.contains(char::is_control)) {
        return Err(GraphError::ControlCharacters { stage });
    }
    check_loop(graph, stage, template)?;
    if kind.is_divided() && steps.len() != graph.rounds(stage) as usize {
        return Err(GraphError::Steps { stage });
    }
    hints.iter().try_for_each(|hint| check_hint(graph, stage, template, hint))?;
    needs.iter().try_for_each(|need| check_need(graph, stage, template, need))
}

fn check_hint(graph: &Graph, stage: u16, template: &StageTemplate, hint: &Hint) -> Result<(), GraphError> {
    let fault = |why| Err(GraphError::Hint { stage, why });
    let Some(made) = graph.stage(hint.stage) else { return fault("the job does not have the stage that it reads") };
    if (template.scope, made.scope) != (Scope::Frame, Scope::Frame) {
        return fault("only stages of frames can have hints, and they read stages of frames");
    }
    if !made.outputs.contains(&hint.role) {
        return fault("the stage that it reads does not make this output");
    }
    match hint.reach {
        Reach::Fan(0) => fault("a fan must be at least 1"),
        Reach::Previous => fault("a hint cannot be a chain"),
        Reach::Same if made.tasks() != template.tasks() => fault("one-to-one reading needs equal numbers of tasks"),
        Reach::Fan(n) if made.tasks().div_ceil(n) != template.tasks() => {
            fault("the number of tasks does not match the fan")
        }
        Reach::All | Reach::Same | Reach::Fan(_) => Ok(()),
    }
}

fn check_loop(graph: &Graph, stage: u16, template: &StageTemplate) -> Result<(), GraphError> {
    let Some(Loop { first, rounds }) = template.closes else { return Ok(()) };
    let fault = |why| Err(GraphError::Loop { stage, why });
    if rounds == 0 || rounds > Graph::MAX_ROUNDS {
        return fault("a loop must have 1 to 64 rounds");
    }
    if first > stage || template.tasks() != 1 || template.kind.is_divided() {
        return fault("the stage that closes a loop must be its last stage and have one task without chunks");
    }
    if graph.iter().any(|(other, inner)| (first..=stage).contains(&other) && inner.scope != template.scope) {
        return fault("all stages of a loop must have the same scope");
    }
    Ok(())
}

/// Checks that all readers from another scope read an output of a loop in the same way: either the last round or every round.
fn check_last_or_every(graph: &Graph) -> Result<(), GraphError> {
    let beyond = |made: u16, &(reader, _): &(u16, &Need)| {
        let scope = |number| graph.stage(number).map(|template| template.scope);
        graph.is_looped(made) && scope(reader) != scope(made)
    };
    for (made, _) in graph.iter() {
        for (stage, need) in graph.readers(made).filter(|reader| beyond(made, reader)) {
            let mut others = graph.readers(made).filter(|reader| beyond(made, reader));
            if others.any(|(_, other)| other.role == need.role && other.round != need.round) {
                let why =
                    "readers in another scope must all read the last round of a loop's output, or all every round";
                return Err(GraphError::Need { stage, why });
            }
        }
    }
    Ok(())
}

fn check_need(graph: &Graph, stage: u16, template: &StageTemplate, need: &Need) -> Result<(), GraphError> {
    let fault = |why| Err(GraphError::Need { stage, why });
    let Some(made) = graph.stage(need.stage) else { return fault("it needs a stage that does not exist") };
    let same_loop = template.scope == made.scope && graph.is_looped(stage) && graph.is_looped(need.stage);
    let is_before = need.round == Round::Previous;
    if !made.outputs.contains(&need.role) {
        return fault("it needs an output that the stage does not make");
    }
    let is_chain = need.reach == Reach::Previous && need.stage == stage;
    if (need.stage >= stage && !is_before && !is_chain) || (is_before && !same_loop) {
        return fault("it needs a later stage");
    }
    if !template.scope.may_read(made.scope) {
        return fault("it needs a stage of a scope that its own scope cannot read");
    }
    if need.round == Round::Every && same_loop {
        return fault("it needs future rounds of its own loop");
    }
    let of_frames = (template.scope, made.scope) == (Scope::Job, Scope::Frame);
    let tasks = if of_frames { None } else { Some(made.tasks()) };
    match (need.reach, tasks) {
        (Reach::Fan(0), _) => fault("a fan must be at least 1"),
        (Reach::Same | Reach::Previous, Some(tasks)) if tasks != template.tasks() => {
            fault("one-to-one reading needs equal numbers of tasks")
        }
        (Reach::Previous, _)
            if need.round == Round::Previous || template.kind.is_divided() || graph.is_looped(stage) =>
        {
            fault("a chain cannot be in a loop, and its tasks cannot have chunks")
        }
        (Reach::Previous, None) => fault("a chain cannot read several frames"),
        (Reach::Fan(n), Some(tasks)) if tasks.div_ceil(n) != template.tasks() => {
            fault("the number of tasks does not match the fan")
        }
        (Reach::Same, None) => fault("one-to-one reading cannot read several frames"),
        _ => Ok(()),
    }
}

/// Checks that stages of the job that read stages of frames with [`Reach::Fan`] have the right number of tasks for `frames`
/// frames.
pub fn check_graph_frames(graph: &Graph, frames: u64) -> Result<(), GraphError> {
    for (stage, template) in graph.stages_of(Scope::Job) {
        for need in &template.needs {
            let made = graph.stage(need.stage).filter(|made| made.scope == Scope::Frame);
            let (Some(made), Reach::Fan(fan)) = (made, need.reach) else { continue };
            let read = u64::from(made.tasks()) * frames;
            let (found, wanted) = (template.tasks(), read.div_ceil(u64::from(fan.max(1))));
            if u64::from(found) != wanted {
                return Err(GraphError::Fan { stage, found, wanted, read, fan });
            }
        }
    }
    Ok(())
}

/// Reason why a graph cannot run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GraphError {
    /// A quantity exceeds its limit.
    #[error("too many {what}: at most {limit}")]
    TooMany {
        /// Quantity that exceeds its limit.
        what: &'static str,
        /// Maximum permitted value.
        limit: u64,
    },
    /// The graph has no stage of frames.
    #[error("the job has no stages for its frames")]
    Empty,
    /// The stage has no tasks, has an empty entry in its sizes, or has more than `u32::MAX` units per step.
    #[error("stage {stage} has no tasks")]
    Tasks {
        /// Number of the stage in the graph.
        stage: u16,
    },
    /// The steps are missing where tasks are divided into chunks (or given where they are not), not ascending, or not one per
    /// round.
    #[error("the steps of stage {stage} must be ascending numbers from 1, one for each round")]
    Steps {
        /// Number of the stage in the graph.
        stage: u16,
    },
    /// A role occurs twice.
    #[error("stage {stage} makes two outputs with the same role")]
    DuplicateRole {
        /// Number of the stage in the graph.
        stage: u16,
    },
    /// A text contains control characters. Texts are shown on terminals and must not control them.
    #[error("the options or tags of stage {stage} contain control characters")]
    ControlCharacters {
        /// Number of the stage in the graph.
        stage: u16,
    },
    /// The loop is invalid.
    #[error("stage {stage}: {why}")]
    Loop {
        /// Number of the stage in the graph.
        stage: u16,
        /// Rule that the stage breaks.
        why: &'static str,
    },
    /// The hint can never be available.
    #[error("stage {stage} has an invalid hint about the previous frame: {why}")]
    Hint {
        /// Number of the stage in the graph.
        stage: u16,
        /// Rule that the stage breaks.
        why: &'static str,
    },
    /// The number of tasks of a stage of the job does not match the tasks of frames that it reads.
    #[error("stage {stage} has {found} tasks, but needs {wanted} to read {read} tasks of frames, {fan} per task")]
    Fan {
        /// Number of the stage in the graph.
        stage: u16,
        /// Number of tasks of the stage.
        found: u32,
        /// Number of tasks that the stage should have.
        wanted: u64,
        /// Number of tasks in all frames that the stage reads.
        read: u64,
        /// Number of tasks of frames that each of its tasks reads.
        fan: u32,
    },
    /// The need cannot be satisfied.
    #[error("stage {stage}: {why}")]
    Need {
        /// Number of the stage in the graph.
        stage: u16,
        /// Rule that the stage breaks.
        why: &'static str,
    },
}

#[cfg(test)]
mod tests {
    use femc_graph::{Role, StageKind, TaskSizes};

    use super::*;

    fn frames() -> Graph {
        let render = StageTemplate::new(StageKind::Render, Scope::Frame, TaskSizes::even(10, 64), &[Role::Tile])
            .with_steps(&[4, 8]);
        let reduce =
            StageTemplate::new(StageKind::Reduce, Scope::Frame, TaskSizes::even(3, 1), &[Role::Pixels, Role::Sums])
                .with_input(0, Role::Tile, Reach::Fan(4))
                .with_need(Need {
                    stage: 1,
                    role: Role::Sums,
                    reach: Reach::Same,
                    round: Round::Previous,
                    gaps: false,
                });
        let image =
            StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image, Role::Preview])
                .with_input(1, Role::Pixels, Reach::All)
                .with_loop(0, 2);
        Graph { stages: vec![render, reduce, image] }
    }

    fn with(change: impl FnOnce(&mut Vec<StageTemplate>)) -> Result<(), GraphError> {
        let mut graph = frames();
        change(&mut graph.stages);
        check_graph(&graph)
    }

    #[test]
    fn a_graph_of_frames_is_sound_and_says_what_it_is() {
        let graph = frames();
        assert_eq!(check_graph(&graph), Ok(()));
        assert_eq!((graph.tasks(Scope::Frame), graph.tasks(Scope::Job), graph.has_job_stages()), (28, 0, false));
        assert_eq!(graph.readers(1).map(|(reader, _)| reader).collect::<Vec<_>>(), [1, 2]);
        assert!((0..3).all(|stage| graph.is_looped(stage) && graph.rounds(stage) == 2));
    }

    #[test]
    fn impossible_graphs_are_refused() {
        let need = |why| Err(GraphError::Need { stage: 1, why });
        assert_eq!(check_graph(&Graph::default()), Err(GraphError::Empty));
        assert_eq!(with(|all| all[0].sizes = TaskSizes::default()), Err(GraphError::Tasks { stage: 0 }));
        assert_eq!(with(|all| all[0].steps = vec![4, 4]), Err(GraphError::Steps { stage: 0 }));
        assert_eq!(with(|all| all[0].steps = vec![4]), Err(GraphError::Steps { stage: 0 }));
        assert_eq!(with(|all| all[1].steps = vec![4, 8]), Err(GraphError::Steps { stage: 1 }));
        assert_eq!(with(|all| all[1].needs[0].stage = 9), need("it needs a stage that does not exist"));
        assert_eq!(
            with(|all| all[1].needs[0].role = Role::Image),
            need("it needs an output that the stage does not make")
        );
        assert_eq!(with(|all| all[1].needs[1].round = Round::Same), need("it needs a later stage"));
        assert_eq!(with(|all| all[1].needs[0].reach = Reach::Fan(0)), need("a fan must be at least 1"));
        assert_eq!(
            with(|all| all[1].needs[0].reach = Reach::Fan(2)),
            need("the number of tasks does not match the fan")
        );
        assert_eq!(
            with(|all| all[1].needs[0].reach = Reach::Same),
            need("one-to-one reading needs equal numbers of tasks")
        );
        assert_eq!(with(|all| all[1].outputs.push(Role::Sums)), Err(GraphError::DuplicateRole { stage: 1 }));
        let look = |stage, role, reach| with(|all| all[1].hints = vec![Hint { stage, role, reach }]);
        let hint = |why| Err(GraphError::Hint { stage: 1, why });
        assert_eq!(look(2, Role::Image, Reach::All), Ok(()), "what comes later is there in the frame before");
        assert_eq!(look(1, Role::Sums, Reach::Same), Ok(()));
        assert_eq!(look(3, Role::Image, Reach::All), hint("the job does not have the stage that it reads"));
        assert_eq!(look(0, Role::Image, Reach::All), hint("the stage that it reads does not make this output"));
        assert_eq!(look(0, Role::Tile, Reach::Same), hint("one-to-one reading needs equal numbers of tasks"));
        assert_eq!(look(0, Role::Tile, Reach::Fan(3)), hint("the number of tasks does not match the fan"));
        assert_eq!(look(0, Role::Tile, Reach::Fan(0)), hint("a fan must be at least 1"));
        let of_job = |all: &mut Vec<StageTemplate>| {
            let own = StageTemplate::new(StageKind::Image, Scope::Job, TaskSizes::even(1, 1), &[]);
            all.push(own.with_hint(2, Role::Image, Reach::All));
        };
        assert!(matches!(with(of_job), Err(GraphError::Hint { stage: 3, .. })));
        let long = |all: &mut Vec<StageTemplate>| all[1].options = "x".repeat(Graph::MAX_OPTIONS + 1);
        assert!(matches!(with(long), Err(GraphError::TooMany { what: "bytes in the options of a stage", .. })));
        let many = |all: &mut Vec<StageTemplate>| all[1].tags = vec!["lab".into(); 65];
        assert!(matches!(with(many), Err(GraphError::TooMany { what: "tags in a stage", limit: 64 })));
        let long = |all: &mut Vec<StageTemplate>| all[1].tags = vec!["x".repeat(JobSpec::MAX_NAME + 1)];
        assert!(matches!(with(long), Err(GraphError::TooMany { what: "bytes in a tag of a stage", .. })));
        assert_eq!(with(|all| all[1].tags = vec!["a\u{1b}".into()]), Err(GraphError::ControlCharacters { stage: 1 }));
        assert_eq!(with(|all| all[1].options = "a\n".into()), Err(GraphError::ControlCharacters { stage: 1 }));
        assert!(matches!(with(|all| all[2].sizes = TaskSizes::even(2, 1)), Err(GraphError::Loop { stage: 2, .. })));
        assert!(with(|all| all[2].closes = Some(Loop { first: 0, rounds: 65 })).is_err());
        assert!(matches!(with(|all| all[0].sizes = TaskSizes::even(1 << 17, 1)), Err(GraphError::TooMany { .. })));
    }

    #[test]
    fn stage_in_a_loop_reads_earlier_outputs_within_its_reach() {
        let read = |reach| {
            with(|all| {
                let before =
                    StageTemplate::new(StageKind::Reduce, Scope::Frame, TaskSizes::even(6, 1), &[Role::Numbers]);
                all.insert(0, before);
                all.iter_mut().skip(1).flat_map(|it| &mut it.needs).for_each(|need| need.stage += 1);
                all[2].needs.push(Need { stage: 0, role: Role::Numbers, reach, round: Round::Same, gaps: false });
                all[3].closes = Some(Loop { first: 1, rounds: 2 });
            })
        };
        let need = |why| Err(GraphError::Need { stage: 2, why });
        assert_eq!((read(Reach::Fan(2)), read(Reach::All)), (Ok(()), Ok(())));
        assert_eq!(read(Reach::Fan(0)), need("a fan must be at least 1"));
        assert_eq!(read(Reach::Fan(6)), need("the number of tasks does not match the fan"));
        assert_eq!(read(Reach::Same), need("one-to-one reading needs equal numbers of tasks"));
    }

    #[test]
    fn other_scopes_read_the_last_round_of_an_output_or_every_round() {
        let read = |rounds: [Round; 2], roles: [Role; 2]| {
            let needs = rounds.into_iter().zip(roles);
            let needs = needs.map(|(round, role)| Need { stage: 1, role, reach: Reach::All, round, gaps: false });
            let own = StageTemplate::new(StageKind::Reduce, Scope::Job, TaskSizes::even(1, 1), &[Levels]);
            with(|all| all.push(StageTemplate { needs: needs.collect(), ..own }))
        };
        use {Role::*, Round::*};
        assert_eq!((read([Same, Same], [Sums; 2]), read([Every, Every], [Sums; 2])), (Ok(()), Ok(())));
        assert_eq!(read([Same, Every], [Sums, Pixels]), Ok(()));
        assert!(matches!(read([Same, Every], [Sums; 2]), Err(GraphError::Need { stage: 3, .. })));
    }
}
