//! Events of a path, and the conditions of an expression on one event.

use std::collections::BTreeSet;
use std::fmt;

/// Kind of event at a vertex of a path, from the camera to the source. The source is the last event, and a path has only one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum EventKind {
    /// `C`: the camera, the first event.
    Camera,
    /// `<RD>`
    ReflectedDiffuse,
    /// `<RG>`
    ReflectedGlossy,
    /// `<RS>`
    ReflectedSpecular,
    /// `<TD>`
    TransmittedDiffuse,
    /// `<TG>`
    TransmittedGlossy,
    /// `<TS>`
    TransmittedSpecular,
    /// `V`: scattered in a medium.
    Volume,
    /// `L`: a lamp.
    Light,
    /// `O`: an object that emits without being a lamp, a glowing medium.
    Object,
    /// `B`: the background.
    Background,
}

impl EventKind {
    /// All kinds, in order.
    pub const ALL: [Self; 11] = [
        Self::Camera,
        Self::ReflectedDiffuse,
        Self::ReflectedGlossy,
        Self::ReflectedSpecular,
        Self::TransmittedDiffuse,
        Self::TransmittedGlossy,
        Self::TransmittedSpecular,
        Self::Volume,
        Self::Light,
        Self::Object,
        Self::Background,
    ];

    /// Checks whether a path ends with this kind.
    pub fn is_source(self) -> bool {
        matches!(self, Self::Light | Self::Object | Self::Background)
    }

    /// Returns the kind as a bit of a set.
    pub(crate) const fn bit(self) -> u16 {
        1 << self as u16
    }
}

/// Set of all kinds.
pub(crate) const ANY_KIND: u16 = (1 << EventKind::ALL.len()) - 1;

/// Condition of an expression on one event.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EventPattern {
    /// Alternatives, of which one must match; with `negated`, none may match.
    pub(crate) any: Vec<EventClass>,
    pub(crate) negated: bool,
}

/// Set of kinds and labels.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct EventClass {
    /// Kinds, a bit for each [`EventKind`].
    pub(crate) kinds: u16,
    /// Labels, of which one must match; with the flag, none may match. `None`: any label.
    pub(crate) labels: Option<(Vec<String>, bool)>,
}

impl EventPattern {
    pub(crate) fn from_class(class: EventClass) -> Self {
        Self { any: vec![class], negated: false }
    }

    /// Checks whether an event of this kind matches, at something that has the labels for which `has` is true.
    pub fn matches(&self, kind: EventKind, has: impl Fn(&str) -> bool) -> bool {
        let fits = |class: &EventClass| {
            let labeled = |(labels, negated): &(Vec<String>, bool)| labels.iter().any(|label| has(label)) != *negated;
            class.kinds & kind.bit() != 0 && class.labels.as_ref().is_none_or(labeled)
        };
        self.any.iter().any(fits) != self.negated
    }

    /// Checks whether an event of this kind matches with suitable labels.
    pub fn may_match(&self, kind: EventKind) -> bool {
        let is_asked_for = |label: &str| {
            let classes = self.any.iter().filter(|class| class.kinds & kind.bit() != 0);
            let mut asking = classes.filter_map(|class| class.labels.as_ref().filter(|(_, negated)| !negated));
            asking.any(|(labels, _)| labels.iter().any(|it| it == label))
        };
        self.matches(kind, |_| true)
            || self.matches(kind, |_| false)
            // In a negated bracket, some labels must be missing and others present: [^'a'<L.[^'b']>].
            || self.matches(kind, |label| !is_asked_for(label))
    }

    /// Returns the kinds that match, regardless of labels.
    pub fn kinds(&self) -> impl Iterator<Item = EventKind> + '_ {
        EventKind::ALL.into_iter().filter(|kind| self.may_match(*kind))
    }

    /// Returns the condition on the labels alone, for any kind.
    pub fn with_any_kind(&self) -> Self {
        let any = self.any.iter().map(|class| EventClass { kinds: ANY_KIND, ..class.clone() }).collect();
        Self { any, negated: self.negated }
    }

    /// Returns the labels as part of a sentence: ` at 'a'`; empty without labels.
    pub fn label_phrase(&self) -> String {
        let labels: Vec<String> = self.labels().map(|label| format!("'{label}'")).collect();
        let is_negated = self.negated || self.any.iter().any(|class| matches!(class.labels, Some((_, true))));
        if labels.is_empty() {
            return String::new();
        }
        let places = if is_negated { " at places other than " } else { " at " };
        format!("{places}{}", labels.join(" or "))
    }

    /// Returns the labels that the condition names.
    pub fn labels(&self) -> impl Iterator<Item = &str> {
        self.any.iter().filter_map(|class| class.labels.as_ref()).flat_map(|it| &it.0).map(String::as_str)
    }
}

/// Sets of kinds that have a short form.
const SHORT_FORMS: [(&str, u16); 25] = {
    use EventKind::{
        ReflectedDiffuse as RD, ReflectedGlossy as RG, ReflectedSpecular as RS, TransmittedDiffuse as TD,
        TransmittedGlossy as TG, TransmittedSpecular as TS,
    };
    let (l, o, b) = (EventKind::Light.bit(), EventKind::Object.bit(), EventKind::Background.bit());
    let (r, t) = (RD.bit() | RG.bit() | RS.bit(), TD.bit() | TG.bit() | TS.bit());
    let (d, g, s) = (RD.bit() | TD.bit(), RG.bit() | TG.bit(), RS.bit() | TS.bit());
    [
        (".", ANY_KIND),
        (".", ANY_KIND & !EventKind::Camera.bit()),
        ("C", EventKind::Camera.bit()),
        ("R", r),
        ("T", t),
        ("[RT]", r | t),
        ("[RTV]", r | t | EventKind::Volume.bit()),
        ("V", EventKind::Volume.bit()),
        ("L", l),
        ("O", o),
        ("B", b),
        ("[LO]", l | o),
        ("[LB]", l | b),
        ("[OB]", o | b),
        ("[LOB]", l | o | b),
        ("D", d),
        ("G", g),
        ("S", s),
        ("[GS]", g | s),
        ("[DS]", d | s),
        ("[DG]", d | g),
        ("<R[GS]>", RG.bit() | RS.bit()),
        ("<T[GS]>", TG.bit() | TS.bit()),
        ("<R[DG]>", RD.bit() | RG.bit()),
        ("<T[DG]>", TD.bit() | TG.bit()),
    ]
};

/// Formats a set of kinds in the notation of expressions.
pub fn format_kinds(kinds: impl IntoIterator<Item = EventKind>) -> String {
    const ONE: [&str; EventKind::ALL.len()] = ["C", "<RD>", "<RG>", "<RS>", "<TD>", "<TG>", "<TS>", "V", "L", "O", "B"];
    let set = kinds.into_iter().fold(0, |set, kind| set | kind.bit());
    if let Some((short, _)) = SHORT_FORMS.iter().find(|(_, kinds)| *kinds == set) {
        return (*short).to_owned();
    }
    let single: Vec<&str> = ONE.iter().enumerate().filter(|(at, _)| set >> at & 1 == 1).map(|(_, one)| *one).collect();
    if let [one] = single[..] { one.to_owned() } else { format!("[{}]", single.concat()) }
}

impl fmt::Display for EventPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", format_kinds(self.kinds()), self.label_phrase())
    }
}

/// Labels of something in the scene, a bit for each label of a [`Vocabulary`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LabelSet(pub(crate) u128);

impl LabelSet {
    /// Returns the labels of both sets.
    #[inline]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// The labels that the expressions of a frame name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Vocabulary(Vec<String>);

impl Vocabulary {
    /// Maximum number of labels.
    pub const MAX_LABELS: usize = 128;

    /// Collects the labels; `None`: there are more than [`Self::MAX_LABELS`].
    pub fn from_labels<'a>(labels: impl IntoIterator<Item = &'a str>) -> Option<Self> {
        let all: BTreeSet<&str> = labels.into_iter().collect();
        (all.len() <= Self::MAX_LABELS).then(|| Self(all.into_iter().map(str::to_owned).collect()))
    }

    /// Returns the labels in order.
    pub fn labels(&self) -> &[String] {
        &self.0
    }

    /// Returns the labels that match something with these names. A label matches its own name, and `a` also matches everything
    /// within it, such as `a.b`.
    pub fn label_set(&self, names: &[&str]) -> LabelSet {
        let has = |label: &str| {
            let within =
                |name: &str| name.strip_prefix(label).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
            names.iter().any(|name| within(name))
        };
        LabelSet(self.0.iter().enumerate().filter(|(_, label)| has(label)).fold(0, |set, (bit, _)| set | 1 << bit))
    }

    /// Checks whether a set has a label.
    pub fn contains(&self, set: LabelSet, label: &str) -> bool {
        self.0.binary_search_by(|known| known.as_str().cmp(label)).is_ok_and(|bit| set.0 >> bit & 1 == 1)
    }
}
