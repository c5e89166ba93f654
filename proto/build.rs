//! Generates the wire types from `femc/v1/femc.proto` without a `protoc` on the machine.

use prost::Message as _;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=femc");
    let descriptors = protox::compile(["femc/v1/femc.proto"], ["."])?;
    let out = std::path::PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure().bytes(".femc.v1").compile_fds(descriptors)?;
    Ok(())
}
