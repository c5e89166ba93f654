//! Processes of the soak test: a coordinator, or two on one PostgreSQL, and workers that connect through proxies of their own.

use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};

use crate::common::proxy::Proxy;
use femc_queue::testing::ScratchDatabase;
use femc_queue::{LogContents, Queue as _, Sqlite};

use crate::common::{TestFolder, TestProcess};

pub const WORKERS: usize = 3;

/// A process that is restarted repeatedly.
pub struct RestartableProcess {
    pub name: String,
    line: String,
    /// File of its stderr.
    stderr_file: PathBuf,
    state: Mutex<ProcessState>,
}

#[derive(Default)]
struct ProcessState {
    process: Option<TestProcess>,
    /// Whether a fault has stopped it with SIGSTOP.
    is_stopped: bool,
}

impl RestartableProcess {
    fn new(dir: &TestFolder, name: &str, line: String) -> Self {
        Self { name: name.into(), line, stderr_file: dir.path(&format!("{name}.err")), state: Mutex::default() }
    }

    /// Returns the running process. Panics if the process ended by itself, which the test does not allow.
    fn process<'a>(&self, state: &'a mut ProcessState) -> Option<&'a mut TestProcess> {
        let process = state.process.as_mut()?;
        assert!(
            process.is_running(),
            "{} ended by itself: {}",
            self.name,
            std::fs::read_to_string(&self.stderr_file).unwrap_or_default()
        );
        Some(process)
    }

    fn lock(&self) -> MutexGuard<'_, ProcessState> {
        self.state.lock().expect("no panic")
    }

    pub fn start(&self, dir: &TestFolder) {
        self.lock().process.get_or_insert_with(|| dir.start_as(&self.name, &self.line));
    }

    /// Sends SIGKILL. Returns `false` if the process was not running.
    pub fn kill(&self) -> bool {
        let mut state = self.lock();
        let was_there = self.process(&mut state).is_some_and(TestProcess::kill);
        *state = ProcessState::default();
        was_there
    }

    /// Sends SIGSTOP. Returns `false` if the process was not running.
    pub fn stop(&self) -> bool {
        let mut state = self.lock();
        state.is_stopped = true;
        self.process(&mut state).map(|process| process.signal("STOP")).is_some()
    }

    /// Sends SIGCONT.
    pub fn resume(&self) {
        let mut state = self.lock();
        state.is_stopped = false;
        self.process(&mut state).into_iter().for_each(|process| process.signal("CONT"));
    }

    /// Calls `action` while the process is stopped, or not running.
    pub fn while_stopped<T>(&self, action: impl FnOnce() -> T) -> T {
        let mut state = self.lock();
        let is_stopped = state.is_stopped;
        self.process(&mut state).into_iter().for_each(|process| process.signal("STOP"));
        let done = action();
        if !is_stopped {
            self.process(&mut state).into_iter().for_each(|process| process.signal("CONT"));
        }
        done
    }

    /// Returns the process id, if the process is running.
    pub fn id(&self) -> Option<u32> {
        self.lock().process.as_ref().map(TestProcess::id)
    }
}

/// Returns ports that are free now. They are below the ports that the system gives to connections, so that a coordinator that was
/// killed can get its port back later.
fn free_addresses(count: usize) -> Vec<SocketAddr> {
    let loopback = |port| SocketAddr::from(([127, 0, 0, 1], port));
    let all = (20_000..30_000).map(loopback).filter(|&address| TcpListener::bind(address).is_ok());
    all.skip(std::process::id() as usize % 1000).take(count).collect()
}

/// Location of the log.
enum Store {
    Sqlite,
    Postgres(Box<ScratchDatabase>),
}

pub struct Farm {
    pub dir: TestFolder,
    /// URLs of all coordinators.
    pub url: String,
    pub coordinators: Vec<RestartableProcess>,
    pub workers: Vec<RestartableProcess>,
    /// Proxies from each worker to each coordinator.
    pub proxies: Vec<Vec<Proxy>>,
    store: Store,
    runtime: tokio::runtime::Runtime,
}

impl Farm {
    /// Starts a farm with two coordinators if there is a PostgreSQL, else one. Ended jobs expire after a minute.
    pub fn new() -> Self {
        let dir = TestFolder::new();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let store =
            runtime.block_on(ScratchDatabase::new()).map_or(Store::Sqlite, |scratch| Store::Postgres(scratch.into()));
        let (count, log) = match &store {
            Store::Sqlite => (1, "sqlite:farm.db".to_owned()),
            Store::Postgres(scratch) => (2, scratch.url()),
        };
        let addresses = free_addresses(count);
        let urls: Vec<String> = addresses.iter().map(|address| format!("http://{address}")).collect();
        let coordinator = |(number, address): (usize, &SocketAddr)| {
            let line = format!(
                "coordinator --listen {address} --store {log} --artifacts artifacts --lease 2s --compact 4000 --keep-ended 1m"
            );
            RestartableProcess::new(&dir, &format!("c{number}"), line)
        };
        let coordinators = addresses.iter().enumerate().map(coordinator).collect();
        let proxies: Vec<Vec<Proxy>> = (0..WORKERS).map(|_| urls.iter().map(|url| Proxy::new(url)).collect()).collect();
        let worker = |(number, ways): (usize, &Vec<Proxy>)| {
            let name = format!("w{number}");
            let join = ways.iter().map(|way| way.url.as_str()).collect::<Vec<_>>().join(",");
            let line = format!("worker --join {join} --threads 1 --name {name} --outbox {name} --color never");
            RestartableProcess::new(&dir, &name, line)
        };
        let workers = proxies.iter().enumerate().map(worker).collect();
        let farm = Self { dir, url: urls.join(","), coordinators, workers, proxies, store, runtime };
        farm.heal();
        farm
    }

    /// Starts all processes that are not running, and thaws all proxies.
    pub fn heal(&self) {
        self.coordinators.iter().chain(&self.workers).for_each(|seat| seat.start(&self.dir));
        self.proxies.iter().flatten().for_each(Proxy::thaw);
    }

    /// Returns the current contents of the log, if there is one.
    pub fn log(&self) -> Option<LogContents> {
        match &self.store {
            Store::Sqlite => self.copy_of_log(),
            Store::Postgres(scratch) => self.runtime.block_on(scratch.log_contents()),
        }
    }

    /// Stops the coordinator for an instant, and copies its log file in the state after a crash.
    fn copy_of_log(&self) -> Option<LogContents> {
        let copied = self.coordinators[0].while_stopped(|| {
            ["farm.db", "farm.db-wal", "farm.db-mark"].map(|name| {
                let copy = self.dir.path(&name.replace("farm", "copy"));
                // A log that has just been created or closed lacks some of these files.
                let _ = std::fs::remove_file(&copy);
                std::fs::copy(self.dir.path(name), copy).is_ok()
            })
        });
        let read =
            async { Sqlite::open(&self.dir.path("copy.db")).await.expect("a log").load().await.expect("its content") };
        copied[0].then(|| self.runtime.block_on(read))
    }
}
