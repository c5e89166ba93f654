//! The list of valid tokens.

use std::fmt;
use std::path::{Path, PathBuf};

use time::OffsetDateTime;

use crate::expiration;
use crate::reload::{ReloadingFile, lines};
use crate::{Holder, Token, TokenDigest, TrustError};

/// A file of token digests, one per line: `NAME ROLE DIGEST`, followed by an optional expiration time: `2027-02-19`, or
/// `2027-02-19T10:00:00Z`. The role is a user's role, or `worker`. The file is reread when it has changed; removing a line revokes
/// its token.
#[derive(Debug, Clone)]
pub struct Tokens(ReloadingFile<Vec<TokenLine>>);

/// Reason for refusing a token.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BadToken {
    /// The text does not have the form of a token.
    #[error("this is not a femc token: it is cut short, or it is something else")]
    Malformed,
    /// The token is not in the file, or no longer.
    #[error("this farm does not know the token: it is wrong, or it was revoked")]
    Unknown,
    /// The token has expired.
    #[error("the token has expired")]
    Expired,
}

impl Tokens {
    /// Reads the file, which must exist and be valid as a whole. When the file changes later, invalid lines are skipped: a typing
    /// error in one line must not keep a removed token valid.
    pub fn open(path: impl Into<PathBuf>) -> Result<Self, TrustError> {
        let path = path.into();
        parse(&path, &std::fs::read_to_string(&path).map_err(TrustError::file(&path))?)?;
        ReloadingFile::open(path, parse_leniently).map(Self)
    }

    /// Returns the holder and the digest of the token.
    pub fn holder(&self, token: &str) -> Result<(Holder, TokenDigest), BadToken> {
        let digest = Token::parse(token).ok_or(BadToken::Malformed)?.digest();
        self.holder_by_digest(&digest).map(|holder| (holder, digest))
    }

    /// Returns the present holder of the token with this digest.
    pub fn holder_by_digest(&self, digest: &TokenDigest) -> Result<Holder, BadToken> {
        self.0.with_content(|lines| {
            // All lines are compared, so that the time does not reveal which line matches.
            let found = lines.iter().fold(None, |found, line| if line.digest == *digest { Some(line) } else { found });
            let line = found.ok_or(BadToken::Unknown)?;
            if line.has_expired() { Err(BadToken::Expired) } else { Ok(line.holder.clone()) }
        })
    }
}

/// A line of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenLine {
    /// Holder of the token.
    pub holder: Holder,
    /// Digest of the token.
    pub digest: TokenDigest,
    /// Time at which the token expires; `None`: never.
    pub(crate) until: Option<OffsetDateTime>,
}

impl TokenLine {
    /// Checks whether the token has expired.
    pub fn has_expired(&self) -> bool {
        self.until.is_some_and(|until| OffsetDateTime::now_utc() >= until)
    }

    /// Returns the expiration time in seconds since 1970.
    pub fn until_seconds(&self) -> Option<i64> {
        self.until.map(OffsetDateTime::unix_timestamp)
    }

    /// Returns the remaining validity in days; negative after its end.
    pub fn days_left(&self) -> Option<i64> {
        let left = |until: i64| (until - OffsetDateTime::now_utc().unix_timestamp()).div_euclid(86_400);
        self.until_seconds().map(left)
    }

    /// Parses a line of the file.
    pub fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace();
        let (name, role, digest) = (words.next()?.to_owned(), words.next()?, words.next()?);
        let holder = match role {
            "worker" => Holder::Worker { name },
            role => Holder::User { name, role: role.parse().ok()? },
        };
        holder.check().ok()?;
        let until = words.next().map(|word| expiration::parse(word).ok_or(())).transpose().ok()?;
        if words.next().is_some() {
            return None;
        }
        Some(Self { holder, digest: TokenDigest::parse(digest)?, until })
    }
}

impl fmt::Display for TokenLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let role = match &self.holder {
            Holder::User { role, .. } => role.name(),
            Holder::Worker { .. } => "worker",
            Holder::Coordinator { .. } => "coordinator",
        };
        write!(f, "{} {role} {}", self.holder.name(), self.digest)?;
        self.until.map_or(Ok(()), |moment| write!(f, " {}", expiration::format(moment)))
    }
}

/// Parses all lines of a file; an invalid line is an error.
pub(crate) fn parse(path: &Path, text: &str) -> Result<Vec<TokenLine>, TrustError> {
    parse_lines(path, text).collect()
}

/// Parses a file and skips invalid lines with a warning.
fn parse_leniently(path: &Path, text: &str) -> Result<Vec<TokenLine>, TrustError> {
    let warn = |error: &TrustError| tracing::warn!(%error, "ignored an invalid line");
    Ok(parse_lines(path, text).filter_map(|line| line.inspect_err(warn).ok()).collect())
}

fn parse_lines(path: &Path, text: &str) -> impl Iterator<Item = Result<TokenLine, TrustError>> {
    lines(text).map(move |(at, line)| {
        let message = || format!("line {at}: expected `NAME ROLE DIGEST` or `NAME ROLE DIGEST UNTIL`");
        TokenLine::parse(line).ok_or_else(|| TrustError::Malformed { path: path.into(), message: message() })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Role;

    fn line(holder: Holder, until: Option<OffsetDateTime>) -> (Token, TokenLine) {
        let token = Token::random().unwrap();
        let line = TokenLine { holder, digest: token.digest(), until };
        (token, line)
    }

    fn ann() -> Holder {
        Holder::User { name: "ann".into(), role: Role::Operator }
    }

    #[test]
    fn a_line_comes_back_and_what_is_none_is_refused() {
        let moment = expiration::parse("2027-02-19T10:00:00Z");
        for line in [line(ann(), None).1, line(Holder::Worker { name: "w1".into() }, moment).1] {
            assert_eq!(TokenLine::parse(&line.to_string()), Some(line));
        }
        let digest = line(ann(), None).1.digest.to_string();
        for wrong in [
            "ann operator".to_owned(),
            format!("ann king {digest}"),
            format!("farm coordinator {digest}"),
            format!("../ann viewer {digest}"),
            format!("ann viewer {}", &digest[1..]),
            format!("ann viewer {digest} soon"),
            format!("ann viewer {digest} 2027-02-19 more"),
        ] {
            assert_eq!(TokenLine::parse(&wrong), None, "{wrong}");
        }
    }

    #[test]
    fn token_is_valid_while_its_line_exists_and_is_not_expired() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens");
        assert!(matches!(Tokens::open(&path), Err(TrustError::File { .. })));
        let (token, open) = line(ann(), None);
        let (old, expired) = line(ann(), expiration::parse("2020-01-01"));
        std::fs::write(&path, format!("# the farm's\n\n{open}\n{expired}\n")).unwrap();
        let tokens = Tokens::open(&path).unwrap();
        assert_eq!(tokens.holder(&token.secret()), Ok((ann(), token.digest())));
        assert_eq!(tokens.holder(&old.secret()), Err(BadToken::Expired));
        assert_eq!(tokens.holder(&Token::random().unwrap().secret()), Err(BadToken::Unknown));
        assert_eq!(tokens.holder(&token.secret()[..40]), Err(BadToken::Malformed));
        assert_eq!(tokens.holder(&token.digest().to_string()), Err(BadToken::Malformed), "the digest is no token");
        std::fs::write(&path, format!("{expired}\n")).unwrap();
        assert_eq!(tokens.holder_by_digest(&token.digest()), Err(BadToken::Unknown));
        std::fs::write(&path, format!("slip of the pen\n{open}\n")).unwrap();
        assert!(matches!(Tokens::open(&path), Err(TrustError::Malformed { .. })));
        assert!(tokens.holder(&token.secret()).is_ok());
        std::fs::remove_file(&path).unwrap();
        assert_eq!(tokens.holder(&token.secret()), Err(BadToken::Unknown), "nobody is in a file that is gone");
    }
}
