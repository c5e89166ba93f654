//! Kinds and roles of earlier versions. Their graphs come from older clients and older logs.

use crate::{Graph, Need, Role, StageKind, StageTemplate};

impl StageKind {
    /// Returns the kind that did this work in earlier versions; `None`: this kind did it, or nothing did.
    pub fn earlier(self) -> Option<Self> {
        match self {
            Self::FirstPassStart | Self::FirstPassSolve | Self::FirstPassFinish => Some(Self::FirstPass),
            Self::FirstPassRays | Self::FirstPassGuides => Some(Self::FirstPassBlock),
            Self::CountLevels | Self::ReduceLevels | Self::ReducePaths | Self::ReduceLayers => Some(Self::Reduce),
            Self::EncodePicture | Self::EncodeSheet | Self::EncodeClip => Some(Self::Encode),
            _ => None,
        }
    }
}

impl Role {
    /// Returns the present role of an output that has this role in a log or a message.
    pub fn updated(self) -> Self {
        match self {
            Self::Elements | Self::Links | Self::Rays | Self::Guides => Self::SolverState,
            other => other,
        }
    }
}

impl Graph {
    /// Returns the graph with the present kinds and roles. The stages keep their numbers and tasks. A graph of this version does not
    /// change.
    pub fn updated(mut self) -> Self {
        let kinds: Vec<StageKind> = self.stages.iter().map(updated_kind).collect();
        let mut is_changed = false;
        for (template, kind) in self.stages.iter_mut().zip(kinds) {
            is_changed |= template.kind != kind;
            template.kind = kind;
            if template.outputs.iter().any(|role| role.updated() != *role) {
                template.outputs = distinct(template.outputs.iter().map(|role| role.updated()));
            }
            if template.needs.iter().any(|need| need.role.updated() != need.role) {
                let updated = template.needs.iter().map(|need| Need { role: need.role.updated(), ..*need });
                template.needs = distinct(updated);
            }
        }
        if is_changed {
            self.add_known_tags();
        }
        self
    }
}

/// Returns the values, each once.
fn distinct<T: PartialEq>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut all = Vec::new();
    for value in values {
        if !all.contains(&value) {
            all.push(value);
        }
    }
    all
}

/// Returns the present kind of a stage with kinds and roles of an earlier version.
fn updated_kind(template: &StageTemplate) -> StageKind {
    let makes = |role| template.outputs.contains(&role);
    let reads = |role| template.needs.iter().any(|need| need.role == role);
    match (template.kind, &template.outputs[..]) {
        (StageKind::FirstPass, _) if makes(Role::Links) => StageKind::FirstPassStart,
        (StageKind::FirstPass, _) if makes(Role::Elements) => StageKind::FirstPassSolve,
        (StageKind::FirstPass, _) if reads(Role::Elements) => StageKind::FirstPassFinish,
        (StageKind::FirstPassBlock, [Role::Rays]) => StageKind::FirstPassRays,
        (StageKind::FirstPassBlock, [Role::Guides]) => StageKind::FirstPassGuides,
        (StageKind::Reduce, [Role::Levels]) if reads(Role::Thumbnail) => StageKind::CountLevels,
        (StageKind::Reduce, [Role::Levels]) => StageKind::ReduceLevels,
        (StageKind::Reduce, [Role::Paths]) => StageKind::ReducePaths,
        (StageKind::Reduce, [Role::LayerPixels]) => StageKind::ReduceLayers,
        (StageKind::Encode, [Role::Picture | Role::Still]) => StageKind::EncodePicture,
        (StageKind::Encode, [Role::Sheet]) => StageKind::EncodeSheet,
        (StageKind::Encode, [Role::Clip]) => StageKind::EncodeClip,
        (kind, _) => kind,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Reach, Scope, TaskSizes, tag};

    fn stage(kind: StageKind, outputs: &[Role]) -> StageTemplate {
        StageTemplate::new(kind, Scope::Content, TaskSizes::even(1, 1), outputs)
    }

    #[test]
    fn steps_of_a_first_pass_get_their_kinds_and_share_one_role() {
        use StageKind::{FirstPassFinish, FirstPassGuides, FirstPassRays, FirstPassSolve, FirstPassStart, Render};
        let read = |template: StageTemplate, from: &[(u16, Role)]| {
            from.iter().fold(template, |template, &(number, role)| template.with_input(number, role, Reach::All))
        };
        let before: &[(u16, Role)] = &[(0, Role::Elements), (0, Role::Links)];
        let stages = vec![
            stage(StageKind::FirstPass, &[Role::Elements, Role::Links]),
            read(stage(StageKind::FirstPassBlock, &[Role::Rays]), before),
            read(stage(StageKind::FirstPass, &[Role::Elements]), &[before, &[(1, Role::Rays)]].concat()),
            read(
                stage(StageKind::FirstPassBlock, &[Role::Guides]),
                &[(2, Role::Elements), (0, Role::Links), (1, Role::Rays)],
            ),
            read(
                stage(StageKind::FirstPass, &[Role::Field]),
                &[(2, Role::Elements), (0, Role::Links), (3, Role::Guides)],
            ),
            read(stage(Render, &[Role::Tile]), &[(4, Role::Field)]),
        ];
        let graph = Graph { stages }.updated();
        let kinds: Vec<StageKind> = graph.stages.iter().map(|stage| stage.kind).collect();
        assert_eq!(kinds, [FirstPassStart, FirstPassRays, FirstPassSolve, FirstPassGuides, FirstPassFinish, Render]);
        let needs = |number: usize| -> Vec<(u16, Role)> {
            graph.stages[number].needs.iter().map(|need| (need.stage, need.role)).collect()
        };
        let states = |numbers: &[u16]| -> Vec<(u16, Role)> {
            numbers.iter().map(|&number| (number, Role::SolverState)).collect()
        };
        assert_eq!((1..5).map(needs).collect::<Vec<_>>(), [&[0][..], &[0, 1], &[2, 0, 1], &[2, 0, 3]].map(states));
        assert_eq!(needs(5), [(4, Role::Field)]);
        let makes: Vec<&[Role]> = graph.stages.iter().map(|stage| &stage.outputs[..]).collect();
        let state = &[Role::SolverState][..];
        assert_eq!(makes, [state, state, state, state, &[Role::Field], &[Role::Tile]]);
        assert!(graph.stages.iter().all(|stage| stage.tags.iter().any(|own| own == tag::TASK_KINDS)));
        assert_eq!(graph.clone().updated(), graph);
    }

    #[test]
    fn reductions_and_encodings_get_their_kinds_and_others_stay() {
        let thumbnails = stage(StageKind::Reduce, &[Role::Levels]).with_input(0, Role::Thumbnail, Reach::All);
        let cases = [
            (thumbnails, StageKind::CountLevels),
            (stage(StageKind::Reduce, &[Role::Levels]), StageKind::ReduceLevels),
            (stage(StageKind::Reduce, &[Role::Paths]), StageKind::ReducePaths),
            (stage(StageKind::Reduce, &[Role::LayerPixels]), StageKind::ReduceLayers),
            (stage(StageKind::Encode, &[Role::Picture]), StageKind::EncodePicture),
            (stage(StageKind::Encode, &[Role::Still]), StageKind::EncodePicture),
            (stage(StageKind::Encode, &[Role::Sheet]), StageKind::EncodeSheet),
            (stage(StageKind::Encode, &[Role::Clip]), StageKind::EncodeClip),
        ];
        for (template, kind) in cases {
            let graph = Graph { stages: vec![template.clone()] }.updated();
            assert_eq!((graph.stages[0].kind, kind.earlier()), (kind, Some(template.kind)));
            assert_eq!(graph.stages[0].tags, [tag::TASK_KINDS]);
        }
        for same in [
            stage(StageKind::Reduce, &[Role::Pixels, Role::Errors, Role::Sums]),
            stage(StageKind::FirstPass, &[Role::Field]),
            stage(StageKind::Image, &[Role::Image, Role::Preview]),
        ] {
            let graph = Graph { stages: vec![same] };
            assert_eq!(graph.clone().updated(), graph);
        }
    }
}
