//! Tests of HTTP over TLS with common clients: curl, Python and Node, over HTTP/1.1 and HTTP/2.
#![cfg(unix)]

use crate::common::{CommandOutput, TestFolder, TestProcess, submit};
use femc_require::Prerequisite;
use std::process::Command;

/// An encrypted farm with one finished job, and its identity files.
struct EncryptedFarm {
    dir: TestFolder,
    url: String,
    job: String,
    _coordinator: TestProcess,
}

impl EncryptedFarm {
    fn start() -> Self {
        let dir = TestFolder::new();
        dir.run("ca init").exits(0);
        for issued in ["issue coordinator farm", "issue worker w1", "issue user ann --role admin"] {
            dir.run(&format!("ca {issued}")).exits(0);
        }
        dir.run("ca token user eve --role viewer").exits(0);
        dir.run("ca token user joe --role operator").exits(0);
        let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem";
        let mut coordinator = dir.start(&format!("{line} --token-file femc-ca/tokens"));
        let line = coordinator.first_line();
        let url = line.split_whitespace().find(|word| word.starts_with("https://")).expect("the address").to_owned();
        // Split the identity into the three files that other programs need: certificate, key, authority.
        let identity = dir.read("ann.pem");
        let sections: Vec<&str> = identity.split_inclusive("-----\n").collect();
        for (name, part) in ["cert", "key", "ca"].iter().zip(sections.chunks(2)) {
            dir.write(&format!("{name}.pem"), &part.concat());
        }
        let mut worker = dir.start(&format!("worker --join {url} --threads 1 --name w1 --identity w1.pem"));
        let job = submit(&dir, &url, "--frames 1 --spp 2 --identity ann.pem");
        dir.run(&format!("watch {job} --quiet --server {url} --identity ann.pem")).exits(0);
        worker.kill();
        Self { dir, url, job, _coordinator: coordinator }
    }

    fn token(&self, user: &str) -> String {
        self.dir.read(&format!("{user}.token")).lines().next().expect("a token").to_owned()
    }

    /// Returns the paths of all GET calls that end by themselves, with the status that an admin gets.
    fn gets(&self) -> Vec<(String, u16)> {
        let job = format!("jobs/{}", self.job);
        let of_job = ["", "/frames", "/tasks?state=done&count=2", "/attempts", "/logs"].map(|rest| (rest, 200));
        let pictures = ["thumbnail.png", "pixels", "image.exr"].map(|name| (format!("/frames/1/{name}"), 200));
        let none = [("/frames/1/maps".to_owned(), 204), ("/clip".to_owned(), 404), ("/nothing".to_owned(), 404)];
        let of_job = of_job.map(|(rest, status)| (rest.to_owned(), status)).into_iter().chain(pictures).chain(none);
        let of_job = of_job.map(|(rest, status)| (format!("{job}{rest}"), status));
        let of_farm = ["me", "jobs", "workers", "audit?count=5"].map(|path| (path.to_owned(), 200));
        of_farm.into_iter().chain(of_job).map(|(path, status)| (format!("/api/v1/{path}"), status)).collect()
    }

    /// Runs curl with the authority's certificate and these arguments.
    fn curl(&self, version: &str, path: &str, arguments: &[&str]) -> CurlAnswer {
        let mut curl = Command::new("curl");
        curl.args(["--silent", "--show-error", "--cacert", "ca.pem", version, "--max-time", "60"]);
        curl.args(["--write-out", "\n%{http_version} %{http_code} %header{location} %header{set-cookie}"]);
        curl.args(arguments).arg(format!("{}{path}", self.url)).current_dir(self.dir.path(""));
        let output = curl.output().expect("curl runs");
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        let end = output.stdout.iter().rposition(|byte| *byte == b'\n').expect("the status");
        let words = String::from_utf8_lossy(&output.stdout[end + 1..]).into_owned();
        let mut words = words.split(' ').map(str::to_owned);
        let mut word = || words.next().unwrap_or_default();
        let (spoken, status, location) = (word(), word().parse().expect("a status"), word());
        let cookie = word().trim_end_matches(';').to_owned();
        CurlAnswer { version: spoken, status, location, cookie, error, body: output.stdout[..end].to_vec() }
    }

    /// Runs a script with the address, the job and the paths, one per line. Returns its output.
    fn script(&self, program: &mut Command) -> String {
        let gets: String = self.gets().iter().map(|(path, status)| format!("{status} {path}\n")).collect();
        self.dir.write("gets", &gets);
        program.args([&self.url, &self.job, "gets"]).current_dir(self.dir.path(""));
        program.env("OPERATOR", self.token("joe")).env("VIEWER", self.token("eve"));
        program.env("NODE_EXTRA_CA_CERTS", self.dir.path("ca.pem")).env("PYTHONDONTWRITEBYTECODE", "1");
        let ran = CommandOutput::new("a client", program.output().expect("it runs")).exits(0);
        print!("{}{}", ran.stdout(), ran.stderr());
        ran.stdout()
    }
}

/// An answer that curl received.
#[derive(Debug)]
struct CurlAnswer {
    version: String,
    status: u16,
    location: String,
    cookie: String,
    error: String,
    body: Vec<u8>,
}

impl CurlAnswer {
    /// Returns the error code of a refusal.
    #[track_caller]
    fn code(&self) -> String {
        let text = String::from_utf8_lossy(&self.body);
        let json: serde_json::Value =
            serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {text:?} of {self:?}"));
        json["error"]["code"].as_str().unwrap_or_else(|| panic!("no code in {text}")).to_owned()
    }
}

/// Options of curl, and the HTTP version that each selects.
const VERSIONS: [(&str, &str); 2] = [("--http1.1", "1.1"), ("--http2", "2")];
/// Options of curl that present ann's certificate.
const ANN: [&str; 4] = ["--cert", "cert.pem", "--key", "key.pem"];
const JSON: [&str; 4] = ["--header", "Content-Type: application/json", "--header", "X-Femc: 1"];

#[test]
fn curl_examples_of_the_manual_work_over_both_http_versions() {
    if !Prerequisite::Curl.has_program() {
        return;
    }
    let farm = EncryptedFarm::start();
    for (option, version) in VERSIONS {
        for (path, status) in farm.gets() {
            let answer = farm.curl(option, &path, &ANN);
            assert_eq!((answer.version.as_str(), answer.status), (version, status), "{path}: {answer:?}");
            assert!(status == 204 || !answer.body.is_empty(), "{path}");
        }
        let feed = farm.curl(option, "/api/v1/feed", &[&ANN[..], &["--max-time", "3"]].concat());
        assert_eq!((feed.version.as_str(), feed.status), (version, 200), "{feed:?}");
        assert!(String::from_utf8_lossy(&feed.body).contains("event: snapshot"), "{feed:?}");
        let steer = format!("{{\"jobs\": [{}], \"action\": \"retry\"}}", farm.job);
        let steered = farm.curl(option, "/api/v1/jobs/control", &[&ANN[..], &JSON, &["--data", &steer]].concat());
        let json: serde_json::Value = serde_json::from_slice(&steered.body).expect("JSON");
        assert_eq!((steered.status, json["refused"][0]["code"].as_str()), (200, Some("ended")), "{steered:?}");
        // The login of the web page: a form, then a cookie.
        let form = format!("token={}", farm.token("eve"));
        let login = farm.curl(option, "/login", &["--data", &form]);
        assert_eq!((login.version.as_str(), login.status, login.location.as_str()), (version, 303, "/"), "{login:?}");
        let cookie = format!("Cookie: {}", login.cookie);
        assert_eq!(farm.curl(option, "/api/v1/jobs", &["--header", &cookie]).status, 200);
        assert_eq!(farm.curl(option, "/api/v1/audit", &["--header", &cookie]).code(), "forbidden");
        assert_eq!(farm.curl(option, "/login", &["--data", "token=wrong"]).code(), "unauthenticated");
        assert_eq!(farm.curl(option, "/api/v1/jobs", &[]).code(), "unauthenticated");
    }
}

#[test]
fn refused_post_gets_its_whole_answer_over_both_http_versions() {
    if !Prerequisite::Curl.has_program() {
        return;
    }
    let farm = EncryptedFarm::start();
    let (viewer, operator) = ("eve", "joe");
    let bearer = |user: &str| format!("Authorization: Bearer {}", farm.token(user));
    let (viewer, operator) = (bearer(viewer), bearer(operator));
    for (name, bytes) in [("small", 100), ("full", 60 << 10), ("large", 4 << 20)] {
        farm.dir.write(name, &" ".repeat(bytes));
    }
    for (option, version) in VERSIONS {
        for (who, head, path, file, status, code) in [
            (&viewer, &JSON[..], "/api/v1/workers/drain", "small", 403, "forbidden"),
            (&viewer, &JSON[..], "/api/v1/workers/drain", "full", 403, "forbidden"),
            (&viewer, &JSON[..], "/api/v1/workers/drain", "large", 403, "forbidden"),
            (&operator, &JSON[..2], "/api/v1/jobs/control", "full", 400, "invalid"),
            (&operator, &JSON[..2], "/api/v1/jobs/control", "large", 400, "invalid"),
            (&operator, &JSON[..], "/api/v1/jobs/control", "full", 400, "invalid"),
            (&operator, &JSON[..], "/api/v1/jobs/control", "large", 413, "too_large"),
            (&operator, &JSON[..], "/api/v1/nothing", "large", 404, "not_found"),
            (&operator, &JSON[..], "/api/v1/jobs", "large", 405, "method_not_allowed"),
        ] {
            let file = format!("@{file}");
            let arguments = [head, &["--header", who, "--data-binary", &file]].concat();
            // Repeat, because a connection reset that comes too early does not occur every time.
            for _ in 0..10 {
                let answer = farm.curl(option, path, &arguments);
                assert_eq!(answer.error, "", "{path} {file}: {answer:?}");
                assert_eq!((answer.version.as_str(), answer.status), (version, status), "{path} {file}: {answer:?}");
                assert_eq!(answer.code(), code, "{path} {file}");
            }
        }
    }
}

#[test]
fn oversized_headers_are_refused_over_both_http_versions() {
    if !Prerequisite::Curl.has_program() {
        return;
    }
    let farm = EncryptedFarm::start();
    let limit = femc_service::Limits::default().headers as usize;
    for (option, version) in VERSIONS {
        // 2 KiB are left for the other headers.
        for (bytes, status) in [(limit - (2 << 10), 200), (limit, 431), (3 * limit, 431)] {
            let filler = format!("X-Filler: {}\n", "x".repeat(1000));
            farm.dir.write("head", &filler.repeat(bytes.div_ceil(1000 + "x-filler".len() + 32)));
            let answer = farm.curl(option, "/api/v1/me", &[&ANN[..], &["--header", "@head"]].concat());
            assert_eq!((answer.version.as_str(), answer.status), (version, status), "{bytes}: {answer:?}");
        }
    }
}

#[test]
fn python_speaks_to_an_encrypted_farm() {
    if !Prerequisite::Python3.has_program() {
        return;
    }
    let farm = EncryptedFarm::start();
    farm.dir.write("client.py", include_str!("encrypted/client.py"));
    let said = farm.script(Command::new("python3").arg("client.py"));
    assert!(said.contains("http.client: done") && said.contains("urllib: done"), "{said}");
    assert!(said.contains("requests: done") || said.contains("requests: not installed"), "{said}");
}

#[test]
fn node_speaks_to_an_encrypted_farm() {
    if !Prerequisite::Node.has_program() {
        return;
    }
    let farm = EncryptedFarm::start();
    farm.dir.write("client.mjs", include_str!("encrypted/client.mjs"));
    let said = farm.script(Command::new("node").arg("client.mjs"));
    assert!(said.contains("fetch: done"), "{said}");
}
