//! `femc watch JOB`: progress until the job ends, then its exit code.

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
    femc watch 7 --preview-to now.png    # a picture of the frame in work, again and again\n\n\
    Ctrl-C leaves the watch (exit code 3) and not the job.")]
pub struct WatchArgs {
    /// The job's number, as `submit` printed it
    #[arg(value_name = "JOB")]
    job: u64,
    /// Draw the frame in work above the bar, as far as it is done: with auto on a terminal with room whose COLORTERM says
    /// that it has 24-bit colors
    #[arg(
        long,
        value_name = "WHEN",
        default_value = "auto",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "always"
    )]
    preview: When,
    /// Keep this file up to date with the frame in work, as far as it is done; at the end it is the last frame
    #[arg(long, value_name = "FILE.png", value_parser = png)]
    preview_to: Option<PathBuf>,
    /// Print JSON on stdout, for machines: an object a line whenever the job's status changes, or the coordinator goes away or
    /// comes back
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    server: ServerArgs,
}

/// Whether to draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum When {
    /// Where it can be seen.
    Auto,
    /// Wherever progress is shown.
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

/// Between two looks.
const EVERY: Duration = Duration::from_millis(250);

/// Watch.
pub fn run(args: &WatchArgs, say: Say) -> Result<Exit, Failure> {
    let job = JobId(args.job);
    let last = client::block_on(&args.server, async |farm| {
        let words = Words { who: "the watch", again: format!("`femc watch {job}` looks again") };
        let views = |stage| Views { drawn: args.preview.draws(stage, say), file: args.preview_to.clone() };
        let last = follow(farm, job, &words, args.json.then_some(say), views, say).await?;
        if let Some(file) = &args.preview_to {
            last_frame(farm, job, file).await?;
        }
        Ok(last)
    })?;
    ended(args, say, &last)
}

/// Words of the messages that a command prints while it follows a job.
pub(super) struct Words {
    /// Such as `the watch`.
    pub(super) who: &'static str,
    /// How to go on after Ctrl-C.
    pub(super) again: String,
}

/// Shows a job's progress until it has ended, also while the coordinator is away for a while; returns how it stands then.
/// - `events`: where every change is printed, for machines.
/// - `views`: which pictures are kept, on a terminal or without one.
pub(super) async fn follow(
    farm: &Farm,
    job: JobId,
    words: &Words,
    events: Option<Say>,
    views: impl FnOnce(Stage) -> Views,
    say: Say,
) -> Result<JobStatus, Failure> {
    let left = || interrupted(format!("job {job} goes on; {}", words.again));
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
                "the coordinator at {} has been away for {}; {} goes on when it is back, and waits {}",
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
            progress.back(&format!("the coordinator is back after {gone_for}; {} goes on", words.who));
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

/// What `--json` prints: an object a line, when there is something new.
struct Events {
    /// `None`: it is not wanted.
    say: Option<Say>,
    last: Option<JobStatus>,
}

#[derive(Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
enum Event<'a> {
    /// How the job stands.
    Status { job: &'a JobJson },
    /// The coordinator does not answer.
    Away { server: &'a str },
    /// It answers again, after so many seconds.
    Back { seconds: f64 },
}

impl Events {
    fn tell(&self, event: &Event<'_>) {
        if let Some(say) = self.say {
            // An event can always be written.
            let _ = json::line(say, event);
        }
    }

    fn status(&mut self, status: &JobStatus) {
        // Time alone is nothing new.
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

/// The last finished frame takes the place of what there was of it; without one, what there was stays.
async fn last_frame(farm: &Farm, job: JobId, file: &Path) -> Result<(), Failure> {
    let preview = farm.frames(job).await?.last().and_then(FrameRecord::preview);
    match preview {
        Some(preview) => match farm.get_if_there(&preview).await? {
            Some(bytes) => femc_film::file::write_atomic(file, &bytes).map_err(failed),
            // Its frame is rendered again.
            None => Ok(()),
        },
        None => Ok(()),
    }
}

/// Say how a job has ended.
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
            "job {} has {}: {} of {} frames are finished; `femc status {0}` tells more",
            job.job,
            if job.state == femc_model::JobState::Cancelled { "been cancelled" } else { "failed" },
            job.frames_done,
            job.frames_total
        ))),
    }
}
