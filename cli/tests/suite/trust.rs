//! Tests of a farm that only accepts its members.

use crate::common::{Place, Running, names, pixels};

/// Creates an authority, an identity for each holder, and a coordinator with the first identity.
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
fn encrypted_farm_equals_one_process_and_each_role_works() {
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
    let error = place.run(&format!("jobs --server {url}")).exits(2).stderr();
    assert!(error.contains("FEMC_IDENTITY"), "{error}");
    let plain = url.replace("https://", "http://");
    place.run(&format!("jobs --server {plain} --identity ann.pem")).exits(4);
    place.run("ca init --dir other").exits(0);
    place.run("ca issue user eve --role admin --dir other").exits(0);
    place.run(&format!("jobs --server {url} --identity eve.pem")).exits(4);
    farm.wait_until("it is noted", || place.read("audit.jsonl").contains("no accepted certificate"));
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
    let error = ended.exits(1).stderr();
    assert!(error.contains("worker w1") && error.contains("revoked"), "{error}");
    farm.wait_until("it is gone", || names().is_empty());
    let error = place.run(&format!("jobs --server {url} --identity w2.pem")).exits(1).stderr();
    assert!(error.contains("worker w2") && error.contains("viewer"), "{error}");
    let list = place.run("ca list --json").exits(0).json();
    let revoked =
        |name: &str| list.as_array().unwrap().iter().find(|line| line["name"] == name).unwrap()["revoked"].clone();
    assert_eq!((revoked("w1"), revoked("w2")), (true.into(), false.into()));
    assert!(place.run("ca list").exits(0).stdout().contains("revoked"));
}

#[test]
fn ca_export_has_only_the_certificate_and_shows_fingerprint() {
    let place = Place::new();
    let missing = place.run("ca export").exits(2).stderr();
    assert!(missing.contains("femc ca init"), "{missing}");
    let (mut farm, _url) = farm(&place, &[]);
    let exported = place.run("ca export -o farm.crt").exits(0);
    assert_eq!(exported.stdout().trim(), "farm.crt");
    let certificate = place.read("farm.crt");
    assert_eq!(certificate, place.read("femc-ca/authority.pem"));
    assert!(certificate.matches("BEGIN").count() == 1 && !certificate.contains("KEY"), "no key is in it");
    let fingerprint = exported.stderr().split_whitespace().last().expect("a fingerprint").to_owned();
    assert_eq!(fingerprint.split(':').count(), 32, "{fingerprint}");
    place.run("ca export -o farm.crt").exits(1);
    // The coordinator prints the same fingerprint of its authority.
    let told = farm.kill_for_stderr();
    assert!(told.contains("browsers warn") && told.contains(&fingerprint), "{told}");
}

#[test]
fn tokens_open_what_identities_open_until_they_are_revoked() {
    let place = Place::new();
    place.run("ca init").exits(0);
    place.run("ca issue coordinator farm").exits(0);
    for token in ["worker w1", "user ann --role submitter", "user eve --role viewer", "user op --role operator"] {
        place.run(&format!("ca token {token}")).exits(0);
    }
    let mut farm = place.start(
        "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem --token-file femc-ca/tokens",
    );
    let line = farm.first_line();
    let url = line.split_whitespace().find(|word| word.starts_with("https://")).expect("the address").to_owned();
    let mut worker = place.start(&format!("worker --join {url} --threads 1 --token-file w1.token"));
    let bearing = |user: &str, line: &str| place.run(&format!("{line} --server {url} --token-file {user}.token"));
    let job = bearing("ann", "submit fog.mgf --spp 4 --frames 1").exits(0).stdout().trim().to_owned();
    bearing("eve", &format!("watch {job}")).exits(0);
    bearing("ann", &format!("fetch {job} -o out")).exits(0);
    let refused = bearing("eve", &format!("cancel {job}")).exits(1).stderr();
    assert!(refused.contains("viewer eve") && refused.contains("submitter"), "{refused}");
    let refused = bearing("w1", "jobs").exits(1).stderr();
    assert!(refused.contains("worker w1"), "{refused}");
    let list = place.run("ca list --json").exits(0).json();
    assert_eq!(list.as_array().unwrap().iter().filter(|line| line["kind"] == "token").count(), 4);

    place.run("ca revoke w1").exits(0);
    let error = worker.end().exits(1).stderr();
    assert!(error.contains("does not know the token"), "{error}");
    place.run("ca revoke eve").exits(0);
    let error = bearing("eve", "jobs").exits(1).stderr();
    assert!(error.contains("does not know the token") && error.contains("--token-file"), "{error}");
    bearing("ann", "jobs").exits(0);
    let error = place.run(&format!("jobs --server {url}")).exits(2).stderr();
    assert!(error.contains("FEMC_TOKEN_FILE"), "{error}");
}

#[test]
fn whoever_watches_with_a_token_that_is_revoked_sees_no_more() {
    let place = Place::new();
    place.run("ca init").exits(0);
    for token in ["user ann --role submitter", "user eve --role viewer"] {
        place.run(&format!("ca token {token}")).exits(0);
    }
    let (_farm, url) = open(&place);
    let bearing = |user: &str, line: &str| format!("{line} --server {url} --token-file {user}.token");
    let job = place.run(&bearing("ann", "submit fog.mgf --spp 4")).exits(0).stdout().trim().to_owned();
    let mut watcher = place.start_as("watch", &bearing("eve", &format!("watch {job} -v")));
    std::thread::sleep(std::time::Duration::from_millis(1500));
    assert!(watcher.is_running(), "no worker is there, so it waits");
    place.run("ca revoke eve").exits(0);
    watcher.end().exits(1);
    // The stream ends with an error that a retry cannot fix.
    assert!(place.read("watch.err").contains("does not know the token"), "{}", place.read("watch.err"));
}

/// Starts a coordinator that accepts tokens on this machine.
fn open(place: &Place) -> (Running, String) {
    let mut farm = place.start(
        "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --token-file femc-ca/tokens",
    );
    let url = farm.address();
    (farm, url)
}

#[test]
fn a_token_goes_no_further_than_this_machine_unless_encrypted() {
    let place = Place::new();
    place.run("ca init").exits(0);
    place.run("ca token user ann --role admin").exits(0);
    let (_farm, url) = open(&place);
    place.run(&format!("jobs --server {url} --token-file ann.token")).exits(0);
    let error = place.run(&format!("jobs --server {url}")).exits(1).stderr();
    assert!(error.contains("neither a certificate nor a token"), "{error}");
    let error = place.run("jobs --server http://192.0.2.1:7878 --token-file ann.token").exits(2).stderr();
    assert!(error.contains("https://") && error.contains("not sent"), "{error}");
    for listen in ["0.0.0.0:0", "0.0.0.0:0 --insecure"] {
        let line =
            format!("coordinator --listen {listen} --store memory --artifacts memory --token-file femc-ca/tokens");
        let error = place.run(&line).exits(2).stderr();
        assert!(error.contains("--identity"), "{error}");
    }
    place.run("coordinator --listen 127.0.0.1:0 --store memory --token-file nothing").exits(1);
    place.run("ca token user ann --role admin").exits(1);
    place.run("ca token coordinator farm").exits(2);
    place.write("open.token", &place.read("ann.token"));
    let error = place.run(&format!("jobs --server {url} --token-file open.token")).exits(1).stderr();
    assert!(error.contains("chmod 600"), "{error}");
}

#[test]
fn audit_log_records_actions_and_refusals_but_no_secret() {
    let place = Place::new();
    let (mut farm, url) = farm(&place, &["worker w1", "user ann --role submitter", "user op --role operator"]);
    let _worker = place.start(&format!("worker --join {url} --threads 1 --identity w1.pem --name node"));
    let as_user = |user: &str, line: &str| place.run(&format!("{line} --server {url} --identity {user}.pem"));
    let job = as_user("ann", "submit fog.mgf --spp 4 --frames 1..2").exits(0).stdout().trim().to_owned();
    as_user("ann", &format!("watch {job}")).exits(0);
    as_user("op", &format!("priority {job} 70")).exits(0);
    as_user("op", "drain node").exits(0);
    as_user("ann", "drain node").exits(1);
    as_user("op", "gc").exits(1);
    as_user("op", &format!("pause {job}")).exits(2);
    // Acknowledged changes are in the audit log even after a kill.
    farm.signal("KILL");
    let record = place.read("audit.jsonl");
    let lines: Vec<serde_json::Value> = record.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let find = |call: &str, who: &str, outcome: &str| {
        let is_it =
            |line: &&serde_json::Value| line["call"] == call && line["who"] == who && line["outcome"] == outcome;
        lines.iter().find(is_it).unwrap_or_else(|| panic!("{call} {who} {outcome} in {record}")).clone()
    };
    let submitted = find("Jobs/Submit", "submitter ann", "ok");
    assert_eq!(submitted["job"].to_string(), job);
    assert!(submitted["from"].as_str().unwrap().starts_with("127.0.0.1:"), "{submitted}");
    assert!(submitted["by"].as_str().unwrap().starts_with("certificate "), "{submitted}");
    assert!(submitted["what"].as_str().unwrap().contains("2 frames"), "{submitted}");
    assert_eq!(find("Jobs/Control", "operator op", "ok")["what"], "Priority(70)");
    assert_eq!(find("Jobs/Control", "operator op", "FailedPrecondition")["job"].to_string(), job);
    assert_eq!(find("Workers/Session", "worker w1", "ok")["what"], "worker node");
    assert!(find("Jobs/DrainWorkers", "operator op", "ok")["what"].as_str().unwrap().contains("node"));
    find("Jobs/DrainWorkers", "submitter ann", "PermissionDenied");
    let refused = find("Artifacts/Collect", "operator op", "PermissionDenied");
    assert!(refused["why"].as_str().unwrap().contains("admin"), "{refused}");
    assert!(!record.contains("PRIVATE"));
    assert!(lines.iter().all(|line| line["call"] != "Jobs/Watch"), "who looks changes nothing");
}

/// Checks the audit log. Pages that are loaded without a login are not recorded as refused. Calls without a login and connections
/// without a request are.
#[test]
fn audit_log_of_encrypted_farm_records_no_page_load_as_refused() {
    let place = Place::new();
    for line in ["ca init --name nights", "ca issue coordinator farm", "ca token user ann --role viewer"] {
        place.run(line).exits(0);
    }
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem";
    let mut farm = place.start(&format!("{line} --token-file femc-ca/tokens"));
    let line = farm.first_line();
    let address = line.split("https://").nth(1).and_then(|rest| rest.split_whitespace().next()).expect("an address");
    let address = address.trim_end_matches('/').to_owned();
    let get = |path: &str| {
        let mut curl = std::process::Command::new("curl");
        curl.args(["--silent", "--insecure", "--write-out", "%{http_code}", "--output"]);
        curl.arg(place.path("answer")).arg(format!("https://{address}{path}"));
        String::from_utf8(curl.output().expect("curl runs").stdout).expect("a status")
    };
    let record = || place.read("audit.jsonl");
    assert_eq!([get("/"), get("/icon.svg")], ["200", "200"]);
    assert_eq!(get("/api/v1/jobs"), "401");
    farm.wait_until("the refusal is in the record", || record().contains("\"Jobs/List\""));
    // This record comes after the ends of the earlier connections.
    drop(std::net::TcpStream::connect(&address).expect("a connection"));
    farm.wait_until("who said nothing is in the record", || record().contains("\"connect\""));
    let record = record();
    let lines = record.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).expect("JSON"));
    let connects = lines.filter(|line| line["call"] == "connect").map(|line| line["times"].as_u64().unwrap_or(1));
    assert!(connects.sum::<u64>() <= 2, "of four connections one was refused and one was silent: {record}");
}

#[test]
fn bad_authority_or_coordinator_identity_is_refused_with_advice() {
    let place = Place::new();
    let error = place.run("ca issue worker w1").exits(2).stderr();
    assert!(error.contains("femc ca init"), "{error}");
    place.run("ca init").exits(0);
    place.run("ca init").exits(1);
    place.run("ca issue worker w1").exits(0);
    place.run("ca issue worker w1").exits(1);
    place.run("ca issue worker w2 --role admin").exits(2);
    place.run("ca issue user ann").exits(2);
    place.run("ca issue user ../ann --role viewer").exits(2);
    place.run("ca issue worker w3 --days 0").exits(2);
    place.run("ca revoke nobody").exits(2);
    let error = place.run("coordinator --listen 127.0.0.1:0 --store memory --identity w1.pem").exits(1).stderr();
    assert!(error.contains("worker w1") && error.contains("femc ca issue coordinator"), "{error}");
    place.run("coordinator --listen 127.0.0.1:0 --store memory --identity nothing.pem").exits(1);
    let error = place.run("coordinator --listen 0.0.0.0:0 --store memory").exits(2).stderr();
    assert!(error.contains("--identity") && error.contains("--insecure"), "{error}");
}
