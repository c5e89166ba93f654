use std::path::PathBuf;

/// Error of an authority, an identity or a token.
#[derive(Debug, thiserror::Error)]
pub enum TrustError {
    /// A file or folder cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// The file exists already and is not changed.
    #[error("{} already exists and was not changed", path.display())]
    Exists {
        /// Path of the file or folder.
        path: PathBuf,
    },
    /// The file has a wrong format.
    #[error("{}: {message}", path.display())]
    Malformed {
        /// Path of the file or folder.
        path: PathBuf,
        /// Description of the problem.
        message: String,
    },
    /// Other users of this machine can read a private key or a token.
    #[error("{} is secret, but other users can read it (mode {mode:o}); run `chmod 600` on it", path.display())]
    InsecurePermissions {
        /// Path of the file or folder.
        path: PathBuf,
        /// Permissions of the file.
        mode: u32,
    },
    /// The name cannot be used in a certificate.
    #[error("invalid name `{name}`: use 1 to 64 letters, digits, and . _ -")]
    Name {
        /// The given name.
        name: String,
    },
    /// Nothing was issued under this name.
    #[error("nothing was issued to `{name}`")]
    Unknown {
        /// The given name.
        name: String,
    },
    /// The certificate does not name a valid holder, or a token was requested for a coordinator.
    #[error("invalid holder: {message}")]
    Holder {
        /// Description of the problem.
        message: String,
    },
    /// The system's random number generator fails.
    #[error("cannot get random numbers: {message}")]
    Random {
        /// Error of the operating system.
        message: String,
    },
    /// A certificate cannot be created.
    #[error("certificate: {0}")]
    Certificate(#[from] rcgen::Error),
}

impl TrustError {
    pub(crate) fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |error| Self::File { path, error }
    }
}
