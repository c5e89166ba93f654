//! Tests that every message survives the wire and that invalid ones are refused.

use std::fmt::Debug;

use femc_model::*;
use prost::Message;

use super::ConvertError;
use crate::wire;
use crate::{OLDEST_PROTOCOL, PROTOCOL};

/// Encodes a value for the wire, decodes it, and checks that nothing changed.
fn assert_round_trip<M, W>(value: M)
where
    M: Clone + PartialEq + Debug + Into<W> + TryFrom<W, Error = ConvertError>,
    W: Message + Default,
{
    let bytes = value.clone().into().encode_to_vec();
    assert_eq!(W::decode(&bytes[..]).unwrap().try_into(), Ok(value));
}

fn digest() -> Digest {
    Digest::compute(b"x")
}

fn artifact() -> Artifact {
    Artifact { digest: digest(), bytes: u64::MAX }
}

fn task(kind: StageKind) -> TaskKey {
    TaskKey { job: JobId(7), stage: Stage { frame: u32::MAX, round: 3, number: u16::MAX, kind }, index: 5 }
}

/// Returns all roles of this version.
fn roles() -> Vec<Role> {
    Role::ALL.into_iter().filter(|role| role.updated() == *role).collect()
}

fn outputs() -> Vec<Output> {
    roles().into_iter().map(|role| Output { role, artifact: artifact() }).collect()
}

fn graph() -> Graph {
    let need = |reach, round| Need { stage: u16::MAX, role: Role::Sums, reach, round, gaps: true };
    let sizes = [(3, 256), (1, u64::MAX)].into_iter().collect();
    let render = StageTemplate::new(StageKind::Render, Scope::Frame, sizes, &[Role::Tile]).with_steps(&[16, 32]);
    let reduce = StageTemplate::new(StageKind::Reduce, Scope::Job, TaskSizes::even(1, 1), &roles())
        .with_need(need(Reach::Fan(256), Round::Previous))
        .with_need(need(Reach::Same, Round::Every))
        .with_input(0, Role::Tile, Reach::All)
        .with_hint(1, Role::Sums, Reach::All)
        .with_hint(0, Role::Tile, Reach::Fan(2))
        .with_hint(1, Role::Pixels, Reach::Same)
        .with_options("rate=24")
        .with_tags(&["ffmpeg", "lab"]);
    let image = StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::default(), &[]).with_loop(u16::MAX, 64);
    Graph { stages: vec![render, reduce, image] }
}

fn notes() -> JobNotes {
    let labels = [("sigma_s", "0.02"), ("camera", "")].map(|(name, value)| (name.to_owned(), value.to_owned()));
    JobNotes { comment: "vor dem Fest".into(), labels: labels.into(), notify: Some("https://hooks.test/a".into()) }
}

fn spec() -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: digest(),
        entry: "a/fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![0, 7, u32::MAX],
        grid: Grid { film: [640, 360], tile: 16 },
        graph: graph(),
        contents: vec![],
        priority: 100,
        owner: "me".into(),
        tags: vec!["lab".into(), "ä".into()],
        notes: notes(),
    }
}

fn log(text: LogText) -> TaskLog {
    TaskLog { outcome: AttemptOutcome::Failed, seconds: 1.5, text }
}

fn failures() -> Vec<Failure> {
    let message = || "m".to_owned();
    vec![
        Failure::Scene { message: message() },
        Failure::Settings { message: message() },
        Failure::Panicked { message: message() },
        Failure::Stalled { seconds: 3 },
        Failure::LostInputs { digests: vec![digest(); 2], message: message() },
        Failure::Store { message: message() },
        Failure::Resources { message: message() },
        Failure::Killed { deaths: 5, worker: "w".into() },
        Failure::Cancelled,
        Failure::TooLarge { limit: 1 << 30 },
    ]
}

pub(crate) fn refusals() -> Vec<Refusal> {
    vec![
        Refusal::NoSuchJob { job: JobId(1) },
        Refusal::Ended { job: JobId(1) },
        Refusal::Invalid { field: "f".into(), message: "m".into() },
        Refusal::StaleEpoch,
        Refusal::NoSuchArtifact { digest: digest() },
        Refusal::DigestMismatch { digest: digest() },
        Refusal::TooLarge { what: "w".into(), limit: 9 },
        Refusal::MissingArtifacts { digests: vec![digest(); Refusal::MAX_NAMED], count: 70 },
        Refusal::ArtifactTooLarge { limit: 9 },
        Refusal::Resume { offset: 5 },
        Refusal::Unavailable { message: "m".into() },
        Refusal::NoRoom { place: "the log".into(), free: 7 },
        Refusal::NoSuchWorker { worker: "w".into() },
        Refusal::Forbidden { who: "viewer ann".into(), takes: "an admin".into() },
        Refusal::Unauthenticated { message: "the token has expired".into() },
    ]
}

#[test]
fn failures_and_refusals_cross_the_wire_also_as_statuses() {
    for failure in failures() {
        assert_round_trip::<Failure, wire::Failure>(failure);
    }
    for refusal in refusals() {
        let status = crate::error::to_status(&refusal);
        let error = crate::error::from_status("url", &status);
        assert!(matches!(error, crate::CallError::Refused(back) if back == refusal));
        assert_round_trip::<Refusal, wire::Refusal>(refusal);
    }
}

#[test]
fn messages_of_a_worker_cross_the_wire() {
    let registration = Registration {
        name: "w".into(),
        instance: u64::MAX,
        engine: "0.1".into(),
        threads: 64,
        slots: 1,
        tags: vec!["lab".into()],
        held: [(StageKind::Image, 0..0), (StageKind::Render, 4..9)]
            .map(|(kind, steps)| HeldLease {
                task: task(kind),
                epoch: Epoch::new(1, 4),
                steps,
                job: Digest::compute(b"job"),
            })
            .to_vec(),
        death: None,
    };
    let died = Death { instance: 1 << 60, computing: registration.held.clone() };
    let reborn = Registration { death: Some(died), ..registration.clone() };
    let (render, image, epoch) = (task(StageKind::Render), task(StageKind::Image), Epoch::new(3, 9));
    let phases = [Phase::Waiting, Phase::Preparing, Phase::Working, Phase::Uploading];
    let progress = phases.map(|phase| TaskProgress { task: render, epoch, phase, units: 12 });
    assert_round_trip::<FromWorker, wire::FromWorker>(FromWorker::Register(registration));
    assert_round_trip::<FromWorker, wire::FromWorker>(FromWorker::Register(reborn));
    assert_round_trip::<FromWorker, wire::FromWorker>(FromWorker::Heartbeat {
        number: 3,
        tasks: progress.to_vec(),
        usage: vec![TaskUsage { task: image, epoch, usage: usage() }],
    });
    assert_round_trip::<FromWorker, wire::FromWorker>(FromWorker::Draining);
    assert_round_trip::<FromWorker, wire::FromWorker>(FromWorker::Available);
    let stored = LogText::Stored(Artifact { bytes: LogText::MAX_STORED as u64, ..artifact() });
    let record = LogRecord { task: render, epoch, worker: "w".into(), reported_at: Tick(7), log: log(stored) };
    assert_round_trip::<LogRecord, wire::LogRecord>(record);
    let long = wire::TaskLog::from(log(LogText::Inline("x".repeat(LogText::MAX_INLINE + 1))));
    assert_eq!(TaskLog::try_from(long), Err(ConvertError::Range { field: "log.inline" }));
    let large = wire::TaskLog::from(log(LogText::Stored(artifact())));
    assert_eq!(TaskLog::try_from(large), Err(ConvertError::Range { field: "log.stored" }));
    for decision in [None, Some(Decision::Continue), Some(Decision::Steps(vec![16, 0])), Some(Decision::Done)] {
        let (outputs, relative_error) = (outputs(), decision.as_ref().map(|_| 0.01));
        let (units, bad_samples, seconds) = (1 << 40, 2, 0.25);
        let blocks = decision.as_ref().map(|_| BlockCounts { all: 9, unlit: 2 });
        let result = TaskResult { outputs, units, bad_samples, relative_error, blocks, decision, seconds };
        assert_round_trip::<FromWorker, wire::FromWorker>(FromWorker::Completed {
            task: render,
            epoch,
            result,
            log: Some(log(LogText::Inline("ä".into()))),
            usage: Some(usage()),
        });
    }
    for failure in failures() {
        assert_round_trip::<FromWorker, wire::FromWorker>(FromWorker::Failed {
            task: image,
            epoch,
            failure,
            log: None,
            usage: None,
        });
    }
    for ending in LeaseEnding::ALL {
        let usage = (ending == LeaseEnding::Done).then(usage);
        assert_round_trip::<AttemptRecord, wire::AttemptRecord>(AttemptRecord {
            task: image,
            epoch,
            worker: "w".into(),
            instance: u64::MAX,
            granted: Tick(3),
            ended: Tick(7),
            ending,
            samples: 11,
            relative_error: Some(0.03),
            usage,
        });
    }
    let endless = wire::Usage::from(ResourceUsage { cpu: f64::NAN, ..usage() });
    assert_eq!(ResourceUsage::try_from(endless), Err(ConvertError::Range { field: "seconds" }));
}

#[test]
fn messages_to_a_worker_cross_the_wire() {
    let (render, image, epoch) = (task(StageKind::Render), task(StageKind::Image), Epoch::new(3, 9));
    let output = Output { role: Role::Pixels, artifact: artifact() };
    let inputs = vec![Input { need: u16::MAX, frame: Stage::JOB_FRAME, item: 9, output }; 2];
    for (more, copy_of) in [(NextRound::Possible, None), (NextRound::Impossible, Some(Epoch::new(2, 8)))] {
        let (hints, inputs, taken) = (inputs[1..].to_vec(), inputs.clone(), [16, 64, 32].into_iter().collect());
        let work = TaskSpec {
            item: 5,
            steps: 16..32,
            inputs,
            hints,
            steps_taken: taken,
            next_round: more,
            elapsed: 1234,
            busy_seconds: 0.5,
        };
        let assignment = Assignment { task: image, epoch, lease: 5000, copy_of, spec: work };
        assert_round_trip::<ToWorker, wire::ToWorker>(ToWorker::Assign(assignment));
    }
    assert_round_trip::<ToWorker, wire::ToWorker>(ToWorker::Welcome {
        worker: WorkerId(4),
        heartbeat: 500,
        lease: 5000,
    });
    let leases = vec![LeaseStatus { task: render, epoch, remaining: 4321 }];
    for intake in [Intake::Open, Intake::Off, Intake::Drained] {
        assert_round_trip::<ToWorker, wire::ToWorker>(ToWorker::Renewed {
            heartbeat: 3,
            leases: leases.clone(),
            intake,
        });
    }
    let older = wire::Renewed { heartbeat: 3, leases: vec![], intake: 0 };
    let older = wire::ToWorker { message: Some(wire::to_worker::Message::Renewed(older)) };
    let heard = ToWorker::Renewed { heartbeat: 3, leases: vec![], intake: Intake::Open };
    assert_eq!(ToWorker::try_from(older), Ok(heard), "an older coordinator that does not send the field");
    assert_round_trip::<ToWorker, wire::ToWorker>(ToWorker::Job { job: JobId(7), spec: Box::new(spec()) });
    for reason in [RevokeReason::Expired, RevokeReason::JobEnded, RevokeReason::Done] {
        assert_round_trip::<ToWorker, wire::ToWorker>(ToWorker::Revoke { task: render, epoch, reason });
    }
    assert_round_trip::<ToWorker, wire::ToWorker>(ToWorker::Accepted { task: render, epoch });
    for refusal in refusals() {
        assert_round_trip::<ToWorker, wire::ToWorker>(ToWorker::Refused { task: render, epoch, refusal });
    }
    assert_round_trip::<ToWorker, wire::ToWorker>(ToWorker::Goodbye);
}

#[test]
fn statuses_of_jobs_cross_the_wire() {
    use JobState::*;
    let frame = FrameProgress {
        frame: 3,
        round: 1,
        rounds: 4,
        stage: StageKind::Image,
        tiles_done: 5,
        tiles_total: 6,
        running: 1,
        samples_done: 99,
        relative_error: Some(0.2),
        blocks: Some(BlockCounts { all: 4, unlit: 1 }),
    };
    let waits = vec![
        WaitReason::Paused,
        WaitReason::NoWorkers,
        WaitReason::NoWorkerWithTags(vec!["lab".into()]),
        WaitReason::WorkersBusy { workers: 3 },
        WaitReason::WorkersDraining { workers: 1 },
        WaitReason::AllWorkersBackingOff,
        WaitReason::WorkersSilent { workers: 2, seconds: 9 },
        WaitReason::WorkersBackingOff { workers: 1, seconds: 4, failure: Failure::Store { message: "full".into() } },
        WaitReason::WorkersQuarantined { workers: 2, seconds: 60 },
        WaitReason::WorkersAvoided { tasks: 3 },
        WaitReason::Regrouping { milliseconds: 300 },
        WaitReason::OtherBuild { frames: 2 },
        WaitReason::BehindJob(JobId(2)),
        WaitReason::StageWaits { frame: 1, stage: StageKind::Image, needs: StageKind::Reduce, tasks: 2 },
        WaitReason::InfrastructureFailures { tasks: 2, message: "the disk is full".into() },
        WaitReason::ImageLost { frame: 7 },
        WaitReason::Quarantined { frame: 1, tasks: 2 },
    ];
    let mut stops = FrameStop::ALL.into_iter();
    for state in [Queued, Running, Paused, Done, Failed, Cancelled] {
        let status = JobStatus {
            job: JobId(7),
            name: "fog".into(),
            owner: "me".into(),
            scene: "a/fog.mgf".into(),
            notes: notes(),
            priority: 50,
            state,
            failure: (state == Failed).then(|| failures().remove(0)),
            frames_total: 10,
            frames_done: 2,
            frames_failed: 1,
            active: vec![frame; 2],
            workers: 3,
            samples_done: 1,
            samples_planned: 2,
            samples_per_second: 1e6,
            bad_samples: 4,
            relative_error: Some(0.1),
            blocks: Some(BlockCounts { all: 4, unlit: 0 }),
            worst_frame: stops.next().map(|stop| WorstFrame { frame: 3, stop }),
            error_target: (state != Done).then_some(0.05),
            seconds: 5.5,
            quarantined: vec![QuarantinedTask {
                task: task(StageKind::Render),
                attempts: 3,
                failure: Failure::Cancelled,
            }],
            stale_messages: 8,
            copies: 2,
            waits: waits.clone(),
            submitted: (state != Queued).then_some(1_795_680_000_123),
            submitted_date: (state == Queued).then_some(1_795_680_000_124),
        };
        assert_round_trip::<JobStatus, wire::JobStatus>(status);
    }
}

#[test]
fn workers_and_frames_cross_the_wire() {
    let tasks = vec![task(StageKind::Render)];
    let (name, tags) = ("w".to_owned(), vec!["lab".to_owned()]);
    let intake = Intake::Open;
    let worker = WorkerStatus {
        worker: WorkerId(1),
        name,
        threads: 2,
        tags,
        tasks,
        silent: 3,
        completed: 4,
        failed: 5,
        intake,
        engine: "0.1".into(),
    };
    for intake in [Intake::Open, Intake::Off, Intake::Drained] {
        assert_round_trip::<WorkerStatus, wire::WorkerStatus>(WorkerStatus { intake, ..worker.clone() });
    }
    let offline = OfflineWorker {
        name: "v".into(),
        threads: 8,
        tags: vec!["hall".into()],
        engine: "0.2".into(),
        last_contact: 1_795_680,
    };
    assert_round_trip::<WorkerList, wire::ListWorkersReply>(WorkerList {
        connected: vec![worker],
        offline: vec![offline],
    });
    for worker in [WorkerSelector::Number(WorkerId(3)), WorkerSelector::Name("w".into())] {
        for drain in [Drain::Begin, Drain::Undo] {
            assert_round_trip::<(WorkerSelector, Drain), wire::DrainWorkersRequest>((worker.clone(), drain));
        }
    }
    let record = FrameRecord {
        frame: 1,
        outputs: outputs(),
        spp: 16,
        relative_error: None,
        blocks: Some(BlockCounts { all: 4, unlit: 4 }),
        bad_samples: 0,
        busy_seconds: 1.0,
        seconds: 2.0,
        rounds: Some(3),
        times: Some(AttemptTimes { attempts: 7, processor: 1.5, wall: 2.5, waiting: 0.5 }),
    };
    assert_round_trip::<FrameRecord, wire::FrameRecord>(FrameRecord { rounds: None, times: None, ..record.clone() });
    assert_round_trip::<FrameRecord, wire::FrameRecord>(record);
    assert_round_trip::<JobSpec, wire::JobSpec>(spec());
}

#[test]
fn nonsense_is_refused_by_name() {
    let blocks = wire::Blocks { all: 1, unlit: 2 };
    assert_eq!(BlockCounts::try_from(blocks), Err(ConvertError::Range { field: "blocks.unlit" }));
    let spec = wire::JobSpec::from(spec());
    let short = wire::JobSpec { bundle: vec![1u8; 31], ..spec.clone() };
    assert_eq!(JobSpec::try_from(short), Err(ConvertError::Digest { field: "job.bundle" }));
    let high = wire::JobSpec { priority: 256, ..spec };
    assert_eq!(JobSpec::try_from(high), Err(ConvertError::Range { field: "priority" }));
    let empty = wire::FromWorker { message: None };
    assert_eq!(FromWorker::try_from(empty), Err(ConvertError::Missing { field: "message" }));
    let kinds = StageKind::ALL.len() as i32;
    let kind = wire::TaskKey { kind: kinds + 1, ..task(StageKind::Render).into() };
    assert_eq!(TaskKey::try_from(kind), Err(ConvertError::Unknown { field: "stage.kind", value: kinds + 1 }));
    let kind = wire::TaskKey { kind: 0, ..task(StageKind::Render).into() };
    assert!(TaskKey::try_from(kind).is_err(), "unspecified is not a kind");
    for (found, what_to_do) in
        [(OLDEST_PROTOCOL - 1, "upgrade this worker"), (PROTOCOL + 1, "upgrade the coordinator first")]
    {
        let other = wire::Registration { protocol: found, slots: 1, ..wire::Registration::default() };
        let refused = Registration::try_from(other);
        assert_eq!(refused, Err(ConvertError::Protocol { found }));
        let said = ConvertError::Protocol { found }.to_string();
        assert!(
            said.contains(what_to_do) && said.contains(&format!("accepts {OLDEST_PROTOCOL} to {PROTOCOL}")),
            "{said}"
        );
    }
    for known in OLDEST_PROTOCOL..=PROTOCOL {
        let worker = wire::Registration { protocol: known, slots: 1, ..wire::Registration::default() };
        assert!(Registration::try_from(worker).is_ok(), "{known}");
    }
    let result = wire::TaskResult::from(TaskResult { outputs: outputs(), ..TaskResult::default() });
    let range = |field| ConvertError::Range { field };
    let nan = wire::TaskResult { seconds: f64::NAN, ..result.clone() };
    assert_eq!(TaskResult::try_from(nan), Err(range("seconds")));
    let many =
        wire::TaskResult { outputs: vec![result.outputs[0].clone(); TaskResult::MAX_OUTPUTS + 1], ..result.clone() };
    assert_eq!(TaskResult::try_from(many), Err(range("result.outputs")));
    let steps = wire::Steps { steps: vec![1; Graph::MAX_TASKS as usize + 1] };
    let long = wire::TaskResult { decision: Some(wire::task_result::Decision::Steps(steps)), ..result };
    assert_eq!(TaskResult::try_from(long), Err(range("result.steps")));
    let stage = wire::TaskKey { stage: 1 << 16, ..task(StageKind::Render).into() };
    assert_eq!(TaskKey::try_from(stage), Err(range("stage")));
    let steps = Some(wire::Range { start: 2, end: 1 });
    assert_eq!(TaskSpec::try_from(wire::Work { steps, ..wire::Work::default() }), Err(range("work.steps")));
    let taken = vec![1; Graph::MAX_TASKS as usize + 1];
    assert_eq!(TaskSpec::try_from(wire::Work { taken, ..wire::Work::default() }), Err(range("work.taken")));
}

#[test]
fn wire_numbers_of_kinds_and_roles_match_farm_tables() {
    let named = |prefix: &str, name: &str| format!("{prefix}_{}", name.to_uppercase().replace('-', "_"));
    for kind in StageKind::ALL {
        let wire = wire::StageKind::try_from(wire::TaskKey::from(task(kind)).kind).unwrap();
        assert_eq!(wire.as_str_name(), named("STAGE_KIND", kind.name()));
    }
    for output in outputs() {
        let wire = wire::Role::try_from(wire::Output::from(output).role).unwrap();
        assert_eq!(wire.as_str_name(), named("ROLE", output.role.name()));
    }
    assert!(wire::StageKind::try_from(StageKind::ALL.len() as i32 + 1).is_err());
    assert!(wire::Role::try_from(Role::ALL.len() as i32 + 1).is_err());
}

#[test]
fn the_largest_assignment_fits_a_message() {
    let output = Output { role: Role::Preview, artifact: artifact() };
    let input = |item| Input { need: Graph::MAX_NEEDS as u16, frame: u32::MAX, item, output };
    let [inputs, hints] =
        [Graph::MAX_INPUTS as u32, TaskSpec::MAX_HINTS as u32].map(|count| (0..count).map(input).collect());
    let (taken, more) = ((0..Graph::MAX_TASKS).map(|item| u32::MAX - item).collect(), NextRound::Impossible);
    let work = TaskSpec {
        item: 0,
        steps: 0..1,
        inputs,
        hints,
        steps_taken: taken,
        next_round: more,
        elapsed: u64::MAX,
        busy_seconds: 1.0,
    };
    assert!(wire::Work::from(work).encoded_len() < crate::MAX_ASSIGNMENT_SIZE * 7 / 8);
}

fn usage() -> ResourceUsage {
    ResourceUsage {
        wait: 0.5,
        wall: 2.0,
        preparation: 0.25,
        cpu: 3.5,
        peak: Some(1 << 30),
        samples: 1024,
        rays: 9000,
        fetched: 77,
        sent: 78,
    }
}

#[test]
fn usage_crosses_the_wire_and_a_month_that_is_none_is_refused() {
    let sums = UsageSums { jobs: 1, frames: 2, tasks: 3, samples: 1 << 40, worker_ms: 3_600_001, processor_us: 7 };
    let usage = OwnerUsage { month: Month::new(2026, 11).unwrap(), owner: "ann".into(), sums };
    assert_round_trip::<OwnerUsage, wire::OwnerUsage>(usage.clone());
    let wire = wire::OwnerUsage { month: "2026-13".into(), ..usage.clone().into() };
    assert_eq!(OwnerUsage::try_from(wire), Err(ConvertError::Range { field: "usage.month" }));
    let wire = wire::OwnerUsage { worker_seconds: f64::NAN, ..usage.into() };
    assert!(OwnerUsage::try_from(wire).is_err());
}

#[test]
fn what_is_done_to_a_job_crosses_the_wire() {
    let frames = Control::RetryFrames(vec![1, 9]);
    let all = [
        Control::Pause,
        Control::Resume,
        Control::Cancel,
        Control::Retry,
        Control::Priority(9),
        Control::Delete,
        frames,
    ];
    for control in all {
        let wire = wire::control_request::Control::from(control.clone());
        assert_eq!(Control::try_from(wire), Ok(control));
    }
}

#[test]
fn two_labels_of_one_name_are_refused() {
    let mut wire = wire::JobSpec::from(spec());
    wire.labels.push(wire.labels[0].clone());
    assert_eq!(JobSpec::try_from(wire), Err(ConvertError::Range { field: "labels" }));
}

#[test]
fn earlier_kinds_and_roles_are_replaced() {
    let stage = |kind, outputs: &[Role]| StageTemplate::new(kind, Scope::Content, TaskSizes::even(1, 1), outputs);
    let start = stage(StageKind::FirstPass, &[Role::Elements, Role::Links]);
    let rays = stage(StageKind::FirstPassBlock, &[Role::Rays]).with_input(0, Role::Elements, Reach::All).with_input(
        0,
        Role::Links,
        Reach::All,
    );
    let graph = Graph { stages: vec![start, rays, stage(StageKind::Encode, &[Role::Clip])] };
    let read = Graph::try_from(wire::Graph::from(graph.clone())).unwrap();
    assert_eq!(read, graph.updated());
    let kinds: Vec<StageKind> = read.stages.iter().map(|stage| stage.kind).collect();
    assert_eq!(kinds, [StageKind::FirstPassStart, StageKind::FirstPassRays, StageKind::EncodeClip]);
    assert_eq!(read.stages[1].needs.len(), 1);
    let output = Output { role: Role::Guides, artifact: artifact() };
    assert_eq!(Output::try_from(wire::Output::from(output)).unwrap().role, Role::SolverState);
}
