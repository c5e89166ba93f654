//! Tests of whole pictures.

use crate::images::{guides, style};
use femc_stylize::{
    ChannelImage, Checkpoint, Example, Method, PreviousFrame, ProgressObserver, Settings, StylizeError, StylizedImage,
    stylize,
};
use std::sync::Mutex;

fn paint(source: &ChannelImage, target: &ChannelImage, settings: &Settings) -> StylizedImage {
    stylize(Example { style: &style(source), guides: source }, target, None, settings, None, &()).expect("a picture")
}

/// Computes the root of the mean squared difference.
fn difference(a: &ChannelImage, b: &ChannelImage) -> f32 {
    let sum: f32 = a.values().iter().zip(b.values()).map(|(a, b)| (a - b) * (a - b)).sum();
    (sum / a.values().len() as f32).sqrt()
}

#[test]
fn target_patches_have_sources_and_pixels_have_style_colors() {
    let source = guides(40, 32, [0.5, 0.5], 1);
    for (width, height) in [(40, 32), (90, 70), (17, 14)] {
        let target = guides(width, height, [0.3, 0.6], 2);
        let result = paint(&source, &target, &Settings::default());
        let grid = result.field.target;
        assert_eq!((result.image.width(), result.image.height()), (width as usize, height as usize));
        assert_eq!(result.field.patches.len(), grid.count());
        assert!(result.field.patches.iter().all(|&p| (p as usize) < result.field.source.count()));
        let style = style(&source);
        let (least, most) = style.values().iter().fold((1.0f32, 0.0f32), |(a, b), &v| (a.min(v), b.max(v)));
        assert!(result.image.values().iter().all(|v| (least - 1e-4..=most + 1e-4).contains(v)));
    }
}

#[test]
fn threads_change_no_bit() {
    let (source, target) = (guides(48, 40, [0.5, 0.5], 1), guides(50, 44, [0.4, 0.4], 2));
    let by = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| paint(&source, &target, &Settings::default()))
    };
    let [one, two, five] = [1, 2, 5].map(by);
    for other in [two, five] {
        assert_eq!(one.image, other.image);
        assert_eq!((&one.field, one.quality), (&other.field, other.quality));
    }
}

#[test]
fn the_source_itself_is_painted_as_the_style() {
    let source = guides(48, 36, [0.5, 0.5], 1);
    let style = style(&source);
    for method in [Method::Balanced, Method::Em] {
        let result = paint(&source, &source, &Settings { method, ..Settings::default() });
        assert!(difference(&result.image, &style) < 0.02, "{method:?}: {}", difference(&result.image, &style));
        assert!(result.quality.guide_error < 75.0, "{method:?}: {:?}", result.quality);
    }
}

#[test]
fn usage_cost_shows_more_of_the_painting_than_nearest_patches() {
    let (source, target) = (guides(48, 40, [0.5, 0.5], 1), guides(48, 40, [0.35, 0.6], 2));
    let figures = |method| paint(&source, &target, &Settings { method, ..Settings::default() }).quality;
    let [balanced, em] = [Method::Balanced, Method::Em].map(figures);
    assert!(balanced.usage_entropy > em.usage_entropy, "{balanced:?} {em:?}");
    assert!(balanced.unused < em.unused, "{balanced:?} {em:?}");
    assert!(balanced.usage_entropy <= balanced.usage_entropy_most + 1e-9, "{balanced:?}");
}

#[test]
fn what_does_not_fit_is_refused_by_what_it_is() {
    let (source, target) = (guides(20, 16, [0.5, 0.5], 1), guides(20, 16, [0.4, 0.5], 2));
    let painting = style(&source);
    let refused = |style: &ChannelImage, target: &ChannelImage, settings: &Settings| {
        stylize(Example { style, guides: &source }, target, None, settings, None, &()).expect_err("refused")
    };
    let settings = Settings::default();
    assert!(matches!(
        refused(&style(&guides(21, 16, [0.5; 2], 1)), &target, &settings),
        StylizeError::StyleSize { .. }
    ));
    let gray = ChannelImage::new(20, 16, 1, vec![0.5; 320]).expect("an image");
    assert_eq!(refused(&gray, &target, &settings), StylizeError::StyleChannels(1));
    let expected = StylizeError::Channels { source_channels: 3, target_channels: 1 };
    assert_eq!(refused(&painting, &gray, &settings), expected);
    for (settings, expected) in [
        (Settings { mu: -1.0, ..settings }, StylizeError::Mu(-1.0)),
        (Settings { mu: f32::INFINITY, ..settings }, StylizeError::Mu(f32::INFINITY)),
        (Settings { balance: -1.0, ..settings }, StylizeError::Balance(-1.0)),
        (Settings { boil: 1.5, ..settings }, StylizeError::Boil(1.5)),
        (Settings { patch: 4, ..settings }, StylizeError::Patch(4)),
        (Settings { patch: 17, ..settings }, StylizeError::Patch(17)),
        (Settings { levels: Some(0), ..settings }, StylizeError::Levels { levels: 0, most: 1, patch: 5 }),
        (Settings { levels: Some(2), ..settings }, StylizeError::Levels { levels: 2, most: 1, patch: 5 }),
    ] {
        assert_eq!(refused(&painting, &target, &settings), expected);
    }
    let small = guides(20, 4, [0.5, 0.5], 1);
    assert_eq!(refused(&painting, &small, &settings), StylizeError::Levels { levels: 1, most: 0, patch: 5 });
}

#[test]
fn a_frame_holds_on_to_the_one_before_as_much_as_it_is_told_to() {
    let size = [64, 48];
    let source = guides(size[0], size[1], [0.5, 0.5], 1);
    let (painting, pixels) = (style(&source), (size[0] * size[1]) as usize);
    let example = Example { style: &painting, guides: &source };
    // The ball moves 2 pixels to the right, and its light has different noise.
    let middles = [0.4, 0.4 + 2.0 / size[0] as f32];
    let [first, second] = [0, 1].map(|at| guides(size[0], size[1], [middles[at], 0.5], 2 + at as u64));
    let painted = stylize(example, &first, None, &Settings::default(), None, &()).expect("a picture");
    let radius = 0.3 * size[1] as f32;
    let motion: Vec<f32> = (0..pixels)
        .map(|at| {
            let (x, y) = ((at % size[0] as usize) as f32, (at / size[0] as usize) as f32);
            let (u, v) = (x - middles[0] * size[0] as f32, y - 0.5 * size[1] as f32);
            if u * u + v * v < radius * radius { 2.0 } else { 0.0 }
        })
        .collect();
    let before = PreviousFrame::new(&painted, [&motion, &vec![0.0; pixels]], None).expect("it fits");
    let flicker = |before: Option<&PreviousFrame>, boil| {
        let settings = Settings { boil, ..Settings::default() };
        let image = stylize(example, &second, before, &settings, None, &()).expect("a picture").image;
        previous_frame(&painted, &motion).flicker(&image).expect("it is known")
    };
    let [alone, held, half, anew] =
        [flicker(None, 0.0), flicker(Some(&before), 0.0), flicker(Some(&before), 0.5), flicker(Some(&before), 1.0)];
    eprintln!("flicker alone {alone:.2}, held {held:.2}, half {half:.2}, anew {anew:.2} levels");
    assert!(held < half && half < alone && held < 0.5 * alone, "{held} {half} {anew} {alone}");
    let smaller = guides(60, 48, [0.5, 0.5], 1);
    let error = stylize(example, &smaller, Some(&before), &Settings::default(), None, &()).expect_err("another size");
    assert_eq!(error, StylizeError::PreviousFrameSize { before: size, target: [60, 48] });
}

fn previous_frame(painted: &StylizedImage, motion: &[f32]) -> PreviousFrame {
    PreviousFrame::new(painted, [motion, &vec![0.0; motion.len()]], None).expect("it fits")
}

#[test]
fn a_run_that_was_cut_off_at_any_level_goes_on_to_the_same_bits() {
    struct Checkpoints(Mutex<Vec<Checkpoint>>);
    impl ProgressObserver for Checkpoints {
        fn on_checkpoint(&self, begun: Checkpoint) {
            self.0.lock().expect("no panic").push(begun);
        }
    }
    let (source, target) = (guides(64, 48, [0.5, 0.5], 1), guides(60, 44, [0.4, 0.4], 2));
    let (painting, checkpoints) = (style(&source), Checkpoints(Mutex::new(Vec::new())));
    let example = Example { style: &painting, guides: &source };
    let whole = stylize(example, &target, None, &Settings::default(), None, &checkpoints).expect("a picture");
    let checkpoints = checkpoints.0.into_inner().expect("no panic");
    assert_eq!(
        checkpoints.iter().map(|begun| begun.levels_left).collect::<Vec<_>>(),
        (0..whole.levels).rev().collect::<Vec<_>>()
    );
    for begun in checkpoints {
        let resumed = |begun| stylize(example, &target, None, &Settings::default(), Some(begun), &());
        let again = resumed(begun.clone()).expect("a picture");
        assert!(again.image == whole.image && again.field == whole.field, "{} levels left", begun.levels_left);
        let mut foreign = begun;
        foreign.patches[0] = u32::MAX;
        assert_eq!(resumed(foreign.clone()).expect_err("a number that no patch has"), StylizeError::ForeignCheckpoint);
        foreign.levels_left += whole.levels;
        assert_eq!(resumed(foreign).expect_err("a level that is none"), StylizeError::ForeignCheckpoint);
    }
}
