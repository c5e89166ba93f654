//! A relay to a server that simulates outages of the server.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// A relay between clients and a server, on threads of its own.
pub struct OutageRelay {
    /// URL of the relay for clients.
    pub url: String,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    /// `None` while the server is away.
    connections: Mutex<Option<Vec<TcpStream>>>,
    refused: AtomicUsize,
}

impl OutageRelay {
    /// Creates a relay to the server at `url`, like `http://127.0.0.1:9000`.
    pub fn new(url: &str) -> Self {
        let server = url.trim_start_matches("http://").trim_end_matches('/').to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("an address"));
        let state = Arc::new(State { connections: Mutex::new(Some(Vec::new())), ..State::default() });
        let shared = state.clone();
        std::thread::spawn(move || listener.incoming().flatten().for_each(|client| connect(client, &server, &shared)));
        Self { url, state }
    }

    /// Breaks all connections and refuses new ones.
    pub fn begin(&self) {
        let connections = self.state.connections.lock().expect("no panic").take();
        for connection in connections.into_iter().flatten() {
            // The connection may be closed already.
            let _ = connection.shutdown(Shutdown::Both);
        }
    }

    /// Ends the outage.
    pub fn end(&self) {
        *self.state.connections.lock().expect("no panic") = Some(Vec::new());
    }

    /// Returns the number of refused connections.
    pub fn refused(&self) -> usize {
        self.state.refused.load(Ordering::SeqCst)
    }
}

fn connect(client: TcpStream, server: &str, state: &State) {
    let mut connections = state.connections.lock().expect("no panic");
    let (Some(open), Ok(server)) = (&mut *connections, TcpStream::connect(server)) else {
        state.refused.fetch_add(1, Ordering::SeqCst);
        return;
    };
    let clone = |stream: &TcpStream| stream.try_clone().expect("another handle");
    open.extend([clone(&client), clone(&server)]);
    let (up, down) = ((clone(&client), clone(&server)), (server, client));
    for (from, to) in [up, down] {
        std::thread::spawn(move || pump(from, to));
    }
}

fn pump(mut from: TcpStream, mut to: TcpStream) {
    let mut buffer = vec![0; 1 << 16];
    while let Ok(read @ 1..) = from.read(&mut buffer) {
        if to.write_all(&buffer[..read]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
