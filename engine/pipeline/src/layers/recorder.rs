//! Hears of samples while they are rendered, and adds their light to the layers that take it.
//!
//! Light is added up by the set of layers that take it together ([`Takers`]), of which the expressions of a frame have few, and each
//! layer gets the sums of its sets when a pixel is done. So the cost of a sample hardly depends on the number of layers.
//!
//! A path stands in one state of the automaton as long as no surface has scattered it both diffusely and about a direction: the cheap case,
//! apart from the others.

use super::LayerPlan;
use femc_film::{LayerLight, LayerSums};
use femc_geometry::Ray;
use femc_layers::{DEAD, Kind, Labels, NO_LAYERS, State, Takers};
use femc_math::Rgb;
use femc_montecarlo::record::{
    Contribution, Found, Hears, Leaving, Lobes, Place, Recorder, Scatterer, Split, Stop, Transmitted, Vertex,
};
use femc_prepared::Prepared;

/// Sums up the layers of the pixels that a tracer renders one after the other.
pub(super) struct LayerRecorder<'a> {
    plan: &'a LayerPlan,
    prepared: &'a Prepared,
    /// Pixel by pixel, layer by layer; without the latest pixel.
    sums: Vec<LayerSums>,
    /// The pixel that is being rendered: its light by [`Takers`], and its samples.
    latest: Option<u32>,
    pixel: Vec<LayerLight>,
    counts: LayerSums,
    // Of the sample that is being traced:
    sample: u32,
    /// Where its path stands with all of its light; dead where it stands nowhere, or in several states.
    state: State,
    /// The states of a path that was split, and what share of its light is in each, by channel. Dead states are left out.
    ways: Vec<(State, Rgb)>,
    before: Vec<(State, Rgb)>,
    /// Labels of the latest vertex, and how it scatters.
    labels: Labels,
    split: Split,
    /// Light by [`Takers`], and those who have some.
    light: Vec<Rgb>,
    lit: Vec<Takers>,
}

impl<'a> LayerRecorder<'a> {
    pub(super) fn new(plan: &'a LayerPlan, prepared: &'a Prepared) -> Self {
        let sets = plan.automaton.layers().len();
        Self {
            plan,
            prepared,
            sums: Vec::new(),
            latest: None,
            pixel: vec![LayerLight::default(); sets],
            counts: LayerSums::default(),
            sample: 0,
            state: DEAD,
            ways: Vec::new(),
            before: Vec::new(),
            labels: plan.plain,
            split: Split { transmitted: Transmitted::No, lobes: Lobes::Glossy },
            light: vec![Rgb::ZERO; sets],
            lit: Vec::with_capacity(sets),
        }
    }

    pub(super) fn into_sums(mut self) -> Vec<LayerSums> {
        self.end_pixel();
        self.sums
    }

    #[inline]
    fn after(&self, state: State, kind: Kind) -> State {
        self.plan.automaton.next(state, kind, self.labels)
    }

    #[inline]
    fn is_dead(&self) -> bool {
        self.state == DEAD && self.ways.is_empty()
    }

    /// Adds light of a source that a path in this state has met.
    #[inline]
    fn add(&mut self, state: State, (kind, labels): (Kind, Labels), color: Rgb) {
        let automaton = &self.plan.automaton;
        let takers = automaton.takers(automaton.next(state, kind, labels));
        if takers == NO_LAYERS {
            return;
        }
        let light = &mut self.light[usize::from(takers)];
        if *light == Rgb::ZERO {
            self.lit.push(takers);
        }
        *light += color;
    }

    /// Adds light that comes to the camera from the latest surface, which scatters it to a path in this state.
    #[inline]
    fn add_scattered(&mut self, state: State, lamp: (Kind, Labels), color: Rgb) {
        let Split { transmitted, lobes } = self.split;
        let [diffuse, glossy] = kinds(transmitted);
        match lobes {
            Lobes::Diffuse => self.add(self.after(state, diffuse), lamp, color),
            Lobes::Glossy => self.add(self.after(state, glossy), lamp, color),
            Lobes::Both(share) => {
                self.add(self.after(state, diffuse), lamp, color * share);
                self.add(self.after(state, glossy), lamp, color * (Rgb::ONE - share));
            }
        }
    }

    /// Adds light that was found by a path in this state.
    #[inline]
    fn add_found(&mut self, state: State, found: Found, light: Option<u32>, color: Rgb) {
        let lamp = (Kind::Light, self.plan.lamp(light));
        match found {
            // The field ends paths of the method `fem` alone, which has no layers.
            Found::Sight | Found::Met | Found::Field => self.add(state, lamp, color),
            Found::Surface => self.add_scattered(state, lamp, color),
            Found::Airlight(medium) => {
                let state = self.plan.automaton.next(state, Kind::Volume, self.plan.medium(medium));
                self.add(state, lamp, color);
            }
            Found::Glow(medium) => self.add(state, (Kind::Object, self.plan.medium(medium)), color),
        }
    }

    /// The same by a path that was split.
    #[inline(never)]
    fn add_to_ways(&mut self, found: Found, light: Option<u32>, color: Rgb) {
        for at in 0..self.ways.len() {
            let (state, share) = self.ways[at];
            self.add_found(state, found, light, color * share);
        }
    }

    /// Takes a path that was split, or that the latest surface splits, on by these events, each with its share.
    #[inline(never)]
    fn step_ways(&mut self, events: &[(Kind, Rgb)]) {
        if self.state != DEAD {
            self.ways.push((self.state, Rgb::ONE));
            self.state = DEAD;
        }
        std::mem::swap(&mut self.ways, &mut self.before);
        self.ways.clear();
        for &(kind, part) in events {
            for at in 0..self.before.len() {
                let (state, share) = self.before[at];
                let state = self.after(state, kind);
                if state == DEAD {
                    continue;
                }
                let share = share * part;
                match self.ways.iter_mut().find(|known| known.0 == state) {
                    Some((_, all)) => *all += share,
                    None => self.ways.push((state, share)),
                }
            }
        }
    }

    /// Takes the path on by an event.
    #[inline]
    fn step(&mut self, kind: Kind) {
        if self.state != DEAD {
            self.state = self.after(self.state, kind);
        } else {
            self.step_ways(&[(kind, Rgb::ONE)]);
        }
    }

    #[cold]
    fn begin_pixel(&mut self, pixel: u32) {
        self.end_pixel();
        self.latest = Some(pixel);
    }

    /// Gives each layer the light of the pixel's samples.
    fn end_pixel(&mut self) {
        if self.latest.take().is_none() {
            return;
        }
        let first = self.sums.len();
        let counts = std::mem::take(&mut self.counts);
        self.sums.resize(first + self.plan.count, counts);
        let layers = &mut self.sums[first..];
        for (light, &takers) in self.pixel.iter_mut().zip(self.plan.automaton.layers()) {
            let Some(light) = light.take() else { continue };
            let mut rest = takers;
            while rest != 0 {
                layers[rest.trailing_zeros() as usize].merge(&light);
                rest &= rest - 1;
            }
        }
    }
}

/// Events of a surface's lobes: diffuse, glossy.
#[inline]
fn kinds(transmitted: Transmitted) -> [Kind; 2] {
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
        self.state = self.plan.automaton.start();
        self.ways.clear();
        Hears::All
    }

    #[inline]
    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        if !self.plan.are_alike && !self.is_dead() {
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
        if !self.is_dead() {
            self.split = split();
        }
    }

    #[inline]
    fn leave(&mut self, way: Leaving) {
        if self.is_dead() {
            return;
        }
        match way {
            Leaving::Straight => {}
            Leaving::Delta(Transmitted::No) => self.step(Kind::ReflectedSpecular),
            Leaving::Delta(Transmitted::Yes) => self.step(Kind::TransmittedSpecular),
            Leaving::Scattered { by: Scatterer::Phase, .. } => self.step(Kind::Volume),
            Leaving::Scattered { by: Scatterer::Diffuse | Scatterer::Glossy, .. } => {
                let Split { transmitted, lobes } = self.split;
                let [diffuse, glossy] = kinds(transmitted);
                match lobes {
                    Lobes::Diffuse => self.step(diffuse),
                    Lobes::Glossy => self.step(glossy),
                    Lobes::Both(share) => self.step_ways(&[(diffuse, share), (glossy, Rgb::ONE - share)]),
                }
            }
        }
    }

    fn hidden(&mut self, _: impl FnOnce() -> Ray) {}

    #[inline]
    fn light(&mut self, contribution: impl FnOnce() -> Contribution) {
        if self.is_dead() {
            return;
        }
        let Contribution { color, found, light, .. } = contribution();
        if color == Rgb::ZERO {
            return;
        }
        if self.state != DEAD {
            self.add_found(self.state, found, light, color);
        } else {
            self.add_to_ways(found, light, color);
        }
    }

    fn stop(&mut self, _: u32, _: Stop, _: Rgb) {}

    #[inline]
    fn end(&mut self, color: Option<Rgb>) {
        // What the film refuses counts in no layer, either.
        let counts = color.is_some();
        if counts {
            self.counts.count(self.sample);
        }
        for takers in self.lit.drain(..).map(usize::from) {
            let light = std::mem::take(&mut self.light[takers]);
            if counts {
                self.pixel[takers].add(self.sample, light);
            }
        }
    }
}
