//! Generates `proto/src/generated` from `proto/femc/v1/femc.proto` without a `protoc` on the machine: `cargo run -p femc-generate`.
//!
//! The generated files are checked in, so that a build of the program compiles neither this generator nor the 27 crates that it
//! needs. The test here compares the checked-in files with the interface. The generator is a separate crate because the interface's
//! crate does not compile while the two differ.

use prost::Message as _;
use std::error::Error;
use std::path::{Path, PathBuf};

const FILES: [&str; 2] = ["femc.v1.rs", "descriptors.bin"];

/// Fields generated as `Bytes`: long values are passed on without a copy. Digests are short.
const BYTES_FIELDS: [&str; 3] = [".femc.v1.PutRequest.piece", ".femc.v1.GetReply.piece", ".femc.v1.BackupReply.log"];

fn proto_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Writes [`FILES`] into an existing folder.
fn generate(out: &Path) -> Result<(), Box<dyn Error>> {
    let descriptors = protox::compile(["femc/v1/femc.proto"], [proto_folder()])?;
    std::fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    let mut build = tonic_prost_build::configure().out_dir(out).codec_path("crate::codec::Codec");
    for field in BYTES_FIELDS {
        build = build.bytes(field);
    }
    Ok(build.compile_fds(descriptors)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let generated = proto_folder().join("src/generated");
    // Generate into another folder first: if the interface has an error, the checked-in files stay as they are.
    let folder = tempfile::tempdir()?;
    generate(folder.path())?;
    for name in FILES {
        std::fs::copy(folder.path().join(name), generated.join(name))?;
    }
    println!("{}: {}", generated.display(), FILES.join(", "));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{FILES, generate, proto_folder};

    #[test]
    fn what_is_kept_is_what_the_interface_says() {
        let folder = tempfile::tempdir().expect("a folder");
        generate(folder.path()).expect("code");
        for name in FILES {
            let said = std::fs::read(folder.path().join(name)).expect(name);
            let is_same = std::fs::read(proto_folder().join("src/generated").join(name)).is_ok_and(|kept| kept == said);
            assert!(
                is_same,
                "femc.proto has changed, src/generated/{name} has not: `cargo run -p femc-generate` writes it"
            );
        }
    }
}
