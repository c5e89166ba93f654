//! Command that runs on this machine at the end of a job.

use std::process::Stdio;
use std::time::Duration;

use femc_model::JobStatus;
use tokio::io::AsyncWriteExt as _;
use tokio::process::Command;

/// Time limit of a command. After it, the command is killed.
const COMMAND_TIMEOUT: Duration = Duration::from_secs(600);
/// Number of bytes from the end of its standard error that are logged.
const LOGGED_BYTES: usize = 500;

/// Runs a command in the shell. The job is in its environment, and the message on its standard input. The outcome is logged.
pub(super) async fn run_command(command: &str, job: &JobStatus, message: &str) {
    let number = job.job.0;
    match outcome(command, job, message).await {
        Ok(None) => tracing::info!(job = number, "the --on-end command succeeded"),
        Ok(Some(fault)) => tracing::warn!(job = number, "the --on-end command failed: {fault}"),
        Err(error) => tracing::warn!(job = number, %error, "cannot run the --on-end command"),
    }
}

/// Returns the fault of the command, if it failed.
async fn outcome(command: &str, job: &JobStatus, message: &str) -> std::io::Result<Option<String>> {
    let mut child = Command::new("sh")
        .args(["-c", command])
        .env("FEMC_JOB", job.job.to_string())
        .env("FEMC_NAME", &job.name)
        .env("FEMC_OWNER", &job.owner)
        .env("FEMC_STATE", job.state.name())
        .env("FEMC_FRAMES", job.frames_total.to_string())
        .env("FEMC_FRAMES_DONE", job.frames_done.to_string())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()?;
    let stdin = child.stdin.take();
    let write = async move {
        if let Some(mut stdin) = stdin {
            // The command need not read its input.
            let _ = stdin.write_all(message.as_bytes()).await;
        }
    };
    let done = async { tokio::join!(write, child.wait_with_output()).1 };
    let Ok(output) = tokio::time::timeout(COMMAND_TIMEOUT, done).await else {
        return Ok(Some(format!("it ran for longer than {} s and was killed", COMMAND_TIMEOUT.as_secs())));
    };
    let output = output?;
    if output.status.success() {
        return Ok(None);
    }
    let errors = &output.stderr[output.stderr.len().saturating_sub(LOGGED_BYTES)..];
    Ok(Some(format!("{}: {}", output.status, String::from_utf8_lossy(errors).trim())))
}
