//! Detection of layers that no path can match, from an expression and the possible events of a scene, before rendering.
//!
//! A path is the camera, any number of scatterings, and a source. The expression's positions (Glushkov's construction, as in
//! [`crate::automaton`]) form a graph. A layer may receive light if a walk leads from the camera to a source and the scene can make
//! the event of every position on it. Callers must list all events that may happen, otherwise the answer is wrong. If every walk
//! has missing events, a walk with the fewest missing events names them.

use crate::automaton::Positions;
use crate::event::{EventKind, EventPattern, LabelSet, Vocabulary};
use crate::expression::Expression;
use std::collections::{BTreeSet, VecDeque};

/// Reason why a layer receives no light.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UnlitReason {
    /// No path of the layer begins with the camera.
    NoCamera,
    /// No path of the layer ends with a source that is its only source.
    NoSource,
    /// Nothing in the scene makes these events, and every path of the layer has some missing event.
    Missing(Vec<EventPattern>),
    /// The shortest path of the layer has this number of segments, which exceeds the maximum.
    TooLong(usize),
}

/// Returns the reason why a layer receives no light; `None`: it may receive some.
/// - `possible`: all events that the scene can make, with the labels of `vocabulary`; without the camera's event.
/// - `max_segments`: maximum number of segments of a path; `None`: unbounded.
pub fn unlit_reason(
    expression: &Expression,
    vocabulary: &Vocabulary,
    possible: &BTreeSet<(EventKind, LabelSet)>,
    max_segments: Option<usize>,
) -> Option<UnlitReason> {
    let all = std::slice::from_ref(expression);
    let positions = Positions::from_expressions(all);
    let availability: Vec<[Availability; 2]> =
        positions.events.iter().map(|event| availability(event, vocabulary, possible)).collect();
    let begins = |at: &usize| positions.events[*at].matches(EventKind::Camera, |_| false);
    let start: Vec<usize> = positions.follow[positions.events.len()].iter().copied().filter(begins).collect();
    if start.is_empty() {
        return Some(UnlitReason::NoCamera);
    }
    let walk = Walk { positions: &positions, availability: &availability, start: &start };
    match (walk.fewest_missing(), walk.shortest()) {
        (None, _) => Some(UnlitReason::NoSource),
        (Some(missing), _) if !missing.is_empty() => Some(UnlitReason::Missing(missing)),
        (_, Some(segments)) if max_segments.is_some_and(|longest| segments > longest) => {
            Some(UnlitReason::TooLong(segments))
        }
        _ => None,
    }
}

/// Whether the scene makes an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Availability {
    Possible,
    /// The expression allows it, but nothing makes it.
    Missing,
    /// The expression does not allow such an event.
    Disallowed,
}

/// Returns the use of an event as a scattering, and as a source.
fn availability(
    event: &EventPattern,
    vocabulary: &Vocabulary,
    possible: &BTreeSet<(EventKind, LabelSet)>,
) -> [Availability; 2] {
    [false, true].map(|is_source| {
        let is_of = |kind: EventKind| kind != EventKind::Camera && kind.is_source() == is_source;
        let fits = |(kind, set): &(EventKind, LabelSet)| event.matches(*kind, |label| vocabulary.contains(*set, label));
        if possible.iter().any(|symbol| is_of(symbol.0) && fits(symbol)) {
            Availability::Possible
        } else if event.kinds().any(is_of) {
            Availability::Missing
        } else {
            Availability::Disallowed
        }
    })
}

/// Search for walks from the camera to a source.
struct Walk<'a> {
    positions: &'a Positions<'a>,
    availability: &'a [[Availability; 2]],
    start: &'a [usize],
}

impl Walk<'_> {
    /// Returns the positions after `at`, each with its use as a scattering, and its use as a source if a path may end there.
    fn successors(&self, at: usize) -> impl Iterator<Item = (usize, Option<Availability>, Option<Availability>)> + '_ {
        self.positions.follow[at].iter().map(|&next| {
            let [scattering, source] = self.availability[next];
            let known = |it: Availability| (it != Availability::Disallowed).then_some(it);
            (next, known(scattering), known(source).filter(|_| self.positions.last[next] != 0))
        })
    }

    /// Returns the missing events of a walk with the fewest missing events, each once; `None`: there is no walk.
    fn fewest_missing(&self) -> Option<Vec<EventPattern>> {
        let count = self.positions.events.len();
        let mut before: Vec<Option<(usize, Option<usize>)>> = vec![None; count];
        let mut queue: VecDeque<(usize, usize)> = VecDeque::new();
        for &at in self.start {
            before[at] = Some((0, None));
            queue.push_back((0, at));
        }
        let mut best: Option<(usize, usize, Option<usize>)> = None;
        while let Some((cost, at)) = queue.pop_front() {
            if before[at].is_none_or(|(known, _)| known < cost) {
                continue;
            }
            for (next, scattering, source) in self.successors(at) {
                if let Some(it) = source {
                    let lacks = it == Availability::Missing;
                    let all = cost + usize::from(lacks);
                    if best.is_none_or(|(least, ..)| all < least) {
                        best = Some((all, at, lacks.then_some(next)));
                    }
                }
                if let Some(it) = scattering {
                    let all = cost + usize::from(it == Availability::Missing);
                    if before[next].is_none_or(|(known, _)| all < known) {
                        before[next] = Some((all, Some(at)));
                        // The queue is sorted by cost, and costs in it differ by at most one.
                        if it == Availability::Missing {
                            queue.push_back((all, next));
                        } else {
                            queue.push_front((all, next));
                        }
                    }
                }
            }
        }
        let (_, last, source) = best?;
        let mut missing: BTreeSet<EventPattern> =
            source.map(|at| self.positions.events[at].clone()).into_iter().collect();
        let mut at = Some(last);
        while let Some(here) = at {
            let previous = before[here].and_then(|(_, previous)| previous);
            if previous.is_some() && self.availability[here][0] == Availability::Missing {
                missing.insert(self.positions.events[here].clone());
            }
            at = previous;
        }
        Some(missing.into_iter().collect())
    }

    /// Returns the number of segments of the shortest walk without missing events.
    fn shortest(&self) -> Option<usize> {
        let mut length: Vec<Option<usize>> = vec![None; self.positions.events.len()];
        let mut queue: VecDeque<usize> = self.start.iter().copied().collect();
        queue.iter().for_each(|&at| length[at] = Some(0));
        while let Some(at) = queue.pop_front() {
            let here = length[at].unwrap_or(0) + 1;
            for (next, scattering, source) in self.successors(at) {
                if source == Some(Availability::Possible) {
                    return Some(here);
                }
                if scattering == Some(Availability::Possible) && length[next].is_none() {
                    length[next] = Some(here);
                    queue.push_back(next);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the darkness of an expression in a scene with diffuse and glossy reflection at `a`, and a lamp.
    fn dark(text: &str, longest: Option<usize>) -> Option<String> {
        let expression = Expression::parse(text).expect(text);
        let vocabulary =
            Vocabulary::from_labels(expression.events().iter().flat_map(|event| event.labels())).expect("few labels");
        let made =
            [EventKind::ReflectedDiffuse, EventKind::ReflectedGlossy].map(|kind| (kind, vocabulary.label_set(&["a"])));
        let lamp = (EventKind::Light, vocabulary.label_set(&["lamp"]));
        let made = made.into_iter().chain([lamp]).collect();
        unlit_reason(&expression, &vocabulary, &made, longest).map(|reason| match reason {
            UnlitReason::Missing(events) => events.iter().map(EventPattern::to_string).collect::<Vec<_>>().join(" "),
            other => format!("{other:?}"),
        })
    }

    #[test]
    fn fewest_missing_events_are_named_and_lit_layers_are_not() {
        for (text, wanted) in [
            ("C.*", None),
            ("CL", None),
            ("CG[DG]*L", None),
            ("C[GS][LOB]", None),
            ("C(S|D)L", None),
            ("C.*<L.'lamp'>", None),
            ("C[^D]*L", None),
            ("CS[DS]*L", Some("S")),
            ("CSTL", Some("S T")),
            ("C<RS>D*L", Some("<RS>")),
            ("CD+<TD>L", Some("<TD>")),
            ("CV.*", Some("V")),
            ("C.*B", Some("B")),
            ("C.*[OB]", Some("[OB]")),
            ("CS?VL", Some("V")),
            ("C(SV|T)L", Some("T")),
            ("C<RD'b'>L", Some("<RD> at 'b'")),
            ("C<RD'a'>L", None),
            ("C<RD[^'a']>L", Some("<RD> at places other than 'a'")),
            ("C'lamp'L", Some(". at 'lamp'")),
            ("D.*L", Some("NoCamera")),
            ("CD", Some("NoSource")),
            ("C", Some("NoSource")),
            ("CLD", Some("NoSource")),
            ("CLL", Some("NoSource")),
        ] {
            assert_eq!(dark(text, None).as_deref(), wanted, "{text}");
        }
        assert_eq!(dark("CDDL", Some(2)).as_deref(), Some("TooLong(3)"));
        assert_eq!((dark("CDDL", Some(3)), dark("CD?D?L", Some(1))), (None, None));
    }
}
