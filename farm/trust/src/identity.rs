//! Identities: a certificate and its key in one file.

use std::fmt;
use std::io::Write as _;
use std::path::Path;

use rustls_pki_types::pem::PemObject as _;
use rustls_pki_types::{CertificateDer, PrivateKeyDer};

use crate::{Holder, TrustError};

/// A certificate, its private key, and the certificate of the authority that signed it, all in PEM.
#[derive(Clone, PartialEq, Eq)]
pub struct Identity {
    certificate: String,
    key: String,
    authority: String,
    holder: Holder,
}

impl fmt::Debug for Identity {
    /// Formats the holder, without the key.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Identity({})", self.holder)
    }
}

impl Identity {
    pub(crate) fn new(certificate: String, key: String, authority: String, holder: Holder) -> Self {
        Self { certificate, key, authority, holder }
    }

    /// Returns the holder.
    pub fn holder(&self) -> &Holder {
        &self.holder
    }

    /// Returns the certificate.
    pub fn certificate(&self) -> &str {
        &self.certificate
    }

    /// Returns the private key.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Returns the authority's certificate.
    pub fn authority(&self) -> &str {
        &self.authority
    }

    /// Reads a file that [`Identity::write`] wrote. A file that other users can access is an error.
    pub fn read(path: &Path) -> Result<Self, TrustError> {
        let text = std::fs::read_to_string(path).map_err(TrustError::file(path))?;
        check_private(path)?;
        Self::parse(&text).map_err(|message| TrustError::Malformed { path: path.into(), message })
    }

    /// Parses a file's text: the first certificate is the identity's own, the second the authority's.
    pub fn parse(text: &str) -> Result<Self, String> {
        let begin = "-----BEGIN ";
        let sections: Vec<String> =
            text.match_indices(begin).map(|(at, _)| section(&text[at..])).collect::<Result<_, _>>()?;
        let sections_of_kind =
            |kind: &str| sections.iter().filter(|section| section.contains(kind)).cloned().collect::<Vec<String>>();
        let (certificates, keys) = (sections_of_kind("BEGIN CERTIFICATE-"), sections_of_kind("PRIVATE KEY-"));
        let ([certificate, authority], [key]) = (&certificates[..], &keys[..]) else {
            return Err(format!(
                "not an identity: found {} certificates and {} private keys; expected its own certificate, the authority's, and one \
                 private key",
                certificates.len(),
                keys.len()
            ));
        };
        let own = CertificateDer::from_pem_slice(certificate.as_bytes()).map_err(|error| error.to_string())?;
        CertificateDer::from_pem_slice(authority.as_bytes()).map_err(|error| error.to_string())?;
        PrivateKeyDer::from_pem_slice(key.as_bytes()).map_err(|error| error.to_string())?;
        let holder = certificate_holder(&own).map_err(|error| error.to_string())?;
        Ok(Self::new(certificate.clone(), key.clone(), authority.clone(), holder))
    }

    /// Writes a new file that only its owner can read.
    pub fn write(&self, path: &Path) -> Result<(), TrustError> {
        create_private_file(path, &[&self.certificate, &self.key, &self.authority].map(String::as_str).concat())
    }

    /// Returns the fingerprint of its certificate.
    pub fn fingerprint(&self) -> Result<Fingerprint, TrustError> {
        let own = CertificateDer::from_pem_slice(self.certificate.as_bytes());
        own.map(|own| Fingerprint::from_certificate(&own))
            .map_err(|error| TrustError::Holder { message: error.to_string() })
    }
}

/// Returns the PEM section at the start of `text`, including its last line.
fn section(text: &str) -> Result<String, String> {
    let last = text.find("-----END ").ok_or("a PEM section has no END line")?;
    let end = text[last..].find('\n').map_or(text.len(), |line| last + line + 1);
    Ok(text[..end].trim_end().to_owned() + "\n")
}

/// Returns the holder of a certificate. The signature is not verified.
pub fn certificate_holder(certificate: &CertificateDer<'_>) -> Result<Holder, TrustError> {
    let strange = |message: String| TrustError::Holder { message };
    let parsed = webpki::EndEntityCert::try_from(certificate).map_err(|error| strange(error.to_string()))?;
    let uris: Vec<&str> = parsed.valid_uri_names().collect();
    match uris[..] {
        [uri] => Holder::from_uri(uri),
        _ => Err(strange(format!("expected one URI in the certificate, found {}", uris.len()))),
    }
}

/// Fingerprint of a certificate: the BLAKE3 digest of its DER.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Fingerprint(blake3::Hash);

impl Fingerprint {
    /// Computes the fingerprint of this certificate.
    pub fn from_certificate(certificate: &CertificateDer<'_>) -> Self {
        Self(blake3::hash(certificate))
    }

    pub(crate) fn parse(text: &str) -> Option<Self> {
        blake3::Hash::from_hex(text).ok().map(Self)
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.to_hex())
    }
}

impl fmt::Debug for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Writes a new file that only its owner can read. An existing file is an error.
pub(crate) fn create_private_file(path: &Path, text: &str) -> Result<(), TrustError> {
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::AlreadyExists => TrustError::Exists { path: path.into() },
        _ => TrustError::File { path: path.into(), error },
    })?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(TrustError::file(path))
}

/// Checks that only the file's owner can access it.
pub(crate) fn check_private(path: &Path) -> Result<(), TrustError> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let mode = std::fs::metadata(path).map_err(TrustError::file(path))?.mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(TrustError::InsecurePermissions { path: path.into(), mode });
        }
    }
    Ok(())
}
