//! Names the build of the engine: what decides a pixel's bits is its sources, what they depend on, and the compiler.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let engine = Path::new("..");
    let mut files = vec![PathBuf::from("../../Cargo.lock")];
    for part in fs::read_dir(engine)? {
        let part = part?.path();
        files.push(part.join("Cargo.toml"));
        sources(&part.join("src"), &mut files)?;
    }
    files.sort();
    let mut hash = Hash::new();
    println!("cargo:rerun-if-changed={}", engine.display());
    println!("cargo:rerun-if-changed=../../Cargo.lock");
    for file in files.iter().filter(|file| file.is_file()) {
        hash.take(file.to_string_lossy().replace('\\', "/").as_bytes());
        hash.take(&fs::read(file)?);
    }
    let compiler = Command::new(env::var_os("RUSTC").unwrap_or_else(|| "rustc".into())).arg("--version").output()?;
    hash.take(&compiler.stdout);
    println!("cargo:rustc-env=FEMC_ENGINE={}-{:016x}", env!("CARGO_PKG_VERSION"), hash.0);
    Ok(())
}

fn sources(folder: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    let Ok(entries) = fs::read_dir(folder) else { return Ok(()) };
    for entry in entries {
        let path = entry?.path();
        if path.is_dir() { sources(&path, files)? } else { files.push(path) }
    }
    Ok(())
}

/// FNV-1a: it tells builds apart, and nobody gains by forging one.
struct Hash(u64);

impl Hash {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn take(&mut self, bytes: &[u8]) {
        for byte in bytes.iter().chain(&(bytes.len() as u64).to_le_bytes()) {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}
