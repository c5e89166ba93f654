//! Tests of `femc view` and of the calls for recorded light.
#![cfg(unix)]

use femc_require::Prerequisite;
use std::path::Path;
use std::process::Command;

use crate::common::http::{Answer, half_float, send_request};
use crate::common::{TestFolder, TestProcess, start_coordinator, status};

/// Pages of a running `femc view`.
struct Pages {
    _process: TestProcess,
    address: String,
    authorization: String,
    /// Page that the address leads to.
    page: String,
}

impl Pages {
    fn open(dir: &TestFolder, line: &str) -> Self {
        let mut process = dir.start(&format!("view {line} --no-browser --json"));
        let document: serde_json::Value = serde_json::from_str(&process.first_line()).expect("JSON");
        let url = SignInUrl::parse(document["url"].as_str().expect("a URL"));
        let token = document["token"].as_str().expect("a token");
        Self {
            address: url.address,
            authorization: format!("Authorization: Bearer {token}"),
            page: url.page,
            _process: process,
        }
    }

    fn get(&self, path: &str) -> Answer {
        send_request(&self.address, &format!("GET /api/v1/{path}"), &[&self.authorization], "")
    }
}

/// URL that `femc view` prints.
struct SignInUrl {
    address: String,
    token: String,
    page: String,
}

impl SignInUrl {
    fn parse(url: &str) -> Self {
        let (address, fragment) = url.split_once("/login#").unwrap_or_else(|| panic!("no address: {url}"));
        let value = |name: &str| {
            let pairs = fragment.split('&').filter_map(|pair| pair.split_once('='));
            pairs.clone().find(|(key, _)| *key == name).map_or_else(String::new, |(_, value)| value.to_owned())
        };
        let address = address.trim_start_matches("http://").to_owned();
        Self { address, token: value("token"), page: value("from") }
    }

    /// Signs in, as a browser does.
    fn sign_in(&self) -> Answer {
        let form = ["Content-Type: application/x-www-form-urlencoded"];
        send_request(&self.address, "POST /login", &form, &format!("token={}", self.token))
    }

    /// Requests the list of files with a header, and returns the status.
    fn files(&self, header: &str) -> u16 {
        send_request(&self.address, "GET /api/v1/files", &[header], "").status
    }
}

/// Encodes text for the query of a URL.
fn encoded(text: &str) -> String {
    text.bytes()
        .map(|byte| if byte.is_ascii_alphanumeric() { char::from(byte).to_string() } else { format!("%{byte:02X}") })
        .collect()
}

/// Returns the header of an answer in columns.
fn header(answer: &Answer) -> serde_json::Value {
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    assert_eq!(&answer.body[..4], b"FLCV");
    let length = u32::from_le_bytes(answer.body[8..12].try_into().expect("four bytes")) as usize;
    serde_json::from_slice(&answer.body[12..12 + length]).expect("JSON")
}

/// Returns a column of bytes.
fn bytes<'a>(answer: &'a Answer, name: &str) -> &'a [u8] {
    column_bytes(answer, name, "u8")
}

/// Returns the bytes of a column.
fn column_bytes<'a>(answer: &'a Answer, name: &str, kind: &str) -> &'a [u8] {
    let header = header(answer);
    let length = u32::from_le_bytes(answer.body[8..12].try_into().expect("four bytes")) as usize;
    let columns = header["columns"].as_array().expect("columns");
    let column = columns.iter().find(|column| column["name"] == name).expect("the column");
    let number = |key: &str| column[key].as_u64().expect("a number") as usize;
    assert_eq!(column["type"], kind);
    let size = if kind == "u8" { 1 } else { 4 };
    &answer.body[12 + length + number("offset")..][..size * number("length")]
}

fn write_gallery(dir: &TestFolder) {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    dir.run(&format!("render {} -o gallery.exr --size 64x48 --spp 64 --stats", scenes.join("gallery.mgf").display()))
        .exits(0);
}

/// Numbers of rows of the three tables of `femc paths`.
fn rows(dir: &TestFolder, file: &str, condition: &str) -> serde_json::Value {
    let count = |table: &str| {
        let mut command = dir.command(&format!("paths {file} --table {table} --csv --where"));
        let output = command.arg(condition).output().expect("the command runs");
        assert!(output.status.success(), "{condition}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).lines().count().saturating_sub(1)
    };
    serde_json::json!({ "paths": count("paths"), "intersections": count("intersections"), "lights": count("lights") })
}

#[test]
fn counts_of_pages_are_those_of_the_command_line_and_of_polars() {
    let Some(programs) = Prerequisite::Python.variable_or_skip("FEMC_TEST_PYTHON_BIN") else { return };
    let dir = TestFolder::new();
    write_gallery(&dir);
    for table in ["paths", "intersections", "lights"] {
        dir.run(&format!("paths gallery.paths --table {table} --parquet {table}.parquet")).exits(0);
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/light_selections.py");
    let mut command = Command::new(Path::new(&programs).join("python"));
    let output = command.arg(script).arg(dir.path("")).output().expect("Python runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let by_polars: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let pages = Pages::open(&dir, "gallery.paths");
    let conditions = by_polars.as_object().expect("conditions");
    assert!(conditions.len() >= 12);
    for (condition, expected) in conditions {
        let answer = pages.get(&format!("files/0/light/selection?density=1&where={}", encoded(condition)));
        let header = header(&answer);
        assert_eq!(header["counts"], *expected, "page and polars: {condition}");
        // The page shows this text, and copies it as a command.
        let text = header["text"].as_str().expect("a text");
        assert_eq!(rows(&dir, "gallery.paths", text), *expected, "command line and polars: {condition}, {text}");
        for table in ["paths", "intersections", "lights"] {
            let ones: u32 = bytes(&answer, &format!("{table}.mask")).iter().map(|byte| byte.count_ones()).sum();
            assert_eq!(u64::from(ones), expected[table].as_u64().expect("a number"), "{condition}: mask of {table}");
        }
    }
}

#[test]
fn representative_paths_of_pages_are_those_of_the_command_line() {
    let dir = TestFolder::new();
    write_gallery(&dir);
    let answer = Pages::open(&dir, "gallery.paths").get("files/0/light/paths?count=400");
    let ran = dir.run("paths gallery.paths --few 400 --json").exits(0);
    let rows: Vec<serde_json::Value> = serde_json::from_str(&ran.stdout()).expect("JSON");
    let numbers: Vec<u32> = rows.iter().map(|row| row["path"].as_u64().expect("a number") as u32).collect();
    assert_eq!(
        column_bytes(&answer, "paths.number", "u32"),
        numbers.iter().flat_map(|it| it.to_le_bytes()).collect::<Vec<u8>>()
    );
    let header = header(&answer);
    let distance = format!("D = {:.4}, DJ = {:.3};", header["d"].as_f64().unwrap(), header["dj"].as_f64().unwrap());
    assert!(ran.stderr().contains(&distance), "{distance} {}", ran.stderr());
}

#[test]
fn a_view_needs_its_token_and_names_faults_of_parameters() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o fog.exr --size 32x32 --spp 8 --stats").exits(0);
    dir.run("render fog.mgf -o other.exr --size 24x24 --spp 8 --stats --seed 2").exits(0);
    let pages = Pages::open(&dir, "fog.paths other.paths");
    assert_eq!(pages.page, "/view%3Fb%3D1");
    let without = send_request(&pages.address, "GET /api/v1/files", &[], "");
    assert_eq!((without.status, without.code().as_str()), (401, "unauthenticated"));
    let files = pages.get("files").json();
    assert_eq!((&files["files"][0]["name"], &files["files"][1]["name"]), (&"fog.paths".into(), &"other.paths".into()));
    let schema = pages.get("files/1/light/schema");
    assert_eq!(
        (schema.json()["film"].clone(), schema.json()["growing"].clone()),
        (serde_json::json!([24, 24]), false.into())
    );
    let tag = format!("If-None-Match: {}", schema.header("etag"));
    let again = send_request(&pages.address, "GET /api/v1/files/1/light/schema", &[&pages.authorization, &tag], "");
    assert_eq!(again.status, 304);
    for (call, fault) in [
        ("selection?where=deepth%3E3", "where: column 1: unknown name \"deepth\""),
        ("selection", "where"),
        ("paths?count=0", "count: expected a number from 1 to 20000"),
        ("paths?among=few", "among: expected all or brightest"),
        ("histograms?pairs=paths:0-99", "pairs"),
        ("histograms?pairs=roofs:0-1", "pairs: `roofs:0-1`"),
        ("histograms?box=1,2,3", "box: expected six numbers"),
        ("voxels?level=9", "level: expected a number from 0 to 7"),
    ] {
        let answer = pages.get(&format!("files/0/light/{call}"));
        let message = answer.json()["error"]["message"].as_str().unwrap_or_default().to_owned();
        assert_eq!(answer.status, 400, "{call}: {message}");
        assert!(message.starts_with(fault), "{call}: {message}");
    }
    assert_eq!(pages.get("files/2/light/schema").status, 404);
    assert_eq!(pages.get("files/0/light/nothing").status, 404);
    // The file is damaged while it is shown.
    let mut damaged = std::fs::read(dir.path("fog.paths")).expect("the file");
    let middle = damaged.len() / 2;
    damaged.truncate(middle);
    std::fs::write(dir.path("fog.paths"), damaged).expect("it is written");
    let answer = pages.get("files/0/light/schema");
    assert_eq!((answer.status, answer.code().as_str()), (422, "unreadable"), "{}", answer.json());
}

#[test]
fn each_address_signs_in_one_browser() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o fog.exr --size 32x32 --spp 8 --stats").exits(0);
    let mut process = dir.start("view fog.paths --no-browser");
    let mut lines = process.lines();
    let first = SignInUrl::parse(&lines.next().expect("an address"));
    assert_eq!(first.page, "/view");
    assert_eq!(first.files(&format!("Authorization: Bearer {}", first.token)), 401, "it is no token for programs");
    let cookie = |answer: &Answer| {
        assert_eq!(answer.status, 303, "{:?}", answer.head);
        let cookie = answer.header("set-cookie");
        assert!(cookie.contains("HttpOnly"), "{cookie}");
        format!("Cookie: {}", cookie.split(';').next().expect("a value"))
    };
    let signed_in = cookie(&first.sign_in());
    assert!(!signed_in.contains(&first.token), "{signed_in}");
    assert_eq!(first.files(&signed_in), 200);
    let again = first.sign_in();
    assert_eq!((again.status, again.code().as_str()), (410, "used"));
    let help = again.json()["error"]["help"].as_str().expect("help").to_owned();
    assert!(help.contains("latest address in the terminal"), "{help}");
    // The form of a browser without scripts gets a page.
    let head = ["Content-Type: application/x-www-form-urlencoded", "Accept: text/html"];
    let page = send_request(&first.address, "POST /login", &head, &format!("token={}", first.token));
    let text = String::from_utf8_lossy(&page.body).into_owned();
    assert!(page.status == 410 && text.contains("latest address in the terminal"), "{text}");
    let second = SignInUrl::parse(&lines.next().expect("another address"));
    assert_ne!(second.token, first.token);
    assert_eq!(second.files(&cookie(&second.sign_in())), 200);
    assert_eq!(second.files(&signed_in), 200, "the first browser stays signed in");
    assert_eq!(second.sign_in().status, 410);
    let third = SignInUrl::parse(&lines.next().expect("a third address"));
    assert_eq!(third.sign_in().status, 303);
    // The note about a used address is written before the next address.
    lines.next().expect("a fourth address");
    let notes = process.kill_for_stderr();
    assert_eq!(notes.matches("a browser has signed in").count(), 3, "{notes}");
}

#[test]
fn programs_have_a_token_of_their_own() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o fog.exr --size 32x32 --spp 8 --stats").exits(0);
    let mut process = dir.start("view fog.paths --no-browser --json");
    let mut documents = process.lines().map(|line| serde_json::from_str::<serde_json::Value>(&line).expect("JSON"));
    let [mut first, token] = {
        let document = documents.next().expect("a document");
        [&document["url"], &document["token"]].map(|it| it.as_str().expect("a text").to_owned())
    };
    let bearer = format!("Authorization: Bearer {token}");
    for _ in 0..2 {
        let url = SignInUrl::parse(&first);
        assert_ne!(url.token, token);
        assert_eq!(url.files(&bearer), 200, "the token is valid as often as needed");
        assert_eq!(url.sign_in().status, 303);
        let next = documents.next().expect("a document for the next browser");
        assert_eq!(next["token"], *token);
        first = next["url"].as_str().expect("a URL").to_owned();
    }
}

#[test]
fn maps_of_a_file_equal_its_pixels() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o fog.exr --size 32x24 --spp 8 --stats").exits(0);
    dir.run("render fog.mgf -o later.exr --size 32x24 --spp 8 --stats --seed 2").exits(0);
    dir.run("paths fog.paths later.paths --union --out both.paths").exits(0);
    let pages = Pages::open(&dir, "fog.paths both.paths");
    let maps = pages.get("files/0/maps");
    assert_eq!((maps.status, maps.header("content-type")), (200, "application/vnd.femc.pixels"));
    let names = ["Y", "standard_error", "freedom", "samples", "depth", "throughput", "deviation"];
    let head = 20 + names.iter().map(|name| 4 + name.len()).sum::<usize>();
    assert_eq!(maps.body.len(), head + names.len() * 2 * 32 * 24);
    let value = |name: &str, at: usize| {
        let plane = names.iter().position(|known| *known == name).expect("a channel");
        let half = &maps.body[head + 2 * (plane * 32 * 24 + at)..][..2];
        f64::from(half_float([half[0], half[1]]))
    };
    let pixels = dir.run("paths fog.paths --table pixels --json").exits(0).json();
    let pixels = pixels.as_array().expect("pixels");
    assert_eq!(pixels.len(), 32 * 24);
    let mut lit = 0;
    for pixel in pixels {
        let number = |name: &str| pixel[name].as_f64().expect("a number");
        let at = (number("pixel_y") * 32.0 + number("pixel_x")) as usize;
        for (channel, due) in [
            ("Y", number("luminance")),
            ("samples", number("samples")),
            ("depth", number("depth")),
            ("throughput", number("throughput")),
            ("deviation", number("variance").sqrt()),
        ] {
            let sent = value(channel, at);
            assert!((sent - due).abs() <= 1e-3 * due.abs() + 1e-4, "{channel} of {pixel}: {sent}");
        }
        let (error, freedom) = (value("standard_error", at), value("freedom", at));
        lit += usize::from(error > 0.0);
        assert!(
            if number("luminance") > 0.0 { error >= 0.0 && freedom >= 1.0 } else { error == -1.0 },
            "{pixel}: {error}"
        );
    }
    assert!(lit > 32 * 12, "{lit} pixels have a standard error");
    let union = pages.get("files/1/maps");
    assert!(union.body == maps.body, "the maps of a union are those of its first frame");
    let tag = format!("If-None-Match: {}", maps.header("etag"));
    assert_eq!(send_request(&pages.address, "GET /api/v1/files/0/maps", &[&pages.authorization, &tag], "").status, 304);
    assert_ne!(maps.header("etag"), union.header("etag"));
    assert_eq!(send_request(&pages.address, "GET /api/v1/files/0/maps", &[], "").status, 401);
    assert_eq!(pages.get("files/2/maps").status, 404);
    std::fs::write(dir.path("fog.paths"), b"hello").expect("it is written");
    let damaged = pages.get("files/0/maps");
    assert_eq!((damaged.status, damaged.code().as_str()), (422, "unreadable"), "{}", damaged.json());
}

#[test]
fn faulty_files_are_refused_before_the_browser_opens() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o fog.exr --size 32x32 --spp 8 --stats").exits(0);
    let whole = std::fs::read(dir.path("fog.paths")).expect("the file");
    let mut later = whole.clone();
    later[8] = later[8].wrapping_add(1);
    for (name, bytes) in
        [("cut.paths", &whole[..whole.len() / 2]), ("later.paths", &later[..]), ("text.paths", b"hello")]
    {
        std::fs::write(dir.path(name), bytes).expect("it is written");
        let ran = dir.run(&format!("view {name} --no-browser")).exits(1);
        assert!(ran.stderr().contains(name), "{}", ran.stderr());
    }
    assert!(dir.run("view nothing.paths --no-browser").exits(1).stderr().contains("nothing.paths"));
    let mixed = dir.run("view fog.paths fog.mgf --no-browser").exits(2);
    assert!(mixed.stderr().contains("one scene, or one or two statistics files"), "{}", mixed.stderr());
}

#[test]
fn light_of_a_frame_in_progress_grows_until_its_end() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let address = url.trim_start_matches("http://").to_owned();
    let ran = dir.run(&format!("submit fog.mgf --frames 3 --size 160x96 --spp 24 --stats --server {url}")).exits(0);
    let job = ran.stdout().trim().to_owned();
    let get = |call: &str| send_request(&address, &format!("GET /api/v1/jobs/{job}/light/{call}"), &[], "");
    assert_eq!(get("schema?frames=3").status, 204, "nothing is rendered yet");
    assert_eq!(get("schema").status, 400, "the frames are missing");
    let mut worker = dir.start(&format!("worker --join {url} --threads 1"));
    let (mut growing, mut last, mut differences) = (0, 0, 0);
    let mut tag = String::new();
    worker.wait_until("the frame is done", || {
        let paths = get(&format!("paths?frames=3&since={tag}"));
        if paths.status == 200 {
            let header = header(&paths);
            differences += u32::from(header["since"] == *tag && !tag.is_empty());
            tag = paths.header("etag").trim_matches('"').to_owned();
        }
        let answer = get("schema?frames=3");
        if answer.status == 200 {
            let schema = answer.json();
            let samples = schema["samples"].as_u64().expect("a number");
            assert!(samples >= last, "{samples} after {last}");
            last = samples;
            growing += u32::from(schema["growing"] == true);
        }
        status(&dir, &url, &job)["state"] == "done"
    });
    assert!(growing > 0, "the growing frame was never shown");
    assert!(differences > 0, "all answers about the growing frame were full");
    // The last difference is that from the growing frame to the finished one.
    let finished = header(&get("paths?frames=3"));
    assert_eq!((&finished["growing"], finished.get("since")), (&false.into(), None));
    let schema = get("schema?frames=3").json();
    assert_eq!((schema["growing"].clone(), schema["samples"].clone()), (false.into(), (160 * 96 * 24).into()));
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    let file = crate::common::file_names(&dir.path("out")).into_iter().find(|name| name.ends_with(".paths"));
    let condition = "any(interaction == volume) and depth > 2";
    let answer = get(&format!("selection?frames=3&where={}", encoded(condition)));
    assert_eq!(header(&answer)["counts"], rows(&dir, &format!("out/{}", file.expect("a file")), condition));
    let plain = dir.run(&format!("submit fog.mgf --frames 3 --size 16x16 --spp 2 --server {url}")).exits(0);
    let plain = plain.stdout().trim().to_owned();
    worker.wait_until("the plain job is done", || status(&dir, &url, &plain)["state"] == "done");
    let none = send_request(&address, &format!("GET /api/v1/jobs/{plain}/light/schema?frames=3"), &[], "");
    assert_eq!((none.status, none.code().as_str()), (404, "not_found"), "{}", none.json());
}

#[test]
fn damaged_statistics_of_a_job_are_named_and_made_again() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let address = url.trim_start_matches("http://").to_owned();
    let ran = dir.run(&format!("submit fog.mgf --frames 3..4 --size 16x16 --spp 8 --stats --server {url}")).exits(0);
    let job = ran.stdout().trim().to_owned();
    let mut worker = dir.start(&format!("worker --join {url} --threads 1"));
    worker.wait_until("the job is done", || status(&dir, &url, &job)["state"] == "done");
    let get = |call: &str| send_request(&address, &format!("GET /api/v1/jobs/{job}/{call}"), &[], "");
    let frames = get("frames").json();
    let outputs = frames["frames"][1]["outputs"].as_array().expect("outputs").clone();
    let statistics = outputs.iter().find(|output| output["role"] == "statistics").expect("statistics");
    let digest = statistics["digest"].as_str().expect("a digest");
    let digest_of_file = digest.parse().expect("a digest");
    let file = dir.path("artifacts").join(femc_store::artifact_path(&digest_of_file).to_string());
    let bytes = std::fs::read(&file).expect("the artifact");
    std::fs::write(&file, &bytes[..bytes.len() / 2]).expect("it is cut");
    let answer = get("light/schema?frames=3..4");
    assert_eq!((answer.status, answer.code().as_str()), (404, "lost"));
    let expected = format!(
        "frame 4 of job {job}: its light statistics are damaged or missing in the farm's store (artifact {digest})"
    );
    assert_eq!(answer.json()["error"]["message"], expected);
    worker.wait_until("the frame is rendered again", || {
        let schema = get("light/schema?frames=3..4");
        schema.status == 200 && schema.json()["growing"] == false
    });
}

/// Light of all rounds so far is shown, and not only that of the latest round.
#[test]
fn light_of_several_rounds_grows() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let address = url.trim_start_matches("http://").to_owned();
    let ran = dir.run(&format!("submit fog.mgf --frames 3 --size 96x64 --error 0.03 --stats --server {url}")).exits(0);
    let job = ran.stdout().trim().to_owned();
    let mut worker = dir.start(&format!("worker --join {url} --threads 1"));
    let mut seen = Vec::new();
    worker.wait_until("the frame is done", || {
        let path = format!("GET /api/v1/jobs/{job}/light/schema?frames=3");
        let answer = send_request(&address, &path, &[], "");
        if answer.status == 200 && answer.json()["growing"] == true {
            seen.push(answer.json()["samples"].as_u64().expect("a number"));
        }
        status(&dir, &url, &job)["state"] == "done"
    });
    seen.dedup();
    assert!(seen.len() > 1 && seen.is_sorted(), "{seen:?}");
}

#[test]
fn a_scene_is_rendered_in_view_and_paused() {
    let dir = TestFolder::new();
    let pages = Pages::open(&dir, "fog.mgf --size 64x48 --spp 4000 --frames 2 --threads 1");
    assert_eq!(pages.page, "/jobs/1/light%3Fframes%3D2");
    let control = |action: &str| {
        let head = ["Content-Type: application/json", "X-Femc: 1", &pages.authorization];
        let body = format!("{{\"jobs\": [1], \"action\": \"{action}\"}}");
        assert_eq!(send_request(&pages.address, "POST /api/v1/jobs/control", &head, &body).status, 200);
    };
    let samples = || pages.get("jobs/1/light/schema?frames=2").json()["samples"].as_u64().expect("a number");
    let mut waited = 0;
    while pages.get("jobs/1/light/schema?frames=2").status != 200 {
        std::thread::sleep(std::time::Duration::from_millis(50));
        waited += 1;
        assert!(waited < 600, "no light after 30 s");
    }
    control("pause");
    assert_eq!(pages.get("jobs/1").json()["job"]["state"], "paused");
    control("resume");
    let before = samples();
    let mut waited = 0;
    while samples() == before {
        std::thread::sleep(std::time::Duration::from_millis(50));
        waited += 1;
        assert!(waited < 600, "no more light after 30 s");
    }
}
