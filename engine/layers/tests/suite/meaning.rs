//! A second implementation of light path expressions, from the text of the manual: its own syntax tree, its own meaning of an event,
//! and a machine with empty steps (Thompson's construction). It shares no code with the crate's parser, event patterns and
//! automaton.

use femc_layers::EventKind;
use std::collections::{BTreeSet, VecDeque};

/// An event: its kind, and the names of the thing where it happens.
pub(crate) type Event = (EventKind, &'static [&'static str]);

/// Letters of a kind: the type, and the scattering if it has one.
pub(crate) fn letters(kind: EventKind) -> (char, Option<char>) {
    match kind {
        EventKind::Camera => ('C', None),
        EventKind::ReflectedDiffuse => ('R', Some('D')),
        EventKind::ReflectedGlossy => ('R', Some('G')),
        EventKind::ReflectedSpecular => ('R', Some('S')),
        EventKind::TransmittedDiffuse => ('T', Some('D')),
        EventKind::TransmittedGlossy => ('T', Some('G')),
        EventKind::TransmittedSpecular => ('T', Some('S')),
        EventKind::Volume => ('V', None),
        EventKind::Light => ('L', None),
        EventKind::Object => ('O', None),
        EventKind::Background => ('B', None),
    }
}

pub(crate) fn is_source(kind: EventKind) -> bool {
    "LOB".contains(letters(kind).0)
}

/// Letters of a type or of a scattering.
#[derive(Clone, Debug)]
pub(crate) enum Part {
    Dot,
    One(char),
    Set(Vec<char>),
    Except(Vec<char>),
}

impl Part {
    fn has(&self, letter: Option<char>) -> bool {
        match self {
            Self::Dot => true,
            Self::One(own) => letter == Some(*own),
            Self::Set(all) => letter.is_some_and(|letter| all.contains(&letter)),
            Self::Except(all) => letter.is_none_or(|letter| !all.contains(&letter)),
        }
    }

    fn text(&self) -> String {
        match self {
            Self::Dot => ".".into(),
            Self::One(letter) => letter.to_string(),
            Self::Set(all) => format!("[{}]", all.iter().collect::<String>()),
            Self::Except(all) => format!("[^{}]", all.iter().collect::<String>()),
        }
    }
}

/// Labels in angles.
#[derive(Clone, Debug)]
pub(crate) enum Labels {
    Any,
    Dot,
    Some(Vec<&'static str>),
    /// Like `Some`, in brackets.
    Set(Vec<&'static str>),
    Except(Vec<&'static str>),
}

/// One event of an expression, or of a bracket.
#[derive(Clone, Debug)]
pub(crate) enum Single {
    Dot,
    Letter(char),
    Label(&'static str),
    Angle(Part, Option<Part>, Labels),
}

/// Checks whether a label matches a thing with these names: its own name, and everything in it.
pub(crate) fn has_label(names: &[&str], label: &str) -> bool {
    names.iter().any(|name| *name == label || name.starts_with(&format!("{label}.")))
}

impl Single {
    pub(crate) fn matches(&self, (kind, names): Event) -> bool {
        let (ty, scattering) = letters(kind);
        match self {
            Self::Dot => true,
            Self::Letter(letter) => *letter == ty || Some(*letter) == scattering,
            Self::Label(label) => has_label(names, label),
            Self::Angle(types, scatterings, labels) => {
                let is_one = |all: &[&str]| all.iter().any(|label| has_label(names, label));
                types.has(Some(ty))
                    && scatterings.as_ref().is_none_or(|part| part.has(scattering))
                    && match labels {
                        Labels::Any | Labels::Dot => true,
                        Labels::Some(all) | Labels::Set(all) => is_one(all),
                        Labels::Except(all) => !is_one(all),
                    }
            }
        }
    }

    fn text(&self) -> String {
        let quoted = |label: &&str| format!("'{}'", label.replace('\\', r"\\").replace('\'', r"\'"));
        let list = |all: &[&str]| all.iter().map(quoted).collect::<String>();
        match self {
            Self::Dot => ".".into(),
            Self::Letter(letter) => letter.to_string(),
            Self::Label(label) => quoted(label),
            Self::Angle(types, scatterings, labels) => {
                let scatterings = scatterings.as_ref().map_or(String::new(), Part::text);
                let labels = match labels {
                    Labels::Any => String::new(),
                    Labels::Dot => ".".into(),
                    Labels::Some(all) => list(all),
                    Labels::Set(all) => format!("[{}]", list(all)),
                    Labels::Except(all) => format!("[^{}]", list(all)),
                };
                format!("<{}{scatterings}{labels}>", types.text())
            }
        }
    }
}

/// An expression.
#[derive(Clone, Debug)]
pub(crate) enum Tree {
    One(Single),
    Bracket(Vec<Single>),
    Except(Vec<Single>),
    Sequence(Vec<Tree>),
    Choice(Vec<Tree>),
    /// `*`, `+` or `?`.
    Sign(char, Box<Tree>),
    /// Least and greatest number of times.
    Times(usize, usize, Box<Tree>),
}

impl Tree {
    /// Checks whether one event matches; `None`: the tree is not one event.
    pub(crate) fn matches(&self, event: Event) -> Option<bool> {
        match self {
            Self::One(single) => Some(single.matches(event)),
            Self::Bracket(all) => Some(all.iter().any(|single| single.matches(event))),
            Self::Except(all) => Some(!all.iter().any(|single| single.matches(event))),
            _ => None,
        }
    }

    /// Writes the expression. `gap` is put between its parts, since spaces do not count.
    pub(crate) fn text(&self, gap: &str) -> String {
        let list = |all: &[Single]| all.iter().map(Single::text).collect::<Vec<_>>().join(gap);
        let repeated = |inner: &Self| {
            let text = inner.text(gap);
            if matches!(inner, Self::One(_) | Self::Bracket(_) | Self::Except(_)) { text } else { format!("({text})") }
        };
        match self {
            Self::One(single) => single.text(),
            Self::Bracket(all) => format!("[{}]", list(all)),
            Self::Except(all) => format!("[^{}]", list(all)),
            Self::Sequence(all) => {
                let grouped = |tree: &Self| {
                    if matches!(tree, Self::Choice(_)) { format!("({})", tree.text(gap)) } else { tree.text(gap) }
                };
                all.iter().map(grouped).collect::<Vec<_>>().join(gap)
            }
            Self::Choice(all) => all.iter().map(|tree| tree.text(gap)).collect::<Vec<_>>().join("|"),
            Self::Sign(sign, inner) => format!("{}{gap}{sign}", repeated(inner)),
            Self::Times(least, most, inner) if least == most => format!("{}{{{least}}}", repeated(inner)),
            Self::Times(least, most, inner) => format!("{}{{{least}{gap},{gap}{most}}}", repeated(inner)),
        }
    }
}

/// A machine with empty steps for one expression.
#[derive(Default)]
pub(crate) struct Machine {
    empty: Vec<Vec<usize>>,
    steps: Vec<Vec<(Tree, usize)>>,
    start: usize,
    end: usize,
}

impl Machine {
    pub(crate) fn new(tree: &Tree) -> Self {
        let mut all = Self::default();
        (all.start, all.end) = (all.state(), all.state());
        all.add(tree, all.start, all.end);
        all
    }

    fn state(&mut self) -> usize {
        self.empty.push(Vec::new());
        self.steps.push(Vec::new());
        self.empty.len() - 1
    }

    fn add(&mut self, tree: &Tree, from: usize, to: usize) {
        match tree {
            Tree::One(_) | Tree::Bracket(_) | Tree::Except(_) => self.steps[from].push((tree.clone(), to)),
            Tree::Sequence(all) => {
                let mut at = from;
                for tree in all {
                    let next = self.state();
                    self.add(tree, at, next);
                    at = next;
                }
                self.empty[at].push(to);
            }
            Tree::Choice(all) => all.iter().for_each(|tree| self.add(tree, from, to)),
            Tree::Sign(sign, inner) => {
                let (begin, end) = (self.state(), self.state());
                self.add(inner, begin, end);
                self.empty[from].push(begin);
                self.empty[end].push(to);
                if *sign != '?' {
                    self.empty[end].push(begin);
                }
                if *sign != '+' {
                    self.empty[from].push(to);
                }
            }
            Tree::Times(least, most, inner) => {
                let mut at = from;
                for time in 0..*most {
                    if time >= *least {
                        self.empty[at].push(to);
                    }
                    let next = self.state();
                    self.add(inner, at, next);
                    at = next;
                }
                self.empty[at].push(to);
            }
        }
    }

    fn with_empty_steps(&self, states: impl IntoIterator<Item = usize>) -> BTreeSet<usize> {
        let (mut all, mut open): (BTreeSet<usize>, Vec<usize>) = (BTreeSet::new(), states.into_iter().collect());
        while let Some(state) = open.pop() {
            if all.insert(state) {
                open.extend(&self.empty[state]);
            }
        }
        all
    }

    fn after(&self, states: &BTreeSet<usize>, event: Event) -> BTreeSet<usize> {
        let steps = states.iter().flat_map(|&state| &self.steps[state]);
        self.with_empty_steps(steps.filter(|(tree, _)| tree.matches(event) == Some(true)).map(|(_, to)| *to))
    }

    /// Checks whether a path of the camera and these events matches.
    pub(crate) fn accepts(&self, word: &[Event]) -> bool {
        let mut states = self.after(&self.with_empty_steps([self.start]), (EventKind::Camera, &[]));
        for event in word {
            states = self.after(&states, *event);
        }
        states.contains(&self.end)
    }

    /// Checks whether an expression matches the camera.
    pub(crate) fn begins_with_the_camera(&self) -> bool {
        !self.after(&self.with_empty_steps([self.start]), (EventKind::Camera, &[])).is_empty()
    }

    /// Returns the number of segments of the shortest path of possible events. The last event is a source, and no other event is.
    pub(crate) fn shortest(&self, is_possible: impl Fn(&Tree, EventKind) -> bool) -> Option<usize> {
        let begin = self.after(&self.with_empty_steps([self.start]), (EventKind::Camera, &[]));
        let mut known: BTreeSet<usize> = begin.clone();
        let mut open: VecDeque<(usize, usize)> = begin.into_iter().map(|state| (state, 0)).collect();
        while let Some((state, length)) = open.pop_front() {
            for (tree, to) in &self.steps[state] {
                let can = |wants_source: bool| {
                    let kinds = EventKind::ALL[1..].iter();
                    kinds.copied().any(|kind| is_source(kind) == wants_source && is_possible(tree, kind))
                };
                let next = self.with_empty_steps([*to]);
                if can(true) && next.contains(&self.end) {
                    return Some(length + 1);
                }
                if can(false) {
                    open.extend(next.into_iter().filter(|state| known.insert(*state)).map(|state| (state, length + 1)));
                }
            }
        }
        None
    }

    /// Returns the least number of events of such a path that are allowed but not made; `None`: there is no path.
    pub(crate) fn fewest_missing(
        &self,
        is_made: impl Fn(&Tree, EventKind) -> bool,
        is_allowed: impl Fn(&Tree, EventKind) -> bool,
    ) -> Option<usize> {
        let begin = self.after(&self.with_empty_steps([self.start]), (EventKind::Camera, &[]));
        let mut costs: Vec<Option<usize>> = vec![None; self.empty.len()];
        begin.into_iter().for_each(|state| costs[state] = Some(0));
        let (mut best, mut is_changed) = (None::<usize>, true);
        while is_changed {
            is_changed = false;
            for state in 0..costs.len() {
                let Some(cost) = costs[state] else { continue };
                for (tree, to) in &self.steps[state] {
                    let cost_as = |wants_source: bool| {
                        let some = |has: &dyn Fn(&Tree, EventKind) -> bool| {
                            EventKind::ALL[1..].iter().any(|kind| is_source(*kind) == wants_source && has(tree, *kind))
                        };
                        if some(&is_made) { Some(cost) } else { some(&is_allowed).then_some(cost + 1) }
                    };
                    let next = self.with_empty_steps([*to]);
                    if let Some(all) = cost_as(true).filter(|_| next.contains(&self.end)) {
                        best = Some(best.map_or(all, |best| best.min(all)));
                    }
                    for (after, all) in next.into_iter().filter_map(|after| Some((after, cost_as(false)?))) {
                        if costs[after].is_none_or(|known| all < known) {
                            costs[after] = Some(all);
                            is_changed = true;
                        }
                    }
                }
            }
        }
        best
    }
}
