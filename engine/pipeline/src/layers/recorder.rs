//! Hears of samples while they are rendered, and adds their light to the layers that take it.

use super::LayerPlan;
use femc_film::LayerSums;
use femc_geometry::Ray;
use femc_layers::{DEAD, Kind, LabelSet, State};
use femc_math::Rgb;
use femc_montecarlo::record::{
    Contribution, Found, Hears, Leaving, Place, Recorder, Scatterer, Split, Stop, Transmitted, Vertex,
};
use femc_prepared::Prepared;

/// Sums up the layers of the pixels that a tracer renders one after the other.
pub(super) struct LayerRecorder<'a> {
    plan: &'a LayerPlan,
    prepared: &'a Prepared,
    /// Pixel by pixel, layer by layer. The counts are those of a pixel's first layer.
    sums: Vec<LayerSums>,
    latest: Option<u32>,
    // Of the sample that is being traced:
    sample: u32,
    /// Where its path stands, and with what share of its light by channel. Dead states are left out.
    states: Vec<(State, Rgb)>,
    before: Vec<(State, Rgb)>,
    /// Labels of the latest vertex.
    labels: LabelSet,
    split: Split,
    /// Light of each layer, and those that have some, a bit each.
    light: Vec<Rgb>,
    lit: u64,
}

/// Where nothing was told of the shares, there is nothing diffuse.
const SHARP: Split = Split { transmitted: Transmitted::No, diffuse: Rgb::ZERO };

impl<'a> LayerRecorder<'a> {
    pub(super) fn new(plan: &'a LayerPlan, prepared: &'a Prepared) -> Self {
        Self {
            plan,
            prepared,
            sums: Vec::new(),
            latest: None,
            sample: 0,
            states: Vec::new(),
            before: Vec::new(),
            labels: LabelSet::default(),
            split: SHARP,
            light: vec![Rgb::ZERO; plan.count],
            lit: 0,
        }
    }

    pub(super) fn into_sums(self) -> Vec<LayerSums> {
        self.sums
    }

    /// The state after an event. What has labels that no layer was compiled for is nothing that a scene has.
    #[inline]
    fn after(&self, state: State, kind: Kind, labels: LabelSet) -> State {
        let automaton = &self.plan.automaton;
        automaton.symbol(kind, labels).map_or(DEAD, |symbol| automaton.next(state, symbol))
    }

    /// Takes the path on by an event.
    #[inline]
    fn step(&mut self, kind: Kind, share: Rgb) {
        for at in 0..self.before.len() {
            let (state, had) = self.before[at];
            let state = self.after(state, kind, self.labels);
            if state == DEAD {
                continue;
            }
            let has = had * share;
            match self.states.iter_mut().find(|known| known.0 == state) {
                Some((_, all)) => *all += has,
                None => self.states.push((state, has)),
            }
        }
    }

    /// Adds light of a source that was met in a state.
    #[inline]
    fn add(&mut self, state: State, (kind, labels): (Kind, LabelSet), color: Rgb) {
        let mut layers = self.plan.automaton.accepts(self.after(state, kind, labels));
        self.lit |= layers;
        while layers != 0 {
            self.light[layers.trailing_zeros() as usize] += color;
            layers &= layers - 1;
        }
    }

    #[cold]
    fn begin_pixel(&mut self, pixel: u32) {
        self.latest = Some(pixel);
        self.sums.resize(self.sums.len() + self.plan.count, LayerSums::default());
    }
}

/// Events of a surface's lobes: diffuse, glossy.
#[inline]
fn lobes(transmitted: Transmitted) -> [Kind; 2] {
    match transmitted {
        Transmitted::No => [Kind::ReflectedDiffuse, Kind::ReflectedGlossy],
        Transmitted::Yes => [Kind::TransmittedDiffuse, Kind::TransmittedGlossy],
    }
}

impl Recorder for LayerRecorder<'_> {
    const HIDDEN: bool = false;

    #[inline]
    fn begin(&mut self, pixel: u32, sample: u32) -> Hears {
        if self.latest != Some(pixel) {
            self.begin_pixel(pixel);
        }
        self.sample = sample;
        self.states.clear();
        let start = self.plan.automaton.start();
        if start != DEAD {
            self.states.push((start, Rgb::ONE));
        }
        while self.lit != 0 {
            self.light[self.lit.trailing_zeros() as usize] = Rgb::ZERO;
            self.lit &= self.lit - 1;
        }
        Hears::All
    }

    #[inline]
    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        if self.plan.is_labelled() && !self.states.is_empty() {
            self.labels = match vertex().place {
                Place::Surface { instance, primitive, material } => {
                    self.plan.surface(self.prepared.object_of(instance, primitive), material)
                }
                Place::Medium(medium) => self.plan.medium(medium),
            };
        }
    }

    #[inline]
    fn split(&mut self, split: impl FnOnce() -> Split) {
        if !self.states.is_empty() {
            self.split = split();
        }
    }

    #[inline]
    fn leave(&mut self, way: Leaving) {
        if self.states.is_empty() || way == Leaving::Straight {
            return;
        }
        std::mem::swap(&mut self.states, &mut self.before);
        self.states.clear();
        match way {
            Leaving::Straight => {}
            Leaving::Delta(Transmitted::No) => self.step(Kind::ReflectedSpecular, Rgb::ONE),
            Leaving::Delta(Transmitted::Yes) => self.step(Kind::TransmittedSpecular, Rgb::ONE),
            Leaving::Scattered { by: Scatterer::Phase, .. } => self.step(Kind::Volume, Rgb::ONE),
            Leaving::Scattered { by: Scatterer::Diffuse | Scatterer::Glossy, .. } => {
                let Split { transmitted, diffuse } = self.split;
                for (kind, share) in lobes(transmitted).into_iter().zip([diffuse, Rgb::ONE - diffuse]) {
                    if share != Rgb::ZERO {
                        self.step(kind, share);
                    }
                }
            }
        }
    }

    fn hidden(&mut self, _: impl FnOnce() -> Ray) {}

    #[inline]
    fn light(&mut self, contribution: impl FnOnce() -> Contribution) {
        if self.states.is_empty() {
            return;
        }
        let Contribution { color, found, light, .. } = contribution();
        if color == Rgb::ZERO {
            return;
        }
        let lamp = (Kind::Light, self.plan.lamp(light));
        for at in 0..self.states.len() {
            let (state, share) = self.states[at];
            match found {
                // The field ends paths of the method `fem` alone, which has no layers.
                Found::Sight | Found::Met | Found::Field => self.add(state, lamp, color * share),
                Found::Surface => {
                    let Split { transmitted, diffuse } = self.split;
                    for (kind, part) in lobes(transmitted).into_iter().zip([diffuse, Rgb::ONE - diffuse]) {
                        if part != Rgb::ZERO {
                            self.add(self.after(state, kind, self.labels), lamp, color * share * part);
                        }
                    }
                }
                Found::Airlight(medium) => {
                    self.add(self.after(state, Kind::Volume, self.plan.medium(medium)), lamp, color * share);
                }
                Found::Glow(medium) => self.add(state, (Kind::Object, self.plan.medium(medium)), color * share),
            }
        }
    }

    fn stop(&mut self, _: u32, _: Stop, _: Rgb) {}

    #[inline]
    fn end(&mut self, color: Option<Rgb>) {
        // What the film refuses counts in no layer, either.
        if color.is_none() {
            return;
        }
        let first = self.sums.len() - self.plan.count;
        self.sums[first].count(self.sample);
        let mut lit = self.lit;
        while lit != 0 {
            let layer = lit.trailing_zeros() as usize;
            self.sums[first + layer].add(self.sample, self.light[layer]);
            lit &= lit - 1;
        }
    }
}
