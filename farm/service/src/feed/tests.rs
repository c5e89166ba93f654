use femc_model::{Intake, OfflineWorker, WorkerId, WorkerList};
use futures_util::StreamExt as _;
use tokio::sync::mpsc;

use super::*;

/// Makes a farm with the given workers, which counts its queries.
fn farm(workers: watch::Receiver<Vec<u64>>) -> (Farm<()>, watch::Receiver<u32>) {
    let (calls, mut inbox) = mpsc::channel(8);
    let (asked, count) = watch::channel(0);
    tokio::spawn(async move {
        while let Some(call) = inbox.recv().await {
            match call {
                Call::Changes { reply, .. } => {
                    asked.send_modify(|count| *count += 1);
                    let there: Vec<WorkerStatus> = workers.borrow().iter().map(|number| worker(*number)).collect();
                    // The first worker is always known.
                    let first = Some(offline("w1")).filter(|_| there.iter().all(|it| it.name != "w1"));
                    let workers = WorkerList { connected: there, offline: first.into_iter().collect() };
                    drop(reply.send(Ok(Changes { workers, ..Changes::default() })));
                }
                other => panic!("unexpected call {other:?}"),
            }
        }
    });
    (Farm::new(calls), count)
}

fn offline(name: &str) -> OfflineWorker {
    let (tags, engine) = (Vec::new(), String::new());
    OfflineWorker { name: name.to_owned(), threads: 1, tags, engine, last_contact: 1500 }
}

fn worker(number: u64) -> WorkerStatus {
    WorkerStatus {
        worker: WorkerId(number),
        name: format!("w{number}"),
        threads: 1,
        tags: Vec::new(),
        tasks: Vec::new(),
        silent: 900,
        completed: 0,
        failed: 0,
        intake: Intake::Open,
        engine: String::new(),
    }
}

/// Returns the kind, the id and the data of an event.
fn parts(event: &Bytes) -> (String, String, serde_json::Value) {
    let text = std::str::from_utf8(event).unwrap();
    let field = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default().to_owned();
    (field("event: "), field("id: "), serde_json::from_str(&field("data: ")).unwrap())
}

fn numbers(list: &serde_json::Value) -> Vec<u64> {
    let number = |it: &serde_json::Value| it.get("worker").unwrap_or(it).as_u64().unwrap();
    list.as_array().unwrap().iter().map(number).collect()
}

#[tokio::test(start_paused = true)]
async fn a_listener_that_was_away_gets_what_it_missed_as_one_delta() {
    let (there, workers) = watch::channel(vec![1, 2]);
    let (farm, _) = farm(workers);
    let feed = Feed::new(farm);
    let mut steady = Box::pin(feed.listen(None, None));
    let (kind, first, data) = parts(&steady.next().await.unwrap().unwrap());
    assert_eq!((kind.as_str(), numbers(&data["workers"])), ("snapshot", vec![1, 2]));
    there.send_replace(vec![1, 2, 3]);
    let (kind, _, data) = parts(&steady.next().await.unwrap().unwrap());
    assert_eq!((kind.as_str(), numbers(&data["workers"])), ("delta", vec![3]), "and nothing that is as it was");
    assert!(data["warnings"].is_null());
    there.send_replace(vec![1, 3, 4]);
    let last = steady.next().await.unwrap().unwrap();
    let mut back = Box::pin(feed.listen(Some(&first), None));
    let (kind, id, data) = parts(&back.next().await.unwrap().unwrap());
    assert_eq!(kind, "delta");
    assert_eq!((numbers(&data["workers"]), numbers(&data["gone_workers"])), (vec![3, 4], vec![2]));
    assert_eq!(id, parts(&last).1, "now it knows as much as the other");
}

#[tokio::test(start_paused = true)]
async fn listeners_share_one_look_at_the_farm_and_the_same_bytes() {
    let (there, workers) = watch::channel(vec![1]);
    let (farm, asked) = farm(workers);
    let feed = Feed::new(farm);
    let mut all: Vec<_> = (0..100).map(|_| Box::pin(feed.listen(None, None))).collect();
    let mut heard = Vec::new();
    for listener in &mut all {
        heard.push(listener.next().await.unwrap().unwrap());
    }
    assert!(heard.windows(2).all(|pair| pair[0].as_ptr() == pair[1].as_ptr()), "one snapshot, not a hundred");
    there.send_replace(vec![1, 2]);
    heard.clear();
    for listener in &mut all {
        heard.push(listener.next().await.unwrap().unwrap());
    }
    assert!(heard.windows(2).all(|pair| pair[0].as_ptr() == pair[1].as_ptr()), "one delta, not a hundred");
    assert!(*asked.borrow() <= 3, "{} looks", *asked.borrow());
    drop(all);
    tokio::time::sleep(Duration::from_secs(5)).await;
    let before = *asked.borrow();
    tokio::time::sleep(Duration::from_secs(60)).await;
    assert_eq!(*asked.borrow(), before, "nobody listens, so nobody asks");
    let mut late = Box::pin(feed.listen(None, None));
    there.send_replace(vec![7]);
    let (_, _, data) = parts(&late.next().await.unwrap().unwrap());
    assert_eq!(numbers(&data["workers"]), [7], "what there is now, not what there was");
}

#[tokio::test(start_paused = true)]
async fn who_is_offline_is_told_once_and_again_when_that_changes() {
    let (there, workers) = watch::channel(vec![1]);
    let (farm, _) = farm(workers);
    let feed = Feed::new(farm);
    let mut listener = Box::pin(feed.listen(None, None));
    let (_, _, snapshot) = parts(&listener.next().await.unwrap().unwrap());
    assert_eq!(snapshot["offline"], serde_json::json!([]));
    there.send_replace(vec![2]);
    let (kind, id, delta) = parts(&listener.next().await.unwrap().unwrap());
    assert_eq!((kind.as_str(), &delta["offline"][0]["name"]), ("delta", &"w1".into()));
    assert_eq!(
        (&delta["offline"][0]["intake"], &delta["offline"][0]["last_contact"]),
        (&"offline".into(), &1.5.into())
    );
    there.send_replace(vec![2, 3]);
    let (_, _, delta) = parts(&listener.next().await.unwrap().unwrap());
    assert!(delta["offline"].is_null(), "it is as before: {delta}");
    there.send_replace(vec![1, 2, 3]);
    listener.next().await.unwrap().unwrap();
    let mut back = Box::pin(feed.listen(Some(&id), None));
    let (kind, _, delta) = parts(&back.next().await.unwrap().unwrap());
    assert_eq!((kind.as_str(), &delta["offline"]), ("delta", &serde_json::json!([])), "it is back");
}

#[tokio::test(start_paused = true)]
async fn a_slow_listener_costs_nothing_and_hears_the_end_of_it() {
    let (there, workers) = watch::channel(vec![0]);
    let (farm, _) = farm(workers);
    let feed = Feed::new(farm);
    let mut slow = Box::pin(feed.listen(None, None));
    slow.next().await.unwrap().unwrap();
    let mut steady = Box::pin(feed.listen(None, None));
    steady.next().await.unwrap().unwrap();
    // More workers leave than the feed remembers.
    for turn in 0..20 {
        there.send_replace((0..500).map(|number| 1 + number + 500 * turn).collect());
        steady.next().await.unwrap().unwrap();
    }
    assert!(feed.hub.lock().workers.removed.len() <= VersionedItems::MAX_REMOVED);
    let (kind, _, data) = parts(&slow.next().await.unwrap().unwrap());
    assert_eq!((kind.as_str(), numbers(&data["workers"]).len()), ("snapshot", 500));
    let quiet = tokio::time::timeout(Duration::from_secs(5), slow.next()).await;
    assert!(quiet.is_err(), "it is up to date");
    assert_eq!(slow.next().await.unwrap().unwrap(), ": alive\n\n");
}

#[tokio::test(start_paused = true)]
async fn an_id_of_another_start_or_of_nobody_brings_a_snapshot() {
    let (_there, workers) = watch::channel(vec![1]);
    let (farm, _) = farm(workers);
    let feed = Feed::new(farm);
    let mut first = Box::pin(feed.listen(None, None));
    let (_, id, _) = parts(&first.next().await.unwrap().unwrap());
    let start = id.split_once('-').unwrap().0.to_owned();
    for wrong in ["", "-", "1-1", "0", &start, &format!("{start}-"), &format!("{start}-99"), &format!("{start}-0")] {
        let mut listener = Box::pin(feed.listen(Some(wrong), None));
        let (kind, _, _) = parts(&listener.next().await.unwrap().unwrap());
        assert_eq!(kind, "snapshot", "{wrong}");
    }
}

#[tokio::test]
async fn listeners_hear_the_end_of_the_coordinator() {
    let (calls, inbox) = mpsc::channel::<Call<()>>(1);
    let feed = Feed::new(Farm::new(calls));
    let mut listener = Box::pin(feed.listen(None, None));
    drop(inbox);
    assert!(listener.next().await.is_none());
}
