//! Numbers of elements and links by kind.

use crate::element::{Element, Shape};
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
    fn count<'a>(elements: impl Iterator<Item = &'a Element>) -> Self {
        elements.fold(Self::default(), |mut sum, element| {
            *match element.shape {
                Shape::Cluster(_) => &mut sum.clusters,
                Shape::Patch(_) => &mut sum.patches,
                Shape::Curved(_) => &mut sum.curved,
                Shape::Volume(_) => &mut sum.fog,
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
        Self {
            elements: KindCounts::count(elements.iter()),
            receivers: KindCounts::count(links.iter().map(|link| &elements[link.receiver as usize])),
            sources: KindCounts::count(links.iter().map(|link| &elements[link.source as usize])),
        }
    }
}
