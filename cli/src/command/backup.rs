//! `femc backup DIR`: copies a running farm.

use super::client::{self, FarmClient};
use crate::args::ServerArgs;
use crate::exit::{Exit, Failure, failed};
use crate::output::{Printer, human};
use clap::Args;
use femc_model::Artifact;
use femc_store::Store;
use std::path::{Path, PathBuf};
use tokio::task::JoinSet;

/// Copy a running farm: its log of jobs, and the artifacts that the log refers to
///
/// The log is copied as of one moment, while the farm works on; meanwhile the coordinator cannot write to its disk, for some tenths
/// of a second per 100 MB. Then the artifacts are fetched that DIR does not have yet: a second backup into the same folder fetches
/// only new ones. Artifacts that were removed in between are left out; a farm that is started from the copy makes them again if it
/// needs them.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc backup /backup/farm\n  \
    femc backup /backup/farm --log-only     # copy the artifacts in artifacts.txt by other means\n  \
    cp -r /backup/farm . && femc coordinator --store sqlite:farm/farm.db --artifacts farm/artifacts    # restore\n\n\
    On a farm with roles, the command needs the role admin. Copy a log in PostgreSQL with `pg_dump --schema=femc`.")]
pub struct BackupArgs {
    /// Folder for farm.db, artifacts.txt and artifacts/; created if missing
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Fetch no artifacts: artifacts.txt lists them, as paths in the farm's folder of artifacts
    #[arg(long)]
    log_only: bool,
    #[command(flatten)]
    server: ServerArgs,
}

/// Artifacts that are fetched at the same time.
const MAX_CONCURRENT: usize = 4;

/// Runs `femc backup`.
pub fn run(args: &BackupArgs, printer: Printer) -> Result<Exit, Failure> {
    let fault = |e| failed(format!("{}: {e}; give a folder that can be written", args.folder.display()));
    std::fs::create_dir_all(&args.folder).map_err(fault)?;
    client::block_on(&args.server, async |farm| {
        let artifacts = copy_log(farm, &args.folder).await?;
        let list: String = artifacts.iter().map(|artifact| format!("{}\n", store_path(artifact))).collect();
        std::fs::write(args.folder.join("artifacts.txt"), list).map_err(fault)?;
        let bytes: u64 = artifacts.iter().map(|artifact| artifact.bytes).sum();
        let all =
            format!("{}, {}B", human::counted_noun(artifacts.len() as u64, "artifact"), human::quantity(bytes as f64));
        if args.log_only {
            printer.result(format!("copied the log; artifacts.txt lists {all}"));
            return Ok(());
        }
        let (fetched, gone) = fetch_missing(farm, &args.folder.join("artifacts"), &artifacts).await?;
        printer.result(format!("copied the log, which refers to {all}; {fetched} were new here"));
        if gone > 0 {
            printer.note(format!("{} skipped: no longer needed", human::counted_noun(gone, "artifact")));
        }
        Ok(())
    })?;
    Ok(Exit::Done)
}

/// Copies the log atomically and returns the artifacts that it refers to.
async fn copy_log(farm: &FarmClient, folder: &Path) -> Result<Vec<Artifact>, Failure> {
    let (new, path) = (folder.join("farm.db.new"), folder.join("farm.db"));
    let fault = |e| failed(format!("{}: {e}; give a folder that can be written", new.display()));
    let mut file = tokio::fs::File::create(&new).await.map_err(fault)?;
    let artifacts = farm.backup(&mut file).await?;
    file.sync_all().await.map_err(fault)?;
    for sidecar in ["farm.db-wal", "farm.db-shm", "farm.db-mark"] {
        // These files belong to an earlier copy on which a coordinator ran, not to this one.
        match std::fs::remove_file(folder.join(sidecar)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(fault(error)),
            Ok(()) | Err(_) => {}
        }
    }
    std::fs::rename(&new, &path).map_err(fault)?;
    Ok(artifacts)
}

/// Fetches the missing artifacts. Returns how many were fetched, and how many the farm no longer has.
async fn fetch_missing(farm: &FarmClient, folder: &Path, artifacts: &[Artifact]) -> Result<(u64, u64), Failure> {
    let store = Store::open_folder(folder).map_err(failed)?;
    let (mut fetched, mut gone, mut running) = (0, 0, JoinSet::new());
    let mut left = artifacts.iter();
    loop {
        while running.len() < MAX_CONCURRENT
            && let Some(&artifact) = left.next()
        {
            let (farm, store) = (farm.clone(), store.clone());
            running.spawn(async move { fetch_one(&farm, &store, &artifact).await });
        }
        match running.join_next().await {
            None => return Ok((fetched, gone)),
            Some(Ok(outcome)) => match outcome? {
                FetchOutcome::Fetched => fetched += 1,
                FetchOutcome::Present => {}
                FetchOutcome::Missing => gone += 1,
            },
            Some(Err(panic)) => return Err(failed(panic)),
        }
    }
}

enum FetchOutcome {
    Fetched,
    Present,
    Missing,
}

async fn fetch_one(farm: &FarmClient, store: &Store, artifact: &Artifact) -> Result<FetchOutcome, Failure> {
    if store.size(&artifact.digest).await.map_err(failed)? == Some(artifact.bytes) {
        return Ok(FetchOutcome::Present);
    }
    let Some(bytes) = farm.get_if_present(artifact).await? else { return Ok(FetchOutcome::Missing) };
    store.put(bytes.into()).await.map_err(failed)?;
    Ok(FetchOutcome::Fetched)
}

fn store_path(artifact: &Artifact) -> String {
    femc_store::artifact_path(&artifact.digest).to_string()
}
