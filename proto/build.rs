//! Generates the wire types from `femc/v1/femc.proto` without a `protoc` on the machine.

use prost::Message as _;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=femc");
    let descriptors = protox::compile(["femc/v1/femc.proto"], ["."])?;
    let out = std::path::PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    // What is long is passed on without a copy; a digest is short.
    let long = [".femc.v1.PutRequest.piece", ".femc.v1.GetReply.piece", ".femc.v1.BackupReply.log"];
    let mut build = tonic_prost_build::configure().codec_path("crate::codec::Codec");
    for field in long {
        build = build.bytes(field);
    }
    build.compile_fds(descriptors)?;
    Ok(())
}
