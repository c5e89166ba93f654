//! Pretended versions: processes that report other values than their own.

use std::sync::LazyLock;

/// A value that a process can be made to report falsely.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pretense {
    /// Version of the protocol.
    Protocol,
    /// Build of the engine.
    Engine,
    /// Number of tiles in a group, for a client: this gives small frames groups, too.
    Fan,
    /// Number of blocks of a first pass, for a client: this splits the first pass of small scenes, too.
    Blocks,
}

impl Pretense {
    const fn name(self) -> &'static str {
        match self {
            Self::Protocol => "protocol",
            Self::Engine => "engine",
            Self::Fan => "fan",
            Self::Blocks => "blocks",
        }
    }
}

/// Returns the value of `what` in `FEMC_PRETEND`; `None`: the process reports its true value.
pub fn pretended(what: Pretense) -> Option<&'static str> {
    static ASKED: LazyLock<String> = LazyLock::new(|| std::env::var("FEMC_PRETEND").unwrap_or_default());
    if !cfg!(debug_assertions) {
        return None;
    }
    value(&ASKED, what)
}

fn value(asked: &str, what: Pretense) -> Option<&str> {
    asked
        .split(',')
        .find_map(|pair| pair.split_once('=').filter(|(name, _)| *name == what.name()))
        .map(|(_, value)| value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pretense_has_its_name() {
        let asked = "protocol=3,engine=old=1";
        assert_eq!((value(asked, Pretense::Protocol), value(asked, Pretense::Engine)), (Some("3"), Some("old=1")));
        assert_eq!(value("", Pretense::Engine), None);
    }
}
