//! Job graphs: stages, inputs and outputs.

use femc_model::{Graph, Hint, Loop, Need, Output, Reach, Role, Round, Scope, StageKind, StageTemplate, TaskSizes};

use super::{ConvertError, convert_all, convert_optional, required};
use crate::wire;

/// Returns the wire number of a row of the farm's tables: its index plus 1.
fn wire_number(index: usize) -> i32 {
    index as i32 + 1
}

/// Returns the row with this wire number.
fn from_wire_number<T: Copy>(table: &[T], field: &'static str, value: i32) -> Result<T, ConvertError> {
    let index = usize::try_from(value).ok().and_then(|number| number.checked_sub(1));
    index.and_then(|place| table.get(place)).copied().ok_or(ConvertError::Unknown { field, value })
}

pub(super) fn kind_number(kind: StageKind) -> i32 {
    wire_number(kind.index())
}

pub(super) fn kind(value: i32) -> Result<StageKind, ConvertError> {
    from_wire_number(&StageKind::ALL, "stage.kind", value)
}

fn role_number(role: Role) -> i32 {
    wire_number(role.index())
}

fn role(value: i32) -> Result<Role, ConvertError> {
    from_wire_number(&Role::ALL, "output.role", value)
}

/// Converts the number of a stage in a graph.
pub(super) fn stage(value: u32) -> Result<u16, ConvertError> {
    value.try_into().map_err(|_| ConvertError::Range { field: "stage" })
}

impl From<Output> for wire::Output {
    fn from(Output { role, artifact }: Output) -> Self {
        Self { role: role_number(role), artifact: Some(artifact.into()) }
    }
}

impl TryFrom<wire::Output> for Output {
    type Error = ConvertError;

    fn try_from(wire: wire::Output) -> Result<Self, ConvertError> {
        Ok(Self { role: role(wire.role)?.updated(), artifact: required("output.artifact", wire.artifact)?.try_into()? })
    }
}

impl From<Graph> for wire::Graph {
    fn from(graph: Graph) -> Self {
        Self { stages: graph.stages.into_iter().map(Into::into).collect() }
    }
}

impl TryFrom<wire::Graph> for Graph {
    type Error = ConvertError;

    fn try_from(wire: wire::Graph) -> Result<Self, ConvertError> {
        // Clients of earlier versions send their kinds and roles.
        Ok(Self { stages: convert_all(wire.stages)? }.updated())
    }
}

impl From<StageTemplate> for wire::Template {
    fn from(template: StageTemplate) -> Self {
        let StageTemplate { kind, scope, sizes, steps, needs, hints, outputs: makes, closes, options, tags } = template;
        let scope = match scope {
            Scope::Job => wire::Scope::Job,
            Scope::Frame => wire::Scope::Frame,
            Scope::Content => wire::Scope::Content,
        };
        Self {
            kind: kind_number(kind),
            scope: scope.into(),
            sizes: sizes.runs().iter().map(|&(tasks, units)| wire::Sizes { tasks, units }).collect(),
            steps,
            needs: needs.into_iter().map(Into::into).collect(),
            hints: hints.into_iter().map(Into::into).collect(),
            makes: makes.into_iter().map(role_number).collect(),
            closes: closes.map(|Loop { first, rounds }| wire::Loop { first: first.into(), rounds }),
            options,
            tags,
        }
    }
}

impl TryFrom<wire::Template> for StageTemplate {
    type Error = ConvertError;

    fn try_from(wire: wire::Template) -> Result<Self, ConvertError> {
        let wire::Template { kind: kind_value, scope, sizes, steps, needs, hints, makes, closes, options, tags } = wire;
        Ok(Self {
            kind: kind(kind_value)?,
            scope: match wire::Scope::try_from(scope) {
                Ok(wire::Scope::Job) => Scope::Job,
                Ok(wire::Scope::Frame) => Scope::Frame,
                Ok(wire::Scope::Content) => Scope::Content,
                Ok(wire::Scope::Unspecified) | Err(_) => {
                    return Err(ConvertError::Unknown { field: "stage.scope", value: scope });
                }
            },
            sizes: sizes.into_iter().map(|wire::Sizes { tasks, units }| (tasks, units)).collect::<TaskSizes>(),
            steps,
            needs: convert_all(needs)?,
            hints: convert_all(hints)?,
            outputs: makes.into_iter().map(role).collect::<Result<_, _>>()?,
            closes: convert_optional(closes)?,
            options,
            tags,
        })
    }
}

impl TryFrom<wire::Loop> for Loop {
    type Error = ConvertError;

    fn try_from(wire::Loop { first, rounds }: wire::Loop) -> Result<Self, ConvertError> {
        Ok(Self { first: stage(first)?, rounds })
    }
}

/// Defines the conversions of a [`Reach`], which two wire messages contain.
macro_rules! impl_reach {
    ($($wire:ident)::+) => {
        impl From<Reach> for $($wire)::+ {
            fn from(reach: Reach) -> Self {
                match reach {
                    Reach::All => Self::All(wire::Empty {}),
                    Reach::Same => Self::Same(wire::Empty {}),
                    Reach::Fan(tasks) => Self::Fan(tasks),
                    Reach::Previous => Self::Previous(wire::Empty {}),
                }
            }
        }

        impl From<$($wire)::+> for Reach {
            fn from(wire: $($wire)::+) -> Self {
                match wire {
                    $($wire)::+::All(_) => Self::All,
                    $($wire)::+::Same(_) => Self::Same,
                    $($wire)::+::Fan(tasks) => Self::Fan(tasks),
                    $($wire)::+::Previous(_) => Self::Previous,
                }
            }
        }
    };
}

impl_reach!(wire::need::Reach);
impl_reach!(wire::hint::Reach);

impl From<Need> for wire::Need {
    fn from(Need { stage, role, reach, round, gaps }: Need) -> Self {
        let round = match round {
            Round::Same => wire::Round::Same,
            Round::Previous => wire::Round::Before,
            Round::Every => wire::Round::Every,
        };
        Self { stage: stage.into(), role: role_number(role), reach: Some(reach.into()), round: round.into(), gaps }
    }
}

impl TryFrom<wire::Need> for Need {
    type Error = ConvertError;

    fn try_from(wire: wire::Need) -> Result<Self, ConvertError> {
        Ok(Self {
            stage: stage(wire.stage)?,
            role: role(wire.role)?,
            reach: required("need.reach", wire.reach)?.into(),
            round: match wire::Round::try_from(wire.round) {
                Ok(wire::Round::Same) => Round::Same,
                Ok(wire::Round::Before) => Round::Previous,
                Ok(wire::Round::Every) => Round::Every,
                Ok(wire::Round::Unspecified) | Err(_) => {
                    return Err(ConvertError::Unknown { field: "need.round", value: wire.round });
                }
            },
            gaps: wire.gaps,
        })
    }
}

impl From<Hint> for wire::Hint {
    fn from(Hint { stage, role, reach }: Hint) -> Self {
        Self { stage: stage.into(), role: role_number(role), reach: Some(reach.into()) }
    }
}

impl TryFrom<wire::Hint> for Hint {
    type Error = ConvertError;

    fn try_from(wire: wire::Hint) -> Result<Self, ConvertError> {
        Ok(Self {
            stage: stage(wire.stage)?,
            role: role(wire.role)?,
            reach: required("hint.reach", wire.reach)?.into(),
        })
    }
}
