//! `femc watch JOB`: progress until the job ends, then its exit code.

use super::client;
use super::interrupt::Interrupt;
use crate::args::ServerArgs;
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, interrupted};
use crate::output::{Progress, Say, human, job as show};
use clap::Args;
use femc_model::{JobId, JobStatus};
use std::time::Duration;

/// Show a job's progress until it ends; the exit code is the job's
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc watch 7\n  \
    femc watch $(femc submit scene.mgf | tail -1) && echo finished\n\n\
    Ctrl-C leaves the watch (exit code 3) and not the job.")]
pub struct WatchArgs {
    /// The job's number, as `submit` printed it
    #[arg(value_name = "JOB")]
    job: u64,
    #[command(flatten)]
    server: ServerArgs,
}

/// Between two looks.
const EVERY: Duration = Duration::from_millis(250);

/// Watch.
pub fn run(args: &WatchArgs, say: Say) -> Result<Exit, Failure> {
    let last = client::block_on(&args.server, async |farm| {
        let mut interrupt = Interrupt::listen()?;
        let mut progress = Progress::new(say, Clock);
        loop {
            let status = farm.patient_status(JobId(args.job)).await?;
            if status.state.has_ended() {
                return Ok(status);
            }
            progress.show(&show::snapshot(&status, None));
            tokio::select! {
                () = tokio::time::sleep(EVERY) => {}
                () = interrupt.wait() => {
                    progress.finish();
                    return Err(interrupted(format!(
                        "no longer watching job {0}, which goes on; `femc watch {0}` looks again", args.job
                    )));
                }
            }
        }
    })?;
    ended(say, &last)
}

/// Say how a job has ended.
fn ended(say: Say, job: &JobStatus) -> Result<Exit, Failure> {
    for line in show::trouble(job) {
        say.warning(line);
    }
    match show::exit(job.state) {
        Some(Exit::Done) => {
            let frames = human::count(job.frames_total.into(), "frame");
            say.result(format!("job {} is done: {frames} in {}", job.job, human::seconds(job.seconds)));
            Ok(Exit::Done)
        }
        _ => Err(failed(format!(
            "job {} has {}: {} of {} frames are finished; `femc status {0}` tells more",
            job.job,
            if job.state == femc_model::JobState::Cancelled { "been cancelled" } else { "failed" },
            job.frames_done,
            job.frames_total
        ))),
    }
}
