//! Tests of an authority's folder and of the identities that it issues.

use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};

use femc_trust::{Authority, CertificateRequest, Holder, Identity, RevocationList, Role, TrustError};

fn user(name: &str) -> CertificateRequest {
    CertificateRequest { holder: Holder::User { name: name.into(), role: Role::Operator }, hosts: vec![], days: 30 }
}

#[test]
fn an_identity_is_one_file_that_comes_back_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::init(folder.path(), "night-drives").unwrap();
    let ann = authority.issue(&user("ann")).unwrap();
    let path = folder.path().join("ann.pem");
    ann.write(&path).unwrap();
    assert_eq!(std::fs::metadata(&path).unwrap().mode() & 0o777, 0o600);
    assert_eq!(Identity::read(&path).unwrap(), ann);
    assert!(matches!(ann.write(&path), Err(TrustError::Exists { .. })), "nothing is written over");
    assert!(!format!("{ann:?}").contains("PRIVATE"), "a key is not printed");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    assert!(matches!(Identity::read(&path), Err(TrustError::InsecurePermissions { mode: 0o644, .. })));
}

#[test]
fn an_authority_is_made_once_and_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let first = Authority::init(folder.path(), "farm").unwrap().issue(&user("ann")).unwrap();
    assert!(matches!(Authority::init(folder.path(), "farm"), Err(TrustError::Exists { .. })));
    let second = Authority::open(folder.path()).unwrap().issue(&user("bob")).unwrap();
    assert_eq!(first.authority(), second.authority());
    assert_ne!(first.key(), second.key());
    assert!(matches!(Authority::open(&folder.path().join("other")), Err(TrustError::File { .. })));
}

#[test]
fn what_is_no_identity_is_refused_with_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::init(&folder.path().join("ca"), "farm").unwrap();
    let ann = authority.issue(&user("ann")).unwrap();
    let path = folder.path().join("x.pem");
    let whole = [ann.certificate(), ann.key(), ann.authority()].concat();
    let swapped = [ann.authority(), ann.key(), ann.certificate()].concat();
    let cut = &whole[..whole.len() - 40];
    for wrong in
        ["", "hello", ann.certificate(), &[ann.certificate(), ann.key()].concat(), &swapped, cut, &whole.repeat(2)]
    {
        std::fs::write(&path, wrong).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        assert!(matches!(Identity::read(&path), Err(TrustError::Malformed { .. })), "{wrong}");
    }
    std::fs::write(&path, [0xff, 0xfe]).unwrap();
    assert!(matches!(Identity::read(&path), Err(TrustError::File { .. })));
}

#[test]
fn names_that_would_not_do_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::init(folder.path(), "farm").unwrap();
    for name in ["", "a b", "../ann", ".", "a/b", "ann\n", "ä", &"x".repeat(65)] {
        assert!(matches!(authority.issue(&user(name)), Err(TrustError::Name { .. })), "{name}");
    }
    assert_eq!(authority.issued_certificates().unwrap(), []);
}

#[test]
fn a_revoked_name_is_on_the_list_that_coordinators_read_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::init(folder.path(), "farm").unwrap();
    let revoked = RevocationList::open(authority.revocation_list_path()).unwrap();
    let ids = ["ann", "bob", "ann"].map(|name| authority.issue(&user(name)).unwrap().fingerprint().unwrap());
    assert!(ids.iter().all(|id| !revoked.contains(id)));
    assert!(matches!(authority.revoke("eve"), Err(TrustError::Unknown { .. })));
    assert_eq!(authority.revoke("ann").unwrap(), 2);
    assert_eq!(ids.map(|id| revoked.contains(&id)), [true, false, true]);
    assert_eq!(authority.issued_certificates().unwrap().len(), 3);
    std::fs::write(authority.revocation_list_path(), "rubbish\n").unwrap();
    assert!(ids.iter().any(|id| revoked.contains(id)), "what it said before holds");
    assert!(matches!(RevocationList::open(authority.revocation_list_path()), Err(TrustError::Malformed { .. })));
}
