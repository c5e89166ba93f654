//! Processes of the soak test: a coordinator, or two on one PostgreSQL, and workers that connect through proxies of their own.

use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};

use crate::common::proxy::Proxy;
use femc_queue::testing::Scratch;
use femc_queue::{Contents, Queue as _, Sqlite};

use crate::common::{Place, Running};

pub const WORKERS: usize = 3;

/// A process that is restarted repeatedly.
pub struct Seat {
    pub name: String,
    line: String,
    /// File of its stderr.
    words: PathBuf,
    life: Mutex<Life>,
}

#[derive(Default)]
struct Life {
    process: Option<Running>,
    /// Whether a fault has stopped it with SIGSTOP.
    stands: bool,
}

impl Seat {
    fn new(place: &Place, name: &str, line: String) -> Self {
        Self { name: name.into(), line, words: place.path(&format!("{name}.err")), life: Mutex::default() }
    }

    /// Returns the running process. Panics if the process ended by itself, which the test does not allow.
    fn process<'a>(&self, life: &'a mut Life) -> Option<&'a mut Running> {
        let process = life.process.as_mut()?;
        assert!(
            process.is_running(),
            "{} ended by itself: {}",
            self.name,
            std::fs::read_to_string(&self.words).unwrap_or_default()
        );
        Some(process)
    }

    fn lock(&self) -> MutexGuard<'_, Life> {
        self.life.lock().expect("no panic")
    }

    pub fn start(&self, place: &Place) {
        self.lock().process.get_or_insert_with(|| place.start_as(&self.name, &self.line));
    }

    /// Sends SIGKILL. Returns `false` if the process was not running.
    pub fn kill(&self) -> bool {
        let mut life = self.lock();
        let was_there = self.process(&mut life).is_some_and(Running::kill);
        *life = Life::default();
        was_there
    }

    /// Sends SIGSTOP. Returns `false` if the process was not running.
    pub fn stop(&self) -> bool {
        let mut life = self.lock();
        life.stands = true;
        self.process(&mut life).map(|process| process.signal("STOP")).is_some()
    }

    /// Sends SIGCONT.
    pub fn go_on(&self) {
        let mut life = self.lock();
        life.stands = false;
        self.process(&mut life).into_iter().for_each(|process| process.signal("CONT"));
    }

    /// Calls `what` while the process is stopped, or not running.
    pub fn stopped<T>(&self, what: impl FnOnce() -> T) -> T {
        let mut life = self.lock();
        let stands = life.stands;
        self.process(&mut life).into_iter().for_each(|process| process.signal("STOP"));
        let done = what();
        if !stands {
            self.process(&mut life).into_iter().for_each(|process| process.signal("CONT"));
        }
        done
    }

    /// Returns the process id, if the process is running.
    pub fn id(&self) -> Option<u32> {
        self.lock().process.as_ref().map(Running::id)
    }
}

/// Returns ports that are free now. They are below the ports that the system gives to connections, so that a coordinator that was
/// killed can get its port back later.
fn free(count: usize) -> Vec<SocketAddr> {
    let loopback = |port| SocketAddr::from(([127, 0, 0, 1], port));
    let all = (20_000..30_000).map(loopback).filter(|&address| TcpListener::bind(address).is_ok());
    all.skip(std::process::id() as usize % 1000).take(count).collect()
}

/// Location of the log.
enum Store {
    Sqlite,
    Postgres(Box<Scratch>),
}

pub struct Farm {
    pub place: Place,
    /// URLs of all coordinators.
    pub url: String,
    pub coordinators: Vec<Seat>,
    pub workers: Vec<Seat>,
    /// Proxies from each worker to each coordinator.
    pub ways: Vec<Vec<Proxy>>,
    store: Store,
    runtime: tokio::runtime::Runtime,
}

impl Farm {
    /// Starts a farm with two coordinators if there is a PostgreSQL, else one. Ended jobs expire after a minute.
    pub fn new() -> Self {
        let place = Place::new();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let store = runtime.block_on(Scratch::new()).map_or(Store::Sqlite, |scratch| Store::Postgres(scratch.into()));
        let (count, log) = match &store {
            Store::Sqlite => (1, "sqlite:farm.db".to_owned()),
            Store::Postgres(scratch) => (2, scratch.url()),
        };
        let free = free(count);
        let urls: Vec<String> = free.iter().map(|address| format!("http://{address}")).collect();
        let coordinator = |(number, address): (usize, &SocketAddr)| {
            let line = format!(
                "coordinator --listen {address} --store {log} --artifacts artifacts --lease 2s --compact 4000 --keep-ended 1m"
            );
            Seat::new(&place, &format!("c{number}"), line)
        };
        let coordinators = free.iter().enumerate().map(coordinator).collect();
        let ways: Vec<Vec<Proxy>> = (0..WORKERS).map(|_| urls.iter().map(|url| Proxy::to(url)).collect()).collect();
        let worker = |(number, ways): (usize, &Vec<Proxy>)| {
            let name = format!("w{number}");
            let join = ways.iter().map(|way| way.url.as_str()).collect::<Vec<_>>().join(",");
            let line = format!("worker --join {join} --threads 1 --name {name} --outbox {name} --color never");
            Seat::new(&place, &name, line)
        };
        let workers = ways.iter().enumerate().map(worker).collect();
        let farm = Self { place, url: urls.join(","), coordinators, workers, ways, store, runtime };
        farm.heal();
        farm
    }

    /// Starts all processes that are not running, and thaws all proxies.
    pub fn heal(&self) {
        self.coordinators.iter().chain(&self.workers).for_each(|seat| seat.start(&self.place));
        self.ways.iter().flatten().for_each(Proxy::thaw);
    }

    /// Returns the current contents of the log, if there is one.
    pub fn log(&self) -> Option<Contents> {
        match &self.store {
            Store::Sqlite => self.copy_of_log(),
            Store::Postgres(scratch) => self.runtime.block_on(scratch.log()),
        }
    }

    /// Stops the coordinator for an instant, and copies its log file in the state after a crash.
    fn copy_of_log(&self) -> Option<Contents> {
        let copied = self.coordinators[0].stopped(|| {
            ["farm.db", "farm.db-wal", "farm.db-mark"].map(|name| {
                let copy = self.place.path(&name.replace("farm", "copy"));
                // A log that has just been created or closed lacks some of these files.
                let _ = std::fs::remove_file(&copy);
                std::fs::copy(self.place.path(name), copy).is_ok()
            })
        });
        let read = async {
            Sqlite::open(&self.place.path("copy.db")).await.expect("a log").load().await.expect("its content")
        };
        copied[0].then(|| self.runtime.block_on(read))
    }
}
