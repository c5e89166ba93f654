//! The processes: a coordinator at one address, and workers that reach it each on a way of its own.

use std::net::TcpListener;
use std::sync::{Mutex, MutexGuard};

use crate::common::proxy::Proxy;
use crate::common::{Place, Running};

pub const WORKERS: usize = 3;

/// A process that is started again and again.
pub struct Seat {
    pub name: String,
    line: String,
    life: Mutex<Life>,
}

#[derive(Default)]
struct Life {
    process: Option<Running>,
    /// A fault has stopped it.
    stands: bool,
}

impl Life {
    /// The process; one that has ended by itself is no part of the plan.
    fn process(&mut self) -> Option<&mut Running> {
        let process = self.process.as_mut()?;
        assert!(process.is_running(), "a process ended by itself");
        Some(process)
    }
}

impl Seat {
    fn new(name: &str, line: String) -> Self {
        Self { name: name.into(), line, life: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Life> {
        self.life.lock().expect("no panic")
    }

    pub fn start(&self, place: &Place) {
        self.lock().process.get_or_insert_with(|| place.start_as(&self.name, &self.line));
    }

    /// SIGKILL; `false` if it was not there.
    pub fn kill(&self) -> bool {
        let mut life = self.lock();
        let was_there = life.process().is_some_and(Running::kill);
        *life = Life::default();
        was_there
    }

    /// SIGSTOP; `false` if it was not there.
    pub fn stop(&self) -> bool {
        let mut life = self.lock();
        life.stands = true;
        life.process().map(|process| process.signal("STOP")).is_some()
    }

    /// SIGCONT.
    pub fn go_on(&self) {
        let mut life = self.lock();
        life.stands = false;
        life.process().into_iter().for_each(|process| process.signal("CONT"));
    }

    /// Does `what` while the process stands still; a process that is not there does so, too.
    pub fn stopped<T>(&self, what: impl FnOnce() -> T) -> T {
        let mut life = self.lock();
        let stands = life.stands;
        life.process().into_iter().for_each(|process| process.signal("STOP"));
        let done = what();
        if !stands {
            life.process().into_iter().for_each(|process| process.signal("CONT"));
        }
        done
    }

    /// Its number, while it lives.
    pub fn id(&self) -> Option<u32> {
        self.lock().process.as_ref().map(Running::id)
    }
}

pub struct Farm {
    pub place: Place,
    pub url: String,
    pub coordinator: Seat,
    pub workers: Vec<Seat>,
    /// Each worker's way.
    pub ways: Vec<Proxy>,
}

impl Farm {
    /// Ended jobs are forgotten after a minute.
    pub fn new() -> Self {
        let place = Place::new();
        // Free now; who else takes ports here takes others, as the system gives them in turn.
        let free = TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("an address");
        let url = format!("http://{free}");
        let line = format!(
            "coordinator --listen {free} --store sqlite:farm.db --artifacts artifacts --lease 2s --compact 4000 --keep-ended 1m"
        );
        let coordinator = Seat::new("coordinator", line);
        let ways: Vec<Proxy> = (0..WORKERS).map(|_| Proxy::to(&url)).collect();
        let worker = |(number, way): (usize, &Proxy)| {
            let name = format!("w{number}");
            let line = format!("worker --join {} --threads 1 --name {name} --outbox {name} --color never", way.url);
            Seat::new(&name, line)
        };
        let workers = ways.iter().enumerate().map(worker).collect();
        let farm = Self { place, url, coordinator, workers, ways };
        farm.heal();
        farm
    }

    /// Everybody lives, and all ways are open.
    pub fn heal(&self) {
        self.coordinator.start(&self.place);
        self.workers.iter().for_each(|worker| worker.start(&self.place));
        self.ways.iter().for_each(Proxy::thaw);
    }
}
