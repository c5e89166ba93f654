//! Additional outputs of a job besides its images: stills under one exposure, a contact sheet, a clip.
//!
//! | stage | scope | reads | makes |
//! | --- | --- | --- | --- |
//! | render | frame | | besides its tile a thumbnail: the tile's exact sums in blocks of pixels |
//! | count-levels | frame | thumbnails of all rounds | levels: a histogram of the blocks' luminance |
//! | reduce-levels | frame | levels of all groups of tiles | levels |
//! | reduce-levels | job | levels of 256 frames, then of 256 of these, and so on | levels |
//! | encode-picture | job | for each frame its image, and the levels of all | a still |
//! | encode-sheet | job | all stills | a contact sheet |
//! | encode-clip | job | all stills | a clip |
//! | paint | job | for each frame its layers, the levels of all, and the brushwork of the previous frame | a painted frame, brushwork |
//!
//! A frame that cannot be finished is not counted in the levels. It is shown as a gray card with a cross. The requested outputs are
//! in the options of the job's own stages. They are not in its settings, because images name the settings: so images are equal with
//! and without a clip.

use femc_film::animation::AnimationFormat;
use femc_model::{Graph, JobSpec, Need, Reach, Role, Round, Scope, StageKind, StageTemplate, TaskSizes};
use serde::{Deserialize, Serialize};

use crate::clip::FFMPEG;

/// Number of tiles whose levels a task counts, and of levels that a task adds up.
const FAN: u32 = 256;

/// Requested outputs of a job besides its images.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ExtraOutputs {
    /// Whether to write each frame as a still under the clip's exposure.
    pub stills: bool,
    /// File name of a contact sheet.
    pub sheet: Option<String>,
    /// A clip.
    pub video: Option<Video>,
    /// Painted style for the frames.
    #[serde(default)]
    pub painting: Option<Painting>,
}

/// A painted style.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Painting {
    /// Name of a built-in style.
    pub style: String,
    /// Amount of change allowed where the frames do not change, 0 to 1.
    pub boil: f32,
}

impl Painting {
    /// Checks that the style exists and `boil` is within 0 to 1.
    pub fn is_valid(&self) -> bool {
        femc_stylize::styles::names().any(|name| name == self.style) && (0.0..=1.0).contains(&self.boil)
    }
}

/// A clip.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Video {
    /// File name; its extension selects the format.
    pub name: String,
    /// Frames per second, 0.01 to 100.
    pub rate: f64,
}

impl Video {
    /// Checks whether the format needs ffmpeg.
    pub fn needs_ffmpeg(&self) -> bool {
        AnimationFormat::from_path(self.name.as_ref()).is_err()
    }

    /// Checks that the file name is safe to pass to an encoder and that the rate is in range.
    pub fn is_valid(&self) -> bool {
        let extension = self.name.rsplit_once('.').map_or("", |(_, extension)| extension);
        is_file(&self.name)
            && (1..=8).contains(&extension.len())
            && extension.chars().all(|c| c.is_ascii_alphanumeric())
            && (0.01..=100.0).contains(&self.rate)
    }
}

/// Checks that the name is safe as a file name in a folder that another user chooses, and not hidden.
fn is_file(name: &str) -> bool {
    JobSpec::is_valid_name(name) && !name.starts_with('.')
}

impl ExtraOutputs {
    /// Checks that the sheet is a PNG, that the clip and the painting are valid, and that sheet and clip are two files.
    pub fn is_valid(&self) -> bool {
        let video = self.video.as_ref();
        self.sheet.as_ref().is_none_or(|name| is_file(name) && name.ends_with(".png"))
            && video.is_none_or(|video| video.is_valid() && Some(&video.name) != self.sheet.as_ref())
            && self.painting.as_ref().is_none_or(Painting::is_valid)
    }

    /// Checks that no output is requested.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the outputs requested in a job's graph; nothing if they are invalid.
    pub fn from_graph(graph: &Graph) -> Self {
        let shows = |template: &&StageTemplate| matches!(template.kind, StageKind::EncodePicture | StageKind::Paint);
        let shown = graph.stages.iter().find(shows);
        let outputs = shown.and_then(|template| serde_json::from_str(&template.options).ok());
        outputs.filter(Self::is_valid).unwrap_or_default()
    }

    /// Adds the stages for the requested outputs to the graph of a job with `frames` frames. The frames' images do not change.
    pub fn add_to(&self, graph: &mut Graph, frames: u32) {
        let makes = |graph: &Graph, role| {
            graph.stages_of(Scope::Frame).rfind(|(_, it)| it.outputs.contains(&role)).map(|(n, _)| n)
        };
        let (Some(render), Some(image)) = (makes(graph, Role::Tile), makes(graph, Role::Image)) else { return };
        if self.is_empty() {
            return;
        }
        self.add_stages(graph, render, image, frames);
        graph.add_known_tags();
    }

    fn add_stages(&self, graph: &mut Graph, render: u16, image: u16, frames: u32) {
        let tiles = graph.stages[usize::from(render)].tasks();
        graph.stages[usize::from(render)].outputs.push(Role::Thumbnail);
        let mut push = |template: StageTemplate| {
            graph.stages.push(template);
            graph.stages.len() as u16 - 1
        };
        let reduce = |scope, tasks| {
            StageTemplate::new(StageKind::ReduceLevels, scope, TaskSizes::even(tasks, 1), &[Role::Levels])
        };
        let need = |stage, role, reach, round, gaps| Need { stage, role, reach, round, gaps };
        let thumbnails = need(render, Role::Thumbnail, Reach::Fan(FAN), Round::Every, false);
        let groups = tiles.div_ceil(FAN);
        let count =
            StageTemplate::new(StageKind::CountLevels, Scope::Frame, TaskSizes::even(groups, 1), &[Role::Levels]);
        let mut levels = push(count.with_need(thumbnails));
        if groups > 1 {
            levels = push(reduce(Scope::Frame, 1).with_input(levels, Role::Levels, Reach::All));
        }
        let (mut count, mut gaps) = (frames, true);
        while gaps || count > 1 {
            count = count.div_ceil(FAN);
            let below = need(levels, Role::Levels, Reach::Fan(FAN), Round::Same, gaps);
            levels = push(reduce(Scope::Job, count).with_need(below));
            gaps = false;
        }
        // Serializing plain data cannot fail.
        let options = serde_json::to_string(self).unwrap_or_default();
        let encode = |kind, tasks, role| {
            StageTemplate::new(kind, Scope::Job, TaskSizes::even(tasks, 1), &[role]).with_options(options.clone())
        };
        if self.painting.is_some() {
            let layers = need(image, Role::LayerImage, Reach::Fan(1), Round::Same, true);
            let paint = StageTemplate::new(
                StageKind::Paint,
                Scope::Job,
                TaskSizes::even(frames, 1),
                &[Role::Painted, Role::Brushwork],
            );
            let paint =
                paint.with_options(options.clone()).with_need(layers).with_input(levels, Role::Levels, Reach::All);
            push(paint.with_input(levels + 1, Role::Brushwork, Reach::Previous));
        }
        if !(self.stills || self.sheet.is_some() || self.video.is_some()) {
            return;
        }
        let shown = if self.stills { Role::Still } else { Role::Picture };
        let images = need(image, Role::Image, Reach::Fan(1), Round::Same, true);
        let stills = push(encode(StageKind::EncodePicture, frames, shown).with_need(images).with_input(
            levels,
            Role::Levels,
            Reach::All,
        ));
        if self.sheet.is_some() {
            push(encode(StageKind::EncodeSheet, 1, Role::Sheet).with_input(stills, shown, Reach::All));
        }
        if let Some(video) = &self.video {
            let tags: &[&str] = if video.needs_ffmpeg() { &[FFMPEG] } else { &[] };
            push(encode(StageKind::EncodeClip, 1, Role::Clip).with_input(stills, shown, Reach::All).with_tags(tags));
        }
    }
}

#[cfg(test)]
mod tests {
    use femc_graph::tag;
    use femc_model::{check_graph, check_graph_frames, max_graph_inputs};

    use super::*;

    fn extra_outputs(stills: bool, sheet: Option<&str>, video: Option<&str>) -> ExtraOutputs {
        let video = video.map(|name| Video { name: name.into(), rate: 7.4 });
        ExtraOutputs { stills, sheet: sheet.map(Into::into), video, painting: None }
    }

    fn of_job(graph: &Graph) -> Vec<(StageKind, u32, Role)> {
        graph.stages_of(Scope::Job).map(|(_, it)| (it.kind, it.tasks(), it.outputs[0])).collect()
    }

    #[test]
    fn levels_are_reduced_in_tree_and_graph_with_clip_is_valid() {
        use {Role::*, StageKind::*};
        for rounds in [&[4][..], &[4, 8, 16]] {
            for (fan, clip) in [(0, "clip.mp4"), (2, "clip.png")] {
                for frames in [1, 256, 257, 65_536] {
                    let plain = femc_model::testing::frame_graph(TaskSizes::even(4, 64), rounds, fan);
                    let mut graph = plain.clone();
                    let outputs = extra_outputs(frames == 1, Some("sheet.png"), Some(clip));
                    outputs.add_to(&mut graph, frames);
                    assert_eq!((check_graph(&graph), ExtraOutputs::from_graph(&graph)), (Ok(()), outputs));
                    let tree = match frames {
                        1 | 256 => vec![(ReduceLevels, 1, Levels)],
                        257 => vec![(ReduceLevels, 2, Levels), (ReduceLevels, 1, Levels)],
                        _ => vec![(ReduceLevels, 256, Levels), (ReduceLevels, 1, Levels)],
                    };
                    let shown = if frames == 1 { Still } else { Picture };
                    let shown = [(EncodePicture, frames, shown), (EncodeSheet, 1, Sheet), (EncodeClip, 1, Clip)];
                    assert_eq!(of_job(&graph), [&tree[..], &shown].concat());
                    let has_tag = |it: &&StageTemplate, tag| it.tags.iter().any(|own| own == tag);
                    assert!(graph.stages.iter().all(|it| has_tag(&it, tag::TASK_KINDS)));
                    let by_ffmpeg = graph.stages.iter().filter(|it| has_tag(it, FFMPEG)).map(|it| it.kind);
                    assert_eq!(
                        by_ffmpeg.collect::<Vec<_>>(),
                        if clip == "clip.mp4" { vec![EncodeClip] } else { vec![] }
                    );
                }
            }
        }
    }

    #[test]
    fn clip_task_of_largest_film_stays_within_assignment_inputs() {
        let rounds: Vec<u32> = (0..Graph::MAX_ROUNDS).map(|round| 4 + round).collect();
        let tiles = Graph::MAX_TASKS;
        let mut graph = femc_model::testing::frame_graph(TaskSizes::even(tiles, 64), &rounds, 256);
        extra_outputs(true, Some("sheet.png"), Some("clip.png")).add_to(&mut graph, Graph::MAX_TASKS);
        assert_eq!(check_graph(&graph), Ok(()));
        assert!(max_graph_inputs(&graph, u64::from(Graph::MAX_TASKS)) <= Graph::MAX_INPUTS);
        let groups: Vec<u32> = graph
            .stages_of(Scope::Frame)
            .filter(|(_, it)| it.outputs == [Role::Levels])
            .map(|(_, it)| it.tasks())
            .collect();
        assert_eq!(groups, [tiles / FAN, 1], "groups of tiles, then the frame");
    }

    #[test]
    fn graph_without_wish_is_unchanged_and_stills_make_no_clip() {
        let plain = femc_model::testing::frame_graph(TaskSizes::even(4, 64), &[4], 0);
        let mut graph = plain.clone();
        ExtraOutputs::default().add_to(&mut graph, 3);
        assert_eq!((&graph, ExtraOutputs::from_graph(&graph)), (&plain, ExtraOutputs::default()));
        extra_outputs(true, None, None).add_to(&mut graph, 3);
        assert_eq!(of_job(&graph)[1..], [(StageKind::EncodePicture, 3, Role::Still)]);
        let image = StageTemplate { tags: vec![], ..graph.stages[1].clone() };
        assert_eq!(image, plain.stages[1], "what makes images is as it was");
    }

    #[test]
    fn painted_job_chains_its_frames_beside_other_outputs() {
        let painting = Some(Painting { style: "oil".into(), boil: 0.25 });
        for stills in [false, true] {
            let mut graph = femc_model::testing::frame_graph(TaskSizes::even(4, 64), &[4], 0);
            graph.stages[1].outputs.push(Role::LayerImage);
            let outputs = ExtraOutputs { stills, painting: painting.clone(), ..ExtraOutputs::default() };
            outputs.add_to(&mut graph, 300);
            assert_eq!(
                (check_graph(&graph), check_graph_frames(&graph, 300), ExtraOutputs::from_graph(&graph)),
                (Ok(()), Ok(()), outputs)
            );
            let stages = of_job(&graph);
            assert_eq!(stages[2], (StageKind::Paint, 300, Role::Painted));
            assert_eq!(stages.len(), 3 + usize::from(stills));
            let paint = graph.stages.iter().find(|it| it.kind == StageKind::Paint).expect("it paints");
            assert_eq!(paint.tags, [tag::PAINTING, tag::TASK_KINDS, tag::LAYERS, tag::FEATURES]);
            assert!(graph.stages.iter().all(|it| it.tags == paint.tags), "no other worker can read the graph");
        }
        for (style, boil) in [("aquatint", 0.5), ("oil", 1.5), ("oil", f32::NAN)] {
            let painting = Some(Painting { style: style.into(), boil });
            assert!(!ExtraOutputs { painting, ..ExtraOutputs::default() }.is_valid(), "{style} {boil}");
        }
    }

    #[test]
    fn a_sheet_is_a_png_beside_the_clip() {
        assert!(extra_outputs(false, Some("a.png"), Some("b.png")).is_valid() && ExtraOutputs::default().is_valid());
        for (sheet, clip) in [("a.jpg", "b.png"), (".png", "b.png"), ("a/b.png", "b.png"), ("a.png", "a.png")] {
            assert!(!extra_outputs(false, Some(sheet), Some(clip)).is_valid(), "{sheet}, {clip}");
        }
        let mut graph = femc_model::testing::frame_graph(TaskSizes::even(4, 64), &[4], 0);
        extra_outputs(true, Some("../a.png"), None).add_to(&mut graph, 3);
        assert_eq!(ExtraOutputs::from_graph(&graph), ExtraOutputs::default(), "somebody else's graph leads nowhere");
    }

    #[test]
    fn a_clip_has_a_name_that_leads_nowhere_and_a_rate() {
        let is_sound = |name: &str, rate| Video { name: name.into(), rate }.is_valid();
        assert!(is_sound("drive.mp4", 24.0) && is_sound("a b.GIF", 0.01));
        for name in [
            "clip",
            "clip.",
            ".",
            "../clip.mp4",
            "a/b.mp4",
            "clip.m:p4",
            "clip.m p4",
            "a\u{1b}.mp4",
            "a.123456789",
            ".mp4",
        ] {
            assert!(!is_sound(name, 24.0), "{name}");
        }
        for rate in [0.0, -1.0, 101.0, f64::NAN, f64::INFINITY] {
            assert!(!is_sound("clip.mp4", rate), "{rate}");
        }
    }
}
