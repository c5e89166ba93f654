//! `femc pause|resume|cancel|retry JOB` and `femc priority JOB N`: steer a job.

use super::client;
use crate::args::ServerArgs;
use crate::exit::{Exit, Failure};
use crate::output::{Say, job as show};
use clap::Args;
use femc_model::{Control, JobId, Wait};

/// A job and its farm.
#[derive(Debug, Args)]
pub struct JobArgs {
    /// The job's number, as `submit` printed it
    #[arg(value_name = "JOB")]
    job: u64,
    #[command(flatten)]
    server: ServerArgs,
}

/// A job, its farm and a priority.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  femc priority 7 90")]
pub struct PriorityArgs {
    #[command(flatten)]
    job: JobArgs,
    /// 0 to 100, greater goes first
    #[arg(value_name = "N", value_parser = clap::value_parser!(u8).range(0..=100))]
    priority: u8,
}

/// Do `control` to the job.
pub fn run(args: &JobArgs, control: Control, say: Say) -> Result<Exit, Failure> {
    let again = client::block_on(&args.server, async |farm| {
        farm.control(JobId(args.job), control).await?;
        if control != Control::Retry {
            return Ok(Vec::new());
        }
        // It is done, whether or not the farm still says what for.
        let Ok(status) = farm.status(JobId(args.job)).await else { return Ok(Vec::new()) };
        let lost = status.waits.iter().filter(|wait| matches!(wait, Wait::ImageLost { .. }));
        Ok(lost.map(|wait| show::wait(&status, wait)).collect())
    })?;
    let done = match control {
        Control::Pause => "is paused; `femc resume` ends that".to_owned(),
        Control::Resume => "goes on".to_owned(),
        Control::Cancel => "is cancelled; finished frames stay, and `femc retry` would do the others".to_owned(),
        Control::Retry => "tries again what failed".to_owned(),
        Control::Priority(priority) => format!("has priority {priority}"),
    };
    say.note(format!("job {} {done}", args.job));
    again.iter().for_each(|line| say.note(line));
    Ok(Exit::Done)
}

/// Change the priority.
pub fn prioritize(args: &PriorityArgs, say: Say) -> Result<Exit, Failure> {
    run(&args.job, Control::Priority(args.priority), say)
}
