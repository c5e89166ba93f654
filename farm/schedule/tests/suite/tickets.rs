//! Law of tickets: a second submission with a key is the same job, or it is refused. It is never another job's answer.

use femc_model::{
    Artifact, Control, Decision, Digest, Graph, Grid, JobId, JobNotes, JobSpec, JobState, Output, Reach, Refusal, Role,
    Scope, StageKind, StageTemplate, TaskResult, TaskSizes,
};
use femc_schedule::{Answer, Command, Event, RequestId};

use crate::common::{TestFarm, job_with_graph};

/// Relation of a changed specification to the original one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Results {
    /// The job would have other results.
    Other,
    /// The job would have the same results.
    Same,
}

/// Makes a job with a shared content and a rendering in rounds.
fn base() -> JobSpec {
    let content = StageTemplate::new(StageKind::Drill, Scope::Content, TaskSizes::even(2, 1), &[Role::Answer]);
    let image = StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image]);
    let stages = vec![content, image.with_input(0, Role::Answer, Reach::All).with_loop(1, 1)];
    let contents = vec![(1, Digest::compute(b"one")), (2, Digest::compute(b"two"))];
    JobSpec { contents, ..job_with_graph(&[1, 2], 1, Graph { stages }) }
}

/// Returns the specification with each field changed, and whether the results are others. A new field of a job does not compile
/// here until it has a row.
fn changed_specs() -> Vec<(&'static str, JobSpec, Results)> {
    let old = base();
    let with_stage = |number: usize, change: fn(&mut StageTemplate)| {
        let mut graph = old.graph.clone();
        change(&mut graph.stages[number]);
        JobSpec { graph, ..old.clone() }
    };
    let JobSpec { name, bundle, entry, settings, frames, grid, graph, contents, priority, owner, tags, notes } =
        old.clone();
    let Grid { film, tile } = grid;
    let other = |spec: JobSpec| (spec, Results::Other);
    let same = |spec: JobSpec| (spec, Results::Same);
    let rows = [
        ("name", same(JobSpec { name: name + "2", ..old.clone() })),
        ("bundle", other(JobSpec { bundle: Digest::compute(bundle.as_bytes()), ..old.clone() })),
        ("entry", other(JobSpec { entry: format!("other/{entry}"), ..old.clone() })),
        ("settings", other(JobSpec { settings: settings + " ", ..old.clone() })),
        ("more frames", {
            let more = [frames.clone(), vec![3]].concat();
            let ends = vec![contents[0], (3, contents[1].1)];
            other(JobSpec { frames: more, contents: ends, ..old.clone() })
        }),
        ("fewer frames", other(JobSpec { frames: vec![1], contents: vec![contents[0]], ..old.clone() })),
        ("other frames", other(JobSpec { frames: vec![frames[0], 9], ..old.clone() })),
        ("film", other(JobSpec { grid: Grid { film: [film[0], film[1] + 1], tile }, ..old.clone() })),
        ("turned film", other(JobSpec { grid: Grid { film: [film[0] + 1, film[1]], tile }, ..old.clone() })),
        ("tile", other(JobSpec { grid: Grid { film, tile: tile + 1 }, ..old.clone() })),
        ("another stage", {
            let extra = StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Preview]);
            let stages = [graph.stages.clone(), vec![extra]].concat();
            other(JobSpec { graph: Graph { stages }, ..old.clone() })
        }),
        ("sizes", other(with_stage(0, |stage| stage.sizes = TaskSizes::even(3, 1)))),
        ("units", other(with_stage(0, |stage| stage.sizes = TaskSizes::even(2, 5)))),
        ("outputs", other(with_stage(1, |stage| stage.outputs.push(Role::Preview)))),
        ("options", other(with_stage(1, |stage| stage.options += "x"))),
        ("content", other(JobSpec { contents: vec![contents[0], (2, Digest::compute(b"three"))], ..old.clone() })),
        ("first content", other(JobSpec { contents: vec![(1, contents[1].1), contents[1]], ..old.clone() })),
        ("one content", other(JobSpec { contents: vec![(2, contents[0].1)], ..old.clone() })),
        ("priority", same(JobSpec { priority: priority + 1, ..old.clone() })),
        ("owner", same(JobSpec { owner: owner + "2", ..old.clone() })),
        ("tags", same(JobSpec { tags: [tags, vec!["gpu".to_owned()]].concat(), ..old.clone() })),
        ("notes", same(JobSpec { notes: JobNotes { comment: "new".into(), ..notes }, ..old.clone() })),
    ];
    rows.into_iter().map(|(name, (spec, results))| (name, spec, results)).collect()
}

/// Submits a job. Returns the answer, and whether the log has a new job.
fn submit(farm: &mut TestFarm, key: &str, spec: &JobSpec) -> (Result<JobId, Refusal>, bool) {
    let event =
        Event::Submitted { request: RequestId(1), key: Some(key.into()), spec: Box::new(spec.clone()), date: None };
    let commands = farm.handle(event);
    let answers = commands.iter().find_map(|command| match command {
        Command::Answer { answer, .. } => Some(answer.clone()),
        _ => None,
    });
    let answer = answers.expect("an answer").map(|answer| match answer {
        Answer::Submitted(job) | Answer::Controlled(job) => job,
    });
    (answer, commands.iter().any(|command| matches!(command, Command::Record(_))))
}

fn complete(farm: &mut TestFarm, job: JobId) {
    farm.join_with(1, vec!["gpu".to_owned()]);
    while farm.leases.iter().any(|(holder, _)| holder.0 == 1) {
        let held = farm.first_lease_of(1);
        let spec = farm.scheduler.spec(held.task.job).expect("a job");
        let roles = &spec.graph.stage(held.task.stage.number).expect("a stage").outputs;
        let artifact = |role: &Role| Artifact::from_bytes(format!("{} {}", role.name(), held.task).as_bytes());
        let outputs = roles.iter().map(|role| Output { role: *role, artifact: artifact(role) }).collect();
        let decision = (held.task.stage.number == 1).then_some(Decision::Done);
        let result = TaskResult { outputs, decision, ..TaskResult::default() };
        farm.complete_with(1, &held, result);
    }
    assert_eq!(farm.state(job), JobState::Done);
}

/// Events between two submissions.
type Life = fn(&mut TestFarm, JobId);

/// Lives of a job before the second submission.
const LIVES: [(&str, Life); 7] = [
    ("submitted", |_, _| {}),
    ("restarted", |farm, _| farm.restart()),
    ("leased", |farm, _| drop(farm.join(1))),
    ("done", complete),
    ("done and restarted", |farm, job| {
        complete(farm, job);
        farm.restart();
    }),
    ("cancelled", |farm, job| drop(farm.control(job, Control::Cancel))),
    ("cancelled and restarted", |farm, job| {
        farm.control(job, Control::Cancel);
        farm.restart();
    }),
];

#[test]
fn a_repeated_key_is_the_same_job_or_is_refused() {
    for (life, live) in LIVES {
        for (field, spec, results) in changed_specs() {
            // In both orders.
            for (first, second) in [(base(), spec.clone()), (spec, base())] {
                let case = format!("{field}, {life}");
                let mut farm = TestFarm::new();
                let job = submit(&mut farm, "ticket", &first).0.unwrap_or_else(|error| panic!("{case}: {error}"));
                live(&mut farm, job);
                for _ in 0..2 {
                    let (answer, is_recorded) = submit(&mut farm, "ticket", &second);
                    match results {
                        Results::Same => assert_eq!(answer, Ok(job), "{case}"),
                        Results::Other => {
                            let Err(Refusal::Invalid { field, message }) = answer else { panic!("{case}: {answer:?}") };
                            assert!(field == "key" && message.contains(&format!("job {job} ")), "{case}: {message}");
                        }
                    }
                    assert!(!is_recorded, "{case}: nothing changes");
                    assert_eq!(submit(&mut farm, "ticket", &first), (Ok(job), false), "{case}: the first client again");
                }
                let (another, is_recorded) = submit(&mut farm, "ticket 2", &second);
                assert!(is_recorded && another != Ok(job) && another.is_ok(), "{case}: another key");
            }
        }
    }
}

#[test]
fn the_key_of_a_deleted_job_is_free_for_any_job() {
    for (field, spec, results) in changed_specs() {
        let mut farm = TestFarm::new();
        let job = submit(&mut farm, "ticket", &base()).0.expect("a job");
        farm.control(job, Control::Cancel);
        farm.control(job, Control::Delete);
        let (again, is_recorded) = submit(&mut farm, "ticket", &spec);
        let again = again.unwrap_or_else(|error| panic!("{field}: {error}"));
        assert!(is_recorded && again > job, "{field}: a new job");
        farm.restart();
        assert_eq!(submit(&mut farm, "ticket", &spec).0, Ok(again), "{field}");
        assert_eq!(submit(&mut farm, "ticket", &base()).0.is_ok(), results == Results::Same, "{field}");
    }
}
