//! Selection of jobs.

use super::notes::label;
use clap::Args;
use femc_model::JobStatus;

/// Jobs by owner, name and labels.
#[derive(Clone, Debug, Default, Args)]
pub struct SelectArgs {
    /// Jobs of this owner
    #[arg(long, value_name = "NAME")]
    pub owner: Option<String>,
    /// Jobs of this name; * matches any text, like 'fog-*'
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Jobs that have this label; repeatable
    #[arg(long = "label", value_name = "NAME=VALUE", value_parser = label)]
    pub labels: Vec<(String, String)>,
}

impl SelectArgs {
    /// Returns whether no condition is given.
    pub fn is_empty(&self) -> bool {
        self.owner.is_none() && self.name.is_none() && self.labels.is_empty()
    }

    /// Returns whether a job fits all conditions.
    pub fn matches(&self, job: &JobStatus) -> bool {
        self.owner.as_ref().is_none_or(|owner| *owner == job.owner)
            && self.name.as_ref().is_none_or(|name| glob_match(name, &job.name))
            && self
                .labels
                .iter()
                .all(|(name, value)| job.notes.labels.get(name).is_some_and(|other| glob_match(value, other)))
    }
}

/// Returns whether a text matches a pattern, in which each * matches any text.
pub fn glob_match(pattern: &str, text: &str) -> bool {
    let Some((head, mut rest)) = pattern.split_once('*') else { return pattern == text };
    let Some(mut text) = text.strip_prefix(head) else { return false };
    while let Some((part, next)) = rest.split_once('*') {
        // The first match is enough: the rest of the pattern may begin anywhere behind it.
        let Some(at) = text.find(part) else { return false };
        text = &text[at + part.len()..];
        rest = next;
    }
    text.ends_with(rest)
}

#[cfg(test)]
mod tests {
    use super::glob_match;

    #[test]
    fn a_star_is_any_text() {
        for (pattern, text) in
            [("fog", "fog"), ("*", ""), ("fog-*", "fog-12"), ("*-12", "fog-12"), ("f*g*2", "fog-12"), ("a*a", "aa")]
        {
            assert!(glob_match(pattern, text), "{pattern} {text}");
        }
        for (pattern, text) in [("fog", "fog-1"), ("fog-*", "fo"), ("*-12", "fog-1"), ("a*a", "a"), ("a*b*a", "aba-")] {
            assert!(!glob_match(pattern, text), "{pattern} {text}");
        }
    }
}
