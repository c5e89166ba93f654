//! Task graphs: the stages of a job, the kinds of their tasks, and the roles of their outputs.
//!
//! The engine plans a job as a [`Graph`], the farm schedules it, and workers execute its tasks.
#![deny(missing_docs)]

mod graph;
mod kind;
mod role;
pub mod tag;
mod update;

pub use graph::{Graph, Hint, Loop, Need, Reach, Round, Scope, StageTemplate, TaskSizes};
pub use kind::{Affinity, Lane, LogDestination, StageKind, StageKindProperties};
pub use role::{Role, RoleProperties};

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_tables_are_whole_and_no_name_is_there_twice() {
        for (index, kind) in StageKind::ALL.into_iter().enumerate() {
            assert_eq!(kind.index(), index);
        }
        for (index, role) in Role::ALL.into_iter().enumerate() {
            assert_eq!(role.index(), index);
        }
        let kinds: BTreeSet<&str> = StageKind::ALL.iter().map(|kind| kind.name()).collect();
        let roles: BTreeSet<&str> = Role::ALL.iter().map(|role| role.name()).collect();
        assert_eq!((kinds.len(), roles.len()), (StageKind::ALL.len(), Role::ALL.len()));
    }
}
