//! `femc gc`: removes unused artifacts from the farm's store.

use super::client;
use crate::args::{FormatArgs, ServerArgs};
use crate::exit::{Exit, Failure};
use crate::output::{Printer, human, json};
use crate::values::DurationArg;
use clap::Args;
use femc_proto::{ArtifactTotals, CollectMode, CollectReport};
use serde::Serialize;
use std::time::Duration;

/// Remove unused artifacts from the farm's store
///
/// Artifacts of all jobs stay: scenes, unfinished and finished frames, also of jobs that have ended. Removed are uploads whose job
/// was never submitted, and leftovers of a coordinator that was killed.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc gc --dry-run\n  \
    femc gc --grace 24h\n  \
    femc gc --dry-run --json | jq '.garbage.bytes'")]
pub struct GcArgs {
    /// Remove nothing, only report what would be removed
    #[arg(long)]
    dry_run: bool,
    /// Keep artifacts younger than this, because they may belong to a running submission or upload; at least 60s
    #[arg(long, value_name = "DURATION", default_value = "1h")]
    grace: DurationArg,
    #[command(flatten)]
    format: FormatArgs,
    #[command(flatten)]
    server: ServerArgs,
}

#[derive(Serialize)]
struct VolumeJson {
    artifacts: u64,
    bytes: u64,
}

impl From<ArtifactTotals> for VolumeJson {
    fn from(ArtifactTotals { artifacts, bytes }: ArtifactTotals) -> Self {
        Self { artifacts, bytes }
    }
}

#[derive(Serialize)]
struct GcReport {
    dry_run: bool,
    referenced: VolumeJson,
    young: VolumeJson,
    garbage: VolumeJson,
    names: Vec<String>,
}

/// Runs `femc gc`.
pub fn run(args: &GcArgs, printer: Printer) -> Result<Exit, Failure> {
    let mode = if args.dry_run { CollectMode::DryRun } else { CollectMode::Remove };
    let grace = Duration::try_from_secs_f64(args.grace.seconds).unwrap_or(Duration::MAX);
    let collected = client::block_on(&args.server, async |farm| farm.collect(mode, grace).await)?;
    let CollectReport { referenced, young, garbage, names } = collected;
    if args.format.json {
        let names = names.iter().map(|artifact| artifact.digest.to_string()).collect();
        let [referenced, young, garbage] = [referenced, young, garbage].map(VolumeJson::from);
        json::print(printer, &GcReport { dry_run: args.dry_run, referenced, young, garbage, names })?;
        return Ok(Exit::Done);
    }
    let volume_text = |volume: ArtifactTotals| {
        format!("{}, {}B", human::counted_noun(volume.artifacts, "artifact"), human::quantity(volume.bytes as f64))
    };
    let what = match mode {
        CollectMode::DryRun => "would be removed",
        CollectMode::Remove => "removed",
    };
    printer.result(format!("{what}: {}", volume_text(garbage)));
    printer.note(format!(
        "kept: {} in use by jobs; {} younger than --grace",
        volume_text(referenced),
        volume_text(young)
    ));
    Ok(Exit::Done)
}
