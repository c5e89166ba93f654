//! Fuzzes a little with every run: see `src/fuzz`.

use std::collections::BTreeSet;

use femc_tests::fuzz::{FuzzStatistics, execute, peak_memory, targets};
use prost::Message as _;

#[test]
fn no_bytes_make_a_decoder_panic_or_fill_the_memory() {
    let targets = targets();
    let before = peak_memory();
    for target in &targets {
        let mut tally = FuzzStatistics::default();
        (0..400).for_each(|seed| execute(target, seed, &mut tally));
        assert!(tally.panics.is_empty(), "{:#?}", tally.panics);
        assert!(
            tally.accepted < tally.executions || target.name.ends_with("Request") || target.name.ends_with("Reply")
        );
    }
    if let (Some(before), Some(after)) = (before, peak_memory()) {
        assert!(after < before + (512 << 20), "grew from {before} to {after} bytes");
    }
}

/// Seeds that once made a decoder panic.
const KNOWN_PANICS: [(&str, u64); 1] = [("elements", 222_945)];

#[test]
fn what_fuzzing_has_found_stays_found() {
    for target in targets() {
        let mut tally = FuzzStatistics::default();
        let seeds = KNOWN_PANICS.iter().filter(|(name, _)| *name == target.name);
        seeds.for_each(|&(_, seed)| execute(&target, seed, &mut tally));
        assert!(tally.panics.is_empty(), "{:#?}", tally.panics);
    }
}

#[test]
fn each_message_of_a_call_has_its_decoder() {
    let set = prost_types::FileDescriptorSet::decode(femc_proto::testing::DESCRIPTORS).expect("a descriptor set");
    let files = set.file.iter().filter(|file| file.package() == "femc.v1");
    let calls = files.flat_map(|file| &file.service).flat_map(|service| &service.method);
    let messages: BTreeSet<&str> = calls.flat_map(|call| [call.input_type(), call.output_type()]).collect();
    let decoded: BTreeSet<String> =
        femc_proto::testing::DECODERS.iter().map(|decoder| format!(".femc.v1.{}", decoder.message)).collect();
    let without: Vec<_> = messages.into_iter().filter(|message| !decoded.contains(*message)).collect();
    assert!(without.is_empty(), "{without:?}");
}
