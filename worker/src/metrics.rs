//! Counters of a worker, and the metrics page that shows them.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use femc_metrics::{Counter, Health, Page, ProcessReport, Seconds, Tally, write_process_metrics};
use femc_model::{Failure, StageKind};
use femc_proto::PROTOCOL;

use crate::Cache;
use crate::meter::Meter;
use crate::task_table::{Task, TaskTable};
use crate::threads::AbandonedThreads;

/// Counters of a worker. Clones share them.
#[derive(Debug, Clone, Default)]
pub struct Metrics(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    /// Set when the worker starts.
    sources: OnceLock<(Arc<TaskTable>, Cache, Meter, AbandonedThreads)>,
    is_connected: AtomicBool,
    sessions: Counter,
    done: Tally<&'static str>,
    failures: Tally<&'static str>,
    refused: Counter,
    revoked: Counter,
    used: UsageTotals,
}

/// Total usage of tasks.
#[derive(Debug, Default)]
struct UsageTotals {
    wall: Seconds,
    waited: Seconds,
    prepared: Seconds,
    cpu: Seconds,
    samples: Counter,
    rays: Counter,
    fetched: Counter,
    sent: Counter,
}

impl Default for Inner {
    fn default() -> Self {
        Self {
            sources: OnceLock::new(),
            is_connected: AtomicBool::new(false),
            done: Tally::with_keys(StageKind::ALL.map(StageKind::name)),
            failures: Tally::with_keys(Failure::CAUSES),
            sessions: Counter::default(),
            refused: Counter::default(),
            revoked: Counter::default(),
            used: UsageTotals::default(),
        }
    }
}

impl Metrics {
    pub(crate) fn attach(
        &self,
        table: &Arc<TaskTable>,
        cache: &Cache,
        meter: &Meter,
        abandoned_threads: &AbandonedThreads,
    ) {
        // If a second worker shares these counters, the page shows only the first one's table, cache and meter.
        let _ = self.0.sources.set((table.clone(), cache.clone(), meter.clone(), abandoned_threads.clone()));
    }

    pub(crate) fn on_connected(&self) {
        self.0.sessions.add(1);
        self.0.is_connected.store(true, Ordering::Relaxed);
    }

    pub(crate) fn on_disconnected(&self) {
        self.0.is_connected.store(false, Ordering::Relaxed);
    }

    /// Counts a task whose report the coordinator accepted.
    pub(crate) fn on_accepted(&self, task: &Task) {
        match task.outcome() {
            Some(Ok(_)) => self.0.done.add(task.assignment.task.stage.kind.name(), 1),
            Some(Err(failure)) => self.0.failures.add(failure.cause(), 1),
            None => {}
        }
        self.add_usage(task);
    }

    pub(crate) fn on_refused(&self, task: &Task) {
        self.0.refused.add(1);
        self.add_usage(task);
    }

    pub(crate) fn on_revoked(&self, task: &Task) {
        self.0.revoked.add(1);
        self.add_usage(task);
    }

    fn add_usage(&self, task: &Task) {
        let Some(usage) = task.usage() else { return };
        self.0.used.wall.add(usage.wall);
        self.0.used.waited.add(usage.wait);
        self.0.used.prepared.add(usage.preparation);
        self.0.used.cpu.add(usage.cpu);
        self.0.used.samples.add(usage.samples);
        self.0.used.rays.add(usage.rays);
        self.0.used.fetched.add(usage.fetched);
        self.0.used.sent.add(usage.sent);
    }

    /// Returns the worker's health and its metrics page.
    pub fn report(&self) -> ProcessReport {
        let is_connected = self.0.is_connected.load(Ordering::Relaxed);
        let health = match is_connected {
            true => Health::Ready,
            false => Health::Waiting { message: "the worker is connecting to its coordinator".into() },
        };
        let mut page = Page::default();
        let labels = [
            ("version", env!("CARGO_PKG_VERSION")),
            ("protocol", &*PROTOCOL.to_string()),
            ("role", "worker"),
            ("engine", crate::engine()),
        ];
        page.gauge("femc_build_info", "Version, protocol, role and engine of this program; always 1.")
            .labeled(&labels, 1.0);
        let help = "Whether the worker has a session with a coordinator.";
        page.gauge("femc_worker_connected", help).value(u8::from(is_connected));
        self.put_tasks(&mut page);
        self.put_usage(&mut page);
        if let Some((table, cache, meter, left_behind)) = self.0.sources.get() {
            let help = "Processor time without a task, including startup, in seconds.";
            page.counter("femc_worker_idle_cpu_seconds_total", help).value(meter.idle().as_secs_f64());
            put_held(&mut page, table);
            let help = "Threads of cancelled tasks that still run because nothing can interrupt them.";
            page.gauge("femc_worker_threads_left_behind", help).count(left_behind.count() as u64);
            cache.write_metrics(&mut page);
        }
        write_process_metrics(&mut page);
        ProcessReport { health, page: page.finish() }
    }

    fn put_tasks(&self, page: &mut Page) {
        let Inner { sessions, done, failures, refused, revoked, .. } = &*self.0;
        page.counter("femc_worker_sessions_total", "Sessions with coordinators.").count(sessions.get());
        let help = "Results that the coordinator has made durable, by kind of stage.";
        page.counter("femc_worker_tasks_done_total", help).each_label("stage", done.get());
        page.counter("femc_worker_failures_total", "Failed tasks, by cause.").each_label("cause", failures.get());
        let help = "Results that arrived after their lease had expired and have no effect.";
        page.counter("femc_worker_refused_total", help).count(refused.get());
        page.counter("femc_worker_revoked_total", "Tasks whose lease was revoked.").count(revoked.get());
    }

    fn put_usage(&self, page: &mut Page) {
        let UsageTotals { wall, waited, prepared, cpu, samples, rays, fetched, sent } = &self.0.used;
        let help = "Time from the start of tasks to their results, in seconds.";
        page.counter("femc_worker_task_seconds_total", help).value(wall.get());
        let help = "Time from the arrival of tasks to their start, in seconds.";
        page.counter("femc_worker_wait_seconds_total", help).value(waited.get());
        let help = "Part of the task seconds before the inputs were ready.";
        page.counter("femc_worker_preparation_seconds_total", help).value(prepared.get());
        let help = "Processor time of tasks, in seconds.";
        page.counter("femc_worker_cpu_seconds_total", help).value(cpu.get());
        page.counter("femc_worker_samples_total", "Pixel samples taken.").count(samples.get());
        page.counter("femc_worker_rays_total", "Rays traced.").count(rays.get());
        let help = "Bytes of artifacts that tasks downloaded.";
        page.counter("femc_worker_fetched_bytes_total", help).count(fetched.get());
        let help = "Bytes of artifacts that results uploaded.";
        page.counter("femc_worker_sent_bytes_total", help).count(sent.get());
    }
}

fn put_held(page: &mut Page, table: &TaskTable) {
    let held = table.held();
    let results: Vec<u64> = held.iter().filter_map(|task| task.result_bytes()).collect();
    let waiting = held.iter().filter(|task| !task.is_begun()).count();
    page.gauge("femc_worker_tasks_held", "Tasks that the worker holds.").count(held.len() as u64);
    page.gauge("femc_worker_tasks_waiting", "Held tasks that have not begun.").count(waiting as u64);
    let help = "Results in the outbox: the coordinator has not acknowledged them.";
    page.gauge("femc_worker_outbox_results", help).count(results.len() as u64);
    page.gauge("femc_worker_outbox_bytes", "Bytes of the results in the outbox.").count(results.iter().sum());
}
