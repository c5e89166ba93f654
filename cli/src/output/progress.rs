use super::{Printer, human};
use crate::clock::{Clock, Timestamp};
use femc_model::BlockCounts;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal};
use std::time::Duration;

/// Interval between two lines if stderr is not a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(5);
/// Number of steps of the bar.
const STEPS: u64 = 1000;

/// Progress of a job.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProgressSnapshot {
    /// Frames finished.
    pub frames_done: u64,
    /// Frames of the job.
    pub frames: u64,
    /// Finished tiles of the frames in progress, in this round.
    pub tiles_done: u64,
    /// Tiles of the frames in progress, in this round.
    pub tiles: u64,
    /// Camera samples finished.
    pub samples: u64,
    /// Estimated part of the work that is done, 0..=1.
    pub fraction: f64,
    /// Relative error of the worst frame so far.
    pub relative_error: Option<f64>,
    /// Number of that frame; `None`: the job has one frame, or none was measured.
    pub worst_frame: Option<u32>,
    /// Blocks of that frame.
    pub blocks: Option<BlockCounts>,
}

/// Progress display on stderr: a bar on a terminal, else a line every few seconds.
#[derive(Debug)]
pub struct Progress {
    form: Form,
    clock: Clock,
    started: Timestamp,
    first: Option<ProgressSnapshot>,
}

#[derive(Debug)]
enum Form {
    Silent,
    Bar(ProgressBar),
    Lines { printer: Printer, last: Timestamp, away: Option<Timestamp> },
}

/// Destination of the progress display.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProgressTarget {
    /// Nowhere.
    None,
    /// Lines in a file or a pipe.
    Lines,
    /// A terminal, redrawn in place.
    Terminal,
}

impl Progress {
    /// Creates a progress display that suits stderr; silent with `--quiet`.
    pub fn new(printer: Printer, clock: Clock) -> Self {
        let form = if printer.quiet() {
            Form::Silent
        } else if io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
            let style = ProgressStyle::with_template("{prefix}{bar:28} {percent:>3} %  {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            Form::Bar(bar)
        } else {
            Form::Lines { printer, last: clock.now(), away: None }
        };
        Self { form, clock, started: clock.now(), first: None }
    }

    /// Shows the current progress of a job.
    pub fn show(&mut self, now: &ProgressSnapshot) {
        let first = *self.first.get_or_insert(*now);
        let elapsed = self.clock.since(self.started);
        self.update(now.fraction, || progress_text(&first, now, elapsed));
    }

    /// Shows a text and the finished part of the work, 0..=1.
    pub fn update(&mut self, fraction: f64, text: impl FnOnce() -> String) {
        match &mut self.form {
            Form::Silent => {}
            Form::Bar(bar) => {
                bar.set_message(text());
                bar.set_position((fraction * STEPS as f64) as u64);
            }
            Form::Lines { printer, last, .. } => {
                if self.clock.since(*last) >= LINE_INTERVAL {
                    *last = self.clock.now();
                    printer.note(format!("{:3.0} %  {}", fraction * 100.0, text()));
                }
            }
        }
    }

    /// Shows a text instead of the progress, while the coordinator is away.
    pub fn show_outage(&mut self, text: &str) {
        match &mut self.form {
            Form::Silent => {}
            Form::Bar(bar) => bar.set_message(text.to_owned()),
            Form::Lines { printer, away, .. } => {
                if away.is_none_or(|printed| self.clock.since(printed) >= LINE_INTERVAL) {
                    *away = Some(self.clock.now());
                    printer.note(text);
                }
            }
        }
    }

    /// Shows a text when the coordinator is back.
    pub fn show_recovery(&mut self, text: &str) {
        if let Form::Lines { printer, away, .. } = &mut self.form {
            *away = None;
            printer.note(text);
        }
    }

    /// Returns the destination of the display.
    pub fn target(&self) -> ProgressTarget {
        match &self.form {
            Form::Silent => ProgressTarget::None,
            Form::Lines { .. } => ProgressTarget::Lines,
            Form::Bar(_) => ProgressTarget::Terminal,
        }
    }

    /// Shows a picture: above the bar, replacing the previous one, or as lines.
    pub fn picture(&mut self, text: &str) {
        match &self.form {
            Form::Silent => {}
            Form::Bar(bar) => bar.set_prefix(format!("{text}\n")),
            Form::Lines { printer, .. } => printer.picture(text),
        }
    }

    /// Removes the bar.
    pub fn finish(&mut self) {
        if let Form::Bar(bar) = &self.form {
            bar.finish_and_clear();
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Returns text like `frame 3/24, tile 12/40, 1.25 M samples/s, error 7.1 %, 2 min 3 s left`.
fn progress_text(first: &ProgressSnapshot, now: &ProgressSnapshot, elapsed: Duration) -> String {
    let seconds = elapsed.as_secs_f64();
    let mut text = format!("frame {}/{}, tile {}/{}", now.frames_done, now.frames, now.tiles_done, now.tiles);
    if seconds > 0.0 && now.samples > first.samples {
        let rate = (now.samples - first.samples) as f64 / seconds;
        text += &format!(", {} samples/s", human::quantity(rate));
    }
    if now.blocks.is_some_and(BlockCounts::is_dark) {
        text += ", no light met";
    } else if let Some(error) = now.relative_error.filter(|error| error.is_finite()) {
        text += &format!(", error {}", human::percent(error));
        if let Some(frame) = now.worst_frame {
            text += &format!(" in frame {frame}");
        }
    }
    if now.fraction > first.fraction && now.fraction < 1.0 && seconds > 0.5 {
        let left = seconds * (1.0 - now.fraction) / (now.fraction - first.fraction);
        text += &format!(", {} left", human::seconds(left));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_and_rate_count_only_what_this_run_did() {
        let first = ProgressSnapshot {
            frames: 4,
            frames_done: 2,
            fraction: 0.5,
            samples: 1_000_000,
            ..ProgressSnapshot::default()
        };
        let now =
            ProgressSnapshot { frames_done: 3, fraction: 0.75, samples: 3_000_000, tiles_done: 3, tiles: 8, ..first };
        assert_eq!(
            progress_text(&first, &now, Duration::from_secs(10)),
            "frame 3/4, tile 3/8, 200 k samples/s, 10.0 s left"
        );
    }

    #[test]
    fn the_error_of_a_job_names_its_worst_frame() {
        let first = ProgressSnapshot { frames: 4, ..ProgressSnapshot::default() };
        let now = ProgressSnapshot { relative_error: Some(0.071), worst_frame: Some(3), ..first };
        assert_eq!(progress_text(&first, &now, Duration::ZERO), "frame 0/4, tile 0/0, error 7.10 % in frame 3");
    }

    #[test]
    fn a_frame_that_met_no_light_has_not_converged() {
        let first = ProgressSnapshot { frames: 1, ..ProgressSnapshot::default() };
        let dark =
            ProgressSnapshot { relative_error: Some(0.0), blocks: Some(BlockCounts { all: 4, unlit: 4 }), ..first };
        assert_eq!(progress_text(&first, &dark, Duration::ZERO), "frame 0/1, tile 0/0, no light met");
    }

    #[test]
    fn a_job_that_has_not_begun_promises_nothing() {
        let first = ProgressSnapshot { frames: 4, ..ProgressSnapshot::default() };
        assert_eq!(progress_text(&first, &first, Duration::ZERO), "frame 0/4, tile 0/0");
    }
}
