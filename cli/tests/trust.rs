//! A farm that lets in only those who belong to it.

mod common;
use common::{Place, Running, names, pixels};

/// An authority, an identity for each of these, and a coordinator behind the first.
fn farm(place: &Place, holders: &[&str]) -> (Running, String) {
    place.run("ca init --name nights").exits(0);
    for holder in ["coordinator farm"].iter().chain(holders) {
        place.run(&format!("ca issue {holder}")).exits(0);
    }
    let mut farm = place.start(
        "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem --revoked femc-ca/revoked",
    );
    let line = farm.first_line();
    let url = line.split_whitespace().find(|word| word.starts_with("https://")).expect("the address").to_owned();
    (farm, url)
}

#[test]
fn an_encrypted_farm_renders_the_pixels_of_one_process_and_each_role_does_its_part() {
    let place = Place::new();
    let (_farm, url) = farm(
        &place,
        &[
            "worker w1",
            "user ann --role submitter",
            "user bob --role submitter",
            "user eve --role viewer",
            "user op --role operator",
        ],
    );
    let _worker = place.start(&format!("worker --join {url} --threads 1 --identity w1.pem"));
    let settings = "--spp 4 --frames 1..2";
    let as_user = |user: &str, line: &str| place.run(&format!("{line} --server {url} --identity {user}.pem"));
    let refused = as_user("eve", &format!("submit fog.mgf {settings}")).exits(1).stderr();
    assert!(refused.contains("viewer eve") && refused.contains("submitter"), "{refused}");
    let job = as_user("ann", &format!("submit fog.mgf {settings}")).exits(0).stdout().trim().to_owned();
    let refused = as_user("bob", &format!("cancel {job}")).exits(1).stderr();
    assert!(refused.contains("submitter bob") && refused.contains("owner"), "{refused}");
    as_user("bob", "drain w1").exits(1);
    as_user("ann", &format!("priority {job} 70")).exits(0);
    as_user("op", &format!("priority {job} 60")).exits(0);
    as_user("op", "gc --dry-run").exits(1);
    as_user("eve", &format!("watch {job}")).exits(0);
    let status = as_user("eve", &format!("status {job} --json")).exits(0).json();
    assert_eq!((&status["owner"], &status["priority"]), (&"ann".into(), &60.into()));
    as_user("eve", &format!("fetch {job} -o out")).exits(0);
    place.run(&format!("render fog.mgf -o alone {settings}")).exits(0);
    for name in names(&place.path("alone")) {
        assert_eq!(pixels(&place.path("out").join(&name)), pixels(&place.path("alone").join(&name)), "{name}");
    }
}

#[test]
fn who_has_no_identity_or_lost_it_is_told_so() {
    let place = Place::new();
    let (mut farm, url) = farm(&place, &["worker w1", "worker w2", "user ann --role admin"]);
    let told = place.run(&format!("jobs --server {url}")).exits(2).stderr();
    assert!(told.contains("FEMC_IDENTITY"), "{told}");
    let plain = url.replace("https://", "http://");
    place.run(&format!("jobs --server {plain} --identity ann.pem")).exits(4);
    let mut worker = place.start(&format!("worker --join {url} --threads 1 --identity w1.pem"));
    let workers = || place.run(&format!("workers --json --server {url} --identity ann.pem")).exits(0).json();
    let names = || -> Vec<String> {
        let workers = workers();
        let name = |worker: &serde_json::Value| worker["name"].as_str().expect("a name").to_owned();
        workers.as_array().expect("a list").iter().map(name).collect()
    };
    worker.wait_until("it is there", || !names().is_empty());
    place.run("ca revoke w1").exits(0);
    let ended = worker.end();
    let told = ended.exits(1).stderr();
    assert!(told.contains("worker w1") && told.contains("revoked"), "{told}");
    farm.wait_until("it is gone", || names().is_empty());
    let told = place.run(&format!("jobs --server {url} --identity w2.pem")).exits(1).stderr();
    assert!(told.contains("worker w2") && told.contains("viewer"), "{told}");
    let list = place.run("ca list --json").exits(0).json();
    let revoked =
        |name: &str| list.as_array().unwrap().iter().find(|line| line["name"] == name).unwrap()["revoked"].clone();
    assert_eq!((revoked("w1"), revoked("w2")), (true.into(), false.into()));
    assert!(place.run("ca list").exits(0).stdout().contains("revoked"));
}

#[test]
fn what_is_no_authority_or_no_coordinator_s_identity_is_refused_with_a_way_out() {
    let place = Place::new();
    let told = place.run("ca issue worker w1").exits(2).stderr();
    assert!(told.contains("femc ca init"), "{told}");
    place.run("ca init").exits(0);
    place.run("ca init").exits(1);
    place.run("ca issue worker w1").exits(0);
    place.run("ca issue worker w1").exits(1);
    place.run("ca issue worker w2 --role admin").exits(2);
    place.run("ca issue user ann").exits(2);
    place.run("ca issue user ../ann --role viewer").exits(2);
    place.run("ca issue worker w3 --days 0").exits(2);
    place.run("ca revoke nobody").exits(2);
    let told = place.run("coordinator --listen 127.0.0.1:0 --store memory --identity w1.pem").exits(1).stderr();
    assert!(told.contains("worker w1") && told.contains("femc ca issue coordinator"), "{told}");
    place.run("coordinator --listen 127.0.0.1:0 --store memory --identity nothing.pem").exits(1);
    let told = place.run("coordinator --listen 0.0.0.0:0 --store memory").exits(2).stderr();
    assert!(told.contains("--identity") && told.contains("--insecure"), "{told}");
}
