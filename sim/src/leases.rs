//! Leases of workers, as observed between coordinators and workers.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use femc_model::{Assignment, Epoch, Failure, JobId, JobSpec, Stage, TaskKey};
use femc_schedule::Fact;

use crate::audit::Violation;
use crate::tasks::{TaskStep, counted_result, steps_of_lease, transitive_inputs};

/// Number of a session that the switch has relayed.
pub(crate) type SessionNumber = u64;

/// Leases that were observed to be granted, brought along by workers, and ended.
#[derive(Debug, Default)]
pub(crate) struct Leases {
    /// All granted leases, with the steps that each covers.
    granted: BTreeMap<(TaskKey, Epoch), Vec<TaskStep>>,
    /// Latest lease of each step, and the lease that it copies. Epochs grow with the log.
    latest: BTreeMap<TaskStep, (Epoch, Option<Epoch>)>,
    /// Leases that a worker brought along, with the sessions in which they were not revoked.
    carried_over: BTreeMap<(TaskKey, Epoch), BTreeSet<SessionNumber>>,
    /// Steps that the log counts under leases that no worker brought along.
    counted: BTreeMap<TaskStep, (TaskKey, Epoch)>,
    /// Jobs that are in the log.
    specs: BTreeMap<JobId, Box<JobSpec>>,
    /// Engine build of the worker that holds a lease.
    engines: BTreeMap<(TaskKey, Epoch), String>,
    /// Engine build of a frame.
    frame_builds: BTreeMap<(JobId, u32), String>,
    sessions: SessionNumber,
    /// Task of each epoch.
    epochs: BTreeMap<Epoch, TaskKey>,
    /// Leases that are copies, each with the epoch of the original.
    copies: BTreeMap<(TaskKey, Epoch), Epoch>,
    /// Attempts that were reported as failed, and number of failures in the log. A lease and its copy are one attempt.
    failures: BTreeMap<TaskKey, (BTreeSet<Epoch>, usize)>,
}

impl Leases {
    /// Notes that a session of a worker with this build begins and brings these leases along.
    pub(crate) fn begin_session(
        &mut self,
        engine: &str,
        held: impl Iterator<Item = (TaskKey, Epoch)>,
    ) -> SessionNumber {
        self.sessions += 1;
        for lease in held {
            self.engines.insert(lease, engine.to_owned());
            self.carried_over.entry(lease).or_default().insert(self.sessions);
        }
        self.sessions
    }

    /// Notes and checks a lease that a coordinator grants to a worker with this build.
    pub(crate) fn grant(&mut self, engine: &str, lease: &Assignment) -> Option<Violation> {
        let (key, steps) = ((lease.task, lease.epoch), steps_of_lease(lease));
        self.engines.insert(key, engine.to_owned());
        for unit in &steps {
            let this = (lease.epoch, lease.copy_of);
            let latest = self.latest.entry(*unit).or_insert(this);
            *latest = this.max(*latest);
        }
        let wrong = self.check_superseded(&steps);
        self.granted.insert(key, steps);
        self.copies.extend(lease.copy_of.map(|original| (key, original)));
        match self.epochs.insert(lease.epoch, lease.task) {
            Some(before) => Some(Violation::EpochReused { epoch: lease.epoch, tasks: [before, lease.task] }),
            None => wrong,
        }
    }

    /// Begins an empty log: earlier results do not count any more.
    pub(crate) fn reset(&mut self) {
        self.counted.clear();
        self.specs.clear();
        self.frame_builds.clear();
        self.failures.clear();
    }

    /// Notes that a worker reports a task as failed.
    pub(crate) fn report_failure(&mut self, task: TaskKey, epoch: Epoch) {
        let attempt = self.copies.get(&(task, epoch)).copied().unwrap_or(epoch);
        self.failures.entry(task).or_default().0.insert(attempt);
    }

    /// Returns the steps that a granted lease covers.
    pub(crate) fn steps(&self, task: TaskKey, epoch: Epoch) -> &[TaskStep] {
        self.granted.get(&(task, epoch)).map_or(&[], Vec::as_slice)
    }

    /// Returns the latest granted leases, with the steps that each covers.
    pub(crate) fn latest_granted(&self, count: usize) -> impl Iterator<Item = (TaskKey, Epoch, Range<u32>)> {
        self.epochs.iter().rev().take(count).filter_map(|(&epoch, &task)| {
            let units = self.steps(task, epoch);
            Some((task, epoch, units.first()?.step..units.last()?.step + 1))
        })
    }

    /// Notes that a coordinator revokes a lease.
    pub(crate) fn revoke(&mut self, session: SessionNumber, task: TaskKey, epoch: Epoch) {
        if let Some(sessions) = self.carried_over.get_mut(&(task, epoch)) {
            sessions.remove(&session);
        }
    }

    /// Drops this job and all earlier ones. The log must not count any more results of them.
    pub(crate) fn drop_until(&mut self, job: JobId) {
        self.granted.retain(|(task, _), _| task.job > job);
        self.latest.retain(|unit, _| unit.job > job);
        self.carried_over.retain(|(task, _), _| task.job > job);
        self.counted.retain(|unit, _| unit.job > job);
        self.specs.retain(|&other, _| other > job);
        self.engines.retain(|(task, _), _| task.job > job);
        self.frame_builds.retain(|&(other, _), _| other > job);
        self.epochs.retain(|_, task| task.job > job);
        self.copies.retain(|(task, _), _| task.job > job);
        self.failures.retain(|task, _| task.job > job);
    }

    /// Checks a record that is being written. A result may count only under a valid lease: the latest lease of all its steps, the
    /// lease that the latest one copies, or a lease that a worker brought along and that may have been adopted. The worker's build
    /// must be that of the frame.
    pub(crate) fn check_fact(&mut self, fact: &Fact) -> Option<Violation> {
        match fact {
            // No task of the simulation stalls.
            Fact::Failed { task, failure: Failure::Stalled { .. }, .. } => {
                return Some(Violation::FalseStall { task: *task });
            }
            Fact::Failed { task, .. } => {
                let (reported, counted) = self.failures.entry(*task).or_default();
                *counted += 1;
                let [counted, reported] = [*counted, reported.len()];
                return (counted > reported).then_some(Violation::TooManyFailures { task: *task, counted, reported });
            }
            Fact::Submitted { job, spec, .. } => {
                self.specs.insert(*job, spec.clone());
                return None;
            }
            Fact::SharedJobBegun { job, engine, spec, .. } => {
                self.specs.insert(*job, spec.clone());
                self.frame_builds.insert((*job, Stage::JOB_FRAME), engine.clone());
                return None;
            }
            Fact::OutputsLost { task } => {
                let spec = self.specs.get(&task.job);
                let mut given = self.granted.range((*task, Epoch(0))..);
                let units = given.next().filter(|((of, _), _)| of == task).map(|(_, units)| units);
                let item = units.and_then(|units| units.first()).map(|unit| unit.item);
                let behind =
                    spec.zip(item).map(|(spec, item)| transitive_inputs(spec, &task.stage, item)).unwrap_or_default();
                self.counted.retain(|unit, (by, _)| {
                    by != task
                        && (unit.job != task.job
                            || !behind.contains(&(unit.stage, unit.item))
                            || by.stage == task.stage)
                });
                return None;
            }
            Fact::Restarted { job, frame } => {
                self.counted.retain(|unit, _| (unit.job, unit.stage.frame) != (*job, *frame));
                if !job.is_shared() {
                    self.frame_builds.remove(&(*job, *frame));
                }
                return None;
            }
            Fact::BuildAssigned { job, frame, engine } => {
                let before = self.frame_builds.insert((*job, *frame), engine.clone());
                return before.map(|before| Violation::BuildChanged {
                    job: *job,
                    frame: *frame,
                    builds: [before, engine.clone()],
                });
            }
            _ => {}
        }
        let result = counted_result(fact)?;
        let key = (result.task, result.epoch);
        let Some(units) = self.granted.get(&key) else {
            return Some(Violation::Unleased { task: key.0, epoch: key.1 });
        };
        let (task, epoch) = key;
        let [build, frame] = [self.engines.get(&key), self.frame_builds.get(&(task.job, task.stage.frame))];
        if build != frame {
            let [build, frame] = [build, frame].map(|build| build.cloned().unwrap_or_default());
            return Some(Violation::ForeignBuild { task, epoch, build, frame });
        }
        if self.carried_over.get(&key).is_some_and(|sessions| !sessions.is_empty()) {
            return None;
        }
        self.counted.extend(units.iter().map(|unit| (*unit, key)));
        self.check_superseded(units)
    }

    /// Checks that a counted step is not leased again, except as a copy. The later lease may be observed before or after the
    /// result.
    fn check_superseded(&self, steps: &[TaskStep]) -> Option<Violation> {
        steps.iter().find_map(|unit| {
            let (&(task, epoch), &(later, copy_of)) = (self.counted.get(unit)?, self.latest.get(unit)?);
            (later > epoch && copy_of != Some(epoch)).then_some(Violation::Superseded { task, epoch, later })
        })
    }
}
