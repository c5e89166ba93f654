//! Notes on a job: a comment, labels, and an address that is notified when the job ends. They affect neither pixels nor scheduling
//! order.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Notes that a job is submitted with.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobNotes {
    /// A line for users; empty: none.
    pub comment: String,
    /// Names and values to find the job by, such as the values of one variant of a sweep.
    pub labels: BTreeMap<String, String>,
    /// URL to which the coordinator posts a message when the job has ended; `None`: no message. Coordinators accept only allowed
    /// URLs.
    pub notify: Option<String>,
}

impl JobNotes {
    /// Maximum length of a comment in bytes.
    pub const MAX_COMMENT: usize = 4096;
    /// Maximum number of labels.
    pub const MAX_LABELS: usize = 64;
    /// Maximum length in bytes of the name of a label, and of its value.
    pub const MAX_LABEL: usize = 256;
    /// Maximum length of a URL in bytes.
    pub const MAX_URL: usize = 2048;

    /// Checks the limits, and that no text contains control characters.
    ///
    /// # Errors
    /// The error names the field and its fault.
    pub fn check(&self) -> Result<(), NotesError> {
        let Self { comment, labels, notify } = self;
        if comment.len() > Self::MAX_COMMENT {
            return Err(NotesError::TooLong { what: "comment", limit: Self::MAX_COMMENT });
        }
        if comment.contains(char::is_control) {
            return Err(NotesError::ControlCharacters { what: "comment" });
        }
        if labels.len() > Self::MAX_LABELS {
            return Err(NotesError::Labels { labels: labels.len() });
        }
        for (name, value) in labels {
            if name.is_empty() || name.contains('=') {
                return Err(NotesError::LabelName { name: name.escape_default().to_string() });
            }
            if name.len().max(value.len()) > Self::MAX_LABEL {
                return Err(NotesError::TooLong { what: "label", limit: Self::MAX_LABEL });
            }
            if [name, value].into_iter().any(|text| text.contains(char::is_control)) {
                return Err(NotesError::ControlCharacters { what: "label" });
            }
        }
        match notify {
            Some(url) if url.len() > Self::MAX_URL => {
                Err(NotesError::TooLong { what: "URL to notify", limit: Self::MAX_URL })
            }
            Some(url) if url.contains(char::is_control) => Err(NotesError::ControlCharacters { what: "URL to notify" }),
            _ => Ok(()),
        }
    }
}

/// Error in a job's notes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NotesError {
    /// A text is longer than its limit.
    #[error("the {what} is too long: at most {limit} bytes")]
    TooLong {
        /// Name of the text.
        what: &'static str,
        /// Limit in bytes.
        limit: usize,
    },
    /// A text contains control characters, which could control a terminal.
    #[error("the {what} contains control characters, such as line breaks; write it as one line of text")]
    ControlCharacters {
        /// Name of the text.
        what: &'static str,
    },
    /// There are too many labels.
    #[error("the job has {labels} labels, at most {} are possible", JobNotes::MAX_LABELS)]
    Labels {
        /// Number of labels.
        labels: usize,
    },
    /// A label's name cannot be separated from its value.
    #[error("invalid label name `{name}`: it must not be empty or contain `=`")]
    LabelName {
        /// Name of the label.
        name: String,
    },
}

impl NotesError {
    /// Returns the name of the invalid field.
    pub fn field(&self) -> &'static str {
        match self {
            Self::TooLong { what: "comment", .. } | Self::ControlCharacters { what: "comment" } => "comment",
            Self::TooLong { what: "label", .. }
            | Self::ControlCharacters { what: "label" }
            | Self::Labels { .. }
            | Self::LabelName { .. } => "labels",
            Self::TooLong { .. } | Self::ControlCharacters { .. } => "notify",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labeled(name: &str, value: &str) -> JobNotes {
        JobNotes { labels: [(name.to_owned(), value.to_owned())].into(), ..JobNotes::default() }
    }

    #[test]
    fn oversized_notes_and_terminal_control_texts_are_refused() {
        let long = |n| "x".repeat(n);
        let good = JobNotes {
            comment: long(4096),
            labels: (0..64).map(|number| (number.to_string(), long(256))).collect(),
            notify: Some(long(2048)),
        };
        assert_eq!(good.check(), Ok(()));
        assert_eq!(labeled("medium.fog.sigma_s", "").check(), Ok(()));
        let refused = [
            JobNotes { comment: long(4097), ..good.clone() },
            JobNotes { comment: "a\u{1b}[2J".into(), ..good.clone() },
            JobNotes { labels: (0..65).map(|number| (number.to_string(), String::new())).collect(), ..good.clone() },
            JobNotes { notify: Some(long(2049)), ..good.clone() },
            JobNotes { notify: Some("http://a/\n".into()), ..good },
            labeled("", "a"),
            labeled("a=b", "c"),
            labeled(&long(257), "a"),
            labeled("a", &long(257)),
            labeled("a\t", "b"),
            labeled("a", "b\r"),
        ];
        for notes in refused {
            assert!(notes.check().is_err(), "{notes:?}");
        }
    }
}
