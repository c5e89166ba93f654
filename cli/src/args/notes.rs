//! Notes on a job: comment, labels, and the URL that is notified of its end.

use crate::exit::{Failure, usage};
use clap::Args;
use femc_model::{JobNotes, JobSpec};

/// Notes on a job.
#[derive(Clone, Debug, Default, Args)]
pub struct NotesArgs {
    /// Comment on the job, one line
    #[arg(long, value_name = "TEXT")]
    comment: Option<String>,
    /// Label to find the job by; repeatable
    #[arg(long = "label", value_name = "NAME=VALUE", value_parser = label)]
    labels: Vec<(String, String)>,
    /// URL to which the coordinator posts a message when the job has ended; the coordinator must allow it
    /// (`femc coordinator --notify-allow`)
    #[arg(long, value_name = "URL")]
    notify: Option<String>,
}

impl NotesArgs {
    /// Merges the notes of the command line into the notes of a job file. The command line wins.
    pub fn merge_over(&self, file: JobNotes) -> Result<JobNotes, Failure> {
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

/// Parses a label.
pub fn label(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("give NAME=VALUE, like shot=12".to_owned()),
    }
}

/// Parses the name of a job.
pub fn job_name(text: &str) -> Result<String, String> {
    if text.len() > JobSpec::MAX_NAME {
        return Err(format!("a name has at most {} bytes", JobSpec::MAX_NAME));
    }
    if !JobSpec::is_valid_name(text) {
        return Err(
            "it becomes part of file names; it must not be empty or contain /, \\, : or control characters".into()
        );
    }
    Ok(text.to_owned())
}
