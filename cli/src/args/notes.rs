//! Notes on a job: what people find it by, and who is told of its end.

use crate::exit::{Failure, usage};
use clap::Args;
use femc_model::{JobNotes, JobSpec};

/// Notes on a job.
#[derive(Clone, Debug, Default, Args)]
pub struct NotesArgs {
    /// A line for people about the job
    #[arg(long, value_name = "TEXT")]
    comment: Option<String>,
    /// A name and a value to find the job by; may be given again
    #[arg(long = "label", value_name = "NAME=VALUE", value_parser = label)]
    labels: Vec<(String, String)>,
    /// The coordinator posts a message there when the job has ended; only URLs that it allows (`femc coordinator --notify-allow`)
    #[arg(long, value_name = "URL")]
    notify: Option<String>,
}

impl NotesArgs {
    /// Notes of a job file with those of the command line in their place.
    pub fn over(&self, file: JobNotes) -> Result<JobNotes, Failure> {
        let mut notes = file;
        if let Some(comment) = &self.comment {
            notes.comment.clone_from(comment);
        }
        notes.labels.extend(self.labels.iter().cloned());
        notes.notify = self.notify.clone().or(notes.notify);
        notes.check().map_err(usage)?;
        Ok(notes)
    }
}

/// A label as typed.
pub fn label(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("give NAME=VALUE, like shot=12".to_owned()),
    }
}

/// A name that a job can have.
pub fn job_name(text: &str) -> Result<String, String> {
    if text.len() > JobSpec::MAX_NAME {
        return Err(format!("a name has {} bytes at most", JobSpec::MAX_NAME));
    }
    if !JobSpec::names_files(text) {
        return Err(
            "the frames' files are named by it: it is not empty, and has no /, \\, : or control characters".into()
        );
    }
    Ok(text.to_owned())
}
