//! Targets for tokens, token lists and identities.

use femc_trust::{Authority, Holder, Identity, Issue, Pass, Role, Token, TokenLine};

use super::Target;

/// Converts bytes to text. Invalid bytes are replaced.
fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

pub(super) fn targets() -> Vec<Target> {
    let folder = tempfile::tempdir().expect("a folder");
    let authority = Authority::init(folder.path(), "farm").expect("an authority");
    let ann = Holder::User { name: "ann".into(), role: Role::Operator };
    let pass = authority.token(ann.clone(), 1).expect("a token");
    let identity = authority.issue(&Issue { holder: ann, hosts: vec![], days: 1 }).expect("an identity");
    let secret = pass.token().secret();
    let line = std::fs::read(authority.tokens()).expect("a list");
    let pass = format!("{secret}\n{}", pass.authority().unwrap_or_default());
    let identity = [identity.certificate(), identity.key(), identity.authority()].concat();
    vec![
        Target::of("token", vec![secret.into()], |bytes| Token::parse(&text(bytes)).is_some()),
        Target::of("line of tokens", vec![line], |bytes| {
            let line = TokenLine::parse(&text(bytes));
            // An accepted line must parse to itself after writing.
            line.is_some_and(|line| TokenLine::parse(&line.to_string()) == Some(line))
        }),
        Target::of("pass", vec![pass.into()], |bytes| Pass::parse(&text(bytes)).is_ok()),
        Target::of("identity", vec![identity.into()], |bytes| Identity::parse(&text(bytes)).is_ok()),
    ]
}
