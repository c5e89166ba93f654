//! One build of the engine within one frame: builds may differ in a bit, and a frame of two builds would be neither's.
//!
//! A frame is its first lease's build's, and from its first result on for good: a fact says so. Workers of other builds do
//! other frames meanwhile. When no worker of a frame's build has been there for a while, because all were upgraded, the frame
//! begins anew with those that are there: what was done of it is lost, and nothing waits for ever. The same holds where workers
//! of its build are there but none with the tags of what comes next, while another build has them for all of it: and such a
//! build is the one that begins it.

use std::collections::BTreeMap;

use femc_model::{Intake, JobId, Scope, Tick, Wait, WorkerId};

use crate::lease_table::{LeaseTable, Worker};
use crate::ledger::{Job, Ledger, Shape};
use crate::open::OpenUnit;
use crate::ready_tasks::ReadyTasks;
use crate::scheduler::Scheduler;
use crate::{Command, Fact};

/// Frames whose build has no worker.
#[derive(Debug, Clone, Default)]
pub(crate) struct Orphans {
    since: BTreeMap<(JobId, u32), Tick>,
    /// When it was looked last.
    looked: Tick,
}

/// How much of a frame, or of the stages of another scope, the workers of a build can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Coverage {
    Nothing,
    Something,
    Everything,
}

/// The build whose frame this is; `None`: whoever comes first.
pub(crate) fn build_of<'a>(ledger: &'a Ledger, table: &'a LeaseTable, job: JobId, frame: u32) -> Option<&'a str> {
    if let Some(shared) = ledger.jobs.get(&job).and_then(|known| known.shared.as_ref()) {
        return Some(&shared.engine);
    }
    ledger.side.build_of(job, frame).or_else(|| {
        let holder = table.of_frame(job, frame).next()?.1.worker;
        table.workers.get(&holder).map(|worker| &*worker.registration.engine)
    })
}

/// Whether the frame is another build's than the worker's.
pub(crate) fn is_of_other_build(ledger: &Ledger, table: &LeaseTable, job: JobId, frame: u32, worker: WorkerId) -> bool {
    let Some(worker) = table.workers.get(&worker) else { return false };
    build_of(ledger, table, job, frame).is_some_and(|build| build != worker.registration.engine)
}

impl Scheduler {
    /// Milliseconds between two looks.
    const LOOK_AT_BUILDS: u64 = 1_000;

    /// Whether a frame is not for this worker to go on with or to begin: it is another build's, or nobody's yet, and another
    /// build can do more of it.
    pub(crate) fn is_reserved_for_others(&self, id: JobId, frame: u32, worker: WorkerId) -> bool {
        let (Some(job), Some(worker)) = (self.ledger.jobs.get(&id), self.table.workers.get(&worker)) else {
            return false;
        };
        if job.shared.is_none() && self.table.builds().len() == 1 && self.ledger.side.build_of(id, frame).is_none() {
            // Whoever has begun it is of the same build.
            return false;
        }
        match build_of(&self.ledger, &self.table, id, frame) {
            Some(build) => build != worker.registration.engine,
            None => !self.has_best_coverage(job, Shape::scope_of(frame), &worker.registration.engine),
        }
    }

    /// Whether no other build can do more of a scope's stages than this one.
    pub(crate) fn has_best_coverage(&self, job: &Job, scope: Scope, build: &str) -> bool {
        // Whoever has the job's tags can do what asks for no others.
        job.spec.graph.of(scope).all(|(_, template)| template.tags.is_empty())
            || self.coverage(job, scope, build, &Self::is_present) >= self.best_coverage(job, scope)
    }

    fn best_coverage(&self, job: &Job, scope: Scope) -> Coverage {
        let is_open = |known: &Self, worker: &Worker| worker.is_open() && known.is_present(worker);
        self.table.builds().map(|build| self.coverage(job, scope, build, &is_open)).max().unwrap_or(Coverage::Nothing)
    }

    fn coverage(&self, job: &Job, scope: Scope, build: &str, is_one: &dyn Fn(&Self, &Worker) -> bool) -> Coverage {
        let capable = |tags: &[String]| {
            let mut workers = self.table.workers.values().filter(|it| it.registration.engine == build);
            workers.any(|it| it.has_tags(&job.spec.tags) && it.has_tags(tags) && is_one(self, it))
        };
        if !capable(&[]) {
            return Coverage::Nothing;
        }
        let mut stages = job.spec.graph.of(scope);
        if stages.all(|(_, template)| capable(&template.tags)) { Coverage::Everything } else { Coverage::Something }
    }

    /// One that has been silent for so long is gone, whatever its connection says.
    pub(crate) fn is_present(&self, worker: &Worker) -> bool {
        worker.intake != Intake::Drained && self.now.since(worker.seen) < self.config.orphaned
    }

    /// Whether workers of this build are there, but none for any stage that comes next in a frame.
    fn cannot_continue(&self, id: JobId, job: &Job, frame: u32, build: &str) -> bool {
        let open = self.ready.get(&id).and_then(|ready_tasks| ready_tasks.open.get(frame));
        let mut stages = open.into_iter().flat_map(|open| open.stages()).peekable();
        let capable = |tags: &[String]| {
            let mut workers = self.table.workers.values().filter(|it| it.registration.engine == build);
            workers.any(|it| self.is_present(it) && it.has_tags(&job.spec.tags) && it.has_tags(tags))
        };
        stages.peek().is_some()
            && stages.all(|(stage, _)| !capable(job.tags_of(stage.number)))
            && self.table.of_frame(id, frame).next().is_none()
    }

    /// A result of the frame counts: the frame is its worker's build's.
    pub(crate) fn note_build(&mut self, job: JobId, frame: u32, worker: WorkerId, now: Tick, out: &mut Vec<Command>) {
        debug_assert!(
            !is_of_other_build(&self.ledger, &self.table, job, frame, worker),
            "a frame of two builds: {job}/{frame}"
        );
        if !job.is_shared()
            && self.ledger.side.build_of(job, frame).is_none()
            && let Some(worker) = self.table.workers.get(&worker)
        {
            let engine = worker.registration.engine.clone();
            self.record(Fact::Built { job, frame, engine }, now, out);
        }
    }

    /// Lets frames begin anew whose build has had no worker for too long, where others are there.
    pub(crate) fn restart_orphans(&mut self, now: Tick, out: &mut Vec<Command>) {
        if now < self.orphans.looked.after(Self::LOOK_AT_BUILDS) {
            return;
        }
        let before = std::mem::take(&mut self.orphans.since);
        let (mut since, mut orphans) = (BTreeMap::new(), Vec::new());
        for id in self.order.jobs() {
            let Some(job) = self.ledger.jobs.get(&id) else { continue };
            // A blocked frame would gain nothing: a retry opens it, and then its time begins.
            let is_orphan = |&(frame, build): &(u32, &str)| {
                let scope = Shape::scope_of(frame);
                job.is_open(frame)
                    && match self.coverage(job, scope, build, &Self::is_present) {
                        Coverage::Nothing => true,
                        Coverage::Something => {
                            self.best_coverage(job, scope) == Coverage::Everything
                                && self.cannot_continue(id, job, frame, build)
                        }
                        Coverage::Everything => false,
                    }
            };
            for (frame, _) in self.ledger.side.builds_of(id).filter(is_orphan) {
                let begun = before.get(&(id, frame)).copied().unwrap_or(now);
                since.insert((id, frame), begun);
                if now.since(begun) >= self.config.orphaned && self.capable(job).next().is_some() {
                    orphans.push((id, frame));
                }
            }
        }
        self.orphans = Orphans { since, looked: now };
        for (job, frame) in orphans {
            self.revoke_frame(job, frame, out);
            self.record(Fact::Restarted { job, frame }, now, out);
            self.rebuild(job);
            out.push(Command::Changed(job));
        }
    }

    /// Frames with something ready that nobody with room may take.
    pub(crate) fn why_other_build(&self, id: JobId, job: &Job, ready_tasks: &ReadyTasks, now: Tick) -> Option<Wait> {
        let is_capable = |worker: &Worker| worker.is_fit(&self.config, now) && worker.has_tags(&job.spec.tags);
        let capable: Vec<(WorkerId, &Worker)> = (self.table.workers.iter())
            .filter(|(_, worker)| is_capable(worker))
            .map(|(&id, worker)| (id, worker))
            .collect();
        let is_reserved = |&(frame, open): &(u32, &OpenUnit)| {
            let able = open.stages().flat_map(|(stage, _)| {
                let (tags, lane) = (job.tags_of(stage.number), stage.kind.row().lane);
                let may_take = move |worker: &Worker| worker.has_tags(tags) && worker.has_room(lane, &self.config);
                capable.iter().filter(move |(_, worker)| may_take(worker))
            });
            let mut able = able.peekable();
            able.peek().is_some() && able.all(|&(worker, _)| self.is_reserved_for_others(id, frame, worker))
        };
        let frames = ready_tasks.open.ready().filter(is_reserved).count() as u32;
        (frames > 0).then_some(Wait::OtherBuild { frames })
    }
}
