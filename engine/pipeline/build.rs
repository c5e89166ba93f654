//! Computes the name of the engine build. The bits of a pixel depend on the engine's sources, their dependencies, the compiler, and
//! its flags. Two builds have the same name if all of these are equal, or if a test has shown that they compute the same bits.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

/// Instruction sets of x86-64 and x86-64-v3. `tests/builds` shows that they give the same bits. Any other set becomes part of the
/// name.
const EQUIVALENT_FEATURES: [&str; 2] = [
    "fxsr,sse,sse2",
    "avx,avx2,bmi1,bmi2,cmpxchg16b,f16c,fma,fxsr,lzcnt,movbe,popcnt,sse,sse2,sse3,sse4.1,sse4.2,ssse3,xsave",
];

/// Compiler flags that change no value: flags of lints, linking and debugging, and flags that choose the instruction set, which has
/// its own part of the name.
const HARMLESS_FLAGS: [&str; 21] = [
    "-A",
    "-D",
    "-F",
    "-L",
    "-W",
    "-l",
    "--cap-lints",
    "--check-cfg",
    "--remap-path-prefix",
    "-Ccodegen-units=",
    "-Cdebuginfo=",
    "-Cforce-frame-pointers",
    "-Cincremental=",
    "-Cinstrument-coverage",
    "-Clink",
    "-Cprefer-dynamic",
    "-Crelocation-model=",
    "-Csplit-debuginfo=",
    "-Cstrip=",
    "-Ctarget-cpu=",
    "-Ctarget-feature=",
];

fn main() -> io::Result<()> {
    let engine = Path::new("..");
    // The manifest lists the features of the engine's dependencies.
    let mut files = ["build.rs", "../../Cargo.lock", "../../Cargo.toml"].map(PathBuf::from).to_vec();
    for part in fs::read_dir(engine)? {
        let part = part?.path();
        files.push(part.join("Cargo.toml"));
        collect_sources(&part.join("src"), &mut files)?;
    }
    files.sort();
    let mut hash = Hash::new();
    println!("cargo:rerun-if-changed={}", engine.display());
    println!("cargo:rerun-if-changed=../../Cargo.lock");
    println!("cargo:rerun-if-changed=../../Cargo.toml");
    for file in files.iter().filter(|file| file.is_file()) {
        hash.update(file.to_string_lossy().replace('\\', "/").as_bytes());
        hash.update(&fs::read(file)?);
    }
    let compiler = Command::new(env::var_os("RUSTC").unwrap_or_else(|| "rustc".into())).arg("--version").output()?;
    hash.update(&compiler.stdout);
    for name in ["TARGET", "PROFILE", "OPT_LEVEL"] {
        hash.update(env_variable(name).as_bytes());
    }
    let instructions = env_variable("CARGO_CFG_TARGET_FEATURE");
    if !EQUIVALENT_FEATURES.contains(&&*instructions) {
        hash.update(instructions.as_bytes());
    }
    value_changing_flags(&env_variable("CARGO_ENCODED_RUSTFLAGS")).iter().for_each(|flag| hash.update(flag.as_bytes()));
    println!("cargo:rustc-env=FEMC_ENGINE={}-{:016x}", env!("CARGO_PKG_VERSION"), hash.0);
    Ok(())
}

fn env_variable(name: &str) -> String {
    env::var(name).unwrap_or_default()
}

/// Returns the flags that may change a value, each with its argument.
fn value_changing_flags(flags: &str) -> Vec<String> {
    let (mut words, mut relevant) = (flags.split('\x1f'), Vec::new());
    while let Some(word) = words.next() {
        let argument = match word {
            "-C"
            | "-D"
            | "-W"
            | "-A"
            | "-F"
            | "-L"
            | "-l"
            | "-Z"
            | "--cfg"
            | "--check-cfg"
            | "--codegen"
            | "--cap-lints"
            | "--remap-path-prefix" => words.next().unwrap_or_default(),
            _ => "",
        };
        let flag = format!("{word}{argument}").replace("--codegen", "-C");
        if !flag.is_empty() && !HARMLESS_FLAGS.iter().any(|harmless| flag.starts_with(harmless)) {
            relevant.push(flag);
        }
    }
    relevant
}

fn collect_sources(folder: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    let Ok(entries) = fs::read_dir(folder) else { return Ok(()) };
    for entry in entries {
        let path = entry?.path();
        if path.is_dir() { collect_sources(&path, files)? } else { files.push(path) }
    }
    Ok(())
}

/// FNV-1a hash. It distinguishes builds and need not resist forgery.
struct Hash(u64);

impl Hash {
    fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    fn update(&mut self, bytes: &[u8]) {
        for byte in bytes.iter().chain(&(bytes.len() as u64).to_le_bytes()) {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}
