//! Events of a path, and what an expression asks of one.

use std::collections::BTreeSet;

/// What happens at a vertex of a path, from the camera to the source. The source is the last event, and the only one of its path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Kind {
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

impl Kind {
    /// All, in order.
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

    /// Whether a path ends with it.
    pub fn is_source(self) -> bool {
        matches!(self, Self::Light | Self::Object | Self::Background)
    }

    /// As a bit of a set.
    pub(crate) const fn bit(self) -> u16 {
        1 << self as u16
    }
}

/// All kinds.
pub(crate) const ANY: u16 = (1 << Kind::ALL.len()) - 1;

/// What an expression asks of one event.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Event {
    /// One of these fits; with `negated` none does.
    pub(crate) any: Vec<Class>,
    pub(crate) negated: bool,
}

/// Kinds and labels.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Class {
    /// Bits of [`Kind`].
    pub(crate) kinds: u16,
    /// One of these labels; with the flag none of them. `None`: whatever it is called.
    pub(crate) labels: Option<(Vec<String>, bool)>,
}

impl Event {
    pub(crate) fn of(class: Class) -> Self {
        Self { any: vec![class], negated: false }
    }

    /// Whether an event of this kind fits, at something that has the labels for which `has` is true.
    pub fn fits(&self, kind: Kind, has: impl Fn(&str) -> bool) -> bool {
        let fits = |class: &Class| {
            let labelled = |(labels, negated): &(Vec<String>, bool)| labels.iter().any(|label| has(label)) != *negated;
            class.kinds & kind.bit() != 0 && class.labels.as_ref().is_none_or(labelled)
        };
        self.any.iter().any(fits) != self.negated
    }

    /// The labels that it names.
    pub fn labels(&self) -> impl Iterator<Item = &str> {
        self.any.iter().filter_map(|class| class.labels.as_ref()).flat_map(|it| &it.0).map(String::as_str)
    }
}

/// Which labels of a [`Vocabulary`] something has: a bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LabelSet(pub(crate) u128);

impl LabelSet {
    /// The labels of both.
    #[inline]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// The labels that the expressions of a frame name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Vocabulary(Vec<String>);

impl Vocabulary {
    /// Most labels.
    pub const MOST: usize = 128;

    /// Of all these labels; `None`: they are more than [`Self::MOST`].
    pub fn of<'a>(labels: impl IntoIterator<Item = &'a str>) -> Option<Self> {
        let all: BTreeSet<&str> = labels.into_iter().collect();
        (all.len() <= Self::MOST).then(|| Self(all.into_iter().map(str::to_owned).collect()))
    }

    /// The labels in order.
    pub fn labels(&self) -> &[String] {
        &self.0
    }

    /// The labels that something of these names has: a label stands for the name, and as `a` for what is within it, `a.b`.
    pub fn set(&self, names: &[&str]) -> LabelSet {
        let has = |label: &str| {
            let within =
                |name: &str| name.strip_prefix(label).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
            names.iter().any(|name| within(name))
        };
        LabelSet(self.0.iter().enumerate().filter(|(_, label)| has(label)).fold(0, |set, (bit, _)| set | 1 << bit))
    }

    /// Whether a set has a label.
    pub fn has(&self, set: LabelSet, label: &str) -> bool {
        self.0.binary_search_by(|known| known.as_str().cmp(label)).is_ok_and(|bit| set.0 >> bit & 1 == 1)
    }
}
