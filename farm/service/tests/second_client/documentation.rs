//! Requests as `docs/http.md` documents them.

use std::collections::{BTreeMap, BTreeSet};

fn page() -> String {
    std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/http.md")).expect("the documentation")
}

/// A documented request.
#[derive(Debug, Clone)]
pub struct Request {
    pub method: String,
    /// Path with the words JOB and N, and with a query.
    pub path: String,
    pub answer: String,
    /// Callers who may make the request.
    pub allowed: String,
}

/// Returns the rows of the table of requests.
pub fn requests() -> Vec<Request> {
    let mut requests = Vec::new();
    for line in page().lines() {
        let row: Vec<&str> = line.split(" | ").collect();
        let [first, answer, allowed] = row[..] else { continue };
        for request in first.split('`').filter(|part| first.starts_with("| `") && part.contains(" /")) {
            let (method, path) = request.split_once(' ').expect("a method");
            requests.push(Request {
                method: method.into(),
                path: path.into(),
                answer: answer.into(),
                allowed: allowed.trim_end_matches(" |").into(),
            });
        }
    }
    requests
}

/// Returns the paths of all requests that change nothing, each with the names of its documented parameters.
pub fn parameters() -> BTreeMap<String, BTreeSet<String>> {
    let page = page();
    let light = light_parameters(&page);
    let mut all = BTreeMap::new();
    for Request { path, answer, .. } in requests().into_iter().filter(|request| request.method == "GET") {
        let form = path.split('?').next().expect("a path").to_owned();
        let mut names: BTreeSet<String> = names_in_queries(&path).chain(names_in_queries(&answer)).collect();
        if let Some((_, call)) = form.rsplit_once("/light/") {
            names.extend(light["all"].iter().chain(&light[call]).cloned());
            names.retain(|name| form.contains("JOB") || name != "frames");
        }
        all.insert(form, names);
    }
    all
}

/// Returns the names before `=` in queries such as `?from=0&count=10`.
fn names_in_queries(text: &str) -> impl Iterator<Item = String> {
    let parts = text.split(['?', '&']).skip(1).filter_map(|part| part.split_once('=')).map(|(name, _)| name);
    parts
        .filter(|name| name.bytes().all(|byte| byte.is_ascii_lowercase()))
        .map(str::to_owned)
        .collect::<Vec<_>>()
        .into_iter()
}

/// Returns the parameters of each question about light. The entry `all` has the parameters that every question takes.
fn light_parameters(page: &str) -> BTreeMap<String, BTreeSet<String>> {
    /// Words in the column of parameters that are values.
    const VALUES: [&str; 4] = ["all", "brightest", "samples", "image"];
    let section =
        page.split("## Recorded light").nth(1).and_then(|rest| rest.split("\n## ").next()).expect("a section");
    let mut all: BTreeMap<String, BTreeSet<String>> = BTreeMap::from([("schema".to_owned(), BTreeSet::new())]);
    for row in section.lines().map(|line| line.split(" | ").collect::<Vec<_>>()) {
        let word = |text: &str| text.trim_start_matches("| ").trim_matches('`').to_owned();
        let is_name = |word: &&str| word.bytes().all(|byte| byte.is_ascii_lowercase()) && !VALUES.contains(word);
        match row[..] {
            [name, _] if name.starts_with("| `") && !name.contains('.') => {
                all.entry("all".to_owned()).or_default().insert(word(name));
            }
            [call, parameters, _, _] if call.starts_with("| `") => {
                let words = parameters.split('`').skip(1).step_by(2).filter(is_name).map(str::to_owned);
                all.insert(word(call), words.collect());
            }
            _ => {}
        }
    }
    all
}
