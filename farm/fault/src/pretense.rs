//! Processes that say that they are of another version than they are.

use std::sync::LazyLock;

/// What a process may be made to say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pretense {
    /// The version of its protocol.
    Protocol,
    /// The build of its engine.
    Engine,
    /// Tiles of a group, of a client: small frames have groups, too.
    Fan,
    /// Blocks of a first pass, of a client: those of small scenes are cut, too.
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

/// What the process is to say instead of the truth, by `FEMC_PRETEND`; `None`: the truth.
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
