//! Numbers of elements and links by kind.

use crate::element::{Element, Kind};
use crate::link::Link;

/// Numbers by kind of element.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kinds {
    /// Groups of surfaces. The light of each is stored by direction.
    pub clusters: usize,
    /// Parts of surfaces with one normal, or nearly so.
    pub patches: usize,
    /// Parts of surfaces too curved for one normal. The light of each is stored by direction.
    pub curved: usize,
    /// Boxes of fog.
    pub fog: usize,
}

impl Kinds {
    fn of(kinds: impl Iterator<Item = Kind>) -> Self {
        kinds.fold(Self::default(), |mut sum, kind| {
            *match kind {
                Kind::Cluster => &mut sum.clusters,
                Kind::Patch => &mut sum.patches,
                Kind::Ball => &mut sum.curved,
                Kind::Fog => &mut sum.fog,
            } += 1;
            sum
        })
    }

    /// Returns the total.
    pub fn total(self) -> usize {
        self.clusters + self.patches + self.curved + self.fog
    }
}

/// Numbers of elements and links of a solution by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Census {
    /// Elements, including clusters.
    pub elements: Kinds,
    /// Links among elements, by kind of the receiver.
    pub receivers: Kinds,
    /// Links among elements, by kind of the source.
    pub senders: Kinds,
}

impl Census {
    pub(crate) fn new(elements: &[Element], links: &[Link]) -> Self {
        let kind = |element: u32| elements[element as usize].kind;
        Self {
            elements: Kinds::of(elements.iter().map(|element| element.kind)),
            receivers: Kinds::of(links.iter().map(|link| kind(link.receiver))),
            senders: Kinds::of(links.iter().map(|link| kind(link.source))),
        }
    }
}
