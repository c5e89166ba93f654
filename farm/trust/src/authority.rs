//! A farm's own certificate authority: a folder with a private key and a list of the certificates that it issued.

use std::io::Write as _;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, SanType,
};
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject as _;
use serde::{Deserialize, Serialize};
use time::{Duration, OffsetDateTime};

use crate::expiration;
use crate::identity::{check_private, create_private_file};
use crate::{Fingerprint, Holder, Identity, RevocationList, Token, TokenFile, TokenLine, TrustError};

/// A certificate authority. Its folder holds `authority.pem` (its certificate), `authority.key`, `name`, `issued.jsonl`,
/// `revoked` and `tokens`.
#[derive(Debug)]
pub struct Authority {
    folder: PathBuf,
    certificate: String,
    issuer: Issuer<'static, KeyPair>,
}

/// Host name in every coordinator certificate; clients verify this name whatever address they dialed.
pub const COORDINATOR_HOST: &str = "coordinator.femc.internal";

/// A request for a certificate.
#[derive(Debug, Clone)]
pub struct CertificateRequest {
    /// Holder of the certificate.
    pub holder: Holder,
    /// Additional host names and addresses of a coordinator, for tools that verify them. The clients of femc do not need them.
    /// `localhost` and the loopback addresses are added.
    pub hosts: Vec<String>,
    /// Validity in days.
    pub days: u32,
}

/// Record of an issued certificate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IssuedCertificate {
    /// Holder, as written in the certificate.
    pub holder: String,
    /// Name of the holder, for people and for `revoke`.
    pub name: String,
    /// Fingerprint of the certificate.
    pub fingerprint: String,
    /// End of validity, in seconds since 1970.
    pub until: i64,
}

impl IssuedCertificate {
    /// Returns the remaining validity in days; negative after its end.
    pub fn days_left(&self) -> i64 {
        (self.until - OffsetDateTime::now_utc().unix_timestamp()).div_euclid(86_400)
    }

    /// Checks whether the list contains its certificate.
    pub fn is_revoked(&self, list: &RevocationList) -> bool {
        Fingerprint::parse(&self.fingerprint).is_none_or(|fingerprint| list.contains(&fingerprint))
    }
}

/// Time by which a certificate's validity begins early, so that machines whose clocks are slightly behind accept it.
const SKEW: Duration = Duration::hours(1);

impl Authority {
    /// Validity of an authority in years.
    const YEARS: i64 = 10;

    /// Creates an authority in `folder`, which is created if needed; `name` is for people. An existing authority is an error and is
    /// not changed.
    pub fn init(folder: &Path, name: &str) -> Result<Self, TrustError> {
        Holder::Coordinator { name: name.into() }.check()?;
        std::fs::create_dir_all(folder).map_err(TrustError::file(folder))?;
        let key = KeyPair::generate()?;
        let certificate = authority_params(name).self_signed(&key)?.pem();
        // The key is written first: a folder with a key counts as an authority.
        create_private_file(&folder.join("authority.key"), &key.serialize_pem())?;
        create_private_file(&folder.join("name"), name)?;
        create_private_file(&folder.join("authority.pem"), &certificate)?;
        Self::open(folder)
    }

    /// Opens the authority in `folder`.
    pub fn open(folder: &Path) -> Result<Self, TrustError> {
        let read = |name: &str| {
            let path = folder.join(name);
            std::fs::read_to_string(&path).map_err(TrustError::file(path))
        };
        let path = folder.join("authority.key");
        let key = read("authority.key")?;
        check_private(&path)?;
        let key =
            KeyPair::from_pem(&key).map_err(|error| TrustError::Malformed { path, message: error.to_string() })?;
        let (certificate, name) = (read("authority.pem")?, read("name")?);
        Ok(Self { folder: folder.into(), certificate, issuer: Issuer::new(authority_params(name.trim()), key) })
    }

    /// Reads the PEM certificate of the authority in `folder`. Its key is not read.
    pub fn read_certificate(folder: &Path) -> Result<String, TrustError> {
        let path = folder.join("authority.pem");
        let text = std::fs::read_to_string(&path).map_err(TrustError::file(&path))?;
        // A file that also contains a private key is refused, so that the key is not handed out.
        let certificates = CertificateDer::pem_slice_iter(text.as_bytes()).collect::<Result<Vec<_>, _>>();
        match certificates.as_deref() {
            Ok([_]) if !text.contains("PRIVATE KEY") => Ok(text),
            Ok(_) => Err(TrustError::Malformed { path, message: "expected one certificate and nothing else".into() }),
            Err(error) => Err(TrustError::Malformed { path, message: error.to_string() }),
        }
    }

    /// Issues a new identity. It is recorded in the folder before this returns.
    pub fn issue(&self, request: &CertificateRequest) -> Result<Identity, TrustError> {
        request.holder.check()?;
        let until = expiration::after_days(request.days);
        let key = KeyPair::generate()?;
        let certificate = holder_params(request, until)?.signed_by(&key, &self.issuer)?;
        let issued = IssuedCertificate {
            holder: request.holder.uri(),
            name: request.holder.name().into(),
            fingerprint: Fingerprint::from_certificate(certificate.der()).to_string(),
            until: until.unix_timestamp(),
        };
        let line = serde_json::to_string(&issued).map_err(|error| self.malformed("issued.jsonl", &error))?;
        self.append("issued.jsonl", &line)?;
        Ok(Identity::new(certificate.pem(), key.serialize_pem(), self.certificate.clone(), request.holder.clone()))
    }

    /// Returns the records of all issued certificates, oldest first.
    pub fn issued_certificates(&self) -> Result<Vec<IssuedCertificate>, TrustError> {
        let path = self.folder.join("issued.jsonl");
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(TrustError::File { path, error }),
        };
        let parse = |line| serde_json::from_str(line).map_err(|error| self.malformed("issued.jsonl", &error));
        text.lines().map(parse).collect()
    }

    /// Issues a new token that is valid for `days` days. Its line is recorded in the folder before this returns. A coordinator
    /// cannot have a token.
    pub fn issue_token(&self, holder: Holder, days: u32) -> Result<TokenFile, TrustError> {
        holder.check()?;
        if let Holder::Coordinator { .. } = holder {
            return Err(TrustError::Holder {
                message: format!("{holder} cannot have a token; only users and workers have tokens"),
            });
        }
        let token = Token::random()?;
        let line = TokenLine { holder, digest: token.digest(), until: Some(expiration::after_days(days)) };
        self.append("tokens", &line.to_string())?;
        Ok(TokenFile::new(token, self.certificate.clone()))
    }

    /// Returns the lines of all tokens that are not revoked, oldest first.
    pub fn token_lines(&self) -> Result<Vec<TokenLine>, TrustError> {
        let path = self.tokens_path();
        match std::fs::read_to_string(&path) {
            Ok(text) => crate::tokens::parse(&path, &text),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
            Err(error) => Err(TrustError::File { path, error }),
        }
    }

    /// Revokes all certificates and tokens that were issued to `name`. Returns their number.
    pub fn revoke(&self, name: &str) -> Result<usize, TrustError> {
        let issued = self.issued_certificates()?;
        let named: Vec<&IssuedCertificate> = issued.iter().filter(|issued| issued.name == name).collect();
        let (tokens, others): (Vec<TokenLine>, Vec<TokenLine>) =
            self.token_lines()?.into_iter().partition(|line| line.holder.name() == name);
        if named.is_empty() && tokens.is_empty() {
            return Err(TrustError::Unknown { name: name.into() });
        }
        for issued in &named {
            self.append("revoked", &format!("{} {}", issued.fingerprint, issued.holder))?;
        }
        if !tokens.is_empty() {
            self.replace_tokens(&others)?;
        }
        Ok(named.len() + tokens.len())
    }

    /// Replaces the list of tokens atomically: a coordinator reads either the old or the new list.
    fn replace_tokens(&self, lines: &[TokenLine]) -> Result<(), TrustError> {
        let (path, new) = (self.tokens_path(), self.folder.join("tokens.new"));
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        std::fs::write(&new, text).map_err(TrustError::file(&new))?;
        std::fs::rename(&new, &path).map_err(TrustError::file(path))
    }

    /// Returns the path of the list of tokens that coordinators read: [`crate::Tokens`].
    pub fn tokens_path(&self) -> PathBuf {
        self.folder.join("tokens")
    }

    /// Returns the path of the revocation list that coordinators read: [`crate::RevocationList`].
    pub fn revocation_list_path(&self) -> PathBuf {
        self.folder.join("revoked")
    }

    fn append(&self, name: &str, line: &str) -> Result<(), TrustError> {
        let path = self.folder.join(name);
        let file = std::fs::OpenOptions::new().create(true).append(true).open(&path);
        let written = file.and_then(|mut file| file.write_all(format!("{line}\n").as_bytes()).and(file.sync_all()));
        written.map_err(TrustError::file(path))
    }

    fn malformed(&self, name: &str, error: &serde_json::Error) -> TrustError {
        TrustError::Malformed { path: self.folder.join(name), message: error.to_string() }
    }
}

fn common_name(name: &str) -> DistinguishedName {
    let mut distinguished = DistinguishedName::new();
    distinguished.push(DnType::CommonName, name);
    distinguished
}

fn authority_params(name: &str) -> CertificateParams {
    let now = OffsetDateTime::now_utc();
    let mut params = CertificateParams::default();
    params.distinguished_name = common_name(&format!("femc authority {name}"));
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params.not_before = now - SKEW;
    params.not_after = now + Duration::days(365 * Authority::YEARS);
    params
}

fn holder_params(request: &CertificateRequest, until: OffsetDateTime) -> Result<CertificateParams, TrustError> {
    let mut params = CertificateParams::default();
    params.distinguished_name = common_name(&request.holder.to_string());
    params.use_authority_key_identifier_extension = true;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.not_before = OffsetDateTime::now_utc() - SKEW;
    params.not_after = until;
    params.subject_alt_names = vec![SanType::URI(request.holder.uri().try_into()?)];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    if let Holder::Coordinator { .. } = request.holder {
        params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        for host in [COORDINATOR_HOST, "localhost", "127.0.0.1", "::1"]
            .into_iter()
            .chain(request.hosts.iter().map(String::as_str))
        {
            params.subject_alt_names.push(match host.parse::<IpAddr>() {
                Ok(address) => SanType::IpAddress(address),
                Err(_) => SanType::DnsName(host.try_into()?),
            });
        }
    }
    Ok(params)
}
