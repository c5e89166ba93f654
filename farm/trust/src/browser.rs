//! Fingerprint of the authority's certificate as browsers show it. Browsers do not trust the certificate until a person imports it.

use std::fmt::Write as _;

use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject as _;

use crate::TrustError;

/// Returns the SHA-256 fingerprint of a certificate, as browsers and `openssl x509 -fingerprint -sha256` show it: `AB:CD:..`.
/// - `pem`: the certificate; sections after it are not read.
pub fn browser_fingerprint(pem: &str) -> Result<String, TrustError> {
    let certificate = CertificateDer::from_pem_slice(pem.as_bytes());
    let certificate = certificate.map_err(|error| TrustError::Holder { message: error.to_string() })?;
    let digest = ring::digest::digest(&ring::digest::SHA256, &certificate);
    let mut text = String::new();
    for (place, byte) in digest.as_ref().iter().enumerate() {
        let colon = if place == 0 { "" } else { ":" };
        // Writing to a string does not fail.
        let _ = write!(text, "{colon}{byte:02X}");
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fingerprint_is_what_openssl_prints() {
        // Expected value: openssl x509 -noout -fingerprint -sha256
        let pem = include_str!("../tests/authority.pem");
        let due = include_str!("../tests/authority.sha256");
        assert_eq!(browser_fingerprint(pem).expect("a certificate"), due.trim());
        assert!(browser_fingerprint("none").is_err());
    }
}
