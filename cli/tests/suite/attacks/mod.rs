//! Attacks on the coordinator's port. Each attack must be refused with a clear message or a closed connection. The farm must serve
//! others during and after it, and its memory must not grow.
//!
//! Attackers come from 127.0.0.2 and up, other clients from 127.0.0.1, because limits per address are tested on their own.
#![cfg(target_os = "linux")]

mod attack;
mod browser;
mod frames;
mod peer;

use std::time::Duration;

use crate::common::{TestFolder, TestProcess};

/// Tolerated growth of the coordinator's memory after an attack, in bytes. Buffers of closed connections go back to the allocator,
/// which does not return all of them to the system.
const GROWTH: u64 = 64 << 20;
/// Memory limit of the transfers on one connection, in bytes.
const TRANSFERS: u64 = 16 * (8 << 20);

/// A coordinator under attack.
pub struct Target {
    dir: TestFolder,
    coordinator: TestProcess,
    /// URL with `http://` or `https://`.
    url: String,
}

impl Target {
    fn start(options: &str) -> Self {
        let dir = TestFolder::new();
        if options.contains("--identity") || options.contains("--token-file") {
            dir.run("ca init").exits(0);
            dir.run("ca issue coordinator farm").exits(0);
            dir.run("ca issue user ann --role viewer").exits(0);
            dir.run("ca token user eve --role viewer").exits(0);
            dir.run("ca token user dora --role viewer").exits(0);
        }
        let line = format!("coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts {options}");
        let mut coordinator = dir.start(&line);
        let line = coordinator.first_line();
        let url = line.split_whitespace().find(|word| word.starts_with("http")).expect("the address").to_owned();
        Self { dir, coordinator, url }
    }

    /// Returns host and port.
    pub fn address(&self) -> &str {
        self.url.split_once("://").expect("a scheme").1
    }

    /// Checks that another client gets answers.
    #[track_caller]
    fn assert_serves_others(&mut self) {
        let identity = match (self.url.starts_with("https"), self.dir.path("dora.token").exists()) {
            (true, _) => "--identity ann.pem",
            (false, true) => "--token-file dora.token",
            (false, false) => "",
        };
        self.dir.run(&format!("jobs --server {} {identity}", self.url)).exits(0);
        assert!(self.coordinator.is_running());
    }

    /// Queues a job, which stays queued because there is no worker.
    #[track_caller]
    fn submit(&self) {
        self.dir.run(&format!("submit fog.mgf --frames 1 --spp 1 --server {}", self.url)).exits(0);
    }

    /// Reads a user's token.
    fn token(&self, name: &str) -> String {
        let text = std::fs::read_to_string(self.dir.path(&format!("{name}.token"))).expect("a token");
        text.lines().next().expect("a line").trim().to_owned()
    }

    /// Revokes a user's token.
    #[track_caller]
    fn revoke(&self, name: &str) {
        self.dir.run(&format!("ca revoke {name}")).exits(0);
    }

    /// Returns the resident memory in bytes.
    fn resident(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.coordinator.id())).expect("it runs");
        let line = status.lines().find(|line| line.starts_with("VmRSS:")).expect("its size");
        let kibibytes: u64 = line.split_whitespace().nth(1).and_then(|word| word.parse().ok()).expect("a number");
        kibibytes << 10
    }
}

/// Runs one attack against a new coordinator. Prints how the attack was refused.
#[track_caller]
fn assert_withstands(name: &str, options: &str, growth: u64, attack: impl AsyncFnOnce(&mut Target) -> String) {
    let mut target = Target::start(options);
    target.assert_serves_others();
    let before = target.resident();
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().expect("a runtime");
    let refused = runtime.block_on(attack(&mut target));
    target.assert_serves_others();
    // Close everything that the attack still holds open.
    runtime.shutdown_timeout(Duration::from_secs(1));
    std::thread::sleep(Duration::from_secs(1));
    target.assert_serves_others();
    let after = target.resident();
    println!("{name}: {refused}; {} -> {} KiB", before >> 10, after >> 10);
    assert!(after <= before + growth, "{name}: grew from {before} to {after} bytes");
}

macro_rules! attacks {
    ($($name:ident($options:expr, $growth:expr) = $attack:expr;)*) => {
        $(#[test]
        fn $name() {
            assert_withstands(stringify!($name), $options, $growth, $attack);
        })*
    };
}

attacks! {
    a_plain_call_to_an_encrypted_port("--identity farm.pem", GROWTH) = attack::plain_to_encrypted;
    a_message_of_4_gib("", GROWTH) = attack::announced_giant;
    a_message_of_9_mib("", GROWTH) = attack::giant;
    a_compressed_message("", GROWTH) = attack::compressed;
    headers_of_64_kib("", GROWTH) = attack::headers;
    a_flood_of_open_calls("", GROWTH) = attack::open_calls;
    a_flood_of_calls_taken_back("", GROWTH) = attack::rapid_reset;
    a_flood_of_pings_that_reads_nothing("", GROWTH) = attack::pings;
    a_flood_of_calls("", GROWTH) = attack::calls;
    nonsense_in_every_call("", GROWTH) = attack::nonsense;
    a_page_of_another_site("", GROWTH) = browser::cross_site;
    a_name_that_was_made_to_lead_here("", GROWTH) = browser::rebinding;
    paths_that_climb("", GROWTH) = browser::path_traversal;
    a_body_without_end("", GROWTH) = browser::huge_body;
    cookies_that_are_forged_or_over("--token-file femc-ca/tokens", GROWTH) = browser::forged_tokens;
    guessed_tokens("--identity farm.pem --token-file femc-ca/tokens", GROWTH) = attack::guesses;
}

/// Attacks that last until the coordinator times out. They run in parallel, each with a thread and a coordinator of its own.
macro_rules! waiting_attacks {
    ($($name:ident($options:expr, $growth:expr) = $attack:expr;)*) => {
        #[test]
        fn whoever_keeps_the_farm_waiting() {
            std::thread::scope(|scope| {
                $(
                    let thread = std::thread::Builder::new().name(stringify!($name).to_owned());
                    let run = || assert_withstands(stringify!($name), $options, $growth, $attack);
                    thread.spawn_scoped(scope, run).expect("a thread");
                )*
            });
        }
    };
}

waiting_attacks! {
    thousands_of_connections("", GROWTH) = attack::connections;
    a_connection_that_says_nothing("", GROWTH) = attack::silence;
    half_a_tls_handshake("--identity farm.pem", GROWTH) = attack::half_a_handshake;
    http2_and_then_nothing("", GROWTH) = attack::greeting_alone;
    http2_that_never_calls("", GROWTH) = attack::endless_pings;
    a_peer_that_stops("", GROWTH) = attack::half_open;
    a_request_of_a_byte_a_second("", GROWTH) = attack::trickle;
    a_head_that_never_ends("", GROWTH) = browser::slow_head;
    feeds_that_are_not_read("", GROWTH) = browser::unread_feeds;
    a_connection_that_is_kept_open("", GROWTH) = browser::idle_connection;
    uploads_that_never_end("", GROWTH + TRANSFERS) = attack::uploads;
    downloads_that_are_not_read("", GROWTH + TRANSFERS) = attack::unread_downloads;
}
