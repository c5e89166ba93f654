//! Targets for tokens, token lists and identities.

use femc_trust::{Authority, CertificateRequest, Holder, Identity, Role, Token, TokenFile, TokenLine};

use super::Target;

/// Converts bytes to text. Invalid bytes are replaced.
fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

pub(super) fn targets() -> Vec<Target> {
    let folder = tempfile::tempdir().expect("a folder");
    let authority = Authority::init(folder.path(), "farm").expect("an authority");
    let ann = Holder::User { name: "ann".into(), role: Role::Operator };
    let pass = authority.issue_token(ann.clone(), 1).expect("a token");
    let identity = authority.issue(&CertificateRequest { holder: ann, hosts: vec![], days: 1 }).expect("an identity");
    let secret = pass.token().secret();
    let line = std::fs::read(authority.tokens_path()).expect("a list");
    let pass = format!("{secret}\n{}", pass.authority().unwrap_or_default());
    let identity = [identity.certificate(), identity.key(), identity.authority()].concat();
    vec![
        Target::new("token", vec![secret.into()], |bytes| Token::parse(&text(bytes)).is_some()),
        Target::new("line of tokens", vec![line], |bytes| {
            let line = TokenLine::parse(&text(bytes));
            // An accepted line must parse to itself after writing.
            line.is_some_and(|line| TokenLine::parse(&line.to_string()) == Some(line))
        }),
        Target::new("pass", vec![pass.into()], |bytes| TokenFile::parse(&text(bytes)).is_ok()),
        Target::new("identity", vec![identity.into()], |bytes| Identity::parse(&text(bytes)).is_ok()),
    ]
}
