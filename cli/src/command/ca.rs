//! `femc ca`: manages the farm's own certificate authority, which issues identities and tokens.

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, human, json};
use clap::{Args, Subcommand, ValueEnum};
use femc_trust::{Authority, CertificateRequest, Holder, IssuedCertificate, Role, TrustError, browser_fingerprint};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Manage the farm's own authority, and identities for its coordinators, workers and users
///
/// An identity is one file: a certificate, its private key, and the authority's certificate. Coordinators, workers and users show
/// their identities to each other; connections without one are refused. Keep the authority's folder where only administrators can
/// read it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc ca init\n  \
    femc ca issue coordinator farm -o farm.pem\n  \
    femc ca issue worker node-7 -o node-7.pem\n  \
    femc ca issue user ann --role operator -o ann.pem\n  \
    femc coordinator --listen 0.0.0.0:7878 --identity farm.pem --revoked femc-ca/revoked\n  \
    femc worker --join https://farm.lan:7878 --identity node-7.pem\n  \
    FEMC_SERVER=https://farm.lan:7878 FEMC_IDENTITY=ann.pem femc jobs\n  \
    femc ca export -o farm.crt    # for browsers, which warn until it is imported\n  \
    femc ca revoke node-7    # node-7 is refused from its next message on\n\n\
    Clients without an identity use a token. Everybody with the token file acts as its owner, until it expires or is revoked:\n  \
    femc ca token user build --role submitter --days 30 -o build.token\n  \
    femc coordinator --listen 0.0.0.0:7878 --identity farm.pem --revoked femc-ca/revoked --token-file femc-ca/tokens\n  \
    FEMC_SERVER=https://farm.lan:7878 FEMC_TOKEN_FILE=build.token femc jobs")]
pub struct CaArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Create the authority
    #[command(after_help = "Examples:\n  femc ca init\n  femc ca init --dir /etc/femc/ca --name night-drives")]
    Init {
        /// Name of the authority for people, in every certificate
        #[arg(long, default_value = "farm")]
        name: String,
        #[command(flatten)]
        folder: FolderArgs,
    },
    /// Issue an identity
    #[command(after_help = "Examples:\n  \
        femc ca issue coordinator farm --host farm.lan --host 10.0.0.1 -o farm.pem\n  \
        femc ca issue worker node-7\n  \
        femc ca issue user ann --role submitter --days 90")]
    Issue(IssueArgs),
    /// Issue a token, for clients that cannot have an identity
    ///
    /// Issue a token, for clients that cannot have an identity. Its owner needs only the token file. The authority does not keep
    /// the token itself, only its digest, in the file `tokens` of its folder, which coordinators read (--token-file): one line
    /// with name, role, digest and end. Everybody who copies a token can use it until it expires, or until its line is removed with
    /// `femc ca revoke`.
    #[command(after_help = "Examples:\n  \
        femc ca token user build --role submitter --days 30 -o build.token\n  \
        femc ca token worker node-7")]
    Token(TokenArgs),
    /// List issued identities and tokens
    #[command(
        after_help = "Examples:\n  femc ca list\n  femc ca list --json | jq '.[] | select(.revoked | not) | .name'"
    )]
    List {
        #[command(flatten)]
        folder: FolderArgs,
        #[command(flatten)]
        format: FormatArgs,
    },
    /// Write the authority's certificate alone, for browsers and other programs
    ///
    /// Write the authority's certificate alone, for browsers and other programs. Browsers warn of a coordinator with --identity,
    /// because they do not know the farm's authority. The warning ends when this file has been imported as the certificate of an
    /// authority. The file contains no key and is not secret. Compare its SHA-256 fingerprint before you import it.
    #[command(after_help = "Examples:\n  \
        femc ca export -o farm.crt\n  \
        openssl x509 -in farm.crt -noout -fingerprint -sha256    # prints the same fingerprint, on any machine")]
    Export {
        /// File to write
        #[arg(short, long, value_name = "FILE", default_value = "femc-authority.crt")]
        output: PathBuf,
        #[command(flatten)]
        folder: FolderArgs,
    },
    /// Revoke the identities and tokens of this name
    #[command(after_help = "Examples:\n  femc ca revoke node-7")]
    Revoke {
        /// Name, as issued
        name: String,
        #[command(flatten)]
        folder: FolderArgs,
    },
}

#[derive(Debug, Args)]
struct FolderArgs {
    /// Folder of the authority
    #[arg(long = "dir", value_name = "DIR", default_value = "femc-ca")]
    folder: PathBuf,
}

#[derive(Debug, Args)]
struct IssueArgs {
    /// Kind of holder
    kind: HolderKind,
    /// Name of the holder: letters, digits, and . _ -
    name: String,
    /// Role of a user. viewer: sees everything; submitter: submits jobs and controls its own; operator: controls every job and
    /// drains workers; admin: removes garbage
    #[arg(long, value_name = "ROLE", required_if_eq("kind", "user"))]
    role: Option<Role>,
    /// For a coordinator: a name or address at which tools other than femc reach it; repeatable
    #[arg(long, value_name = "HOST")]
    host: Vec<String>,
    /// Validity in days
    #[arg(long, value_name = "DAYS", default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
    days: u32,
    /// File to write [default: NAME.pem]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    folder: FolderArgs,
}

#[derive(Debug, Args)]
struct TokenArgs {
    /// Kind of holder
    kind: TokenHolderKind,
    /// Name of the holder: letters, digits, and . _ -
    name: String,
    /// Role of a user, as with `femc ca issue`
    #[arg(long, value_name = "ROLE", required_if_eq("kind", "user"))]
    role: Option<Role>,
    /// Validity in days
    #[arg(long, value_name = "DAYS", default_value_t = 90, value_parser = clap::value_parser!(u32).range(1..=3650))]
    days: u32,
    /// File to write [default: NAME.token]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    folder: FolderArgs,
}

/// Kinds of token holders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TokenHolderKind {
    Worker,
    User,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum HolderKind {
    Coordinator,
    Worker,
    User,
}

/// Runs `femc ca`.
pub fn run(args: CaArgs, printer: Printer) -> Result<Exit, Failure> {
    match args.action {
        Action::Init { name, folder } => {
            Authority::init(&folder.folder, &name).map_err(|error| map_trust_error(&error))?;
            printer.note(format!(
                "{} is now the farm's authority; keep it private and back it up",
                folder.folder.display()
            ));
        }
        Action::Issue(args) => issue(args, printer)?,
        Action::Token(args) => token(args, printer)?,
        Action::List { folder, format } => list(&folder.folder, format, printer)?,
        Action::Export { output, folder } => export(&output, &folder.folder, printer)?,
        Action::Revoke { name, folder } => {
            let authority = open(&folder.folder)?;
            let count = authority.revoke(&name).map_err(|error| map_trust_error(&error))?;
            let list = authority.revocation_list_path();
            printer.note(format!(
                "{name}: {count} revoked; coordinators read {} (--revoked) and {} (--token-file): copy both files to other machines",
                list.display(),
                authority.tokens_path().display()
            ));
        }
    }
    Ok(Exit::Done)
}

fn open(folder: &Path) -> Result<Authority, Failure> {
    Authority::open(folder).map_err(|error| map_open_error(folder, &error))
}

fn map_open_error(folder: &Path, error: &TrustError) -> Failure {
    match error {
        TrustError::File { error: cause, .. } if cause.kind() == std::io::ErrorKind::NotFound => usage(format!(
            "--dir {}: the folder contains no authority; create one with `femc ca init`",
            folder.display()
        )),
        _ => map_trust_error(error),
    }
}

/// Writes the authority's certificate, and prints how to check it.
fn export(output: &Path, folder: &Path, printer: Printer) -> Result<(), Failure> {
    let path = unused_path(Some(output.into()), String::new())?;
    let certificate = Authority::read_certificate(folder).map_err(|error| map_open_error(folder, &error))?;
    let fingerprint = browser_fingerprint(&certificate).map_err(|error| map_trust_error(&error))?;
    std::fs::write(&path, certificate).map_err(|error| failed(format!("{}: {error}", path.display())))?;
    printer.result(path.display());
    printer.note(format!(
        "import it into browsers as the certificate of an authority, after you have compared its SHA-256 fingerprint: {fingerprint}"
    ));
    Ok(())
}

fn issue(args: IssueArgs, printer: Printer) -> Result<(), Failure> {
    let IssueArgs { kind, name, role, host, days, output, folder } = args;
    if kind != HolderKind::Coordinator && !host.is_empty() {
        return Err(usage("--host: only coordinators have host names"));
    }
    let path = unused_path(output, format!("{name}.pem"))?;
    let holder = holder(kind, name, role)?;
    let issue = CertificateRequest { holder, hosts: host, days };
    let identity = open(&folder.folder)?.issue(&issue).map_err(|error| map_trust_error(&error))?;
    identity.write(&path).map_err(|error| map_trust_error(&error))?;
    printer.result(path.display());
    Ok(())
}

fn token(args: TokenArgs, printer: Printer) -> Result<(), Failure> {
    let TokenArgs { kind, name, role, days, output, folder } = args;
    let path = unused_path(output, format!("{name}.token"))?;
    let kind = match kind {
        TokenHolderKind::Worker => HolderKind::Worker,
        TokenHolderKind::User => HolderKind::User,
    };
    let pass =
        open(&folder.folder)?.issue_token(holder(kind, name, role)?, days).map_err(|error| map_trust_error(&error))?;
    pass.write(&path).map_err(|error| map_trust_error(&error))?;
    printer.result(path.display());
    Ok(())
}

fn holder(kind: HolderKind, name: String, role: Option<Role>) -> Result<Holder, Failure> {
    match (kind, role) {
        (HolderKind::Coordinator, None) => Ok(Holder::Coordinator { name }),
        (HolderKind::Worker, None) => Ok(Holder::Worker { name }),
        (HolderKind::User, Some(role)) => Ok(Holder::User { name, role }),
        (HolderKind::User, None) => Err(usage("--role: a user needs a role: viewer, submitter, operator or admin")),
        (HolderKind::Coordinator | HolderKind::Worker, Some(_)) => Err(usage("--role: only users have a role")),
    }
}

/// Returns the path to write to. Fails if it exists.
fn unused_path(output: Option<PathBuf>, default: String) -> Result<PathBuf, Failure> {
    let path = output.unwrap_or_else(|| default.into());
    if path.exists() {
        return Err(failed(format!("{} exists and is not overwritten; give another -o", path.display())));
    }
    Ok(path)
}

#[derive(Serialize)]
struct Line {
    kind: &'static str,
    name: String,
    holder: String,
    /// Digest of the certificate or token.
    fingerprint: String,
    /// End of validity in seconds since 1970; `None`: never.
    until: Option<i64>,
    days_left: Option<i64>,
    revoked: bool,
}

fn list(folder: &Path, format: FormatArgs, printer: Printer) -> Result<(), Failure> {
    let authority = open(folder)?;
    let revoked =
        femc_trust::RevocationList::open(authority.revocation_list_path()).map_err(|error| map_trust_error(&error))?;
    let line = |issued: IssuedCertificate| {
        let (revoked, days_left) = (issued.is_revoked(&revoked), issued.days_left());
        let IssuedCertificate { holder, name, fingerprint, until } = issued;
        let (until, days_left) = (Some(until), Some(days_left));
        Line { kind: "certificate", name, holder, fingerprint, until, days_left, revoked }
    };
    let issued = authority.issued_certificates().map_err(|error| map_trust_error(&error))?.into_iter().map(line);
    let tokens = authority.token_lines().map_err(|error| map_trust_error(&error))?.into_iter().map(|line| Line {
        kind: "token",
        name: line.holder.name().into(),
        holder: line.holder.uri(),
        fingerprint: line.digest.to_string(),
        until: line.until_seconds(),
        days_left: line.days_left(),
        revoked: false,
    });
    let lines: Vec<Line> = issued.chain(tokens).collect();
    if format.json {
        return json::print(printer, &lines);
    }
    if lines.is_empty() {
        printer.note("nothing was issued yet; issue an identity with `femc ca issue`");
    } else {
        printer.result(human::table(
            &["kind", "holder", "state", "fingerprint"],
            &lines.iter().map(row).collect::<Vec<_>>(),
        ));
    }
    Ok(())
}

fn row(line: &Line) -> Vec<String> {
    let state = match (line.revoked, line.days_left) {
        (true, _) => "revoked".to_owned(),
        (false, None) => "valid".to_owned(),
        (false, Some(..0)) => "expired".to_owned(),
        (false, Some(days)) => format!("valid for {days} days"),
    };
    vec![
        line.kind.to_owned(),
        line.holder.trim_start_matches("femc://").to_owned(),
        state,
        line.fingerprint.chars().take(16).collect(),
    ]
}

/// Converts an error of the authority into a failure of this program.
pub fn map_trust_error(error: &TrustError) -> Failure {
    match error {
        TrustError::Name { .. } => usage(error),
        TrustError::Unknown { .. } => usage(format!("{error}; `femc ca list` lists all")),
        TrustError::File { .. }
        | TrustError::Random { .. }
        | TrustError::Exists { .. }
        | TrustError::Malformed { .. }
        | TrustError::InsecurePermissions { .. }
        | TrustError::Holder { .. }
        | TrustError::Certificate(_) => failed(error),
    }
}
