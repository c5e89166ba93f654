//! Detection of layers that no path can match, from an expression and the possible events of a scene, before rendering.
//!
//! A path is the camera, any number of scatterings, and a source. The expression's positions (Glushkov's construction, as in
//! [`crate::automaton`]) form a graph. A layer may receive light if a walk leads from the camera to a source and the scene can make
//! the event of every position on it. Callers must list all events that may happen, otherwise the answer is wrong. If every walk
//! has missing events, a walk with the fewest missing events names them.

use crate::automaton::Positions;
use crate::event::{Event, Kind, LabelSet, Vocabulary};
use crate::expression::Expression;
use std::collections::{BTreeSet, VecDeque};

/// Reason why a layer receives no light.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Darkness {
    /// No path of the layer begins with the camera.
    NoCamera,
    /// No path of the layer ends with a source that is its only source.
    NoSource,
    /// Nothing in the scene makes these events, and every path of the layer has some missing event.
    Missing(Vec<Event>),
    /// The shortest path of the layer has this number of segments, which exceeds the maximum.
    TooLong(usize),
}

/// Returns the reason why a layer receives no light; `None`: it may receive some.
/// - `made`: all events that the scene can make, with the labels of `vocabulary`; without the camera's event.
/// - `longest`: maximum number of segments of a path; `None`: unbounded.
pub fn darkness(
    expression: &Expression,
    vocabulary: &Vocabulary,
    made: &BTreeSet<(Kind, LabelSet)>,
    longest: Option<usize>,
) -> Option<Darkness> {
    let all = std::slice::from_ref(expression);
    let positions = Positions::of(all);
    let uses: Vec<[Use; 2]> = positions.events.iter().map(|event| uses(event, vocabulary, made)).collect();
    let begins = |at: &usize| positions.events[*at].fits(Kind::Camera, |_| false);
    let start: Vec<usize> = positions.follow[positions.events.len()].iter().copied().filter(begins).collect();
    if start.is_empty() {
        return Some(Darkness::NoCamera);
    }
    let walk = Walk { positions: &positions, uses: &uses, start: &start };
    match (walk.fewest_missing(), walk.shortest()) {
        (None, _) => Some(Darkness::NoSource),
        (Some(missing), _) if !missing.is_empty() => Some(Darkness::Missing(missing)),
        (_, Some(segments)) if longest.is_some_and(|longest| segments > longest) => Some(Darkness::TooLong(segments)),
        _ => None,
    }
}

/// Whether the scene makes an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Use {
    Made,
    /// The expression allows it, but nothing makes it.
    Missing,
    /// The expression does not allow such an event.
    Never,
}

/// Returns the use of an event as a scattering, and as a source.
fn uses(event: &Event, vocabulary: &Vocabulary, made: &BTreeSet<(Kind, LabelSet)>) -> [Use; 2] {
    [false, true].map(|is_source| {
        let is_of = |kind: Kind| kind != Kind::Camera && kind.is_source() == is_source;
        let fits = |(kind, set): &(Kind, LabelSet)| event.fits(*kind, |label| vocabulary.has(*set, label));
        if made.iter().any(|symbol| is_of(symbol.0) && fits(symbol)) {
            Use::Made
        } else if event.kinds().any(is_of) {
            Use::Missing
        } else {
            Use::Never
        }
    })
}

/// Search for walks from the camera to a source.
struct Walk<'a> {
    positions: &'a Positions<'a>,
    uses: &'a [[Use; 2]],
    start: &'a [usize],
}

impl Walk<'_> {
    /// Returns the positions after `at`, each with its use as a scattering, and its use as a source if a path may end there.
    fn after(&self, at: usize) -> impl Iterator<Item = (usize, Option<Use>, Option<Use>)> + '_ {
        self.positions.follow[at].iter().map(|&next| {
            let [scattering, source] = self.uses[next];
            let known = |it: Use| (it != Use::Never).then_some(it);
            (next, known(scattering), known(source).filter(|_| self.positions.last[next] != 0))
        })
    }

    /// Returns the missing events of a walk with the fewest missing events, each once; `None`: there is no walk.
    fn fewest_missing(&self) -> Option<Vec<Event>> {
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
            for (next, scattering, source) in self.after(at) {
                if let Some(it) = source {
                    let lacks = it == Use::Missing;
                    let all = cost + usize::from(lacks);
                    if best.is_none_or(|(least, ..)| all < least) {
                        best = Some((all, at, lacks.then_some(next)));
                    }
                }
                if let Some(it) = scattering {
                    let all = cost + usize::from(it == Use::Missing);
                    if before[next].is_none_or(|(known, _)| all < known) {
                        before[next] = Some((all, Some(at)));
                        // The queue is sorted by cost, and costs in it differ by at most one.
                        if it == Use::Missing { queue.push_back((all, next)) } else { queue.push_front((all, next)) }
                    }
                }
            }
        }
        let (_, last, source) = best?;
        let mut missing: BTreeSet<Event> = source.map(|at| self.positions.events[at].clone()).into_iter().collect();
        let mut at = Some(last);
        while let Some(here) = at {
            let previous = before[here].and_then(|(_, previous)| previous);
            if previous.is_some() && self.uses[here][0] == Use::Missing {
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
            for (next, scattering, source) in self.after(at) {
                if source == Some(Use::Made) {
                    return Some(here);
                }
                if scattering == Some(Use::Made) && length[next].is_none() {
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
            Vocabulary::of(expression.events().iter().flat_map(|event| event.labels())).expect("few labels");
        let made = [Kind::ReflectedDiffuse, Kind::ReflectedGlossy].map(|kind| (kind, vocabulary.set(&["a"])));
        let lamp = (Kind::Light, vocabulary.set(&["lamp"]));
        let made = made.into_iter().chain([lamp]).collect();
        darkness(&expression, &vocabulary, &made, longest).map(|darkness| match darkness {
            Darkness::Missing(events) => events.iter().map(Event::to_string).collect::<Vec<_>>().join(" "),
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
