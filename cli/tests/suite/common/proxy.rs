//! A proxy to a server that can delay or break connections.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Direction of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// To the server.
    Up,
    /// From the server.
    Down,
}

/// A proxy between clients and a server. Delayed bytes are not lost.
pub struct Proxy {
    /// URL of the proxy for clients.
    pub url: String,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    up: AtomicBool,
    down: AtomicBool,
    streams: Mutex<Vec<TcpStream>>,
}

impl State {
    fn is_frozen(&self, direction: Direction) -> &AtomicBool {
        match direction {
            Direction::Up => &self.up,
            Direction::Down => &self.down,
        }
    }
}

impl Proxy {
    /// Creates a proxy to the server at `url`.
    pub fn new(url: &str) -> Self {
        let target = url.trim_start_matches("http://").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("its address"));
        let state = Arc::<State>::default();
        let shared = state.clone();
        std::thread::spawn(move || {
            for near in listener.incoming() {
                let (Ok(near), Ok(far)) = (near, TcpStream::connect(&target)) else { continue };
                let clone = |stream: &TcpStream| stream.try_clone().expect("another handle");
                shared.streams.lock().expect("no panic").extend([clone(&near), clone(&far)]);
                let (back, forth) = (clone(&near), clone(&far));
                for (from, to, direction) in [(near, far, Direction::Up), (forth, back, Direction::Down)] {
                    let shared = shared.clone();
                    std::thread::spawn(move || relay(from, to, shared.is_frozen(direction)));
                }
            }
        });
        Self { url, state }
    }

    /// Holds back all bytes in both directions; connections stay open.
    pub fn freeze(&self) {
        [Direction::Up, Direction::Down].into_iter().for_each(|way| self.freeze_direction(way));
    }

    /// Holds back all bytes in one direction.
    pub fn freeze_direction(&self, direction: Direction) {
        self.state.is_frozen(direction).store(true, Ordering::SeqCst);
    }

    /// Delivers the held bytes and stops delaying.
    pub fn thaw(&self) {
        [Direction::Up, Direction::Down]
            .into_iter()
            .for_each(|way| self.state.is_frozen(way).store(false, Ordering::SeqCst));
    }

    /// Breaks all connections; new ones can be made.
    pub fn cut(&self) {
        for stream in self.state.streams.lock().expect("no panic").drain(..) {
            // The connection may be closed already.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

fn relay(mut from: TcpStream, mut to: TcpStream, is_frozen: &AtomicBool) {
    let mut bytes = [0; 1 << 16];
    while let Ok(count) = from.read(&mut bytes) {
        while is_frozen.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(5));
        }
        if count == 0 || to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
