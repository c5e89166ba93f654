use crate::exit::{Failure, usage};
use clap::Args;
use femc_model::JobSpec;
use femc_worker::{ExtraOutputs, Video};
use std::path::{Path, PathBuf};

/// Outputs that are made of all frames of a run, under one exposure. Every command that renders, submits or plans takes these
/// flags.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Pictures")]
pub struct ExtrasArgs {
    /// Make a clip of the frames: femc writes .png, .apng and .gif, ffmpeg writes any other format
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// Write a PNG beside every EXR
    #[arg(long)]
    pub preview: bool,
    /// Put all frames on one PNG
    #[arg(long, value_name = "FILE.png")]
    pub contact_sheet: Option<PathBuf>,
}

impl ExtrasArgs {
    /// Refuses file names whose extension belongs to another format.
    pub fn check(&self) -> Result<(), Failure> {
        match self.contact_sheet.as_ref().filter(|sheet| sheet.extension().is_none_or(|e| e != "png")) {
            Some(sheet) => Err(usage(format!("--contact-sheet {}: a sheet is a PNG; give FILE.png", sheet.display()))),
            None => Ok(()),
        }
    }

    /// Returns the outputs as a farm job needs them: file names without folders, because `femc fetch` chooses the folder.
    /// - `rate`: frames per second of a clip.
    pub fn requested_outputs(&self, rate: f64) -> Result<ExtraOutputs, Failure> {
        self.check()?;
        let sheet = self.contact_sheet.as_deref().map(|path| bare_file_name("--contact-sheet", path)).transpose()?;
        let video = self.video.as_deref().map(|path| bare_file_name("--video", path)).transpose()?;
        let video = video.map(|name| Video { name, rate });
        if let Some(Video { name, .. }) = video.as_ref().filter(|video| !video.is_valid()) {
            let formats = "the file extension sets the clip's format; give FILE.png, FILE.gif or FILE.mp4";
            return Err(usage(format!("--video {name}: {formats}")));
        }
        let outputs = ExtraOutputs { stills: self.preview, sheet, video, painting: None };
        let clash =
            || usage("--contact-sheet: the name must end in .png and differ from the clip's name; give FILE.png");
        if outputs.is_valid() { Ok(outputs) } else { Err(clash()) }
    }
}

/// Returns a file name that contains no folder.
fn bare_file_name(flag: &str, path: &Path) -> Result<String, Failure> {
    let name = path.to_str().filter(|name| JobSpec::is_valid_name(name));
    let wrong = || {
        usage(format!(
            "{flag} {}: give a file name without a folder; `femc fetch -o DIR` chooses the folder",
            path.display()
        ))
    };
    name.map(ToOwned::to_owned).ok_or_else(wrong)
}
