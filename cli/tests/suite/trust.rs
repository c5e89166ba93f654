//! Tests of a farm that only accepts its members.

use crate::common::{TestFolder, TestProcess, file_names, pixels};

/// Creates an authority, an identity for each holder, and a coordinator with the first identity.
fn farm(dir: &TestFolder, holders: &[&str]) -> (TestProcess, String) {
    dir.run("ca init --name nights").exits(0);
    for holder in ["coordinator farm"].iter().chain(holders) {
        dir.run(&format!("ca issue {holder}")).exits(0);
    }
    let mut farm = dir.start(
        "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem --revoked femc-ca/revoked",
    );
    let line = farm.first_line();
    let url = line.split_whitespace().find(|word| word.starts_with("https://")).expect("the address").to_owned();
    (farm, url)
}

#[test]
fn encrypted_farm_equals_one_process_and_each_role_works() {
    let dir = TestFolder::new();
    let (_farm, url) = farm(
        &dir,
        &[
            "worker w1",
            "user ann --role submitter",
            "user bob --role submitter",
            "user eve --role viewer",
            "user op --role operator",
        ],
    );
    let _worker = dir.start(&format!("worker --join {url} --threads 1 --identity w1.pem"));
    let settings = "--spp 4 --frames 1..2";
    let as_user = |user: &str, line: &str| dir.run(&format!("{line} --server {url} --identity {user}.pem"));
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
    dir.run(&format!("render fog.mgf -o alone {settings}")).exits(0);
    for name in file_names(&dir.path("alone")) {
        assert_eq!(pixels(&dir.path("out").join(&name)), pixels(&dir.path("alone").join(&name)), "{name}");
    }
}

#[test]
fn who_has_no_identity_or_lost_it_is_told_so() {
    let dir = TestFolder::new();
    let (mut farm, url) = farm(&dir, &["worker w1", "worker w2", "user ann --role admin"]);
    let error = dir.run(&format!("jobs --server {url}")).exits(2).stderr();
    assert!(error.contains("FEMC_IDENTITY"), "{error}");
    let plain = url.replace("https://", "http://");
    dir.run(&format!("jobs --server {plain} --identity ann.pem")).exits(4);
    dir.run("ca init --dir other").exits(0);
    dir.run("ca issue user eve --role admin --dir other").exits(0);
    dir.run(&format!("jobs --server {url} --identity eve.pem")).exits(4);
    farm.wait_until("it is noted", || dir.read("audit.jsonl").contains("no accepted certificate"));
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --identity w1.pem"));
    let workers = || dir.run(&format!("workers --json --server {url} --identity ann.pem")).exits(0).json();
    let names = || -> Vec<String> {
        let workers = workers();
        let name = |worker: &serde_json::Value| worker["name"].as_str().expect("a name").to_owned();
        workers.as_array().expect("a list").iter().map(name).collect()
    };
    worker.wait_until("it is there", || !names().is_empty());
    dir.run("ca revoke w1").exits(0);
    let ended = worker.end();
    let error = ended.exits(1).stderr();
    assert!(error.contains("worker w1") && error.contains("revoked"), "{error}");
    farm.wait_until("it is gone", || names().is_empty());
    let error = dir.run(&format!("jobs --server {url} --identity w2.pem")).exits(1).stderr();
    assert!(error.contains("worker w2") && error.contains("viewer"), "{error}");
    let list = dir.run("ca list --json").exits(0).json();
    let revoked =
        |name: &str| list.as_array().unwrap().iter().find(|line| line["name"] == name).unwrap()["revoked"].clone();
    assert_eq!((revoked("w1"), revoked("w2")), (true.into(), false.into()));
    assert!(dir.run("ca list").exits(0).stdout().contains("revoked"));
}

#[test]
fn ca_export_has_only_the_certificate_and_shows_fingerprint() {
    let dir = TestFolder::new();
    let missing = dir.run("ca export").exits(2).stderr();
    assert!(missing.contains("femc ca init"), "{missing}");
    let (mut farm, _url) = farm(&dir, &[]);
    let exported = dir.run("ca export -o farm.crt").exits(0);
    assert_eq!(exported.stdout().trim(), "farm.crt");
    let certificate = dir.read("farm.crt");
    assert_eq!(certificate, dir.read("femc-ca/authority.pem"));
    assert!(certificate.matches("BEGIN").count() == 1 && !certificate.contains("KEY"), "no key is in it");
    let fingerprint = exported.stderr().split_whitespace().last().expect("a fingerprint").to_owned();
    assert_eq!(fingerprint.split(':').count(), 32, "{fingerprint}");
    dir.run("ca export -o farm.crt").exits(1);
    // The coordinator prints the same fingerprint of its authority.
    let told = farm.kill_for_stderr();
    assert!(told.contains("browsers warn") && told.contains(&fingerprint), "{told}");
}

#[test]
fn tokens_open_what_identities_open_until_they_are_revoked() {
    let dir = TestFolder::new();
    dir.run("ca init").exits(0);
    dir.run("ca issue coordinator farm").exits(0);
    for token in ["worker w1", "user ann --role submitter", "user eve --role viewer", "user op --role operator"] {
        dir.run(&format!("ca token {token}")).exits(0);
    }
    let mut farm = dir.start(
        "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem --token-file femc-ca/tokens",
    );
    let line = farm.first_line();
    let url = line.split_whitespace().find(|word| word.starts_with("https://")).expect("the address").to_owned();
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --token-file w1.token"));
    let bearing = |user: &str, line: &str| dir.run(&format!("{line} --server {url} --token-file {user}.token"));
    let job = bearing("ann", "submit fog.mgf --spp 4 --frames 1").exits(0).stdout().trim().to_owned();
    bearing("eve", &format!("watch {job}")).exits(0);
    bearing("ann", &format!("fetch {job} -o out")).exits(0);
    let refused = bearing("eve", &format!("cancel {job}")).exits(1).stderr();
    assert!(refused.contains("viewer eve") && refused.contains("submitter"), "{refused}");
    let refused = bearing("w1", "jobs").exits(1).stderr();
    assert!(refused.contains("worker w1"), "{refused}");
    let list = dir.run("ca list --json").exits(0).json();
    assert_eq!(list.as_array().unwrap().iter().filter(|line| line["kind"] == "token").count(), 4);

    dir.run("ca revoke w1").exits(0);
    let error = worker.end().exits(1).stderr();
    assert!(error.contains("does not know the token"), "{error}");
    dir.run("ca revoke eve").exits(0);
    let error = bearing("eve", "jobs").exits(1).stderr();
    assert!(error.contains("does not know the token") && error.contains("--token-file"), "{error}");
    bearing("ann", "jobs").exits(0);
    let error = dir.run(&format!("jobs --server {url}")).exits(2).stderr();
    assert!(error.contains("FEMC_TOKEN_FILE"), "{error}");
}

#[test]
fn whoever_watches_with_a_token_that_is_revoked_sees_no_more() {
    let dir = TestFolder::new();
    dir.run("ca init").exits(0);
    for token in ["user ann --role submitter", "user eve --role viewer"] {
        dir.run(&format!("ca token {token}")).exits(0);
    }
    let (_farm, url) = start_token_coordinator(&dir);
    let bearing = |user: &str, line: &str| format!("{line} --server {url} --token-file {user}.token");
    let job = dir.run(&bearing("ann", "submit fog.mgf --spp 4")).exits(0).stdout().trim().to_owned();
    let mut watcher = dir.start_as("watch", &bearing("eve", &format!("watch {job} -v")));
    std::thread::sleep(std::time::Duration::from_millis(1500));
    assert!(watcher.is_running(), "no worker is there, so it waits");
    dir.run("ca revoke eve").exits(0);
    watcher.end().exits(1);
    // The stream ends with an error that a retry cannot fix.
    assert!(dir.read("watch.err").contains("does not know the token"), "{}", dir.read("watch.err"));
}

/// Starts a coordinator that accepts tokens on this machine.
fn start_token_coordinator(dir: &TestFolder) -> (TestProcess, String) {
    let mut farm = dir.start(
        "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --token-file femc-ca/tokens",
    );
    let url = farm.address();
    (farm, url)
}

#[test]
fn a_token_goes_no_further_than_this_machine_unless_encrypted() {
    let dir = TestFolder::new();
    dir.run("ca init").exits(0);
    dir.run("ca token user ann --role admin").exits(0);
    let (_farm, url) = start_token_coordinator(&dir);
    dir.run(&format!("jobs --server {url} --token-file ann.token")).exits(0);
    let error = dir.run(&format!("jobs --server {url}")).exits(1).stderr();
    assert!(error.contains("neither a certificate nor a token"), "{error}");
    let error = dir.run("jobs --server http://192.0.2.1:7878 --token-file ann.token").exits(2).stderr();
    assert!(error.contains("https://") && error.contains("not sent"), "{error}");
    for listen in ["0.0.0.0:0", "0.0.0.0:0 --insecure"] {
        let line =
            format!("coordinator --listen {listen} --store memory --artifacts memory --token-file femc-ca/tokens");
        let error = dir.run(&line).exits(2).stderr();
        assert!(error.contains("--identity"), "{error}");
    }
    dir.run("coordinator --listen 127.0.0.1:0 --store memory --token-file nothing").exits(1);
    dir.run("ca token user ann --role admin").exits(1);
    dir.run("ca token coordinator farm").exits(2);
    dir.write("open.token", &dir.read("ann.token"));
    let error = dir.run(&format!("jobs --server {url} --token-file open.token")).exits(1).stderr();
    assert!(error.contains("chmod 600"), "{error}");
}

#[test]
fn audit_log_records_actions_and_refusals_but_no_secret() {
    let dir = TestFolder::new();
    let (mut farm, url) = farm(&dir, &["worker w1", "user ann --role submitter", "user op --role operator"]);
    let _worker = dir.start(&format!("worker --join {url} --threads 1 --identity w1.pem --name node"));
    let as_user = |user: &str, line: &str| dir.run(&format!("{line} --server {url} --identity {user}.pem"));
    let job = as_user("ann", "submit fog.mgf --spp 4 --frames 1..2").exits(0).stdout().trim().to_owned();
    as_user("ann", &format!("watch {job}")).exits(0);
    as_user("op", &format!("priority {job} 70")).exits(0);
    as_user("op", "drain node").exits(0);
    as_user("ann", "drain node").exits(1);
    as_user("op", "gc").exits(1);
    as_user("op", &format!("pause {job}")).exits(2);
    // Acknowledged changes are in the audit log even after a kill.
    farm.signal("KILL");
    let record = dir.read("audit.jsonl");
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
    let dir = TestFolder::new();
    for line in ["ca init --name nights", "ca issue coordinator farm", "ca token user ann --role viewer"] {
        dir.run(line).exits(0);
    }
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem";
    let mut farm = dir.start(&format!("{line} --token-file femc-ca/tokens"));
    let line = farm.first_line();
    let address = line.split("https://").nth(1).and_then(|rest| rest.split_whitespace().next()).expect("an address");
    let address = address.trim_end_matches('/').to_owned();
    let get = |path: &str| {
        let mut curl = std::process::Command::new("curl");
        curl.args(["--silent", "--insecure", "--write-out", "%{http_code}", "--output"]);
        curl.arg(dir.path("answer")).arg(format!("https://{address}{path}"));
        String::from_utf8(curl.output().expect("curl runs").stdout).expect("a status")
    };
    let record = || dir.read("audit.jsonl");
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
    let dir = TestFolder::new();
    let error = dir.run("ca issue worker w1").exits(2).stderr();
    assert!(error.contains("femc ca init"), "{error}");
    dir.run("ca init").exits(0);
    dir.run("ca init").exits(1);
    dir.run("ca issue worker w1").exits(0);
    dir.run("ca issue worker w1").exits(1);
    dir.run("ca issue worker w2 --role admin").exits(2);
    dir.run("ca issue user ann").exits(2);
    dir.run("ca issue user ../ann --role viewer").exits(2);
    dir.run("ca issue worker w3 --days 0").exits(2);
    dir.run("ca revoke w9").exits(2);
    let error = dir.run("coordinator --listen 127.0.0.1:0 --store memory --identity w1.pem").exits(1).stderr();
    assert!(error.contains("worker w1") && error.contains("femc ca issue coordinator"), "{error}");
    dir.run("coordinator --listen 127.0.0.1:0 --store memory --identity nothing.pem").exits(1);
    let error = dir.run("coordinator --listen 0.0.0.0:0 --store memory").exits(2).stderr();
    assert!(error.contains("--identity") && error.contains("--insecure"), "{error}");
}
