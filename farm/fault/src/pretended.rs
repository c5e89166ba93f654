//! Pretended versions: processes that report other values than their own.

use std::sync::LazyLock;

/// A value that a process can be made to report falsely.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PretendedValue {
    /// Version of the protocol.
    Protocol,
    /// Build of the engine.
    Engine,
    /// Number of tiles in a group, for a client: this gives small frames groups, too.
    Fan,
    /// Number of blocks of a first pass, for a client: this splits the first pass of small scenes, too.
    Blocks,
}

impl PretendedValue {
    const fn name(self) -> &'static str {
        match self {
            Self::Protocol => "protocol",
            Self::Engine => "engine",
            Self::Fan => "fan",
            Self::Blocks => "blocks",
        }
    }
}

/// Returns the value of `wanted` in `FEMC_PRETEND`; `None`: the process reports its true value.
pub fn pretended_value(wanted: PretendedValue) -> Option<&'static str> {
    static PRETEND: LazyLock<String> = LazyLock::new(|| std::env::var("FEMC_PRETEND").unwrap_or_default());
    if !cfg!(debug_assertions) {
        return None;
    }
    find_value(&PRETEND, wanted)
}

fn find_value(variable: &str, what: PretendedValue) -> Option<&str> {
    variable
        .split(',')
        .find_map(|pair| pair.split_once('=').filter(|(name, _)| *name == what.name()))
        .map(|(_, value)| value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pretense_has_its_name() {
        let variable = "protocol=3,engine=old=1";
        assert_eq!(
            (find_value(variable, PretendedValue::Protocol), find_value(variable, PretendedValue::Engine)),
            (Some("3"), Some("old=1"))
        );
        assert_eq!(find_value("", PretendedValue::Engine), None);
    }
}
