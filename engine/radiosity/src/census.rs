//! Numbers of elements and links by kind.

use crate::element::{Element, ElementKind};
use crate::link::Link;

/// Numbers by kind of element.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KindCounts {
    /// Groups of surfaces. The light of each is stored by direction.
    pub clusters: usize,
    /// Parts of surfaces with one normal, or nearly so.
    pub patches: usize,
    /// Parts of surfaces too curved for one normal. The light of each is stored by direction.
    pub curved: usize,
    /// Boxes of fog.
    pub fog: usize,
}

impl KindCounts {
    fn count(kinds: impl Iterator<Item = ElementKind>) -> Self {
        kinds.fold(Self::default(), |mut sum, kind| {
            *match kind {
                ElementKind::Cluster => &mut sum.clusters,
                ElementKind::Patch => &mut sum.patches,
                ElementKind::Curved => &mut sum.curved,
                ElementKind::Volume => &mut sum.fog,
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
    pub elements: KindCounts,
    /// Links among elements, by kind of the receiver.
    pub receivers: KindCounts,
    /// Links among elements, by kind of the source.
    pub sources: KindCounts,
}

impl Census {
    pub(crate) fn new(elements: &[Element], links: &[Link]) -> Self {
        let kind = |element: u32| elements[element as usize].kind;
        Self {
            elements: KindCounts::count(elements.iter().map(|element| element.kind)),
            receivers: KindCounts::count(links.iter().map(|link| kind(link.receiver))),
            sources: KindCounts::count(links.iter().map(|link| kind(link.source))),
        }
    }
}
