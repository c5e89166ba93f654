use std::path::PathBuf;

/// Why an authority or an identity cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TrustError {
    /// A file or folder.
    #[error("{}: {error}", path.display())]
    File {
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// There is one already; it is left as it is.
    #[error("{} is there already, and is left as it is", path.display())]
    Exists {
        /// Path of the file or folder.
        path: PathBuf,
    },
    /// The file is no identity or no authority.
    #[error("{}: {message}", path.display())]
    Malformed {
        /// Path of the file or folder.
        path: PathBuf,
        /// What is wrong with it.
        message: String,
    },
    /// Other users of this machine can read a private key or a token.
    #[error("{} is secret and other users can read it (mode {mode:o}); chmod 600 it", path.display())]
    Readable {
        /// Path of the file or folder.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// A name that would not do in a certificate.
    #[error("`{name}` is no name: 1 to 64 letters, digits, and . _ -")]
    Name {
        /// Name that was given.
        name: String,
    },
    /// Nothing was issued under this name.
    #[error("nothing was issued to `{name}`")]
    Unknown {
        /// Name that was given.
        name: String,
    },
    /// Not by this farm's authority for this farm.
    #[error("the certificate does not say whose it is: {message}")]
    Holder {
        /// What is wrong with the certificate's names.
        message: String,
    },
    /// The system has no randomness to give.
    #[error("no randomness: {message}")]
    Random {
        /// Error of the operating system.
        message: String,
    },
    /// Certificates cannot be made.
    #[error("certificate: {0}")]
    Certificate(#[from] rcgen::Error),
}

impl TrustError {
    pub(crate) fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |error| Self::File { path, error }
    }
}
