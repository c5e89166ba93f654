//! Groups of mutants: which sources are changed, and what must detect the changes.

/// A group of source files and of the tests that guard them.
#[derive(Debug)]
pub struct Group {
    /// Name on the command line. Its list is `sim/mutants/NAME`.
    pub name: &'static str,
    /// Source files that are mutated.
    pub files: &'static [&'static str],
    /// Crates of these files, with their folders.
    pub crates: &'static [(&'static str, &'static str)],
    /// Tests that must detect the mutants.
    pub tests: Tests,
}

/// Tests of a group.
#[derive(Debug)]
pub enum Tests {
    /// Tests of the crate of the mutant, and simulated farms.
    CrateAndWorlds,
    /// Tests of the crate of the mutant.
    Crate,
    /// Tests of all crates of the group whose names contain one of these words.
    AllNamed(&'static [&'static str]),
}

/// All groups.
pub const GROUPS: [Group; 4] = [
    Group {
        name: "farm",
        files: &[
            "farm/schedule/src/**/*.rs",
            "farm/queue/src/**/*.rs",
            "farm/store/src/**/*.rs",
            "coordinator/src/session.rs",
            "coordinator/src/janitor.rs",
            "coordinator/src/actor.rs",
            "coordinator/src/queries.rs",
            "coordinator/src/roster.rs",
            "coordinator/src/worker_events.rs",
            "worker/src/outbox/*.rs",
            "worker/src/claims.rs",
            "worker/src/session.rs",
        ],
        crates: &[
            ("femc-schedule", "farm/schedule"),
            ("femc-queue", "farm/queue"),
            ("femc-store", "farm/store"),
            ("femc-coordinator", "coordinator"),
            ("femc-worker", "worker"),
        ],
        tests: Tests::CrateAndWorlds,
    },
    Group {
        name: "light",
        files: &["engine/paths/src/query/*.rs", "engine/layers/src/*.rs", "engine/montecarlo/src/guided.rs"],
        crates: &[
            ("femc-paths", "engine/paths"),
            ("femc-layers", "engine/layers"),
            ("femc-montecarlo", "engine/montecarlo"),
        ],
        tests: Tests::Crate,
    },
    Group {
        name: "views",
        files: &["farm/service/src/feed/mod.rs", "farm/service/src/picture.rs"],
        crates: &[("femc-service", "farm/service")],
        tests: Tests::Crate,
    },
    Group {
        name: "commands",
        files: &[
            "cli/src/command/sweep/*.rs",
            "cli/src/command/stylize/*.rs",
            "worker/src/execute/encode_*.rs",
            "worker/src/execute/paint.rs",
        ],
        crates: &[("femc", "cli"), ("femc-worker", "worker")],
        tests: Tests::AllNamed(&["sweep", "stylize", "encode", "paint", "oracles"]),
    },
];

impl Group {
    /// Returns the group of a name.
    pub fn from_name(name: &str) -> Result<&'static Self, String> {
        let names = || GROUPS.iter().map(|group| group.name).collect::<Vec<_>>().join(", ");
        GROUPS.iter().find(|group| group.name == name).ok_or_else(|| format!("unknown group; known: {}", names()))
    }

    /// Returns whether simulated farms run the mutants, too.
    pub fn has_worlds(&self) -> bool {
        matches!(self.tests, Tests::CrateAndWorlds)
    }

    /// Returns the crates whose tests guard a mutant.
    /// - `package`: crate of the mutant.
    pub fn tested_crates(&self, package: &str) -> impl Iterator<Item = &'static str> {
        let is_tested = move |name: &str| matches!(self.tests, Tests::AllNamed(_)) || name == package;
        self.crates.iter().map(|(name, _)| *name).filter(move |name| is_tested(name))
    }

    /// Returns the arguments of the test programs.
    pub fn test_arguments(&self) -> &'static [&'static str] {
        match self.tests {
            Tests::AllNamed(words) => words,
            Tests::CrateAndWorlds | Tests::Crate => &[],
        }
    }
}
