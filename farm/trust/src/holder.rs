//! Holders of certificates, and the roles of users.

use std::fmt;
use std::str::FromStr;

use crate::TrustError;

/// Permissions of a user; each role includes those of the roles before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Permission to see jobs, workers, logs and images.
    Viewer,
    /// Permission to submit jobs, and to control the user's own jobs.
    Submitter,
    /// Permission to control every job, and to drain workers.
    Operator,
    /// Permission to remove artifacts from the store that no job refers to.
    Admin,
}

impl Role {
    /// All roles, the one with the fewest permissions first.
    pub const ALL: [Self; 4] = [Self::Viewer, Self::Submitter, Self::Operator, Self::Admin];

    /// Returns the name of the role in lower case.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Submitter => "submitter",
            Self::Operator => "operator",
            Self::Admin => "admin",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let role = Self::ALL.into_iter().find(|role| role.name() == text);
        role.ok_or_else(|| format!("unknown role `{text}`; give viewer, submitter, operator or admin"))
    }
}

/// Holder of a certificate or token. Its URIs are `femc://user/ann?role=operator`, `femc://worker/w1` and
/// `femc://coordinator/farm`.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Holder {
    /// A coordinator.
    Coordinator {
        /// Name, for people to read.
        name: String,
    },
    /// A worker, which may take part in rendering and do nothing else.
    Worker {
        /// Name, for people to read.
        name: String,
    },
    /// A person, or a person's program.
    User {
        /// Name, which becomes the owner of submitted jobs.
        name: String,
        /// Role that limits the allowed calls.
        role: Role,
    },
}

impl Holder {
    const SCHEME: &str = "femc://";

    /// Returns the holder's name.
    pub fn name(&self) -> &str {
        match self {
            Self::Coordinator { name } | Self::Worker { name } | Self::User { name, .. } => name,
        }
    }

    /// Checks that the name can be used in a certificate and as a file name.
    pub(crate) fn check(&self) -> Result<(), TrustError> {
        let name = self.name();
        let is_good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
        let is_name = (1..=64).contains(&name.len()) && name.chars().all(is_good) && !name.starts_with('.');
        if is_name { Ok(()) } else { Err(TrustError::Name { name: name.to_owned() }) }
    }

    /// Returns the URI that the holder's certificate contains.
    pub fn uri(&self) -> String {
        let scheme = Self::SCHEME;
        match self {
            Self::Coordinator { name } => format!("{scheme}coordinator/{name}"),
            Self::Worker { name } => format!("{scheme}worker/{name}"),
            Self::User { name, role } => format!("{scheme}user/{name}?role={role}"),
        }
    }

    pub(crate) fn from_uri(uri: &str) -> Result<Self, TrustError> {
        let strange = || TrustError::Holder { message: format!("`{uri}`") };
        let (kind, rest) = uri.strip_prefix(Self::SCHEME).and_then(|rest| rest.split_once('/')).ok_or_else(strange)?;
        let holder = match kind {
            "coordinator" => Self::Coordinator { name: rest.to_owned() },
            "worker" => Self::Worker { name: rest.to_owned() },
            "user" => {
                let (name, role) = rest.split_once("?role=").ok_or_else(strange)?;
                Self::User { name: name.to_owned(), role: role.parse().map_err(|_| strange())? }
            }
            _ => return Err(strange()),
        };
        holder.check().map_err(|_| strange())?;
        Ok(holder)
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Coordinator { name } => write!(f, "coordinator {name}"),
            Self::Worker { name } => write!(f, "worker {name}"),
            Self::User { name, role } => write!(f, "{role} {name}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn certificate_uri_names_its_holder_and_other_uris_are_refused() {
        let name = || "ann.b-c_1".to_owned();
        let users = Role::ALL.map(|role| Holder::User { name: name(), role });
        for holder in users.into_iter().chain([Holder::Coordinator { name: name() }, Holder::Worker { name: name() }]) {
            assert_eq!(Holder::from_uri(&holder.uri()).unwrap(), holder);
        }
        for wrong in [
            "",
            "femc://",
            "femc://user/ann",
            "femc://user/ann?role=king",
            "femc://user/?role=admin",
            "femc://worker/",
            "femc://worker/a/b",
            "femc://worker/a?role=admin",
            "femc://user/ann?role=viewer?role=admin",
            "femc://user/a\0b?role=admin",
            "http://user/ann?role=admin",
            "femc://root/ann",
            "femc://worker/../../etc",
        ] {
            assert!(matches!(Holder::from_uri(wrong), Err(TrustError::Holder { .. })), "{wrong}");
        }
    }

    #[test]
    fn roles_are_in_order() {
        assert!(Role::ALL.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
