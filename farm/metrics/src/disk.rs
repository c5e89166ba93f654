//! Room on disks.

use std::io;
use std::path::Path;

/// Bytes that this process may still write to the disk of `path`, which is there.
#[cfg(unix)]
pub fn free(path: &Path) -> io::Result<u64> {
    let disk = rustix::fs::statvfs(path)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Bytes that this process may still write to the disk of `path`, which is there.
#[cfg(not(unix))]
pub fn free(_: &Path) -> io::Result<u64> {
    Err(io::ErrorKind::Unsupported.into())
}
