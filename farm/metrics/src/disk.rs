//! Free space on disks.

use std::io;
use std::path::Path;

/// Returns the number of bytes that this process may still write to the disk of `path`, which must exist.
#[cfg(unix)]
pub fn free_disk_bytes(path: &Path) -> io::Result<u64> {
    let disk = rustix::fs::statvfs(path)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Returns the number of bytes that this process may still write to the disk of `path`, which must exist.
#[cfg(not(unix))]
pub fn free_disk_bytes(_: &Path) -> io::Result<u64> {
    Err(io::ErrorKind::Unsupported.into())
}
