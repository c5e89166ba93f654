//! Repeated measurements of the size of the processes and their files.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::farm::{Farm, RestartableProcess};

/// Interval between two measurements.
const SAMPLE_INTERVAL: Duration = Duration::from_secs(10);
/// Growth from the first half to the second that is tolerated: percent, and bytes.
const GROWTH_TOLERANCE: (u64, u64) = (10, 2 << 20);
/// Shortest run whose growth can be judged: ended jobs are kept for a minute, garbage for another.
const MIN_DURATION: Duration = Duration::from_secs(600);

/// Measurement of one process.
#[derive(Debug, Clone, Copy, Default)]
struct ProcessSize {
    /// Process id; 0: not running.
    id: u32,
    resident_bytes: u64,
    /// User and system time.
    cpu_seconds: f64,
}

/// Measurement of all processes and files.
#[derive(Debug, Clone, Default)]
pub struct Measurement {
    seconds: f64,
    coordinators: Vec<ProcessSize>,
    workers: Vec<ProcessSize>,
    log_bytes: u64,
    artifacts: u64,
    artifact_bytes: u64,
}

/// Measures repeatedly until `is_over`.
pub fn measure_repeatedly(farm: &Farm, begun: Instant, is_over: &AtomicBool) -> Vec<Measurement> {
    let mut measurements = Vec::new();
    while !is_over.load(Ordering::SeqCst) {
        measurements.push(Measurement::read(farm, begun));
        let next = begun + SAMPLE_INTERVAL * measurements.len() as u32;
        while Instant::now() < next && !is_over.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(100));
        }
    }
    measurements
}

impl Measurement {
    fn read(farm: &Farm, begun: Instant) -> Self {
        let (artifacts, artifact_bytes) = volume(&farm.dir.path("artifacts"));
        let size = |name| farm.dir.path(name).metadata().map_or(0, |data| data.len());
        Self {
            seconds: begun.elapsed().as_secs_f64(),
            coordinators: farm.coordinators.iter().map(ProcessSize::measure).collect(),
            workers: farm.workers.iter().map(ProcessSize::measure).collect(),
            log_bytes: size("farm.db") + size("farm.db-wal"),
            artifacts,
            artifact_bytes,
        }
    }

    /// Returns a table with a line for each measurement.
    pub fn table(measurements: &[Self], between: &str) -> String {
        let mut head: Vec<String> = ["seconds", "log KiB", "artifacts", "artifact KiB"].map(str::to_owned).into();
        let (coordinators, workers) =
            measurements.first().map_or((0, 0), |gauge| (gauge.coordinators.len(), gauge.workers.len()));
        let names = |letter: char, count: usize| (0..count).map(move |number| format!("{letter}{number}"));
        let names = names('c', coordinators).chain(names('w', workers));
        head.extend(names.flat_map(|name| [format!("{name} pid"), format!("{name} KiB"), format!("{name} CPU s")]));
        let line = |gauge: &Self| {
            let mut line = vec![
                format!("{:.1}", gauge.seconds),
                kib(gauge.log_bytes),
                gauge.artifacts.to_string(),
                kib(gauge.artifact_bytes),
            ];
            for process in gauge.coordinators.iter().chain(&gauge.workers) {
                line.extend([
                    process.id.to_string(),
                    kib(process.resident_bytes),
                    format!("{:.2}", process.cpu_seconds),
                ]);
            }
            line.join(between)
        };
        std::iter::once(head.join(between)).chain(measurements.iter().map(line)).map(|line| line + "\n").collect()
    }
}

fn kib(bytes: u64) -> String {
    (bytes >> 10).to_string()
}

impl ProcessSize {
    fn measure(process: &RestartableProcess) -> Self {
        let Some(id) = process.id() else { return Self::default() };
        let read = |name| std::fs::read_to_string(format!("/proc/{id}/{name}")).unwrap_or_default();
        let (status, stat) = (read("status"), read("stat"));
        let resident =
            status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.split_whitespace().next()?.parse().ok());
        // Fields after the name in parentheses. Clock ticks are hundredths of a second on Linux.
        let ticks = |index| stat.rsplit(')').next()?.split_whitespace().nth(index)?.parse::<f64>().ok();
        let cpu = ticks(11).zip(ticks(12)).map_or(0.0, |(user, system)| (user + system) / 100.0);
        Self { id, resident_bytes: resident.unwrap_or(0u64) * 1024, cpu_seconds: cpu }
    }
}

/// Returns the number of files below a folder, and their bytes.
fn volume(folder: &Path) -> (u64, u64) {
    let Ok(entries) = std::fs::read_dir(folder) else { return (0, 0) };
    entries.flatten().fold((0, 0), |(count, bytes), entry| match entry.metadata() {
        Ok(data) if data.is_dir() => {
            let below = volume(&entry.path());
            (count + below.0, bytes + below.1)
        }
        Ok(data) => (count + 1, bytes + data.len()),
        // The file was removed meanwhile.
        Err(_) => (count, bytes),
    })
}

/// Returns lines about growth from the first half of the run to the second: in the mean memory of each process over all of its
/// lives, and in the files. The first eighth of the run is left out, because the farm fills up there.
pub fn growth(measurements: &[Measurement], time: Duration) -> Vec<String> {
    let measurements = &measurements[measurements.len() / 8..];
    if time < MIN_DURATION || measurements.len() < 8 {
        return Vec::new();
    }
    let (first, second) = measurements.split_at(measurements.len() / 2);
    let mut grown = Vec::new();
    let mut compare = |what: String, of: &dyn Fn(&Measurement) -> u64| {
        let mean = |half: &[Measurement]| {
            let values: Vec<u64> = half.iter().map(of).filter(|&value| value > 0).collect();
            values.iter().sum::<u64>() / (values.len() as u64).max(1)
        };
        let (before, after) = (mean(first), mean(second));
        if after > before + before * GROWTH_TOLERANCE.0 / 100 + GROWTH_TOLERANCE.1 {
            grown.push(format!("{what}: from {before} to {after} bytes on the average"));
        }
    };
    // Of several coordinators, the leader is the largest; the others only wait.
    let leader =
        |gauge: &Measurement| gauge.coordinators.iter().map(|process| process.resident_bytes).max().unwrap_or(0);
    compare("memory of the coordinator that leads".into(), &leader);
    for worker in 0..measurements[0].workers.len() {
        compare(format!("memory of worker {worker}"), &|gauge| gauge.workers[worker].resident_bytes);
    }
    compare("the log".into(), &|gauge| gauge.log_bytes);
    compare("the store".into(), &|gauge| gauge.artifact_bytes);
    grown
}
