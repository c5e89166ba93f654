//! `femc watch JOB`: shows the progress of a job until it ends, and exits with its exit code.

use super::client::{self, FarmClient};
use super::interrupt::Interrupt;
use super::live_preview::{LivePreview, PreviewTargets};
use crate::args::ServerArgs;
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, interrupted};
use crate::output::half_blocks::DrawingSize;
use crate::output::job::JobJson;
use crate::output::{Printer, Progress, ProgressTarget, human, job as show, json};
use clap::{Args, ValueEnum};
use femc_model::{FrameRecord, JobId, JobStatus};
use femc_service::view::above_target;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Show a job's progress until it ends; the exit code is the job's
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc watch 7\n  \
    femc watch $(femc submit scene.mgf | tail -1) && echo finished\n  \
    femc watch 7 --preview-to now.png    # update a picture of the running frame\n\n\
    Ctrl-C ends the watch (exit code 3); the job continues.")]
pub struct WatchArgs {
    /// Job number, as printed by `submit`
    #[arg(value_name = "JOB")]
    job: u64,
    /// Draw the frame in progress above the bar: with auto, if stderr is a large enough terminal whose COLORTERM announces 24-bit
    /// colors
    #[arg(
        long,
        value_name = "WHEN",
        default_value = "auto",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "always"
    )]
    preview: PreviewMode,
    /// Keep this file up to date with the frame in progress; at the end it is the last frame
    #[arg(long, value_name = "FILE.png", value_parser = png)]
    preview_to: Option<PathBuf>,
    /// Print JSON on stdout: one object per line whenever the job's status changes, or the coordinator goes away or comes back
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: ServerArgs,
}

/// Whether to draw a preview.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum PreviewMode {
    /// If the terminal supports it.
    Auto,
    /// On every terminal or pipe that shows progress.
    Always,
    /// Not at all.
    Never,
}

impl PreviewMode {
    fn is_drawn(self, target: ProgressTarget, printer: Printer) -> bool {
        match (self, target) {
            (Self::Never, _) | (_, ProgressTarget::None) | (Self::Auto, ProgressTarget::Lines) => false,
            (Self::Always, ProgressTarget::Lines | ProgressTarget::Terminal) => true,
            (Self::Auto, ProgressTarget::Terminal) => printer.true_color() && DrawingSize::from_stderr().is_some(),
        }
    }
}

fn png(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    if path.extension().is_some_and(|extension| extension == "png") {
        Ok(path)
    } else {
        Err("a preview is a PNG; give FILE.png".to_owned())
    }
}

/// Interval between two status calls.
const POLL_INTERVAL: Duration = Duration::from_millis(250);

/// Runs `femc watch`.
pub fn run(args: &WatchArgs, printer: Printer) -> Result<Exit, Failure> {
    let job = JobId(args.job);
    let last = client::block_on(&args.server, async |farm| {
        let messages =
            FollowMessages { activity: "the watch", resume_hint: format!("`femc watch {job}` resumes the watch") };
        let targets = |stage| PreviewTargets {
            on_terminal: args.preview.is_drawn(stage, printer),
            file: args.preview_to.clone(),
        };
        let last = follow(farm, job, &messages, args.json.then_some(printer), targets, printer).await?;
        if let Some(file) = &args.preview_to {
            write_last_frame(farm, job, file).await?;
        }
        Ok(last)
    })?;
    report_end(args, printer, &last)
}

/// Texts for the messages of a command that follows a job.
pub(super) struct FollowMessages {
    /// Name of the activity, such as `the watch`.
    pub(super) activity: &'static str,
    /// Command to continue after Ctrl-C.
    pub(super) resume_hint: String,
}

/// Shows a job's progress until the job has ended, even if the coordinator is away for a while. Returns the final status.
/// - `events`: output for JSON events.
/// - `targets`: destinations of the preview, which depend on whether there is a terminal.
pub(super) async fn follow(
    farm: &FarmClient,
    job: JobId,
    messages: &FollowMessages,
    events: Option<Printer>,
    targets: impl FnOnce(ProgressTarget) -> PreviewTargets,
    printer: Printer,
) -> Result<JobStatus, Failure> {
    let left = || interrupted(format!("job {job} continues; {}", messages.resume_hint));
    let mut interrupt = Interrupt::listen()?;
    let mut events = Events { printer: events, last: None };
    let mut progress = Progress::new(printer, Clock);
    let targets = targets(progress.target());
    let is_seen = targets.on_terminal || targets.file.is_some();
    let mut preview = is_seen.then(|| LivePreview::new(farm.clone(), job, targets));
    loop {
        let mut away = None;
        let status = farm.status_reporting_outage(job, |gone| {
            if away.is_none() {
                events.emit_outage(farm.url());
            }
            away = Some(gone);
            progress.show_outage(&format!(
                "the coordinator at {} has been away for {}; {} resumes when it is back, and waits up to {}",
                farm.url(),
                human::seconds(gone.as_secs_f64()),
                messages.activity,
                human::seconds(client::RECONNECT_TIMEOUT.as_secs_f64())
            ));
        });
        let status = tokio::select! {
            status = status => Some(status?),
            () = interrupt.wait() => None,
        };
        let Some(status) = status else {
            progress.finish();
            return Err(left());
        };
        if let Some(gone) = away {
            let gone_for = human::seconds(gone.as_secs_f64());
            progress.show_recovery(&format!("the coordinator is back after {gone_for}; {} resumes", messages.activity));
            events.emit_recovery(gone);
        }
        events.emit_status(&status);
        if status.state.has_ended() {
            return Ok(status);
        }
        if let Some(preview) = &mut preview
            && let Some(picture) = preview.latest().await?
        {
            progress.picture(&picture);
        }
        progress.show(&show::progress_snapshot(&status, None));
        tokio::select! {
            () = tokio::time::sleep(POLL_INTERVAL) => {}
            () = interrupt.wait() => {
                progress.finish();
                return Err(left());
            }
        }
    }
}

/// Output of `--json`: one object per line after each change.
struct Events {
    /// `None`: events are not printed.
    printer: Option<Printer>,
    last: Option<JobStatus>,
}

#[derive(Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
enum Event<'a> {
    /// Status of the job.
    Status { job: &'a JobJson },
    /// The coordinator does not answer.
    Away { server: &'a str },
    /// The coordinator answers again after this many seconds.
    Back { seconds: f64 },
}

impl Events {
    fn emit(&self, event: &Event<'_>) {
        if let Some(printer) = self.printer {
            // Serializing an event cannot fail.
            let _ = json::print_line(printer, event);
        }
    }

    fn emit_status(&mut self, status: &JobStatus) {
        // A change of the time alone is not an event.
        let now = Some(JobStatus { seconds: 0.0, ..status.clone() });
        if self.last != now {
            self.emit(&Event::Status { job: &JobJson::from(status) });
            self.last = now;
        }
    }

    fn emit_outage(&self, server: &str) {
        self.emit(&Event::Away { server });
    }

    fn emit_recovery(&self, gone: Duration) {
        self.emit(&Event::Back { seconds: gone.as_secs_f64() });
    }
}

/// Replaces the preview by the last finished frame. Without a finished frame, the preview stays.
async fn write_last_frame(farm: &FarmClient, job: JobId, file: &Path) -> Result<(), Failure> {
    let preview = farm.frames(job).await?.last().and_then(FrameRecord::preview);
    match preview {
        Some(preview) => match farm.get_if_present(&preview).await? {
            Some(bytes) => femc_film::file::write_atomic(file, &bytes).map_err(failed),
            // The frame is lost and is rendered again.
            None => Ok(()),
        },
        None => Ok(()),
    }
}

/// Reports how a job has ended.
fn report_end(args: &WatchArgs, printer: Printer, job: &JobStatus) -> Result<Exit, Failure> {
    for line in show::failure_lines(job) {
        printer.warning(line);
    }
    match show::exit_code(job.state) {
        Some(Exit::Done) => {
            let frames = human::counted_noun(job.frames_total.into(), "frame");
            if above_target(job).is_some() {
                show::error_text(job).into_iter().for_each(|error| printer.note(error));
            }
            let line = format!("job {} is done: {frames} in {}", job.job, human::seconds(job.seconds));
            if args.json {
                printer.note(line);
            } else {
                printer.result(line);
            }
            Ok(Exit::Done)
        }
        _ => Err(failed(format!(
            "job {} has {}: {} of {} frames are finished; `femc status {0}` shows more",
            job.job,
            if job.state == femc_model::JobState::Cancelled { "been cancelled" } else { "failed" },
            job.frames_done,
            job.frames_total
        ))),
    }
}
