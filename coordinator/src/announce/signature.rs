//! Signatures of messages, as specified by Standard Webhooks.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ring::hmac;

/// Signing key. Its `Debug` output does not show it.
#[derive(Clone)]
pub struct NotifyKey(Arc<hmac::Key>);

/// Error of a key file.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("{path}: {error}")]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// The key is too short, or the text after `whsec_` is not base64.
    #[error(
        "{path}: expected a key of at least {} bytes, or `whsec_` and such a key in base64; \
         create one with `openssl rand -base64 32`",
        NotifyKey::MIN_KEY_BYTES
    )]
    Form {
        /// Path of the file.
        path: PathBuf,
    },
}

impl NotifyKey {
    /// Minimum length of a key in bytes.
    const MIN_KEY_BYTES: usize = 16;

    /// Reads the key from a file: `whsec_` and base64, or raw bytes. White space at both ends is ignored.
    ///
    /// # Errors
    /// The file cannot be read, or has no key.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let bytes = std::fs::read(path).map_err(|error| KeyError::Read { path: path.to_owned(), error })?;
        Self::parse(&bytes).ok_or_else(|| KeyError::Form { path: path.to_owned() })
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let text = bytes.trim_ascii();
        let key = match text.strip_prefix(b"whsec_") {
            Some(encoded) => STANDARD.decode(encoded).ok()?,
            None => text.to_vec(),
        };
        (key.len() >= Self::MIN_KEY_BYTES).then(|| Self(Arc::new(hmac::Key::new(hmac::HMAC_SHA256, &key))))
    }

    /// Returns the signature of a message: `v1,` and the base64 of HMAC-SHA256 over its id, its time and its body.
    pub(super) fn sign(&self, id: &str, unix_seconds: u64, body: &str) -> String {
        let tag = hmac::sign(&self.0, format!("{id}.{unix_seconds}.{body}").as_bytes());
        format!("v1,{}", STANDARD.encode(tag))
    }
}

impl fmt::Debug for NotifyKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("NotifyKey")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signature_is_that_of_the_standards_example() {
        // The values come from the specification of Standard Webhooks, and from Python's `hmac`.
        let key = NotifyKey::parse(b"whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw\n").expect("a key");
        let signature = key.sign("msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, r#"{"test": 2432232314}"#);
        assert_eq!(signature, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }

    #[test]
    fn short_keys_and_what_is_no_base64_are_refused() {
        assert!(NotifyKey::parse(b"0123456789abcdef").is_some());
        for bad in [&b""[..], b"short", b"whsec_", b"whsec_c2hvcnQ=", b"whsec_not base64 but long enough"] {
            assert!(NotifyKey::parse(bad).is_none(), "{bad:?}");
        }
    }
}
