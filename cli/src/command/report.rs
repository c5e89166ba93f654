//! `femc report JOB`: writes a page about jobs, or about the light of frames.

use super::subject::{self, IncludedLogs, Subject};
use crate::args::ServerArgs;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::Printer;
use clap::Args;
use femc_reports::light::{BottleneckReport, read};
use femc_reports::pages::{JobsReport, light};
use std::path::{Path, PathBuf};

/// Write a page about jobs: workers over time, durations, errors, samples, cost, failures; or about the light of frames
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc report 7 -o report.html\n  \
    femc report fog                            # the sweep in the folder fog, without a farm\n  \
    femc watch 7 && femc report 7 && xdg-open job-7.html\n  \
    femc report box.paths                      # box.html: maps and histograms of a frame's light\n\n\
    The page is one file and needs no network. `femc stats` prints the numbers of jobs; `femc paths` and `femc bottlenecks` print the numbers of light.")]
pub struct ReportArgs {
    /// Job numbers, or folders of sweeps that have ended; or light statistics (.paths) of frames
    #[arg(value_name = "JOB|DIR|FRAME.paths", required = true)]
    subjects: Vec<Subject>,
    /// File to write [default: job-JOB.html, DIR/report.html for a sweep, FRAME.html for a frame]
    #[arg(long, short, value_name = "FILE.html")]
    out: Option<PathBuf>,
    #[command(flatten)]
    server: ServerArgs,
}

/// Runs `femc report`.
pub fn run(args: &ReportArgs, printer: Printer) -> Result<Exit, Failure> {
    if let Some(files) = light_files(&args.subjects)? {
        return light_page(args, &files, printer);
    }
    let records = subject::records(&args.subjects, IncludedLogs::Failures, &args.server)?;
    let out = args.out.clone().unwrap_or_else(|| match &args.subjects[..] {
        [Subject::Job(job)] => format!("job-{job}.html").into(),
        [Subject::Sweep(folder)] => folder.join("report.html"),
        _ => "jobs.html".into(),
    });
    let title = match &args.subjects[..] {
        [Subject::Sweep(folder)] => Some(folder.display().to_string()),
        _ => None,
    };
    femc_film::file::write_atomic(&out, JobsReport { title, records }.html()?.as_bytes()).map_err(failed)?;
    printer.result(out.display());
    Ok(Exit::Done)
}

/// Returns the statistics files, if the page is about light.
fn light_files(subjects: &[Subject]) -> Result<Option<Vec<PathBuf>>, Failure> {
    let is_light = |path: &Path| path.extension().is_some_and(|extension| extension == "paths");
    let files: Vec<PathBuf> = subjects
        .iter()
        .filter_map(|subject| match subject {
            Subject::Sweep(path) if is_light(path) && !path.is_dir() => Some(path.clone()),
            _ => None,
        })
        .collect();
    match files.len() {
        0 => Ok(None),
        count if count < subjects.len() => {
            Err(usage("a page shows either jobs and sweeps, or the light of frames (FRAME.paths)"))
        }
        count if count > light::MAX_FILES => Err(usage(format!(
            "{count} files: a page shows at most {}; `femc bottlenecks` accepts all of them",
            light::MAX_FILES
        ))),
        _ => Ok(Some(files)),
    }
}

fn light_page(args: &ReportArgs, files: &[PathBuf], printer: Printer) -> Result<Exit, Failure> {
    let mut frames = Vec::new();
    for file in files {
        let set = read(file)?;
        let is_one = set.frames.len() == 1;
        for statistics in set.frames {
            // In a union, the frame numbers distinguish the frames.
            let number = statistics.scope.frame;
            let name = if is_one { file.clone() } else { format!("{}, frame {number}", file.display()).into() };
            frames.push((name, statistics));
        }
    }
    if frames.len() > light::MAX_FILES {
        return Err(usage(format!(
            "{} frames: a page shows at most {}; `femc bottlenecks` accepts all of them",
            frames.len(),
            light::MAX_FILES
        )));
    }
    let out = args.out.clone().unwrap_or_else(|| match files {
        [one] => one.with_extension("html"),
        _ => "light.html".into(),
    });
    let page = light::html(&frames, &BottleneckReport::from_frames(&frames))?;
    femc_film::file::write_atomic(&out, page.as_bytes()).map_err(failed)?;
    printer.result(out.display());
    Ok(Exit::Done)
}
