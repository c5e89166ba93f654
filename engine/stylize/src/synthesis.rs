//! Stylization from the coarsest level to the finest.

use crate::patches::{STYLE_CHANNELS, Weights};
use crate::previous_frame::blend_with_previous;
use crate::search::{Search, first_guess};
use crate::{
    ChannelImage, Method, PatchField, PatchGrid, Patches, PreviousFrame, QualityMetrics, Settings, StylizeError, brute,
};

/// A painted example.
#[derive(Clone, Copy, Debug)]
pub struct Example<'a> {
    /// The painting: red, green and blue.
    pub style: &'a ChannelImage,
    /// Guides of the source at each pixel of the painting.
    pub guides: &'a ChannelImage,
}

/// Progress of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Current level, from 1 (the coarsest) on.
    pub level: usize,
    /// Number of levels.
    pub levels: usize,
    /// Current search, from 1 on; 0: the first guess, from guides alone.
    pub iteration: usize,
    /// Number of searches per level.
    pub iterations: usize,
    /// Finished fraction of all work, 0 to 1, by the number of patches.
    pub fraction: f64,
}

/// Checkpoint of a painting after a level. A run that resumes from it gives the same bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checkpoint {
    /// Number of finer levels that are left; 0: the painting is finished.
    pub levels_left: usize,
    /// Number of the source patch, by number of the target patch, at the finished level.
    pub patches: Vec<u32>,
}

/// Receiver of a run's progress.
pub trait ProgressObserver: Sync {
    /// Receives the progress before each step.
    fn on_progress(&self, _: Progress) {}

    /// Receives the checkpoint after each level.
    fn on_checkpoint(&self, _: Checkpoint) {}
}

impl ProgressObserver for () {}

/// A picture in the style of an example.
#[derive(Clone, Debug)]
pub struct StylizedImage {
    /// Red, green and blue, of the size of the target.
    pub image: ChannelImage,
    /// The source patches that painted it.
    pub field: PatchField,
    /// Levels of the pyramids.
    pub levels: usize,
    /// Quality figures.
    pub quality: QualityMetrics,
}

/// Paints the target.
/// - `target`: guides, the same channels as the example's;
/// - `previous`: the previous frame, of the target's size, that the painting should stay close to;
/// - `checkpoint`: checkpoint of an earlier run with the same arguments;
/// - errors: sizes, channels, settings or the checkpoint do not fit.
pub fn stylize(
    example: Example<'_>,
    target: &ChannelImage,
    previous: Option<&PreviousFrame>,
    settings: &Settings,
    checkpoint: Option<Checkpoint>,
    observer: &dyn ProgressObserver,
) -> Result<StylizedImage, StylizeError> {
    let Example { style, guides } = example;
    if style.size() != guides.size() {
        return Err(StylizeError::StyleSize { style: style.size(), source_size: guides.size() });
    }
    if style.channels() != STYLE_CHANNELS {
        return Err(StylizeError::StyleChannels(style.channels()));
    }
    if guides.channels() != target.channels() {
        let (source_channels, target_channels) = (guides.channels(), target.channels());
        return Err(StylizeError::Channels { source_channels, target_channels });
    }
    if let Some(before) = previous.map(PreviousFrame::size).filter(|&before| before != target.size()) {
        return Err(StylizeError::PreviousFrameSize { before, target: target.size() });
    }
    let levels = settings.check(guides, target)?;
    let held = previous.map(|before| before.pyramid(levels));
    let [styles, sources, targets] = [style, guides, target].map(|image| image.pyramid(levels));
    let steps = ProgressReporter::new(&targets, settings, observer);
    let grids = |at: usize| [&targets[at], &sources[at]].map(|image| PatchGrid::from_image(image, settings.patch));
    let mut last = checkpoint.map(|begun| begun.field(levels, grids)).transpose()?.map(|(left, field)| {
        let image = field.vote(&styles[left]);
        (left, field, image)
    });
    let done = last.as_ref().map_or(levels, |last| last.0);
    for (at, ((style, guides), target)) in styles.iter().zip(&sources).zip(&targets).enumerate().take(done).rev() {
        let before = previous.zip(held.as_ref()).map(|(before, held)| (before, &held[at]));
        let step = &|iteration, part| steps.report(at, iteration, part);
        let work = LevelSynthesis { style, guides, target, previous: before, level: at, settings, step };
        let field = last.map_or_else(|| work.first_guess(), |(_, field, _)| work.upsampled(&field));
        let (field, image) = work.paint(field);
        observer.on_checkpoint(Checkpoint { levels_left: at, patches: field.patches.clone() });
        last = Some((at, field, image));
    }
    let (_, field, image) = last.ok_or(StylizeError::Levels { levels, most: 0, patch: settings.patch })?;
    let figures = QualityMetrics::new(&field, [guides, target], style, &image);
    Ok(StylizedImage { image, field, levels, quality: figures })
}

impl Checkpoint {
    /// Returns the number of levels left and the field, if the checkpoint belongs to this run.
    /// - `grids`: target and source patches of a level.
    fn field(
        self,
        levels: usize,
        grids: impl Fn(usize) -> [PatchGrid; 2],
    ) -> Result<(usize, PatchField), StylizeError> {
        let Self { levels_left: left, patches } = self;
        if left >= levels {
            return Err(StylizeError::ForeignCheckpoint);
        }
        let [target, source] = grids(left);
        let fits = patches.len() == target.count() && patches.iter().all(|&p| (p as usize) < source.count());
        if fits { Ok((left, PatchField { target, source, patches })) } else { Err(StylizeError::ForeignCheckpoint) }
    }
}

/// The work of one level.
struct LevelSynthesis<'a> {
    style: &'a ChannelImage,
    guides: &'a ChannelImage,
    target: &'a ChannelImage,
    /// The previous frame, and its painting at this level.
    previous: Option<(&'a PreviousFrame, &'a ChannelImage)>,
    /// Level; 0 is the finest.
    level: usize,
    settings: &'a Settings,
    /// Receives the iteration and the finished fraction of it.
    step: &'a dyn Fn(usize, f64),
}

impl LevelSynthesis<'_> {
    fn patches(&self, style: Option<&ChannelImage>, guides: &ChannelImage) -> Patches {
        Patches::new(style, guides, Weights::new(self.settings, guides.channels()), self.settings.patch)
    }

    /// Guesses the field from the guides alone.
    fn first_guess(&self) -> PatchField {
        (self.step)(0, 0.0);
        let [source, target] = [self.guides, self.target].map(|guides| self.patches(None, guides));
        first_guess(&source, &target)
    }

    /// Returns the field of the previous level, doubled.
    fn upsampled(&self, field: &PatchField) -> PatchField {
        let [target, source] =
            [self.target, self.guides].map(|image| PatchGrid::from_image(image, self.settings.patch));
        field.upsampled(target, source)
    }

    /// Returns the image that the search should match: the painting so far, blended toward the previous frame.
    fn search_target(&self, image: &ChannelImage) -> Option<ChannelImage> {
        self.previous.map(|(_, painted)| blend_with_previous(image, painted, 1.0 - self.settings.boil))
    }

    /// Alternates search and vote.
    fn paint(&self, mut field: PatchField) -> (PatchField, ChannelImage) {
        let source = self.patches(Some(self.style), self.guides);
        let mut image = field.vote(self.style);
        let mut target = self.patches(Some(self.search_target(&image).as_ref().unwrap_or(&image)), self.target);
        let mut search = match self.settings.method {
            Method::Balanced => {
                let grids = (target.grid(), source.grid());
                let before = self.previous.map(|(before, _)| before.patches(grids.0, grids.1, self.level));
                let price = source.style_energy(self.settings.balance);
                Some(Search::new(&source, &target, field.clone(), price, before.unwrap_or_default()))
            }
            Method::Em => None,
        };
        for iteration in 1..=self.settings.iterations {
            let tell = |part| (self.step)(iteration, part);
            match &mut search {
                Some(search) => {
                    tell(0.0);
                    search.pass(&target, iteration as u32);
                    field.clone_from(search.field());
                }
                None => field = brute::nearest(&source, &target, tell),
            }
            image = field.vote(self.style);
            target.set_style(self.search_target(&image).as_ref().unwrap_or(&image));
        }
        (field, image)
    }
}

/// The shares of the levels in the work, for progress reports.
struct ProgressReporter<'a> {
    /// Work of each level, the finest first: pixels, squared for brute force.
    pixels: Vec<f64>,
    iterations: usize,
    observer: &'a dyn ProgressObserver,
}

impl<'a> ProgressReporter<'a> {
    fn new(targets: &[ChannelImage], settings: &Settings, observer: &'a dyn ProgressObserver) -> Self {
        let pixels = |image: &ChannelImage| (image.width() * image.height()) as f64;
        // Brute force tries every source patch for every target patch.
        let power = match settings.method {
            Method::Balanced => 1,
            Method::Em => 2,
        };
        let pixels = targets.iter().map(|image| pixels(image).powi(power)).collect();
        Self { pixels, iterations: settings.iterations, observer }
    }

    fn report(&self, at: usize, iteration: usize, part: f64) {
        let (levels, iterations) = (self.pixels.len(), self.iterations);
        let all: f64 = self.pixels.iter().sum();
        let before: f64 = self.pixels[at + 1..].iter().sum();
        let here = self.pixels[at] * (iteration.saturating_sub(1) as f64 + part) / iterations.max(1) as f64;
        let fraction = if iteration == 0 { 0.0 } else { (before + here) / all };
        self.observer.on_progress(Progress { level: levels - at, levels, iteration, iterations, fraction });
    }
}
