//! Attacks. Each returns a description of how it was refused.

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

use bytes::Bytes;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;

use super::peer::{self, Peer, announced, connect, connect_from, message, outcome, wait_until_closed};
use super::{Target, frames};

/// Waits until a connection opened at `begun` is closed. Returns text with the seconds.
async fn seconds_until_closed(stream: &mut TcpStream, begun: Instant) -> String {
    wait_until_closed(stream).await;
    format!("closed after {} s", begun.elapsed().as_secs())
}

/// Sends bytes. Returns false if the other side does not accept all of them.
async fn push(stream: &mut TcpStream, bytes: &[u8]) -> bool {
    tokio::time::timeout(Duration::from_secs(10), stream.write_all(bytes)).await.is_ok_and(|sent| sent.is_ok())
}

pub async fn connections(target: &mut Target) -> String {
    let mut open = Vec::new();
    for n in 0..3000u32 {
        if let Ok(stream) = connect_from(Ipv4Addr::new(127, 0, 0, 2), target.address()).await {
            open.push(stream);
        }
        if n % 1000 == 999 {
            target.assert_serves_others();
        }
    }
    let mut turned_away = 0;
    for stream in &mut open {
        let mut byte = [0];
        let read = tokio::time::timeout(Duration::from_millis(1), stream.read(&mut byte)).await;
        turned_away += usize::from(read.is_ok_and(|read| !matches!(read, Ok(1..))));
    }
    assert!(turned_away >= 2000, "{turned_away} of {} turned away", open.len());
    let begun = Instant::now();
    for stream in &mut open {
        wait_until_closed(stream).await;
    }
    format!("{turned_away} of {} turned away at once, the others after {} s", open.len(), begun.elapsed().as_secs())
}

pub async fn silence(target: &mut Target) -> String {
    let begun = Instant::now();
    let mut stream = connect(target.address()).await;
    seconds_until_closed(&mut stream, begun).await
}

pub async fn half_a_handshake(target: &mut Target) -> String {
    let begun = Instant::now();
    let mut stream = connect(target.address()).await;
    // 100 bytes of a handshake record of 512 bytes.
    let hello = [&[0x16, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3][..], &[7; 89]].concat();
    assert!(push(&mut stream, &hello).await);
    seconds_until_closed(&mut stream, begun).await
}

pub async fn plain_to_encrypted(target: &mut Target) -> String {
    let begun = Instant::now();
    let mut stream = connect(target.address()).await;
    assert!(push(&mut stream, &[frames::client_preface(), frames::call(1, "/femc.v1.Jobs/List")].concat()).await);
    seconds_until_closed(&mut stream, begun).await
}

pub async fn greeting_alone(target: &mut Target) -> String {
    let begun = Instant::now();
    let mut stream = connect(target.address()).await;
    assert!(push(&mut stream, &frames::client_preface()).await);
    seconds_until_closed(&mut stream, begun).await
}

pub async fn endless_pings(target: &mut Target) -> String {
    let begun = Instant::now();
    let mut stream = connect(target.address()).await;
    assert!(push(&mut stream, &frames::client_preface()).await);
    while begun.elapsed() < peer::CLOSE_TIMEOUT {
        tokio::time::sleep(Duration::from_millis(500)).await;
        if !push(&mut stream, &[frames::settings(), frames::ping()].concat()).await {
            return format!("closed after {} s", begun.elapsed().as_secs());
        }
    }
    panic!("it may talk for ever");
}

pub async fn half_open(target: &mut Target) -> String {
    let stream = connect(target.address()).await.into_std().expect("a socket");
    let mut other = TcpStream::from_std(stream.try_clone().expect("another handle")).expect("a socket");
    let mut peer = Peer::from_stream(TcpStream::from_std(stream).expect("a socket")).await;
    let first = peer.call("Jobs/List", message(&[])).await;
    assert!(first.starts_with("status 0"), "{first}");
    peer.stop();
    seconds_until_closed(&mut other, Instant::now()).await
}

pub async fn trickle(target: &mut Target) -> String {
    let mut peer = Peer::connect(target.address()).await;
    let (response, mut send) = peer.begin("Jobs/Submit").await.expect("a call");
    let sends = tokio::spawn(async move {
        // Announce a message of a thousand bytes.
        let _ = send.send_data(announced(1000, &[]), false);
        loop {
            tokio::time::sleep(Duration::from_secs(1)).await;
            if send.send_data(Bytes::from_static(b"x"), false).is_err() {
                return;
            }
        }
    });
    let refused = outcome(response).await;
    sends.abort();
    assert!(refused.starts_with("status 4"), "{refused}");
    refused
}

pub async fn announced_giant(target: &mut Target) -> String {
    let mut peer = Peer::connect(target.address()).await;
    let refused = peer.call("Jobs/Submit", announced(u32::MAX, &[0; 1000])).await;
    assert!(refused.starts_with("status 11"), "{refused}");
    refused
}

pub async fn giant(target: &mut Target) -> String {
    let mut refusals = Vec::new();
    for call in ["Jobs/Submit", "Artifacts/Missing", "Artifacts/Put", "Workers/Session"] {
        let mut peer = Peer::connect(target.address()).await;
        let refused = peer.call(call, message(&vec![0; 9 << 20])).await;
        assert!(refused.starts_with("status 11"), "{call}: {refused}");
        refusals.push(refused);
    }
    refusals.remove(0)
}

pub async fn compressed(target: &mut Target) -> String {
    let mut peer = Peer::connect(target.address()).await;
    let mut bytes = message(&[0; 100]).to_vec();
    bytes[0] = 1;
    let refused = peer.call("Jobs/Submit", bytes.into()).await;
    assert!(refused.starts_with("status") && !refused.starts_with("status 0"), "{refused}");
    refused
}

pub async fn headers(target: &mut Target) -> String {
    let mut peer = Peer::connect(target.address()).await;
    let request = http::Request::post("http://farm/femc.v1.Jobs/List")
        .header("content-type", "application/grpc")
        .header("x-padding", "x".repeat(64 << 10))
        .body(())
        .expect("a request");
    let (response, _) = peer.calls.send_request(request, true).expect("a call");
    let refused = outcome(response).await;
    assert!(refused.starts_with("closed") || refused.starts_with("HTTP 431"), "{refused}");
    refused
}

pub async fn open_calls(target: &mut Target) -> String {
    let mut stream = connect(target.address()).await;
    assert!(push(&mut stream, &frames::client_preface()).await);
    let mut sent = 0;
    for n in 0..20_000u32 {
        if !push(&mut stream, &frames::call(2 * n + 1, "/femc.v1.Jobs/Submit")).await {
            break;
        }
        sent += 1;
    }
    target.assert_serves_others();
    let begun = Instant::now();
    drop(stream);
    format!("{sent} sent, 256 of them held; {} s", begun.elapsed().as_secs())
}

pub async fn rapid_reset(target: &mut Target) -> String {
    let begun = Instant::now();
    let (mut stream, mut sent) = (connect(target.address()).await, 0);
    assert!(push(&mut stream, &frames::client_preface()).await);
    for n in 0..200_000u32 {
        let both = [frames::call(2 * n + 1, "/femc.v1.Jobs/List"), frames::reset(2 * n + 1)].concat();
        if !push(&mut stream, &both).await {
            break;
        }
        sent += 1;
    }
    target.assert_serves_others();
    wait_until_closed(&mut stream).await;
    assert!(sent < 200_000, "all were taken");
    format!("closed after {sent} calls, {} s", begun.elapsed().as_secs())
}

pub async fn pings(target: &mut Target) -> String {
    let mut stream = connect(target.address()).await;
    assert!(push(&mut stream, &frames::client_preface()).await);
    let many: Vec<u8> = (0..10_000).flat_map(|_| frames::ping()).collect();
    let mut sent = 0;
    while sent < 500 && push(&mut stream, &many).await {
        sent += 1;
    }
    target.assert_serves_others();
    wait_until_closed(&mut stream).await;
    format!("closed after {sent} times 10 000")
}

pub async fn calls(target: &mut Target) -> String {
    let mut peers = Vec::new();
    for _ in 0..4 {
        let mut peer = Peer::connect(target.address()).await;
        peers.push(tokio::spawn(async move {
            let mut outcomes = BTreeMap::<String, u32>::new();
            for _ in 0..2000 {
                let mut open = Vec::new();
                for _ in 0..8 {
                    let Ok((response, mut send)) = peer.begin("Artifacts/Missing").await else { return outcomes };
                    let _ = send.send_data(message(&[]), true);
                    open.push(response);
                }
                for response in open {
                    *outcomes.entry(outcome(response).await.chars().take(9).collect()).or_default() += 1;
                }
            }
            outcomes
        }));
    }
    target.assert_serves_others();
    let mut outcomes = BTreeMap::<String, u32>::new();
    for peer in peers {
        for (what, times) in peer.await.expect("no panic") {
            *outcomes.entry(what).or_default() += times;
        }
    }
    assert!(outcomes.keys().all(|what| ["status 0:", "status 8:"].contains(&what.as_str())), "{outcomes:?}");
    format!("{outcomes:?}")
}

/// Returns a message that announces the digest of a missing file.
fn digest_message(digest: u8) -> Bytes {
    message(&[&[0x0a, 32][..], &[digest; 32]].concat())
}

pub async fn uploads(target: &mut Target) -> String {
    let before = target.resident();
    let mut peer = Peer::connect(target.address()).await;
    let mut open = Vec::new();
    for n in 0..200 {
        let (response, mut send) = peer.begin("Artifacts/Put").await.expect("a call");
        send.send_data(digest_message(n), false).expect("it is taken");
        // Half of a piece of one mebibyte.
        let piece = [&[0x12, 0x80, 0x80, 0x40][..], &vec![0; 1 << 19]].concat();
        send.reserve_capacity(1 << 20);
        let _ = send.send_data(announced((1 << 20) + 4, &piece), false);
        open.push((response, send));
    }
    tokio::time::sleep(Duration::from_secs(2)).await;
    target.assert_serves_others();
    let held = target.resident().saturating_sub(before);
    assert!(held < super::GROWTH, "{held} bytes are held for who sends nothing");
    // This upload has a slot; the others wait for one.
    let (response, _send) = open.swap_remove(0);
    let refused = outcome(response).await;
    assert!(refused.starts_with("status 4"), "{refused}");
    format!("{refused}; {} KiB held", held >> 10)
}

pub async fn unread_downloads(target: &mut Target) -> String {
    let bytes = Bytes::from(vec![7; 24 << 20]);
    let artifact = femc_model::Artifact::from_bytes(&bytes);
    let client = femc_proto::Client::connect(&target.url).await.expect("a connection");
    client.put(bytes).await.expect("it is kept");
    let before = target.resident();
    let stream = connect(target.address()).await;
    let (mut calls, connection) =
        h2::client::Builder::new().initial_window_size(0).handshake::<_, Bytes>(stream).await.expect("HTTP/2");
    tokio::spawn(connection);
    let wanted = message(&[&[0x0a, 32][..], artifact.digest.as_bytes()].concat());
    let mut open = Vec::new();
    for _ in 0..200 {
        let request =
            http::Request::post("http://farm/femc.v1.Artifacts/Get").header("content-type", "application/grpc");
        std::future::poll_fn(|context| calls.poll_ready(context)).await.expect("room for a call");
        let (response, mut send) = calls.send_request(request.body(()).expect("a request"), false).expect("a call");
        send.send_data(wanted.clone(), true).expect("it is taken");
        open.push(response);
    }
    tokio::time::sleep(Duration::from_secs(3)).await;
    // The number of transfers per address is limited. This address has used all of its transfers; other addresses have their own.
    target.assert_serves_others();
    let held = target.resident().saturating_sub(before);
    assert!(held < super::TRANSFERS + super::GROWTH, "{held} bytes are held for who reads nothing");
    format!("16 of 200 begun, {} KiB held", held >> 10)
}

pub async fn nonsense(target: &mut Target) -> String {
    let calls = [
        "Jobs/Submit",
        "Jobs/List",
        "Jobs/Status",
        "Jobs/Watch",
        "Jobs/Control",
        "Jobs/Frames",
        "Jobs/Parts",
        "Jobs/Logs",
        "Jobs/Attempts",
        "Jobs/ListWorkers",
        "Jobs/DrainWorkers",
        "Workers/Session",
        "Artifacts/Missing",
        "Artifacts/Offer",
        "Artifacts/Put",
        "Artifacts/Get",
        "Artifacts/Collect",
        "Jobs/None",
        "None/None",
    ];
    let mut state = 1u64;
    let mut outcomes = BTreeMap::<String, u32>::new();
    let mut peer = Peer::connect(target.address()).await;
    for n in 0..40 {
        for call in calls {
            let byte = |_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 56) as u8
            };
            let body: Vec<u8> = (0..n * 8).map(byte).collect();
            let bytes = if n % 2 == 0 { message(&body) } else { body.into() };
            *outcomes.entry(peer.call(call, bytes).await.chars().take(9).collect()).or_default() += 1;
        }
    }
    assert!(outcomes.len() > 3 && !outcomes.keys().any(|what| what.starts_with("closed")), "{outcomes:?}");
    format!("{outcomes:?}")
}

pub async fn guesses(target: &mut Target) -> String {
    target.dir.run("ca token user bob --role viewer").exits(0);
    let real = target.dir.read("bob.token");
    let (_, rest) = real.split_once('\n').expect("a token and a certificate");
    for n in 0..20u64 {
        let guess = format!("femc_{n:064x}\n{rest}");
        let path = target.dir.path("guess.token");
        let _ = std::fs::remove_file(&path);
        std::fs::write(&path, guess).expect("a file");
        std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600)).expect("its mode");
        let answer =
            target.dir.run(&format!("jobs --server {} --token-file guess.token", target.url)).exits(1).stderr();
        assert!(answer.contains("does not know the token"), "{answer}");
    }
    target.dir.run(&format!("jobs --server {} --token-file bob.token", target.url)).exits(0);
    let record = target.dir.read("audit.jsonl");
    let guesses = record.lines().filter(|line| line.contains("Unauthenticated")).count();
    assert!((1..=20).contains(&guesses) && !record.contains(&real[5..69]), "{record}");
    format!("20 of 20 refused, {guesses} lines in the record")
}
