//! One build of the engine within one frame: builds may differ in a bit, and a frame of two builds would be neither's.
//!
//! A frame is its first lease's build's, and from its first result on for good: a fact says so. Workers of other builds do
//! other frames meanwhile. When no worker of a frame's build has been there for a while, because all were upgraded, the frame
//! begins anew with those that are there: what was done of it is lost, and nothing waits for ever.

use std::collections::BTreeMap;

use femc_model::{Intake, JobId, Tick, Wait, WorkerId};

use crate::lease_table::{LeaseTable, Worker};
use crate::ledger::{Job, Ledger};
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

/// The build whose frame this is; `None`: whoever comes first.
fn build_of<'a>(ledger: &'a Ledger, table: &'a LeaseTable, job: JobId, frame: u32) -> Option<&'a str> {
    if let Some(shared) = ledger.jobs.get(&job).and_then(|known| known.shared.as_ref()) {
        return Some(&shared.engine);
    }
    ledger.annex.build_of(job, frame).or_else(|| {
        let holder = table.of_frame(job, frame).next()?.1.worker;
        table.workers.get(&holder).map(|worker| &*worker.registration.engine)
    })
}

/// Whether the frame is another build's than the worker's.
pub(crate) fn is_foreign(ledger: &Ledger, table: &LeaseTable, job: JobId, frame: u32, worker: WorkerId) -> bool {
    let Some(worker) = table.workers.get(&worker) else { return false };
    build_of(ledger, table, job, frame).is_some_and(|build| build != worker.registration.engine)
}

impl Scheduler {
    /// Milliseconds between two looks.
    const LOOK_AT_BUILDS: u64 = 1_000;

    /// A result of the frame counts: the frame is its worker's build's.
    pub(crate) fn note_build(&mut self, job: JobId, frame: u32, worker: WorkerId, now: Tick, out: &mut Vec<Command>) {
        debug_assert!(
            !is_foreign(&self.ledger, &self.table, job, frame, worker),
            "a frame of two builds: {job}/{frame}"
        );
        if !job.is_shared()
            && self.ledger.annex.build_of(job, frame).is_none()
            && let Some(worker) = self.table.workers.get(&worker)
        {
            let engine = worker.registration.engine.clone();
            self.record(Fact::Built { job, frame, engine }, now, out);
        }
    }

    /// Lets frames begin anew whose build has had no worker for too long, where others are there.
    pub(crate) fn free_orphans(&mut self, now: Tick, out: &mut Vec<Command>) {
        if now < self.orphans.looked.after(Self::LOOK_AT_BUILDS) {
            return;
        }
        let before = std::mem::take(&mut self.orphans.since);
        let (mut since, mut orphans) = (BTreeMap::new(), Vec::new());
        for id in self.order.jobs() {
            let Some(job) = self.ledger.jobs.get(&id) else { continue };
            let able: Vec<&Worker> =
                self.table.workers.values().filter(|worker| worker.has_tags(&job.spec.tags)).collect();
            // One that has been silent for so long is gone, whatever its connection says.
            let is_there = |it: &Worker| it.intake != Intake::Drained && now.since(it.seen) < self.config.orphaned;
            let has = |build: &str| able.iter().any(|it| is_there(it) && it.registration.engine == build);
            // A blocked frame would gain nothing: a retry opens it, and then its time begins.
            let orphaned = self.ledger.annex.builds_of(id).filter(|&(frame, build)| job.is_open(frame) && !has(build));
            for (frame, _) in orphaned {
                let begun = before.get(&(id, frame)).copied().unwrap_or(now);
                since.insert((id, frame), begun);
                if now.since(begun) >= self.config.orphaned && able.iter().any(|worker| worker.is_open()) {
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
    pub(crate) fn why_foreign(&self, id: JobId, job: &Job, ready_tasks: &ReadyTasks, now: Tick) -> Option<Wait> {
        let may_take = |worker: &Worker| {
            let has_room = worker.held.len() < worker.capacity(&self.config);
            has_room && worker.is_fit(&self.config, now) && worker.has_tags(&job.spec.tags)
        };
        let able: Vec<WorkerId> =
            self.table.workers.iter().filter(|(_, worker)| may_take(worker)).map(|(&id, _)| id).collect();
        let is_foreign = |frame: u32| {
            let mut able = able.iter();
            able.all(|&worker| is_foreign(&self.ledger, &self.table, id, frame, worker))
        };
        let frames = ready_tasks.open.ready().filter(|(frame, _)| is_foreign(*frame)).count() as u32;
        (frames > 0 && !able.is_empty()).then_some(Wait::OtherBuild { frames })
    }
}
