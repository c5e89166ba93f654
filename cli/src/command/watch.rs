//! `femc watch JOB`: shows the progress of a job until it ends, and exits with its exit code.

use super::client::{self, Farm};
use super::interrupt::Interrupt;
use super::lookout::{Lookout, Views};
use crate::args::ServerArgs;
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, interrupted};
use crate::output::blocks::Room;
use crate::output::job::JobJson;
use crate::output::{Progress, Say, Stage, human, job as show, json};
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
    preview: When,
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
enum When {
    /// If the terminal supports it.
    Auto,
    /// On every terminal or pipe that shows progress.
    Always,
    /// Not at all.
    Never,
}

impl When {
    fn draws(self, stage: Stage, say: Say) -> bool {
        match (self, stage) {
            (Self::Never, _) | (_, Stage::None) | (Self::Auto, Stage::Lines) => false,
            (Self::Always, Stage::Lines | Stage::Terminal) => true,
            (Self::Auto, Stage::Terminal) => say.true_color() && Room::at_stderr().is_some(),
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
const EVERY: Duration = Duration::from_millis(250);

/// Runs `femc watch`.
pub fn run(args: &WatchArgs, say: Say) -> Result<Exit, Failure> {
    let job = JobId(args.job);
    let last = client::block_on(&args.server, async |farm| {
        let words = Words { who: "the watch", again: format!("`femc watch {job}` resumes the watch") };
        let views = |stage| Views { drawn: args.preview.draws(stage, say), file: args.preview_to.clone() };
        let last = follow(farm, job, &words, args.json.then_some(say), views, say).await?;
        if let Some(file) = &args.preview_to {
            last_frame(farm, job, file).await?;
        }
        Ok(last)
    })?;
    ended(args, say, &last)
}

/// Texts for the messages of a command that follows a job.
pub(super) struct Words {
    /// Name of the activity, such as `the watch`.
    pub(super) who: &'static str,
    /// Command to continue after Ctrl-C.
    pub(super) again: String,
}

/// Shows a job's progress until the job has ended, even if the coordinator is away for a while. Returns the final status.
/// - `events`: output for JSON events.
/// - `views`: destinations of the preview, which depend on whether there is a terminal.
pub(super) async fn follow(
    farm: &Farm,
    job: JobId,
    words: &Words,
    events: Option<Say>,
    views: impl FnOnce(Stage) -> Views,
    say: Say,
) -> Result<JobStatus, Failure> {
    let left = || interrupted(format!("job {job} continues; {}", words.again));
    let mut interrupt = Interrupt::listen()?;
    let mut events = Events { say: events, last: None };
    let mut progress = Progress::new(say, Clock);
    let views = views(progress.stage());
    let is_seen = views.drawn || views.file.is_some();
    let mut lookout = is_seen.then(|| Lookout::new(farm.clone(), job, views));
    loop {
        let mut away = None;
        let status = farm.status_unless_away(job, |gone| {
            if away.is_none() {
                events.away(farm.url());
            }
            away = Some(gone);
            progress.away(&format!(
                "the coordinator at {} has been away for {}; {} resumes when it is back, and waits up to {}",
                farm.url(),
                human::seconds(gone.as_secs_f64()),
                words.who,
                human::seconds(client::PATIENCE.as_secs_f64())
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
            progress.back(&format!("the coordinator is back after {gone_for}; {} resumes", words.who));
            events.back(gone);
        }
        events.status(&status);
        if status.state.has_ended() {
            return Ok(status);
        }
        if let Some(lookout) = &mut lookout
            && let Some(picture) = lookout.latest().await?
        {
            progress.picture(&picture);
        }
        progress.show(&show::snapshot(&status, None));
        tokio::select! {
            () = tokio::time::sleep(EVERY) => {}
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
    say: Option<Say>,
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
    fn tell(&self, event: &Event<'_>) {
        if let Some(say) = self.say {
            // Serializing an event cannot fail.
            let _ = json::line(say, event);
        }
    }

    fn status(&mut self, status: &JobStatus) {
        // A change of the time alone is not an event.
        let now = Some(JobStatus { seconds: 0.0, ..status.clone() });
        if self.last != now {
            self.tell(&Event::Status { job: &JobJson::from(status) });
            self.last = now;
        }
    }

    fn away(&self, server: &str) {
        self.tell(&Event::Away { server });
    }

    fn back(&self, gone: Duration) {
        self.tell(&Event::Back { seconds: gone.as_secs_f64() });
    }
}

/// Replaces the preview by the last finished frame. Without a finished frame, the preview stays.
async fn last_frame(farm: &Farm, job: JobId, file: &Path) -> Result<(), Failure> {
    let preview = farm.frames(job).await?.last().and_then(FrameRecord::preview);
    match preview {
        Some(preview) => match farm.get_if_there(&preview).await? {
            Some(bytes) => femc_film::file::write_atomic(file, &bytes).map_err(failed),
            // The frame is lost and is rendered again.
            None => Ok(()),
        },
        None => Ok(()),
    }
}

/// Reports how a job has ended.
fn ended(args: &WatchArgs, say: Say, job: &JobStatus) -> Result<Exit, Failure> {
    for line in show::trouble(job) {
        say.warning(line);
    }
    match show::exit(job.state) {
        Some(Exit::Done) => {
            let frames = human::count(job.frames_total.into(), "frame");
            if above_target(job).is_some() {
                show::error(job).into_iter().for_each(|error| say.note(error));
            }
            let line = format!("job {} is done: {frames} in {}", job.job, human::seconds(job.seconds));
            if args.json {
                say.note(line);
            } else {
                say.result(line);
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
