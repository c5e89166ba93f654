//! Tests that the guard grants every call to exactly the roles in the call's .proto comment.

use femc_service::Right;
use femc_trust::Role;
use prost::Message as _;
use prost_types::FileDescriptorSet;

use super::operation;
use crate::wire;

/// Returns the path of each call with its documented callers: the words after "Who may:" in its comment.
fn documented_callers() -> Vec<(String, String)> {
    let all = FileDescriptorSet::decode(wire::DESCRIPTORS).expect("a descriptor");
    let mut found = Vec::new();
    for file in &all.file {
        for place in file.source_code_info.iter().flat_map(|info| &info.location) {
            // This is the n-th call (field 2) of the m-th service (field 6).
            let [6, m, 2, n] = place.path[..] else { continue };
            let service = &file.service[m as usize];
            let path = format!("/{}.{}/{}", file.package(), service.name(), service.method[n as usize].name());
            let comment = place.leading_comments().split_whitespace().collect::<Vec<_>>().join(" ");
            let who = comment.split("Who may: ").nth(1).and_then(|rest| rest.split(['.', ';']).next());
            found.push((path, who.unwrap_or_default().to_owned()));
        }
    }
    found
}

#[test]
fn who_may_call_by_the_documentation_may_call() {
    let documented = documented_callers();
    assert!(documented.len() > 15, "{documented:?}");
    for (path, who) in documented {
        let right = match who.as_str() {
            "workers" => Right::Worker,
            "workers, viewers" => Right::WorkerOrUser(Role::Viewer),
            "workers, submitters" => Right::WorkerOrUser(Role::Submitter),
            "viewers" => Right::User(Role::Viewer),
            // The call itself checks who owns the job.
            "submitters" | "the job's owner, if a submitter" => Right::User(Role::Submitter),
            "operators" => Right::User(Role::Operator),
            "admins" => Right::User(Role::Admin),
            other => panic!("{path}: unknown callers {other:?}"),
        };
        assert_eq!(operation(&path).right(), right, "{path}");
    }
}
