//! Which jobs are meant.

use super::notes::label;
use clap::Args;
use femc_model::JobStatus;

/// Jobs by what they are.
#[derive(Clone, Debug, Default, Args)]
pub struct SelectArgs {
    /// Jobs of this owner
    #[arg(long, value_name = "NAME")]
    pub owner: Option<String>,
    /// Jobs of this name; * stands for any text, like 'fog-*'
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Jobs that have this label; may be given again
    #[arg(long = "label", value_name = "NAME=VALUE", value_parser = label)]
    pub labels: Vec<(String, String)>,
}

impl SelectArgs {
    /// Whether nothing was said.
    pub fn is_empty(&self) -> bool {
        self.owner.is_none() && self.name.is_none() && self.labels.is_empty()
    }

    /// Whether a job is meant.
    pub fn holds(&self, job: &JobStatus) -> bool {
        self.owner.as_ref().is_none_or(|owner| *owner == job.owner)
            && self.name.as_ref().is_none_or(|name| fits(name, &job.name))
            && self
                .labels
                .iter()
                .all(|(name, value)| job.notes.labels.get(name).is_some_and(|other| fits(value, other)))
    }
}

/// Whether a text is so, where each * stands for any text.
pub fn fits(pattern: &str, text: &str) -> bool {
    let Some((head, mut rest)) = pattern.split_once('*') else { return pattern == text };
    let Some(mut text) = text.strip_prefix(head) else { return false };
    while let Some((part, next)) = rest.split_once('*') {
        // The first place is as good as any: what follows may begin anywhere behind it.
        let Some(at) = text.find(part) else { return false };
        text = &text[at + part.len()..];
        rest = next;
    }
    text.ends_with(rest)
}

#[cfg(test)]
mod tests {
    use super::fits;

    #[test]
    fn a_star_is_any_text() {
        for (pattern, text) in
            [("fog", "fog"), ("*", ""), ("fog-*", "fog-12"), ("*-12", "fog-12"), ("f*g*2", "fog-12"), ("a*a", "aa")]
        {
            assert!(fits(pattern, text), "{pattern} {text}");
        }
        for (pattern, text) in [("fog", "fog-1"), ("fog-*", "fo"), ("*-12", "fog-1"), ("a*a", "a"), ("a*b*a", "aba-")] {
            assert!(!fits(pattern, text), "{pattern} {text}");
        }
    }
}
