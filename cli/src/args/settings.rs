use super::{Filter, Guide, Method};
use crate::values::{DurationArg, Frames, Override, Size};
use clap::{Args, ValueEnum};
use femc_pipeline::Layer;
use std::path::PathBuf;

/// Samples that the histograms contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StatsMode {
    /// Samples whose paths are recorded
    Some,
    /// All samples
    Full,
}

/// Render settings as typed, the same for every command that renders or plans. `None`: not typed.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Render settings")]
pub struct SettingsArgs {
    /// Camera to look through [default: the scene's first]
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Film size in pixels [default: the camera's]
    #[arg(long, value_name = "WxH")]
    pub size: Option<Size>,
    /// Frames of the clip: K, A..B (B included) or A..B+STEP, with commas between several [default: all]
    #[arg(long, value_name = "FRAMES")]
    pub frames: Option<Frames>,
    /// Stop at N samples per pixel
    #[arg(long, value_name = "N", group = "stop", value_parser = clap::value_parser!(u32).range(1..))]
    pub spp: Option<u32>,
    /// Stop when every 16x16 block's mean has relative error E at 95 % confidence [default: 0.05]
    ///
    /// Stop when the mean of every 16x16 block of pixels has relative error E at 95 % confidence [default: 0.05]. Each tile stops
    /// by itself. The samples of a tile are two independent halves, and each half decides whether the other has enough samples, so
    /// that stopping does not darken the image. The file states the error of each block.
    #[arg(long, value_name = "E", group = "stop", value_parser = positive)]
    pub error: Option<f64>,
    /// Stop at a time budget per frame: 90s, 2m, 1h30m
    ///
    /// Stop at a time budget per frame, wall time from its first lease: 90s, 2m, 1h30m. Samples are distributed to tiles by error
    /// and cost. Their number depends on the clock, so the file records how they were distributed, and `femc render --replay FILE`
    /// renders the same pixels again.
    #[arg(long, value_name = "DURATION", group = "stop")]
    pub time: Option<DurationArg>,
    /// Path tracing alone, the first pass alone, both, or the one that a pilot finds faster [default: auto]
    #[arg(long, value_enum)]
    pub method: Option<Method>,
    /// Guides of the paths of two passes; `1998` is a baseline for measurements and implies `--method femc` [default: targets]
    #[arg(long, value_enum)]
    pub guide: Option<Guide>,
    /// Longest path in segments, counting the one from the camera; 0: unbounded [default: 0]
    #[arg(long, value_name = "N")]
    pub max_depth: Option<u32>,
    /// Pixel filter; box: a pixel is the mean luminance over its area [default: box]
    #[arg(long, value_enum)]
    pub filter: Option<Filter>,
    /// Seed: the same seed gives the same image bit by bit, for any number of workers and threads [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Workers in this process [default: 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub workers: Option<u32>,
    /// Threads per worker [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub threads: Option<u32>,
    /// Override a scalar of the scene, like medium.fog.sigma_s=0.03 (repeatable)
    #[arg(long, value_name = "SELECTOR=VALUE")]
    pub set: Vec<Override>,
    /// Folder that contains the includes, textures and lamps of the scene, at any depth [default: the scene's folder]
    #[arg(long, value_name = "DIR")]
    pub root: Option<PathBuf>,
    /// Write light statistics beside each frame, as FRAME.paths: counts of all samples, and some whole paths (`femc paths`)
    ///
    /// Write light statistics beside each frame, as FRAME.paths: counts and maps of all samples, and some whole paths
    /// (`femc paths`, `femc bottlenecks`). With `--stats=full` the histograms of each attribute contain all samples instead of the
    /// recorded ones; that takes about 50 % longer.
    #[arg(long, value_enum, value_name = "HOW", num_args = 0..=1, require_equals = true, default_missing_value = "some")]
    pub stats: Option<StatsMode>,
    /// Also write a layer of the light into FRAME.layers.exr: a name and a light path expression, like direct=CDL (repeatable)
    ///
    /// Also write a layer of the light into FRAME.layers.exr, beside the frame: a name and a light path expression in the grammar
    /// of Open Shading Language, like `--layer direct=CDL` (repeatable). `docs/layers.md` has the grammar and examples.
    #[arg(long, value_name = "NAME=EXPRESSION")]
    pub layer: Vec<Layer>,
    /// Also write predefined layers: guides (five), lamps (one per lamp), direct, indirect, fog, surfaces; of the first hit:
    /// normal, position, depth, albedo, motion, object, material, first_pass_error
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub layers: Vec<String>,
    /// Also measure the light at the points, grids and areas of a file in each frame (`femc measure --help` shows one)
    #[arg(long, value_name = "POINTS.toml")]
    pub measure: Option<PathBuf>,
    /// Only measure: frames have readings and no images
    #[arg(long)]
    pub measure_only: bool,
}

impl SettingsArgs {
    /// Merges the settings of a job file into these typed settings. The typed settings win. Overrides of the scene are kept from
    /// both.
    pub fn merge_over(self, job: Self) -> Self {
        let typed_stop = self.spp.is_some() || self.error.is_some() || self.time.is_some();
        let (spp, error, time) =
            if typed_stop { (self.spp, self.error, self.time) } else { (job.spp, job.error, job.time) };
        Self {
            camera: self.camera.or(job.camera),
            size: self.size.or(job.size),
            frames: self.frames.or(job.frames),
            spp,
            error,
            time,
            method: self.method.or(job.method),
            guide: self.guide.or(job.guide),
            max_depth: self.max_depth.or(job.max_depth),
            filter: self.filter.or(job.filter),
            seed: self.seed.or(job.seed),
            workers: self.workers.or(job.workers),
            threads: self.threads.or(job.threads),
            set: job.set.into_iter().chain(self.set).collect(),
            root: self.root.or(job.root),
            stats: self.stats.or(job.stats),
            layer: job.layer.into_iter().chain(self.layer).collect(),
            layers: job.layers.into_iter().chain(self.layers).collect(),
            measure: self.measure.or(job.measure),
            measure_only: self.measure_only || job.measure_only,
        }
    }
}

/// Parses a finite number > 0.
fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number > 0.0 => Ok(number),
        _ => Err(format!("`{text}` is not a relative error; write a number > 0, like 0.05 for 5 %")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Typed {
        #[command(flatten)]
        settings: SettingsArgs,
    }

    fn typed(line: &str) -> Result<SettingsArgs, clap::Error> {
        Typed::try_parse_from(line.split_whitespace()).map(|typed| typed.settings)
    }

    #[test]
    fn the_three_stopping_rules_exclude_each_other() {
        for line in ["femc --spp 4 --error 0.1", "femc --spp 4 --time 3s", "femc --error 0.1 --time 3s"] {
            assert_eq!(typed(line).map_err(|e| e.exit_code()).err(), Some(2), "{line}");
        }
    }

    #[test]
    fn numbers_out_of_range_are_wrong_usage() {
        for line in ["--spp 0", "--error 0", "--error -1", "--error nan", "--time 0s", "--threads 0", "--workers 0"] {
            assert_eq!(typed(&format!("femc {line}")).map_err(|e| e.exit_code()).err(), Some(2), "{line}");
        }
    }

    #[test]
    fn typed_flags_and_stopping_rules_override_the_job_file() {
        let job = typed("femc --spp 64 --seed 3 --size 8x8 --set a.b.c=1").expect("settings");
        let both = typed("femc --error 0.2 --seed 4 --set a.b.c=2").expect("settings").merge_over(job);
        assert_eq!((both.spp, both.error, both.seed), (None, Some(0.2), Some(4)));
        assert_eq!(both.size, Some(Size { width: 8, height: 8 }));
        assert_eq!(both.set.iter().map(|o| o.value).collect::<Vec<_>>(), [1.0, 2.0]);
    }
}
