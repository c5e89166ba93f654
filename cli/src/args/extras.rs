use crate::exit::{Failure, usage};
use clap::Args;
use femc_model::JobSpec;
use femc_worker::{Video, Wish};
use std::path::{Path, PathBuf};

/// What is made of a run's frames, all under one exposure: the same on every command that renders, submits or plans.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Pictures")]
pub struct ExtrasArgs {
    /// Make a clip of the frames: .png, .apng and .gif are written by femc, any other format by ffmpeg
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
    /// Refuses names that promise another format.
    pub fn check(&self) -> Result<(), Failure> {
        match self.contact_sheet.as_ref().filter(|sheet| sheet.extension().is_none_or(|e| e != "png")) {
            Some(sheet) => Err(usage(format!("--contact-sheet {}: a sheet is a PNG; give FILE.png", sheet.display()))),
            None => Ok(()),
        }
    }

    /// The same as a job's: its files lie in the folder that they are fetched into.
    /// - `rate`: frames a second of a clip.
    pub fn wish(&self, rate: f64) -> Result<Wish, Failure> {
        self.check()?;
        let sheet = self.contact_sheet.as_deref().map(|path| name("--contact-sheet", path)).transpose()?;
        let video = self.video.as_deref().map(|path| name("--video", path)).transpose()?;
        let video = video.map(|name| Video { name, rate });
        if let Some(Video { name, .. }) = video.as_ref().filter(|video| !video.is_sound()) {
            let formats = "the name's ending is the clip's format; give FILE.png, FILE.gif or FILE.mp4";
            return Err(usage(format!("--video {name}: {formats}")));
        }
        let wish = Wish { stills: self.preview, sheet, video, painting: None };
        let clash = || usage("--contact-sheet: give FILE.png, another one than the clip's");
        if wish.is_sound() { Ok(wish) } else { Err(clash()) }
    }
}

/// A file's name without a folder.
fn name(flag: &str, path: &Path) -> Result<String, Failure> {
    let name = path.to_str().filter(|name| JobSpec::names_files(name));
    let wrong =
        || usage(format!("{flag} {}: `femc fetch -o DIR` says where; give the file's name alone", path.display()));
    name.map(ToOwned::to_owned).ok_or_else(wrong)
}
