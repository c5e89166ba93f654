//! A deterministic automaton for all expressions of a frame.
//!
//! A state is a set of positions: events of the expressions that the path may have just passed (Glushkov's construction, which has
//! no empty steps). States that no path can tell apart are merged (Moore's refinement). The remaining states are numbered in the
//! order in which they are reached from the start, so the table is a function of the layers and the label sets alone.

use crate::error::LayerError;
use crate::event::{EventKind, EventPattern, LabelSet, Vocabulary};
use crate::expression::{Expression, Node};
use crate::layer::{Layer, parse_layers};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// State of a path in all expressions.
pub type State = u16;

/// State from which no layer can accept the path any more.
pub const DEAD_STATE: State = 0;

/// A set of labels of something in the scene: offset of its events in the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LabelOffset(u32);

impl LabelOffset {
    /// Returns the symbol of an event of `kind` at something with these labels.
    #[inline]
    pub fn symbol(self, kind: EventKind) -> Symbol {
        Symbol(self.0 + kind as u32)
    }
}

/// An event at something with a set of labels. A path that has left the camera stays in its state at another [`EventKind::Camera`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Symbol(u32);

impl Symbol {
    /// No event: every state stays.
    pub const NONE: Self = Self(EventKind::Camera as u32);
}

/// Number of a set of layers that accept paths together; [`NO_LAYERS`] is the empty set.
pub type LayerSetIndex = u16;

/// No layer accepts the path.
pub const NO_LAYERS: LayerSetIndex = 0;

/// Number of kinds that may follow the camera.
const KINDS: usize = EventKind::ALL.len() - 1;
/// Entries of the table per state and label set: one for each kind, including the camera.
const COLUMNS: usize = EventKind::ALL.len();
/// Maximum number of entries of the table during construction.
const MAX_ENTRIES: usize = 1 << 22;

/// The compiled expressions of all layers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Automaton {
    /// Label sets that occur in the scene, ascending.
    sets: Vec<LabelSet>,
    /// Next state, by state, label set and kind of event.
    next: Vec<State>,
    /// Number of table entries per state.
    columns: usize,
    /// Layers that accept a path which ends with this event in this state, by state and symbol.
    accepting: Vec<LayerSetIndex>,
    /// Sets of layers by their number, a bit for each layer.
    layer_sets: Vec<u64>,
    start: State,
}

impl Automaton {
    /// Compiles the layers for a scene whose objects, media and lamps have these label sets of `vocabulary`.
    /// - errors: a layer is invalid, or all layers together need too many states.
    pub fn new(
        layers: &[Layer],
        vocabulary: &Vocabulary,
        sets: impl IntoIterator<Item = LabelSet>,
    ) -> Result<Self, LayerError> {
        let sets: Vec<LabelSet> = sets.into_iter().collect::<BTreeSet<_>>().into_iter().collect();
        let most = (MAX_ENTRIES / (sets.len() * KINDS).max(1)).min(usize::from(State::MAX));
        let expressions = parse_layers(layers)?;
        let positions = Positions::from_expressions(&expressions);
        let subsets =
            Subsets::from_positions(&positions, vocabulary, &sets, most).ok_or(LayerError::TooManyStates(most))?;
        Ok(subsets.minimize(sets))
    }

    /// Collects the labels that the layers name.
    /// - errors: a layer is invalid, or the layers name too many labels.
    pub fn vocabulary(layers: &[Layer]) -> Result<Vocabulary, LayerError> {
        let expressions = parse_layers(layers)?;
        let events: Vec<&EventPattern> = expressions.iter().flat_map(Expression::events).collect();
        let labels: BTreeSet<&str> = events.iter().flat_map(|event| event.labels()).collect();
        let count = labels.len();
        Vocabulary::from_labels(labels).ok_or(LayerError::TooManyLabels(count))
    }

    /// Returns the number of states.
    pub fn states(&self) -> usize {
        self.accepting.len() / self.columns
    }

    /// Returns the state of a path that has left the camera.
    pub fn start(&self) -> State {
        self.start
    }

    /// Returns the position of this label set in the table; `None`: nothing in the scene has it.
    pub fn label_offset(&self, set: LabelSet) -> Option<LabelOffset> {
        self.sets.binary_search(&set).ok().map(|at| LabelOffset((at * COLUMNS) as u32))
    }

    /// Returns the state after an event.
    #[inline]
    pub fn next(&self, state: State, event: Symbol) -> State {
        self.next[usize::from(state) * self.columns + event.0 as usize]
    }

    /// Returns the layers that accept a path which ends with this event in `state`.
    #[inline]
    pub fn accepting_layers(&self, state: State, event: Symbol) -> LayerSetIndex {
        self.accepting[usize::from(state) * self.columns + event.0 as usize]
    }

    /// Returns the sets of layers, indexed by [`LayerSetIndex`], a bit for each layer.
    pub fn layer_sets(&self) -> &[u64] {
        &self.layer_sets
    }
}

/// The events of all expressions, and the possible order of these events.
pub(crate) struct Positions<'a> {
    pub(crate) events: Vec<&'a EventPattern>,
    /// Successors of position `n`; at `events.len() + layer`: the first positions of the layer's paths.
    pub(crate) follow: Vec<BTreeSet<usize>>,
    /// By position: the layer whose paths may end there, as a bit.
    pub(crate) last: Vec<u64>,
}

/// First and last positions of a part of an expression, and whether the part also matches no event at all.
struct Ends {
    first: BTreeSet<usize>,
    last: BTreeSet<usize>,
    is_empty: bool,
}

impl<'a> Positions<'a> {
    pub(crate) fn from_expressions(expressions: &'a [Expression]) -> Self {
        let mut positions = Self { events: Vec::new(), follow: Vec::new(), last: Vec::new() };
        let ends: Vec<Ends> = expressions.iter().map(|expression| positions.walk(&expression.0)).collect();
        positions.last = vec![0; positions.events.len()];
        for (layer, ends) in ends.into_iter().enumerate() {
            ends.last.into_iter().for_each(|at| positions.last[at] |= 1 << layer);
            positions.follow.push(ends.first);
            // A path has at least one event.
            positions.last.push(0);
        }
        positions
    }

    fn walk(&mut self, node: &'a Node) -> Ends {
        match node {
            Node::Event(event) => {
                let at = self.events.len();
                self.events.push(event);
                self.follow.push(BTreeSet::new());
                Ends { first: [at].into(), last: [at].into(), is_empty: false }
            }
            Node::Sequence(nodes) => {
                let mut all = Ends { first: BTreeSet::new(), last: BTreeSet::new(), is_empty: true };
                for node in nodes {
                    let next = self.walk(node);
                    self.join(&all.last, &next.first);
                    if all.is_empty {
                        all.first.extend(&next.first);
                    }
                    if !next.is_empty {
                        all.last.clear();
                    }
                    all.last.extend(next.last);
                    all.is_empty &= next.is_empty;
                }
                all
            }
            Node::Choice(nodes) => {
                let mut all = Ends { first: BTreeSet::new(), last: BTreeSet::new(), is_empty: false };
                for node in nodes {
                    let one = self.walk(node);
                    all.first.extend(one.first);
                    all.last.extend(one.last);
                    all.is_empty |= one.is_empty;
                }
                all
            }
            Node::ZeroOrMore(node) => Ends { is_empty: true, ..self.repeated(node) },
            Node::OneOrMore(node) => self.repeated(node),
            Node::Optional(node) => Ends { is_empty: true, ..self.walk(node) },
        }
    }

    fn repeated(&mut self, node: &'a Node) -> Ends {
        let one = self.walk(node);
        self.join(&one.last, &one.first);
        one
    }

    fn join(&mut self, last: &BTreeSet<usize>, first: &BTreeSet<usize>) {
        last.iter().for_each(|at| self.follow[*at].extend(first));
    }
}

/// The automaton of the subset construction, before it is minimized.
struct Subsets {
    symbols: usize,
    /// Next state, by state and symbol.
    next: Vec<u32>,
    accepts: Vec<u64>,
    start: u32,
}

impl Subsets {
    /// Builds the automaton; `None`: it needs more than `max_states` states.
    fn from_positions(
        positions: &Positions<'_>,
        vocabulary: &Vocabulary,
        sets: &[LabelSet],
        max_states: usize,
    ) -> Option<Self> {
        let fits = |kind: EventKind, set: LabelSet| -> Vec<bool> {
            let has = |label: &str| vocabulary.contains(set, label);
            positions.events.iter().map(|event| event.matches(kind, has)).collect()
        };
        let kinds = &EventKind::ALL[1..];
        let fitting: Vec<Vec<bool>> = sets
            .iter()
            .flat_map(|&set| kinds.iter().map(move |&kind| (kind, set)))
            .map(|(kind, set)| fits(kind, set))
            .collect();
        let step = |state: &BTreeSet<usize>, fits: &[bool]| -> BTreeSet<usize> {
            let after = state.iter().flat_map(|&at| &positions.follow[at]);
            after.copied().filter(|&at| fits[at]).collect()
        };
        let begin: BTreeSet<usize> = (positions.events.len()..positions.follow.len()).collect();
        let start = step(&begin, &fits(EventKind::Camera, LabelSet::default()));
        // The empty set is the dead state.
        let mut known: BTreeMap<BTreeSet<usize>, u32> = [(BTreeSet::new(), 0)].into();
        let mut queue: VecDeque<BTreeSet<usize>> = [BTreeSet::new()].into();
        let mut number = |set: BTreeSet<usize>, queue: &mut VecDeque<BTreeSet<usize>>| {
            let fresh = known.len() as u32;
            *known.entry(set.clone()).or_insert_with(|| {
                queue.push_back(set);
                fresh
            })
        };
        let start = number(start, &mut queue);
        let (mut next, mut accepts) = (Vec::new(), Vec::new());
        while let Some(state) = queue.pop_front() {
            accepts.push(state.iter().fold(0, |layers, &at| layers | positions.last[at]));
            for fits in &fitting {
                next.push(number(step(&state, fits), &mut queue));
            }
            if accepts.len() + queue.len() > max_states {
                return None;
            }
        }
        Some(Self { symbols: fitting.len(), next, accepts, start })
    }

    /// Minimizes the number of states.
    fn minimize(self, sets: Vec<LabelSet>) -> Automaton {
        let Self { symbols, next, accepts, start } = self;
        let row = |state: usize| &next[state * symbols..(state + 1) * symbols];
        let mut class: Vec<u32> = number_items(accepts.iter().copied());
        loop {
            let signature = |state: usize| {
                let after: Vec<u32> = row(state).iter().map(|&to| class[to as usize]).collect();
                (class[state], after)
            };
            let finer = number_items((0..accepts.len()).map(signature));
            let is_done = finer.iter().max() == class.iter().max();
            class = finer;
            if is_done {
                break;
            }
        }
        // The dead state comes first, then the others in the order in which they are reached from the start.
        let mut order: Vec<usize> = vec![0];
        let mut place: BTreeMap<u32, State> = [(class[0], DEAD_STATE)].into();
        let mut visit = |state: u32, order: &mut Vec<usize>| {
            *place.entry(class[state as usize]).or_insert_with(|| {
                order.push(state as usize);
                (order.len() - 1) as State
            })
        };
        let start = visit(start, &mut order);
        let (mut table, mut at) = (Vec::new(), 0);
        while let Some(&state) = order.get(at) {
            for set in row(state).chunks(KINDS) {
                table.push(at as State);
                table.extend(set.iter().map(|&to| visit(to, &mut order)));
            }
            at += 1;
        }
        let accepted: Vec<u64> = order.iter().map(|&state| accepts[state]).collect();
        // The empty set comes first.
        let takers = number_items(std::iter::once(0).chain(accepted.iter().copied()));
        let mut layers = vec![0; takers.iter().max().map_or(0, |most| *most as usize + 1)];
        takers.iter().skip(1).zip(accepted).for_each(|(&taker, accepted)| layers[taker as usize] = accepted);
        let takers = table.iter().map(|&to| takers[1 + usize::from(to)] as LayerSetIndex).collect();
        let columns = sets.len() * COLUMNS;
        Automaton { sets, next: table, columns, accepting: takers, layer_sets: layers, start }
    }
}

/// Numbers the items: equal items get equal numbers, from 0 in order of first occurrence.
fn number_items<T: Ord>(all: impl Iterator<Item = T>) -> Vec<u32> {
    let mut known = BTreeMap::new();
    all.map(|it| {
        let fresh = known.len() as u32;
        *known.entry(it).or_insert(fresh)
    })
    .collect()
}
