//! Laws of answers: an answer depends on its request and on the farm, not on the requests before it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use femc_model::{Role, TaskState};
use http::header::IF_NONE_MATCH;
use serde_json::Value;

use crate::common::{Answer, Random, ask};
use crate::documentation;
use crate::world::{GROWTH, Server, World, attempt, log, output, record, task};

/// Kind of the answers of a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Class {
    /// The answer has a tag. The farm may keep data for it.
    Tagged,
    /// The answer has no tag, and the farm keeps data for it.
    Kept,
    /// The answer is made anew each time.
    Plain,
    /// The answer depends on the time or on the caller, or never ends. Other tests check it.
    Other,
}
use Class::{Kept, Other, Plain, Tagged};

/// Parameters that all questions about light have.
const LIGHT: &[&str] = &["frames", "where", "box"];

/// Every documented request with the class of its answers and its parameters.
const ROUTES: &[(&str, Class, &[&str])] = &[
    ("/api/v1/me", Other, &[]),
    ("/api/v1/feed", Other, &[]),
    ("/api/v1/jobs", Plain, &[]),
    ("/api/v1/jobs/JOB", Plain, &[]),
    ("/api/v1/jobs/JOB/frames", Kept, &["from", "count"]),
    ("/api/v1/jobs/JOB/tasks", Kept, &["from", "count", "frame", "stage", "state", "sort"]),
    ("/api/v1/jobs/JOB/attempts", Plain, &["from", "task"]),
    ("/api/v1/jobs/JOB/logs", Plain, &["task", "since"]),
    ("/api/v1/jobs/JOB/frames/N/thumbnail.png", Tagged, &["height"]),
    ("/api/v1/jobs/JOB/frames/N/pixels", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/maps", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/image.exr", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/layers.exr", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/preview.png", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/still.png", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/painted.png", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/statistics.paths", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/geometry.glb", Tagged, &[]),
    ("/api/v1/jobs/JOB/frames/N/readings.json", Tagged, &[]),
    ("/api/v1/jobs/JOB/geometry", Tagged, &["frame"]),
    ("/api/v1/jobs/JOB/frames/N/solution.glb", Tagged, &[]),
    ("/api/v1/jobs/JOB/solution", Tagged, &["frame"]),
    ("/api/v1/jobs/JOB/frames/N/targets.json", Tagged, &[]),
    ("/api/v1/jobs/JOB/targets", Tagged, &["frame"]),
    ("/api/v1/jobs/JOB/clip", Tagged, &[]),
    ("/api/v1/jobs/JOB/sheet.png", Tagged, &[]),
    ("/api/v1/jobs/JOB/light/schema", Tagged, LIGHT),
    ("/api/v1/jobs/JOB/light/paths", Tagged, &["frames", "where", "box", "count", "among"]),
    ("/api/v1/jobs/JOB/light/histograms", Tagged, &["frames", "where", "box", "pairs", "by"]),
    ("/api/v1/jobs/JOB/light/voxels", Tagged, &["frames", "where", "box", "level", "bounce"]),
    ("/api/v1/jobs/JOB/light/summary", Tagged, LIGHT),
    ("/api/v1/jobs/JOB/light/selection", Tagged, &["frames", "where", "box", "density"]),
    ("/api/v1/workers", Plain, &[]),
    ("/api/v1/compare", Tagged, &["a", "b"]),
    ("/api/v1/files", Plain, &[]),
    ("/api/v1/files/N/maps", Tagged, &[]),
    ("/api/v1/files/N/light/schema", Tagged, &["where", "box"]),
    ("/api/v1/usage", Plain, &[]),
    ("/api/v1/audit", Other, &["count"]),
];

/// Expected answer.
#[derive(Debug, Clone)]
enum Expected {
    /// The whole body.
    Text(String),
    /// Names of the listed tasks, without the job.
    Tasks(&'static [&'static str]),
    /// Texts that occur in the body, and a text that does not.
    Holds(&'static [&'static str], &'static str),
    /// A status without the content that was requested.
    Status(u16),
}
use Expected::{Holds, Status, Tasks, Text};

/// A request with its answer.
#[derive(Debug, Clone)]
struct Case {
    path: String,
    expected: Expected,
}

impl Case {
    fn line(&self) -> String {
        format!("GET /api/v1/{}", self.path)
    }

    /// Checks an answer against the expected one.
    fn check(&self, answer: &Answer) {
        let (path, body) = (&self.path, answer.text());
        let status = if let Status(status) = self.expected { status } else { 200 };
        assert_eq!(answer.status, status, "{path}: {body}");
        match &self.expected {
            Text(text) => assert_eq!(body, *text, "{path}"),
            Tasks(names) => {
                let json: Value = serde_json::from_slice(&answer.body).expect("JSON");
                let tasks = json["tasks"].as_array().expect("a list").iter();
                let listed: Vec<&str> =
                    tasks.filter_map(|task| task["task"].as_str()?.split_once('/')).map(|it| it.1).collect();
                assert_eq!(listed, *names, "{path}");
            }
            Holds(texts, absent) => {
                assert!(texts.iter().all(|text| body.contains(text)), "{path}: {texts:?} in {body}");
                assert!(absent.is_empty() || !body.contains(absent), "{path}: no {absent:?} in {body}");
            }
            Status(_) => {}
        }
    }
}

fn case(path: &str, expected: Expected) -> Case {
    Case { path: path.to_owned(), expected }
}

fn pictures() -> Vec<Case> {
    let text = |path: &str, text: &str| case(path, Text(text.to_owned()));
    vec![
        text("jobs/7/frames/3/thumbnail.png", "90 rows: preview 7.3"),
        text("jobs/7/frames/3/thumbnail.png?height=24", "24 rows: preview 7.3"),
        text("jobs/7/frames/3/thumbnail.png?height=180", "180 rows: preview 7.3"),
        text("jobs/8/frames/3/thumbnail.png", "90 rows: image 8.3"),
        text("jobs/8/frames/5/thumbnail.png?height=24", "24 rows: image 8.5"),
        text("jobs/7/frames/4/thumbnail.png?height=24", "24 rows: tile a + tile b"),
        text("jobs/7/frames/4/thumbnail.png", "90 rows: tile a + tile b"),
        text("jobs/8/frames/4/thumbnail.png", "90 rows: tile c"),
        case("jobs/7/frames/5/thumbnail.png", Status(204)),
        text("jobs/7/frames/3/pixels", "pixels: image 7.3"),
        text("jobs/8/frames/3/pixels", "pixels: image 8.3"),
        text("jobs/7/frames/4/pixels", "pixels: tile a + tile b"),
        text("jobs/7/frames/3/maps", "maps: light 7.3"),
        case("jobs/7/frames/4/maps", Status(204)),
        text("files/0/maps", "maps of a file: light of file 0"),
        text("files/1/maps", "maps of a file: light of file 1"),
    ]
}

fn downloads() -> Vec<Case> {
    let text = |path: &str, text: &str| case(path, Text(text.to_owned()));
    vec![
        text("jobs/7/frames/3/image.exr", "image 7.3"),
        text("jobs/8/frames/3/image.exr", "image 8.3"),
        text("jobs/8/frames/5/image.exr", "image 8.5"),
        case("jobs/7/frames/4/image.exr", Status(404)),
        text("jobs/7/frames/3/preview.png", "preview 7.3"),
        text("jobs/7/frames/3/layers.exr", "layers 7.3"),
        text("jobs/7/frames/3/statistics.paths", "light 7.3"),
        text("jobs/7/frames/3/geometry.glb", "geometry 7.3"),
        case("jobs/7/frames/4/geometry.glb", Status(404)),
        text("jobs/7/frames/3/readings.json", "readings 7.3"),
        case("jobs/8/frames/3/readings.json", Status(404)),
        case("jobs/8/frames/3/geometry.glb", Status(404)),
        text("jobs/7/geometry", "geometry 7.3"),
        text("jobs/7/geometry?frame=1", "geometry 7.3"),
        text("jobs/7/geometry?frame=3", "geometry 7.3"),
        text("jobs/7/geometry?frame=4", "geometry 7.4"),
        text("jobs/7/geometry?frame=5", "geometry 7.4"),
        case("jobs/8/geometry", Status(404)),
        case("files/0/geometry", Status(404)),
        text("jobs/7/frames/3/solution.glb", "solution 7.3"),
        case("jobs/7/frames/4/solution.glb", Status(404)),
        text("jobs/7/solution?frame=4", "solution 7.3"),
        case("jobs/8/solution", Status(404)),
        text("jobs/7/frames/3/targets.json", "targets 7.3"),
        case("jobs/7/frames/4/targets.json", Status(404)),
        text("jobs/7/targets?frame=4", "targets 7.3"),
        case("jobs/8/targets", Status(404)),
        case("files/0/solution", Status(404)),
        text("compare?a=7/3&b=8/3", "image 7.3 against image 8.3"),
        text("compare?a=7/3&b=0", "image 7.3 against light of file 0"),
        text("compare?a=0&b=7/3", "light of file 0 against image 7.3"),
        text("compare?a=0&b=1", "light of file 0 against light of file 1"),
        text("compare?a=1&b=0", "light of file 1 against light of file 0"),
        case("compare?a=7/3&b=7/4", Status(204)),
        case("compare?a=7/3&b=9/3", Status(404)),
        case("compare?a=7/3&b=9", Status(404)),
        case("compare?a=7/3", Status(400)),
        case("compare?a=7/3&b=8/x", Status(400)),
        text("jobs/7/frames/3/still.png", "still"),
        case("jobs/7/frames/3/painted.png", Status(404)),
        text("jobs/7/clip", "\x1aclip 7"),
        text("jobs/7/sheet.png", "sheet 7"),
        case("jobs/8/sheet.png", Status(404)),
    ]
}

fn light() -> Vec<Case> {
    /// Paths of data sets, and the text of their sources.
    const SETS: [(&str, &str); 8] = [
        ("jobs/7/light/CALL?frames=3", "frame 3 [light 7.3]"),
        ("jobs/7/light/CALL?frames=4", "frame 4 so far [paths a]"),
        ("jobs/7/light/CALL?frames=4,3", "frame 3 [light 7.3], frame 4 so far [paths a]"),
        ("jobs/8/light/CALL?frames=3", "frame 3 [light 7.3]"),
        ("jobs/8/light/CALL?frames=5", "frame 5 [light 7.3]"),
        ("jobs/8/light/CALL?frames=3..5", "frame 3 [light 7.3], frame 4 so far [paths c], frame 5 [light 7.3]"),
        ("files/0/light/CALL?", "file 0 [light of file 0]"),
        ("files/1/light/CALL?", "file 1 [light of file 1]"),
    ];
    /// Calls, their parameters, and the text of the question.
    const CALLS: [(&str, &str, &str); 21] = [
        ("schema", "", "schema"),
        ("schema", "&where=d+%3E+1", "schema if d > 1"),
        ("schema", "&box=0,0,0,1,1,1", "schema in [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]"),
        ("paths", "", "5000 of all"),
        ("paths", "&count=7", "7 of all"),
        ("paths", "&count=7&among=brightest", "7 brightest"),
        ("paths", "&where=d+%3E+1", "5000 of all if d > 1"),
        ("paths", "&where=d+%3E+2", "5000 of all if d > 2"),
        ("paths", "&box=0,0,0,1,1,2", "5000 of all in [[0.0, 0.0, 0.0], [1.0, 1.0, 2.0]]"),
        ("histograms", "&where=d", "histograms [] by samples if d"),
        ("histograms", "&where=d&pairs=lights:3-0", "histograms [[2, 3, 0]] by samples if d"),
        ("histograms", "", "histograms [] by samples"),
        ("histograms", "&by=image", "histograms [] by image"),
        ("histograms", "&by=image&box=0,0,0,1,1,2", "histograms [] by image in [[0.0, 0.0, 0.0], [1.0, 1.0, 2.0]]"),
        ("voxels", "&level=3&where=d", "voxels 3 None if d"),
        ("voxels", "&level=3&bounce=1&where=d", "voxels 3 Some(1) if d"),
        ("voxels", "&level=4&where=d", "voxels 4 None if d"),
        ("summary", "", "summary"),
        ("summary", "&where=d", "summary if d"),
        ("selection", "&where=d", "selection if d"),
        ("selection", "&where=d&density=1", "selection and density if d"),
    ];
    // Each of these parameters alone.
    const MORE: [(&str, &str, &str); 6] = [
        ("histograms", "&where=e", "histograms [] by samples if e"),
        ("voxels", "&level=3", "voxels 3 None"),
        ("voxels", "&level=3&box=0,0,0,1,1,2", "voxels 3 None in [[0.0, 0.0, 0.0], [1.0, 1.0, 2.0]]"),
        ("selection", "", "selection"),
        ("summary", "&box=0,0,0,1,1,2", "summary in [[0.0, 0.0, 0.0], [1.0, 1.0, 2.0]]"),
        ("selection", "&box=0,0,0,1,1,2", "selection in [[0.0, 0.0, 0.0], [1.0, 1.0, 2.0]]"),
    ];
    let all = SETS.iter().flat_map(|set| CALLS.iter().chain(&MORE).map(move |call| (set, call)));
    let one = |((path, sources), (call, parameters, question)): (&(&str, &str), &(&str, &str, &str))| Case {
        path: path.replace("CALL", call) + parameters,
        expected: Text(format!("{question} of {sources}")),
    };
    let mut cases: Vec<Case> = all.map(one).collect();
    cases.push(case("jobs/7/light/schema?frames=5", Status(204)));
    cases
}

fn tables() -> Vec<Case> {
    const ALL: &[&str] =
        &["3.0/render.0/0", "3.0/render.0/1", "3.0/image.1/0", "4.0/render.0/0", "4.0/render.0/1", "4.0/image.1/0"];
    vec![
        case("jobs", Holds(&["\"job\":7", "\"job\":8"], "")),
        case("jobs/7", Holds(&["{\"job\":7,", "clip.webm"], "")),
        case("jobs/8", Holds(&["{\"job\":8,", "clip.webm"], "")),
        case("jobs/9", Status(404)),
        case("jobs/7/frames", Holds(&["\"total\":3", "\"processor_seconds\":31.0,", "\"frame\":5"], "")),
        case("jobs/7/frames?from=1", Holds(&["\"total\":3", "\"frame\":5"], "\"frame\":3")),
        case("jobs/7/frames?from=1&count=1", Holds(&["\"total\":3", "\"frame\":4"], "\"frame\":5")),
        case("jobs/8/frames", Holds(&["\"processor_seconds\":3.0,"], "")),
        case("jobs/7/tasks", Tasks(ALL)),
        case("jobs/8/tasks", Tasks(&["3.0/render.0/0", "4.0/render.0/2"])),
        case("jobs/7/tasks?from=4", Tasks(&["4.0/render.0/1", "4.0/image.1/0"])),
        case("jobs/7/tasks?count=1", Tasks(&["3.0/render.0/0"])),
        case("jobs/7/tasks?frame=4", Tasks(&["4.0/render.0/0", "4.0/render.0/1", "4.0/image.1/0"])),
        case("jobs/7/tasks?stage=1", Tasks(&["3.0/image.1/0", "4.0/image.1/0"])),
        case("jobs/7/tasks?state=failed", Tasks(&["4.0/render.0/1"])),
        case("jobs/7/tasks?sort=task&count=2", Tasks(&["3.0/render.0/0", "3.0/render.0/1"])),
        case("jobs/7/tasks?sort=-task&count=2", Tasks(&["4.0/image.1/0", "4.0/render.0/1"])),
        case("jobs/7/tasks?sort=-task&count=2&from=1", Tasks(&["4.0/render.0/1", "4.0/render.0/0"])),
        case(
            "jobs/7/tasks?sort=-processor_seconds&count=5",
            Tasks(&["4.0/render.0/1", "3.0/render.0/1", "3.0/render.0/0", "3.0/image.1/0", "4.0/render.0/0"]),
        ),
        case(
            "jobs/7/tasks?sort=-processor_seconds&frame=3",
            Tasks(&["3.0/render.0/1", "3.0/render.0/0", "3.0/image.1/0"]),
        ),
        case("jobs/7/tasks?sort=-processor_seconds&stage=1", Tasks(&["3.0/image.1/0", "4.0/image.1/0"])),
        case("jobs/7/tasks?sort=-processor_seconds&state=running", Tasks(&["4.0/render.0/0"])),
        case("jobs/7/tasks?sort=-processor_seconds&state=failed", Tasks(&["4.0/render.0/1"])),
        case("jobs/8/tasks?sort=-task&count=2", Tasks(&["4.0/render.0/2", "3.0/render.0/0"])),
        case("jobs/7/attempts", Holds(&["\"epoch\":1", "\"next\":2"], "\"epoch\":3")),
        case("jobs/7/attempts?from=2", Holds(&["\"epoch\":3", "\"next\":4"], "\"epoch\":1,")),
        case("jobs/7/attempts?task=7/3.0/render.0/1", Holds(&["\"epoch\":2", "\"next\":null"], "\"epoch\":3")),
        case("jobs/8/attempts", Holds(&["\"epoch\":1", "\"next\":null"], "\"epoch\":2")),
        case("jobs/7/logs", Holds(&["log one", "log two", "log three"], "night")),
        case("jobs/7/logs?since=3", Holds(&["log two", "log three"], "log one")),
        case("jobs/7/logs?task=7/3.0/render.0/0", Holds(&["log one", "log three"], "log two")),
        case("jobs/8/logs", Holds(&["log of the night"], "log one")),
        case("workers", Holds(&["\"offline\":[]"], "")),
        case("files", Holds(&["file 0", "file 1"], "file 2")),
        case("usage", Holds(&["usage"], "")),
    ]
}

fn families() -> [Vec<Case>; 4] {
    [pictures(), downloads(), light(), tables()]
}

fn cases() -> Vec<Case> {
    families().concat()
}

/// Makes the farm, with its files in a folder.
fn world(folder: &tempfile::TempDir) -> World {
    let files = ["0", "1"].map(|name| folder.path().join(name));
    for (number, path) in files.iter().enumerate() {
        std::fs::write(path, format!("light of file {number}")).expect("a file");
    }
    World::new(files.to_vec())
}

/// Returns the documented form of a path, and the names and values of its parameters.
fn documented_form(path: &str) -> (String, Vec<(&str, &str)>) {
    let (path, query) = path.split_once('?').unwrap_or((path, ""));
    let mut form = String::from("/api/v1");
    let mut before = "";
    for segment in path.split('/') {
        let is_number = segment.bytes().all(|byte| byte.is_ascii_digit());
        form += match (is_number, before) {
            (true, "jobs") => "/JOB",
            (true, _) => "/N",
            (false, _) => "/",
        };
        form += if is_number { "" } else { segment };
        before = segment;
    }
    (form, query.split('&').filter_map(|parameter| parameter.split_once('=')).collect())
}

#[test]
fn every_documented_request_and_parameter_has_cases() {
    let documented: BTreeMap<String, BTreeSet<String>> = documentation::parameters();
    let listed: BTreeSet<&str> = ROUTES.iter().map(|(path, ..)| *path).collect();
    assert_eq!(documented.keys().map(String::as_str).collect::<BTreeSet<_>>(), listed, "classify the requests");
    let cases = cases();
    for &(path, class, parameters) in ROUTES {
        let named: BTreeSet<&str> = documented[path]
            .iter()
            .map(String::as_str)
            .filter(|name| *name != "since" || !path.contains("light"))
            .collect();
        assert!(named.iter().all(|name| parameters.contains(name) || class == Other), "{path}: {named:?}");
        if class == Other {
            continue;
        }
        let own: Vec<Vec<(&str, &str)>> = cases
            .iter()
            .map(|case| documented_form(&case.path))
            .filter(|(form, _)| form == path)
            .map(|(_, it)| it)
            .collect();
        assert!(!own.is_empty(), "{path} has a case");
        for parameter in parameters {
            let others = |all: &[(&str, &str)]| -> BTreeMap<String, String> {
                let others = all.iter().filter(|(name, _)| name != parameter);
                others.map(|&(name, value)| (name.to_owned(), value.to_owned())).collect()
            };
            let differ = |a: &Vec<(&str, &str)>, b: &Vec<(&str, &str)>| others(a) == others(b) && a != b;
            let has_pair = own.iter().any(|a| own.iter().any(|b| differ(a, b)));
            assert!(has_pair, "{path}: two cases that differ in {parameter} only");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn answers_do_not_depend_on_earlier_requests() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::new(&world(&folder)).await;
    // Each pair, in both orders.
    for family in [pictures(), downloads(), tables()] {
        for first in &family {
            for second in &family {
                let server = server.fresh();
                for case in [first, second] {
                    case.check(&ask(&server.http, &case.line(), &[]).await);
                }
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn answers_do_not_depend_on_requests_at_the_same_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let (server, cases) = (Server::new(&world(&folder)).await, cases());
    for seed in 0..3 {
        let (mut random, server) = (Random(seed), server.fresh());
        for _ in 0..150 {
            let clients: Vec<(&Case, bool)> = (0..16).map(|_| (random.pick(&cases), random.below(4) == 0)).collect();
            let answers = clients.iter().map(async |(case, leaves)| {
                let line = case.line();
                let answer = ask(&server.http, &line, &[]);
                // A client that leaves ends its request at any point.
                let patience = if *leaves { Duration::ZERO } else { Duration::MAX };
                tokio::time::timeout(patience, answer).await.ok()
            });
            let answers = futures_util::future::join_all(answers).await;
            for ((case, leaves), answer) in clients.iter().zip(&answers) {
                assert!(*leaves || answer.is_some(), "{}", case.path);
                answer.iter().for_each(|answer| case.check(answer));
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_tag_belongs_to_one_answer() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::new(&world(&folder)).await;
    let cases = cases();
    let class = |case: &Case| {
        let (form, _) = documented_form(&case.path);
        // The other calls about a file are as for frames.
        let form = if form.contains("/files/N/light") { "/api/v1/files/N/light/schema".to_owned() } else { form };
        ROUTES.iter().find(|(path, ..)| *path == form).expect("a class").1
    };
    let mut answers = Vec::new();
    for case in &cases {
        let answer = ask(&server.http, &case.line(), &[]).await;
        let has_tag = answer.status == 200 && class(case) == Tagged;
        assert_eq!(!answer.tag.is_empty(), has_tag, "{}", case.path);
        answers.push(answer);
    }
    for (case, answer) in cases.iter().zip(&answers).filter(|(_, answer)| !answer.tag.is_empty()) {
        let again = ask(&server.http, &case.line(), &[]).await;
        assert_eq!(again, *answer, "{}", case.path);
        for (other, known) in cases.iter().zip(&answers).filter(|(_, known)| !known.tag.is_empty()) {
            let (own, foreign) = (&case.path, &other.path);
            assert!(known.tag != answer.tag || known.body == answer.body, "{own} and {foreign} have one tag");
        }
    }
    // A client that knows another answer gets the whole answer.
    let mut random = Random(1);
    for _ in 0..4000 {
        let [case, other] = [random.below(cases.len()), random.below(cases.len())];
        let other = if random.below(8) == 0 { case } else { other };
        let (answer, tag) = (&answers[case], format!("\"{}\"", answers[other].tag));
        let got = ask(&server.http, &cases[case].line(), &[(IF_NONE_MATCH, &tag)]).await;
        if answers[other].tag == answer.tag && !answer.tag.is_empty() {
            assert_eq!((got.status, got.body.len(), &got.tag), (304, 0, &answer.tag), "{}", cases[case].path);
        } else {
            assert_eq!(got, *answer, "{} with the tag of {}", cases[case].path, cases[other].path);
        }
    }
}

/// A change of the farm, with requests whose answers change, and the new answers.
type Change = (fn(&mut World), Vec<Case>);

fn changes() -> Vec<Change> {
    let text = |path: &str, text: &str| case(path, Text(text.to_owned()));
    vec![
        (
            |world| {
                let parts = &mut world.job(7).parts[0].outputs;
                parts.extend([output(Role::Tile, "tile d"), output(Role::Paths, "paths b")]);
            },
            vec![
                text("jobs/7/frames/4/thumbnail.png", "90 rows: tile a + tile b + tile d"),
                text("jobs/7/frames/4/pixels", "pixels: tile a + tile b + tile d"),
                text("jobs/7/light/schema?frames=4", "schema of frame 4 so far [paths a + paths b]"),
                text("jobs/7/light/paths?frames=4&count=7", "7 of all of frame 4 so far [paths a + paths b]"),
            ],
        ),
        (
            |world| {
                let job = world.job(7);
                job.records.push(record(4, &[(Role::Image, "image 7.4"), (Role::Statistics, "light 7.4")]));
                job.parts.clear();
            },
            vec![
                text("jobs/7/frames/4/thumbnail.png", "90 rows: image 7.4"),
                text("jobs/7/frames/4/pixels", "pixels: image 7.4"),
                text("jobs/7/frames/4/maps", "maps: light 7.4"),
                text("jobs/7/frames/4/image.exr", "image 7.4"),
                text("jobs/7/light/schema?frames=4", "schema of frame 4 [light 7.4]"),
                text("jobs/7/light/schema?frames=4,3", "schema of frame 3 [light 7.3], frame 4 [light 7.4]"),
            ],
        ),
        (
            // A finished frame is in progress again, with its latest parts.
            |world| {
                let job = world.job(8);
                job.records.retain(|record| record.frame != 3);
                let mut parts = job.parts[0].clone();
                (parts.frame, parts.outputs) =
                    (3, vec![output(Role::Tile, "tile d"), output(Role::Statistics, "light 7.3")]);
                job.parts.insert(0, parts);
            },
            vec![
                text("jobs/8/frames/3/thumbnail.png", "90 rows: tile d"),
                text("jobs/8/light/schema?frames=3", "schema of frame 3 so far [light 7.3]"),
                case("jobs/8/frames/3/image.exr", Status(404)),
            ],
        ),
        (
            |world| {
                let names = [
                    (Role::Image, "image 7.3 again"),
                    (Role::Preview, "preview 7.3 again"),
                    (Role::Statistics, "light 7.3 again"),
                ];
                let clip = [(Role::Still, "still"), (Role::Clip, "\x1aclip 7 again"), (Role::Sheet, "sheet 7 again")];
                world.job(7).records = vec![record(0, &clip), record(3, &names)];
            },
            vec![
                text("jobs/7/frames/3/thumbnail.png?height=24", "24 rows: preview 7.3 again"),
                text("jobs/7/frames/3/pixels", "pixels: image 7.3 again"),
                text("jobs/7/frames/3/maps", "maps: light 7.3 again"),
                text("jobs/7/frames/3/image.exr", "image 7.3 again"),
                text("jobs/7/light/schema?frames=3", "schema of frame 3 [light 7.3 again]"),
                text("jobs/7/clip", "\x1aclip 7 again"),
                text("jobs/7/sheet.png", "sheet 7 again"),
            ],
        ),
        (
            |world| {
                let job = world.job(7);
                (job.tasks[4], job.tasks[5]) =
                    (task(7, (4, 0, 1), TaskState::Done, 1), task(7, (4, 1, 0), TaskState::Failed, 3));
                job.attempts.extend([attempt(7, (4, 1, 0), 6, 32.0), attempt(7, (4, 0, 1), 7, 1.0)]);
                job.logs.push(log(7, (4, 1, 0), 5, "log four"));
            },
            vec![
                case("jobs/7/frames", Holds(&["\"processor_seconds\":64.0,"], "")),
                case("jobs/7/tasks?state=failed", Tasks(&["4.0/image.1/0"])),
                case("jobs/7/tasks?sort=-processor_seconds&state=failed", Tasks(&["4.0/image.1/0"])),
                case("jobs/7/tasks?sort=-processor_seconds&count=2", Tasks(&["4.0/image.1/0", "4.0/render.0/1"])),
                case("jobs/7/logs?since=3", Holds(&["log four"], "log one")),
                case("jobs/7/attempts?from=4", Holds(&["\"epoch\":6"], "")),
            ],
        ),
        (
            |world| std::fs::write(&world.files[0], "another light of file 0").expect("a file"),
            vec![
                text("files/0/maps", "maps of a file: another light of file 0"),
                text("files/0/light/schema", "schema of file 0 [another light of file 0]"),
                text("files/1/light/schema", "schema of file 1 [light of file 1]"),
            ],
        ),
    ]
}

/// Asks for all cases, and for the cases of the changes.
async fn ask_all(server: &Server, cases: &[Case]) -> Vec<Answer> {
    let mut answers = Vec::new();
    for case in cases {
        answers.push(ask(&server.http, &case.line(), &[]).await);
    }
    answers
}

#[tokio::test(start_paused = true)]
async fn an_answer_about_a_changed_farm_is_not_the_old_one() {
    let mut all = cases();
    all.extend(changes().into_iter().flat_map(|(_, cases)| cases));
    let mut servers = Vec::new();
    for (change, cases) in changes() {
        let folder = tempfile::tempdir().expect("a folder");
        let server = Server::new(&world(&folder)).await;
        let before = ask_all(&server, &all).await;
        server.change(change).await;
        servers.push((folder, server, before, cases));
    }
    // Growing light is kept for a second of the real clock, and sorted tasks for a second of tokio's.
    std::thread::sleep(GROWTH);
    tokio::time::advance(GROWTH).await;
    for (_folder, server, before, cases) in &servers {
        for case in cases {
            case.check(&ask(&server.http, &case.line(), &[]).await);
        }
        let fresh = server.fresh();
        for (case, old) in all.iter().zip(before) {
            let due = ask(&fresh.http, &case.line(), &[]).await;
            let tag = format!("\"{}\"", old.tag);
            let got = ask(&server.http, &case.line(), &[(IF_NONE_MATCH, &tag)]).await;
            if got.status == 304 {
                assert_eq!((&due.tag, &due.body), (&old.tag, &old.body), "{}", case.path);
            } else {
                assert_eq!((got.text(), got.status), (due.text(), due.status), "{}", case.path);
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_part_that_is_made_again_is_shown() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut lacking = world(&folder);
    lacking.absent = vec!["tile b".into(), "paths b".into()];
    lacking.job(7).parts[0].outputs.push(output(Role::Paths, "paths b"));
    let server = Server::new(&lacking).await;
    let text = |path: &str, text: &str| case(path, Text(text.to_owned()));
    let lines = ["jobs/7/frames/4/thumbnail.png", "jobs/7/frames/4/pixels", "jobs/7/light/schema?frames=4"];
    let [partial, whole] = [
        ["90 rows: tile a", "pixels: tile a", "schema of frame 4 so far [paths a]"],
        ["90 rows: tile a + tile b", "pixels: tile a + tile b", "schema of frame 4 so far [paths a + paths b]"],
    ]
    .map(|texts| [0, 1, 2].map(|place| text(lines[place], texts[place])));
    let before = ask_all(&server, &partial).await;
    partial.iter().zip(&before).for_each(|(case, answer)| case.check(answer));
    server.change(|world| world.absent.clear()).await;
    std::thread::sleep(GROWTH);
    for (case, old) in whole.iter().zip(&before) {
        let tag = format!("\"{}\"", old.tag);
        let got = ask(&server.http, &case.line(), &[(IF_NONE_MATCH, &tag)]).await;
        case.check(&got);
        assert_ne!(got.tag, old.tag, "{}", case.path);
    }
}

#[tokio::test(start_paused = true)]
async fn rows_of_an_earlier_answer_belong_to_their_data_set() {
    const SETS: [&str; 5] = [
        "jobs/7/light/paths?frames=3",
        "jobs/7/light/paths?frames=4",
        "jobs/8/light/paths?frames=3",
        "jobs/8/light/paths?frames=5",
        "files/0/light/paths?count=5000",
    ];
    let folder = tempfile::tempdir().expect("a folder");
    for first in SETS {
        for second in SETS {
            let server = Server::new(&world(&folder)).await;
            let get = async |path: &str| ask(&server.http, &format!("GET /api/v1/{path}"), &[]).await;
            let known = get(first).await;
            let full = get(second).await;
            // A third client asks for all other sets meanwhile.
            for other in SETS {
                get(other).await;
            }
            let got = get(&format!("{second}&since={}", known.tag)).await;
            let since = if known.tag == full.tag { format!(" since {}", known.tag) } else { String::new() };
            assert_eq!((got.text(), &got.tag), (full.text() + &since, &full.tag), "{second} since {first}");
        }
    }
}
