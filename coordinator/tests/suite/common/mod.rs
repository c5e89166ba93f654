//! A network that fails where a test wants it to.
#![allow(dead_code)] // each test file uses only a part of this module

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};

/// Point at which a connection breaks.
#[derive(Debug, Clone, Copy)]
pub enum Cut {
    /// After this many bytes from client to server.
    Up(u64),
    /// After this many bytes from server to client.
    Down(u64),
}

/// Traffic through a [`Proxy`].
#[derive(Debug, Default)]
pub struct ProxyTraffic {
    up: AtomicU64,
    down: AtomicU64,
    cuts: AtomicUsize,
}

impl ProxyTraffic {
    /// Returns the bytes from clients to the server, on all connections.
    pub fn up(&self) -> u64 {
        self.up.load(Ordering::SeqCst)
    }

    /// Returns the bytes from the server to clients, on all connections.
    pub fn down(&self) -> u64 {
        self.down.load(Ordering::SeqCst)
    }

    /// Returns the number of connections that were cut.
    pub fn cuts(&self) -> usize {
        self.cuts.load(Ordering::SeqCst)
    }
}

/// A proxy between clients and a server. Its first connection breaks at the first cut, its second at the second, and so on.
pub struct Proxy {
    pub url: String,
    pub traffic: Arc<ProxyTraffic>,
}

impl Proxy {
    pub async fn start(server: SocketAddr, cuts: &[Cut]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let seen = Arc::new(ProxyTraffic::default());
        let cuts = Mutex::new(cuts.iter().copied().collect::<VecDeque<_>>());
        let shared = seen.clone();
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let cut = cuts.lock().unwrap().pop_front();
                tokio::spawn(connection(client, server, cut, shared.clone()));
            }
        });
        Self { url, traffic: seen }
    }
}

async fn connection(client: TcpStream, server: SocketAddr, cut: Option<Cut>, traffic: Arc<ProxyTraffic>) {
    let Ok(server) = TcpStream::connect(server).await else { return };
    let ((from_client, to_client), (from_server, to_server)) = (client.into_split(), server.into_split());
    let (up, down) = match cut {
        Some(Cut::Up(bytes)) => (bytes, u64::MAX),
        Some(Cut::Down(bytes)) => (u64::MAX, bytes),
        None => (u64::MAX, u64::MAX),
    };
    // The direction that ends first ends the connection in both directions.
    let is_cut = tokio::select! {
        is_cut = pump(from_client, to_server, up, &traffic.up) => is_cut,
        is_cut = pump(from_server, to_client, down, &traffic.down) => is_cut,
    };
    traffic.cuts.fetch_add(usize::from(is_cut), Ordering::SeqCst);
}

/// Forwards bytes. Returns whether it ended at its limit.
async fn pump(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, limit: u64, count: &AtomicU64) -> bool {
    let (mut buffer, mut passed) = (vec![0; 1 << 16], 0);
    while let Ok(read @ 1..) = from.read(&mut buffer).await {
        let read = read.min(usize::try_from(limit - passed).unwrap_or(usize::MAX));
        if to.write_all(&buffer[..read]).await.is_err() {
            return false;
        }
        count.fetch_add(read as u64, Ordering::SeqCst);
        passed += read as u64;
        if passed == limit {
            return true;
        }
    }
    false
}
