//! Metrics of the process itself, under the names of Prometheus' own client libraries, which dashboards know. Values that the
//! system does not provide are left out.

use std::sync::LazyLock;
use std::time::SystemTime;

use crate::page::Page;

/// Writes memory, processor time, open files and start time of this process to the page.
pub fn write_process_metrics(page: &mut Page) {
    if let Some(seconds) = cpu_seconds() {
        page.counter("process_cpu_seconds_total", "User and system processor time, in seconds.").value(seconds);
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    if let Some(bytes) = kilobytes(&status, "VmRSS:") {
        page.gauge("process_resident_memory_bytes", "Resident memory, in bytes.").count(bytes);
    }
    if let Some(bytes) = kilobytes(&status, "VmSize:") {
        page.gauge("process_virtual_memory_bytes", "Virtual memory, in bytes.").count(bytes);
    }
    if let Ok(files) = std::fs::read_dir("/proc/self/fd") {
        page.gauge("process_open_fds", "Open file descriptors.").count(files.count() as u64);
    }
    if let Some(most) = max_open_files() {
        page.gauge("process_max_fds", "Maximum number of open file descriptors.").count(most);
    }
    let since_1970 = process_start_time().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let help = "Start time of the process, in seconds since 1970.";
    page.gauge("process_start_time_seconds", help).value(since_1970.as_secs_f64());
}

fn kilobytes(status: &str, field: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? << 10)
}

fn max_open_files() -> Option<u64> {
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    limits.lines().find_map(|line| line.strip_prefix("Max open files"))?.split_whitespace().next()?.parse().ok()
}

#[cfg(unix)]
fn cpu_seconds() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 + time.tv_nsec as f64 / 1e9)
}

#[cfg(not(unix))]
fn cpu_seconds() -> Option<f64> {
    None
}

/// Returns the time of the first call. The server of the page calls it when it begins, which is close to the start of the process;
/// this works on every system.
pub fn process_start_time() -> SystemTime {
    static START: LazyLock<SystemTime> = LazyLock::new(SystemTime::now);
    *START
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Samples;

    #[test]
    fn this_process_has_a_size_and_an_age_where_the_system_says() {
        let mut page = Page::default();
        write_process_metrics(&mut page);
        let samples = Samples::parse(&page.finish()).expect("a page");
        if cfg!(target_os = "linux") {
            let value = |name| samples.value(name, &[]).expect(name);
            assert!(value("process_resident_memory_bytes") > 1e5 && value("process_cpu_seconds_total") > 0.0);
            assert!(value("process_open_fds") >= 3.0 && value("process_max_fds") >= value("process_open_fds"));
            let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).expect("after 1970").as_secs_f64();
            assert!((0.0..3600.0).contains(&(now - value("process_start_time_seconds"))), "it is young");
        }
    }
}
