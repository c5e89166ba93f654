//! Setup of measurements. It must be equal for all figures in one table.

use serde::{Deserialize, Serialize};

/// The machine and the program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setup {
    /// Name of the processor.
    pub processor: String,
    /// Number of cores that this process may use.
    pub cores: usize,
    /// Number of rendering threads.
    pub threads: usize,
    /// Version of femc.
    pub version: String,
    /// Build of the engine.
    pub engine: String,
    /// `release` or `debug`.
    pub profile: String,
    /// Architecture and instruction sets that the program was compiled for. It also uses wider ones that it detects.
    pub instructions: String,
}

/// A scene with its reference and render settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneSetup {
    /// Stem of the scene's file name.
    pub name: String,
    /// File of the scene, as given.
    pub file: String,
    /// Digest of the scene's content, with overrides applied.
    pub digest: String,
    /// Frame number in the scene's clip.
    pub frame: u32,
    /// Width and height of the film, pixels.
    pub film: [u32; 2],
    /// Render settings, without those that differ from run to run.
    pub settings: serde_json::Value,
    /// Reference, as given.
    pub reference: String,
    /// Digest of the reference's pixels.
    pub reference_digest: String,
}

/// Difference between two setups: name, value there, value here.
pub type Difference = (&'static str, String, String);

impl Setup {
    /// Describes this program on this machine.
    /// - `engine`: build of the engine.
    pub fn current(threads: usize, engine: &str) -> Self {
        let sets = [
            ("sse4.2", cfg!(target_feature = "sse4.2")),
            ("avx2", cfg!(target_feature = "avx2")),
            ("fma", cfg!(target_feature = "fma")),
            ("avx512f", cfg!(target_feature = "avx512f")),
        ];
        let sets = sets.iter().filter(|(_, is_there)| *is_there).map(|(name, _)| *name);
        Self {
            processor: processor(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            threads,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            engine: engine.to_owned(),
            profile: if cfg!(debug_assertions) { "debug" } else { "release" }.to_owned(),
            instructions: std::iter::once(std::env::consts::ARCH).chain(sets).collect::<Vec<_>>().join(" "),
        }
    }

    /// Lists the differences from the setup of a file.
    pub fn differences(&self, stored: &Self) -> Vec<Difference> {
        let all = [
            ("processor", &stored.processor, &self.processor),
            ("cores", &stored.cores.to_string(), &self.cores.to_string()),
            ("threads", &stored.threads.to_string(), &self.threads.to_string()),
            ("version", &stored.version, &self.version),
            ("engine build", &stored.engine, &self.engine),
            ("profile", &stored.profile, &self.profile),
            ("instructions", &stored.instructions, &self.instructions),
        ]
        .map(|(name, there, here)| (name, there.clone(), here.clone()));
        all.into_iter().filter(|(_, there, here)| there != here).collect()
    }
}

impl SceneSetup {
    /// Lists the differences from the setup of a file. Paths of files may differ.
    pub fn differences(&self, stored: &Self) -> Vec<Difference> {
        let film = |[width, height]: [u32; 2]| format!("{width}x{height}");
        let all = [
            ("scene's content", stored.digest.clone(), self.digest.clone()),
            ("frame", stored.frame.to_string(), self.frame.to_string()),
            ("film", film(stored.film), film(self.film)),
            ("settings", stored.settings.to_string(), self.settings.to_string()),
            ("reference's pixels", stored.reference_digest.clone(), self.reference_digest.clone()),
        ];
        all.into_iter().filter(|(_, there, here)| there != here).collect()
    }
}

/// Returns the system's name of the processor.
fn processor() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split_once(':'));
    name.map_or_else(|| format!("unnamed {}", std::env::consts::ARCH), |(_, name)| name.trim().to_owned())
}
