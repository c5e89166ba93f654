//! Assigns each frame to one build of the engine. The results of builds may differ in a bit, so one build must render a whole
//! frame.
//!
//! The worker that gets the first lease of a frame determines its build; with the first result, a fact makes this permanent.
//! Meanwhile workers of other builds render other frames. If no worker of a frame's build has been present for some time, because
//! all were upgraded, the frame restarts with the present workers. Its results are lost, but nothing waits forever. The frame also
//! restarts if workers of its build are present, none of them has the tags of the next stages, and another build has the tags of
//! all stages. Such a build is the one that begins it.

use std::collections::BTreeMap;

use femc_model::{Intake, JobId, Scope, Tick, WaitReason, WorkerId};

use crate::lease_table::{LeaseTable, Worker};
use crate::ledger::{GraphView, Job, Ledger};
use crate::open_frames::OpenFrame;
use crate::ready_tasks::ReadyTasks;
use crate::scheduler::Scheduler;
use crate::{Command, Fact};

/// Frames whose build has no worker, with the time since when.
#[derive(Debug, Clone, Default)]
pub(crate) struct OrphanedFrames {
    since: BTreeMap<(JobId, u32), Tick>,
    /// Time of the last check.
    last_check: Tick,
}

/// Part of the stages of a frame, or of another scope, that the workers of a build can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Coverage {
    Nothing,
    Something,
    Everything,
}

/// Returns the build that renders this frame; `None`: the first worker decides.
pub(crate) fn build_of<'a>(ledger: &'a Ledger, table: &'a LeaseTable, job: JobId, frame: u32) -> Option<&'a str> {
    if let Some(shared) = ledger.jobs.get(&job).and_then(|known| known.shared.as_ref()) {
        return Some(&shared.engine);
    }
    ledger.side.build_of(job, frame).or_else(|| {
        let holder = table.leases_of_frame(job, frame).next()?.1.worker;
        table.workers.get(&holder).map(|worker| &*worker.registration.engine)
    })
}

/// Checks whether the frame belongs to another build than the worker's.
pub(crate) fn is_of_other_build(ledger: &Ledger, table: &LeaseTable, job: JobId, frame: u32, worker: WorkerId) -> bool {
    let Some(worker) = table.workers.get(&worker) else { return false };
    build_of(ledger, table, job, frame).is_some_and(|build| build != worker.registration.engine)
}

impl Scheduler {
    /// Milliseconds between two checks.
    const BUILD_CHECK_INTERVAL: u64 = 1_000;

    /// Checks whether this worker may neither begin nor continue the frame: it belongs to another build, or it has no build yet and
    /// another build can do more of it.
    pub(crate) fn is_reserved_for_others(&self, id: JobId, frame: u32, worker: WorkerId) -> bool {
        let (Some(job), Some(worker)) = (self.ledger.jobs.get(&id), self.table.workers.get(&worker)) else {
            return false;
        };
        if job.shared.is_none() && self.table.builds().len() == 1 && self.ledger.side.build_of(id, frame).is_none() {
            // All workers have the same build.
            return false;
        }
        match build_of(&self.ledger, &self.table, id, frame) {
            Some(build) => build != worker.registration.engine,
            None => !self.has_best_coverage(job, GraphView::scope_of(frame), &worker.registration.engine),
        }
    }

    /// Checks that no other build can do more of a scope's stages than this one.
    pub(crate) fn has_best_coverage(&self, job: &Job, scope: Scope, build: &str) -> bool {
        // A worker with the job's tags can do stages that require no others.
        job.spec.graph.stages_of(scope).all(|(_, template)| template.tags.is_empty())
            || self.coverage(job, scope, build, &Self::is_present) >= self.best_coverage(job, scope)
    }

    fn best_coverage(&self, job: &Job, scope: Scope) -> Coverage {
        let is_open = |known: &Self, worker: &Worker| worker.is_open() && known.is_present(worker);
        self.table.builds().map(|build| self.coverage(job, scope, build, &is_open)).max().unwrap_or(Coverage::Nothing)
    }

    fn coverage(&self, job: &Job, scope: Scope, build: &str, is_eligible: &dyn Fn(&Self, &Worker) -> bool) -> Coverage {
        let capable = |tags: &[String]| {
            let mut workers = self.table.workers.values().filter(|it| it.registration.engine == build);
            workers.any(|it| it.has_tags(&job.spec.tags) && it.has_tags(tags) && is_eligible(self, it))
        };
        if !capable(&[]) {
            return Coverage::Nothing;
        }
        let mut stages = job.spec.graph.stages_of(scope);
        if stages.all(|(_, template)| capable(&template.tags)) { Coverage::Everything } else { Coverage::Something }
    }

    /// Checks that a worker is present. A worker that has been silent for too long counts as gone, whatever the state of its
    /// connection.
    pub(crate) fn is_present(&self, worker: &Worker) -> bool {
        worker.intake != Intake::Drained && self.now.since(worker.last_message) < self.config.orphaned_after
    }

    /// Checks whether workers of this build can do none of the next stages of a frame.
    fn cannot_continue(&self, id: JobId, job: &Job, frame: u32, build: &str) -> bool {
        let open = self.ready.get(&id).and_then(|ready_tasks| ready_tasks.open.get(frame));
        let mut stages = open.into_iter().flat_map(|open| open.stages()).peekable();
        let capable = |tags: &[String]| {
            let mut workers = self.table.workers.values().filter(|it| it.registration.engine == build);
            workers.any(|it| self.is_present(it) && it.has_tags(&job.spec.tags) && it.has_tags(tags))
        };
        stages.peek().is_some()
            && stages.all(|(stage, _)| !capable(job.tags_of(stage.number)))
            && self.table.leases_of_frame(id, frame).next().is_none()
    }

    /// Assigns the frame to the worker's build when its first result counts.
    pub(crate) fn note_build(&mut self, job: JobId, frame: u32, worker: WorkerId, now: Tick, out: &mut Vec<Command>) {
        debug_assert!(
            !is_of_other_build(&self.ledger, &self.table, job, frame, worker),
            "a result from another build of the engine: {job}/{frame}"
        );
        if !job.is_shared()
            && self.ledger.side.build_of(job, frame).is_none()
            && let Some(worker) = self.table.workers.get(&worker)
        {
            let engine = worker.registration.engine.clone();
            self.record_fact(Fact::BuildAssigned { job, frame, engine }, now, out);
        }
    }

    /// Restarts frames whose build has had no worker for too long, if other workers are present.
    pub(crate) fn restart_orphans(&mut self, now: Tick, out: &mut Vec<Command>) {
        if now < self.orphaned_frames.last_check.after(Self::BUILD_CHECK_INTERVAL) {
            return;
        }
        let before = std::mem::take(&mut self.orphaned_frames.since);
        let (mut since, mut orphans) = (BTreeMap::new(), Vec::new());
        for id in self.order.jobs() {
            let Some(job) = self.ledger.jobs.get(&id) else { continue };
            // A restart does not help a blocked frame. A retry opens it, and then its time begins.
            let is_orphan = |&(frame, build): &(u32, &str)| {
                let scope = GraphView::scope_of(frame);
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
                let orphaned_since = before.get(&(id, frame)).copied().unwrap_or(now);
                since.insert((id, frame), orphaned_since);
                if now.since(orphaned_since) >= self.config.orphaned_after && self.capable_workers(job).next().is_some()
                {
                    orphans.push((id, frame));
                }
            }
        }
        self.orphaned_frames = OrphanedFrames { since, last_check: now };
        for (job, frame) in orphans {
            self.revoke_frame(job, frame, out);
            self.record_fact(Fact::Restarted { job, frame }, now, out);
            self.rebuild_ready(job);
            out.push(Command::JobChanged(job));
        }
    }

    /// Counts frames with ready tasks that no worker with room may take because of its build.
    pub(crate) fn other_build_wait(
        &self,
        id: JobId,
        job: &Job,
        ready_tasks: &ReadyTasks,
        now: Tick,
    ) -> Option<WaitReason> {
        let is_capable = |worker: &Worker| worker.is_fit(&self.config, now) && worker.has_tags(&job.spec.tags);
        let capable: Vec<(WorkerId, &Worker)> = (self.table.workers.iter())
            .filter(|(_, worker)| is_capable(worker))
            .map(|(&id, worker)| (id, worker))
            .collect();
        let is_reserved = |&(frame, open): &(u32, &OpenFrame)| {
            let eligible = open.stages().flat_map(|(stage, _)| {
                let (tags, lane) = (job.tags_of(stage.number), stage.kind.properties().lane);
                let may_take = move |worker: &Worker| worker.has_tags(tags) && worker.has_room(lane, &self.config);
                capable.iter().filter(move |(_, worker)| may_take(worker))
            });
            let mut eligible = eligible.peekable();
            eligible.peek().is_some() && eligible.all(|&(worker, _)| self.is_reserved_for_others(id, frame, worker))
        };
        let frames = ready_tasks.open.ready().filter(is_reserved).count() as u32;
        (frames > 0).then_some(WaitReason::OtherBuild { frames })
    }
}
