//! Bearer tokens: a client that presents a token is treated as its holder.
//!
//! A token is a secret of 256 random bits. The farm stores its BLAKE3 digest and never the token. A secret of this length cannot be
//! guessed from its plain digest. A copied token can be used from anywhere; therefore it is sent only over encrypted connections or
//! within the machine. It is valid until its date or until its line is removed, whichever is first.

use std::fmt;
use std::path::Path;

use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject as _;

use crate::TrustError;
use crate::identity::{check_private, create_private_file};

/// A token: the secret itself.
#[derive(Clone, PartialEq, Eq)]
pub struct Token([u8; 32]);

impl Token {
    /// Prefix by which people and scanners for leaked secrets recognize a token.
    const PREFIX: &str = "femc_";

    /// Creates a new token with the system's random number generator.
    pub fn random() -> Result<Self, TrustError> {
        let mut secret = [0; 32];
        getrandom::fill(&mut secret).map_err(|error| TrustError::Random { message: error.to_string() })?;
        Ok(Self(secret))
    }

    /// Parses a token; text before or after it is not accepted.
    pub fn parse(text: &str) -> Option<Self> {
        let digits = text.strip_prefix(Self::PREFIX)?;
        // Upper case would be a second text for the same token.
        if digits.bytes().any(|byte| byte.is_ascii_uppercase()) {
            return None;
        }
        blake3::Hash::from_hex(digits).ok().map(|bytes| Self(bytes.into()))
    }

    /// Returns the token's text, which is secret.
    pub fn secret(&self) -> String {
        format!("{}{}", Self::PREFIX, blake3::Hash::from(self.0).to_hex())
    }

    /// Returns the digest by which the farm identifies the token.
    pub fn digest(&self) -> TokenDigest {
        TokenDigest(blake3::hash(&self.0))
    }
}

impl fmt::Debug for Token {
    /// Formats the digest, without the secret.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Token({})", self.digest())
    }
}

/// The BLAKE3 digest of a token. Digests are compared in constant time.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct TokenDigest(blake3::Hash);

impl TokenDigest {
    pub(crate) fn parse(text: &str) -> Option<Self> {
        blake3::Hash::from_hex(text).ok().map(Self)
    }
}

impl fmt::Display for TokenDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.to_hex())
    }
}

impl fmt::Debug for TokenDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// A token as its owner keeps it: one file, with the authority's certificate that verifies coordinators.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenFile {
    token: Token,
    authority: Option<String>,
}

impl TokenFile {
    pub(crate) fn new(token: Token, authority: String) -> Self {
        Self { token, authority: Some(authority) }
    }

    /// Returns the token.
    pub fn token(&self) -> &Token {
        &self.token
    }

    /// Returns the authority's certificate in PEM. Without it, the token can be used only on this machine.
    pub fn authority(&self) -> Option<&str> {
        self.authority.as_deref()
    }

    /// Reads a file that [`TokenFile::write`] wrote, or one that contains only a token. A file that other users can access is an
    /// error.
    pub fn read(path: &Path) -> Result<Self, TrustError> {
        let text = std::fs::read_to_string(path).map_err(TrustError::file(path))?;
        check_private(path)?;
        Self::parse(&text).map_err(|message| TrustError::Malformed { path: path.into(), message })
    }

    /// Parses a file's text: a line with the token, then at most one certificate.
    pub fn parse(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let (first, rest) = text.split_once('\n').unwrap_or((text, ""));
        let token = Token::parse(first.trim())
            .ok_or("its first line is not a token: it is cut short, or it is something else")?;
        let authority = match rest.trim() {
            "" => None,
            certificate if certificate.matches("-----BEGIN ").count() == 1 => {
                CertificateDer::from_pem_slice(certificate.as_bytes()).map_err(|error| error.to_string())?;
                Some(format!("{certificate}\n"))
            }
            _ => return Err("only one certificate may follow the token".into()),
        };
        Ok(Self { token, authority })
    }

    /// Writes a new file that only its owner can read.
    pub fn write(&self, path: &Path) -> Result<(), TrustError> {
        create_private_file(path, &format!("{}\n{}", self.token.secret(), self.authority().unwrap_or_default()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_has_one_text_and_no_other_is_one() {
        let (token, other) = (Token::random().unwrap(), Token::random().unwrap());
        let text = token.secret();
        assert_eq!(Token::parse(&text), Some(token.clone()));
        assert_ne!(token.digest(), other.digest());
        assert!(!format!("{token:?}").contains(&text[5..]), "a secret is not printed");
        let upper = format!("femc_{}", text[5..].to_uppercase().replace(char::is_numeric, "A"));
        for n in 0..text.len() {
            assert_eq!(Token::parse(&text[..n]), None, "cut at {n}");
        }
        for wrong in [&upper, &format!("{text}0"), &format!(" {text}"), &text[5..], &text.replace('_', "-")] {
            assert_eq!(Token::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_pass_is_a_token_and_at_most_one_certificate() {
        let text = Token::random().unwrap().secret();
        assert_eq!(TokenFile::parse(&format!("{text}\n")).unwrap().authority(), None);
        let cut = "-----BEGIN CERTIFICATE-----\nMIIB";
        for rest in ["rubbish", "-----BEGIN CERTIFICATE-----", &text, cut] {
            assert!(TokenFile::parse(&format!("{text}\n{rest}")).is_err(), "{rest}");
        }
    }
}
