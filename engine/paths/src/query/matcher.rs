//! Evaluation of queries. A query is compiled once for the names of a frame: texts become sets of names, so that a path needs no
//! comparison of texts. Terms that hold for a whole path are evaluated at most once for each path ([`PathFacts`]). So the work for a
//! path is about the number of terms times the number of its intersections and lights, however the terms are nested.

use super::{CompareOp, Condition, EqualityOp, Quantity, Query, is_text_within};
use crate::attribute::{Attribute, Getter, Table};
use crate::record::{Intersection, LightPath, LightRecord, Name, Names};
use crate::schema::{Scale, Value};
use crate::statistics::Scope;
use std::cell::{Cell, OnceCell};

/// A query, compiled for the paths of a frame.
#[derive(Clone, Debug)]
pub struct Matcher<'a> {
    scope: &'a Scope,
    condition: Option<ResolvedCondition>,
    /// Number of terms that hold for a whole path.
    facts: u32,
    /// Number of terms.
    terms: usize,
    /// Whether the condition contains none of the terms `any`, `all`, `light` and `lights`. Such a condition has the same value for
    /// an intersection alone and for the intersection within its path.
    is_alike_alone: bool,
}

/// Selected parts of a path.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// Indices of the selected intersections, ascending.
    pub intersections: Vec<u32>,
    /// Indices of the selected lights, ascending.
    pub lights: Vec<u32>,
}

impl Query {
    /// Compiles the query for frames of this scope with these names.
    pub fn compile<'a>(&self, scope: &'a Scope, names: &Names) -> Matcher<'a> {
        let mut facts = 0;
        let mut compile = |condition| ResolvedCondition::new(&condition, names).with_facts(&mut facts);
        let condition = self.to_condition().map(&mut compile);
        let terms = condition.as_ref().map_or(1, ResolvedCondition::count_terms);
        let is_alike_alone = condition.as_ref().is_none_or(|condition| !condition.has_quantities());
        Matcher { scope, condition, facts, terms, is_alike_alone }
    }
}

impl Matcher<'_> {
    /// Returns the work of the selection from a path, as a number of evaluations of terms.
    pub fn work(&self, path: &LightPath) -> usize {
        self.terms * (1 + path.intersections.len() + path.lights.len())
    }

    /// Checks whether a path is selected.
    pub fn is_match(&self, path: &LightPath) -> bool {
        self.is_match_with(path, &PathFacts::new(self.facts))
    }

    fn is_match_with(&self, path: &LightPath, facts: &PathFacts) -> bool {
        let Some(condition) = &self.condition else { return true };
        if let ResolvedCondition::OfPath(_, condition) = condition {
            return condition.holds(&self.context(path, facts, None));
        }
        contexts(path).any(|index| condition.holds(&self.context(path, facts, index)))
    }

    /// Returns the selected intersections and lights of a path, or `None` if the path is not selected. A selected path may have no
    /// selected intersections.
    pub fn select(&self, path: &LightPath) -> Option<Selection> {
        let mut selection = Selection::default();
        self.select_into(path, &mut selection).then_some(selection)
    }

    /// Checks whether a path is selected, and replaces `selection` with its selected intersections and lights.
    pub fn select_into(&self, path: &LightPath, selection: &mut Selection) -> bool {
        selection.intersections.clear();
        selection.lights.clear();
        let facts = PathFacts::new(self.facts);
        let count = path.intersections.len() as u32;
        let must_match_first =
            !self.is_alike_alone || count == 0 || matches!(self.condition, Some(ResolvedCondition::OfPath(..)));
        if must_match_first && !self.is_match_with(path, &facts) {
            return false;
        }
        let Some(condition) = self.condition.as_ref().filter(|it| !matches!(it, ResolvedCondition::OfPath(..))) else {
            selection.intersections.extend(0..count);
            selection.lights.extend(0..path.lights.len() as u32);
            return true;
        };
        let holds = |context: Context<'_>| condition.holds(&context);
        let alone = |index: Option<u32>| Context { is_alone: true, ..self.context(path, &facts, index) };
        selection.intersections.extend((0..count).filter(|&index| holds(alone(Some(index)))));
        if !must_match_first && selection.intersections.is_empty() {
            return false;
        }
        if self.is_alike_alone {
            selection.lights.extend(0..path.lights.len() as u32);
            return true;
        }
        let is_selected = |light: &LightRecord| holds(Context { light: Some(light), ..alone(path.parent(light)) });
        let lights = (0..).zip(&path.lights).filter(|(_, light)| is_selected(light));
        selection.lights.extend(lights.map(|(index, _)| index));
        true
    }

    fn context<'a>(&'a self, path: &'a LightPath, facts: &'a PathFacts, index: Option<u32>) -> Context<'a> {
        Context { scope: self.scope, path, facts, index, light: None, is_alone: false }
    }
}

/// Facts of a path, as far as they are known: results of the terms that hold for a whole path, and an order of its lights.
#[derive(Debug, Default)]
struct PathFacts {
    /// Bits of the first [`PathFacts::MAX_BITS`] terms.
    known: Cell<u64>,
    holding: Cell<u64>,
    /// Results of the later terms.
    others: Vec<Cell<Option<bool>>>,
    /// Indices of the lights in order of their vertices.
    lights: OnceCell<Vec<u32>>,
}

/// Number of a term among those that hold for a whole path.
type FactNumber = u32;

/// Number of a term before [`ResolvedCondition::with_facts`].
const UNNUMBERED: FactNumber = FactNumber::MAX;

impl PathFacts {
    const MAX_BITS: u32 = u64::BITS;

    /// Creates facts for a number of terms.
    fn new(terms: u32) -> Self {
        // Few conditions have so many terms, so most paths need no memory.
        Self { others: vec![Cell::new(None); terms.saturating_sub(Self::MAX_BITS) as usize], ..Self::default() }
    }

    /// Returns the result of a term, evaluated at most once.
    fn get(&self, number: FactNumber, evaluate: impl FnOnce() -> bool) -> bool {
        if let Some(other) = number.checked_sub(Self::MAX_BITS) {
            let known = &self.others[other as usize];
            let holds = known.get().unwrap_or_else(evaluate);
            known.set(Some(holds));
            return holds;
        }
        let bit = 1 << number;
        if self.known.get() & bit == 0 {
            let holds = evaluate();
            self.known.set(self.known.get() | bit);
            self.holding.set(if holds { self.holding.get() | bit } else { self.holding.get() });
        }
        self.holding.get() & bit != 0
    }

    /// Returns the lights at a vertex of the path.
    fn lights_at<'a>(&'a self, path: &'a LightPath, vertex: u32) -> impl Iterator<Item = &'a LightRecord> + use<'a> {
        const MAX_SCANNED: usize = 16;
        let lights = &path.lights[..];
        let (indices, scanned): (&[u32], _) = if lights.len() <= MAX_SCANNED {
            (&[], lights)
        } else {
            let vertex_of = |index: &u32| lights[*index as usize].vertex;
            let ordered = self.lights.get_or_init(|| {
                let mut all: Vec<u32> = (0..lights.len() as u32).collect();
                all.sort_by_key(vertex_of);
                all
            });
            let begin = ordered.partition_point(|index| vertex_of(index) < vertex);
            let count = ordered[begin..].partition_point(|index| vertex_of(index) == vertex);
            (&ordered[begin..begin + count], &[])
        };
        let scanned = scanned.iter().filter(move |light| light.vertex == vertex);
        indices.iter().map(|index| &lights[*index as usize]).chain(scanned)
    }
}

/// Returns the places at which a condition is evaluated: all intersections, or once none.
fn contexts(path: &LightPath) -> impl Iterator<Item = Option<u32>> + use<> {
    let count = path.intersections.len() as u32;
    (0..count).map(Some).chain((count == 0).then_some(None))
}

/// A set of names.
#[derive(Clone, Debug)]
struct NameSet(Vec<Name>);

impl NameSet {
    /// Returns the names that are `value` or lie in it.
    fn new(names: &Names, value: &str) -> Self {
        let within = names.iter().filter(|(_, (_, text))| is_text_within(text, value));
        Self(within.map(|(name, _)| *name).collect())
    }

    fn contains(&self, name: Name) -> bool {
        const MAX_SCANNED: usize = 8;
        if self.0.len() <= MAX_SCANNED { self.0.contains(&name) } else { self.0.binary_search(&name).is_ok() }
    }
}

/// A condition whose texts are resolved.
#[derive(Clone, Debug)]
enum ResolvedCondition {
    And(Box<Self>, Box<Self>),
    Or(Box<Self>, Box<Self>),
    Not(Box<Self>),
    Number(&'static Attribute, CompareOp, f64),
    Name(&'static Attribute, NameSet),
    /// A word by its index; `None`: no known word.
    Word(&'static Attribute, Option<u8>),
    Intersections(Quantity, FactNumber, Box<Self>),
    Lights(Quantity, FactNumber, Box<Self>),
    Sequence(Vec<NameSet>),
    InBox([[f64; 3]; 2]),
    InLasso(Vec<[f64; 2]>),
    /// A condition on the path, which holds or not at all its intersections and lights.
    OfPath(FactNumber, Box<Self>),
}

impl ResolvedCondition {
    fn new(condition: &Condition, names: &Names) -> Self {
        let inner = |condition: &Condition| Box::new(Self::new(condition, names));
        match condition {
            Condition::And(a, b) => Self::And(inner(a), inner(b)),
            Condition::Or(a, b) => Self::Or(inner(a), inner(b)),
            Condition::Not(condition) => Self::Not(inner(condition)),
            Condition::Number(attribute, CompareOp::Unequal, value) => {
                Self::Not(inner(&Condition::Number(attribute, CompareOp::Equal, *value)))
            }
            Condition::Number(attribute, op, value) => Self::Number(attribute, *op, *value),
            Condition::Word(attribute, EqualityOp::IsNot, value) => {
                Self::Not(inner(&Condition::Word(attribute, EqualityOp::Is, value.clone())))
            }
            Condition::Word(attribute, EqualityOp::Is, value) => match attribute.scale {
                Scale::Class(words) => {
                    Self::Word(attribute, (0u8..).zip(words.list()).find(|it| it.1 == value).map(|it| it.0))
                }
                _ => Self::Name(attribute, NameSet::new(names, value)),
            },
            Condition::Intersections(quantity, condition) => {
                Self::Intersections(*quantity, UNNUMBERED, inner(condition))
            }
            Condition::Lights(quantity, condition) => Self::Lights(*quantity, UNNUMBERED, inner(condition)),
            Condition::Sequence(objects) => {
                Self::Sequence(objects.iter().map(|object| NameSet::new(names, object)).collect())
            }
            Condition::InBox(corners) => Self::InBox(*corners),
            Condition::InLasso(points) => Self::InLasso(points.clone()),
        }
    }

    /// Checks whether the condition is on the path only.
    fn is_of_path(&self) -> bool {
        match self {
            Self::And(a, b) | Self::Or(a, b) => a.is_of_path() && b.is_of_path(),
            Self::Not(condition) => condition.is_of_path(),
            Self::Number(attribute, ..) | Self::Name(attribute, _) | Self::Word(attribute, _) => {
                attribute.table() == Table::Paths
            }
            Self::Sequence(_) | Self::InLasso(_) | Self::OfPath(..) => true,
            Self::Intersections(..) | Self::Lights(..) | Self::InBox(_) => false,
        }
    }

    /// Checks whether a part of the condition is on several intersections or lights.
    fn has_quantities(&self) -> bool {
        match self {
            Self::And(a, b) | Self::Or(a, b) => a.has_quantities() || b.has_quantities(),
            Self::Not(condition) => condition.has_quantities(),
            Self::Intersections(..) | Self::Lights(..) => true,
            _ => false,
        }
    }

    /// Counts the terms. Each name of a sequence and each point of a lasso is a term.
    fn count_terms(&self) -> usize {
        match self {
            Self::And(a, b) | Self::Or(a, b) => 1 + a.count_terms() + b.count_terms(),
            Self::Not(condition)
            | Self::Intersections(_, _, condition)
            | Self::Lights(_, _, condition)
            | Self::OfPath(_, condition) => 1 + condition.count_terms(),
            Self::Sequence(objects) => objects.len(),
            Self::InLasso(points) => points.len(),
            _ => 1,
        }
    }

    /// Gives a number to each term that holds for a whole path.
    /// - `count`: number of such terms so far.
    fn with_facts(self, count: &mut u32) -> Self {
        let next = |count: &mut u32| {
            *count += 1;
            *count - 1
        };
        if self.is_of_path() {
            return Self::OfPath(next(count), Box::new(self));
        }
        let mut inner = |condition: Box<Self>| Box::new(condition.with_facts(count));
        match self {
            Self::And(a, b) => {
                let [a, b] = path_first([inner(a), inner(b)]);
                Self::And(a, b)
            }
            Self::Or(a, b) => {
                let [a, b] = path_first([inner(a), inner(b)]);
                Self::Or(a, b)
            }
            Self::Not(condition) => Self::Not(inner(condition)),
            Self::Intersections(quantity, _, condition) => {
                let condition = inner(condition);
                Self::Intersections(quantity, next(count), condition)
            }
            Self::Lights(quantity, _, condition) => {
                let condition = inner(condition);
                Self::Lights(quantity, next(count), condition)
            }
            term => term,
        }
    }

    fn holds(&self, context: &Context<'_>) -> bool {
        let path = context.path;
        match self {
            Self::And(a, b) => a.holds(context) && b.holds(context),
            Self::Or(a, b) => a.holds(context) || b.holds(context),
            Self::Not(condition) => !condition.holds(context),
            Self::Number(attribute, op, value) => {
                context.has_value(attribute, |own| matches!(own, Value::Number(own) if op.compare(own, *value)))
            }
            Self::Name(attribute, set) => {
                context.has_value(attribute, |own| matches!(own, Value::Name(own) if set.contains(own)))
            }
            Self::Word(attribute, word) => {
                context.has_value(attribute, |own| matches!(own, Value::Word(own) if Some(own) == *word))
            }
            Self::Intersections(_, _, condition) if context.is_alone => condition.holds(context),
            Self::Intersections(quantity, fact, condition) => context.facts.get(*fact, || {
                quantity.holds(contexts(path).map(|index| condition.holds(&Context { index, light: None, ..*context })))
            }),
            Self::Lights(quantity, _, condition) if context.is_alone => {
                // An intersection alone has the lights sampled there; a light alone has itself.
                let own = context.lights();
                quantity.holds(own.map(|light| condition.holds(&Context { light: Some(light), ..*context })))
            }
            Self::Lights(quantity, fact, condition) => context.facts.get(*fact, || {
                let lights = path.lights.iter().map(|light| (light, path.parent(light)));
                let holds = |(light, index)| condition.holds(&Context { index, light: Some(light), ..*context });
                quantity.holds(lights.map(holds))
            }),
            Self::Sequence(objects) => {
                // Number of objects in this order on the branch up to each intersection.
                let mut visited = Vec::<usize>::with_capacity(path.intersections.len());
                for it in &path.intersections {
                    let before = (it.parent as usize).checked_sub(1).map_or(0, |parent| visited[parent]);
                    let is_next = objects.get(before).is_some_and(|set| set.contains(it.object));
                    visited.push(before + usize::from(is_next));
                }
                objects.is_empty() || visited.contains(&objects.len())
            }
            Self::InBox([low, high]) => context
                .intersection()
                .is_some_and(|it| (0..3).all(|axis| (low[axis]..=high[axis]).contains(&it.position[axis]))),
            Self::OfPath(fact, condition) => context.facts.get(*fact, || condition.holds(context)),
            Self::InLasso(points) => is_inside(points, context.pixel().map(|axis| f64::from(axis) + 0.5)),
        }
    }
}

/// Puts a condition on the path first, since it is evaluated only once.
fn path_first([a, b]: [Box<ResolvedCondition>; 2]) -> [Box<ResolvedCondition>; 2] {
    if matches!(*b, ResolvedCondition::OfPath(..)) { [b, a] } else { [a, b] }
}

/// Checks whether a point lies within a closed line, by the even-odd rule.
fn is_inside(line: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let ends = line.iter().cycle().skip(1);
    let crossings = line.iter().zip(ends).filter(|([_, y0], [_, y1])| (*y0 <= y) != (*y1 <= y));
    crossings.filter(|([x0, y0], [x1, y1])| x0 + (y - y0) / (y1 - y0) * (x1 - x0) <= x).count() % 2 == 1
}

impl Quantity {
    fn holds(self, mut items: impl Iterator<Item = bool>) -> bool {
        match self {
            Self::Any => items.any(|holds| holds),
            Self::All => items.all(|holds| holds),
        }
    }
}

impl CompareOp {
    fn compare(self, a: f64, b: f64) -> bool {
        match self {
            Self::Equal => a == b,
            Self::Unequal => a != b,
            Self::Below => a < b,
            Self::AtMost => a <= b,
            Self::Above => a > b,
            Self::AtLeast => a >= b,
        }
    }
}

/// A path, and the intersection and the light in question.
#[derive(Clone, Copy)]
struct Context<'a> {
    scope: &'a Scope,
    path: &'a LightPath,
    facts: &'a PathFacts,
    /// Index of the intersection in the path.
    index: Option<u32>,
    light: Option<&'a LightRecord>,
    /// Whether the intersection or the light is examined alone.
    is_alone: bool,
}

impl<'a> Context<'a> {
    fn intersection(&self) -> Option<&'a Intersection> {
        self.index.and_then(|index| self.path.intersections.get(index as usize))
    }

    /// Returns the light in question, or else all lights sampled at the intersection.
    fn lights(&self) -> impl Iterator<Item = &'a LightRecord> + use<'a> {
        let all =
            self.light.is_none().then(|| self.facts.lights_at(self.path, self.index.map_or(0, |index| index + 1)));
        self.light.into_iter().chain(all.into_iter().flatten())
    }

    fn pixel(&self) -> [u32; 2] {
        let (pixel, width) = (self.path.key.pixel, self.scope.film[0].max(1));
        [pixel % width, pixel / width]
    }

    /// Checks whether the value of an attribute fulfills a predicate: of the path, of the intersection, or of any of the lights.
    fn has_value(&self, attribute: &Attribute, holds: impl Fn(Value) -> bool) -> bool {
        match attribute.getter {
            Getter::Path(get) => get(self.scope, self.path).is_some_and(holds),
            Getter::Intersection(get) => self.intersection().and_then(|it| get(self.scope, it)).is_some_and(holds),
            Getter::Light(get) => self.lights().filter_map(|it| get(self.scope, it)).any(holds),
        }
    }
}
