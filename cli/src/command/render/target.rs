//! Destination of frames: OUT ending in `.exr` or `.png` is one image, anything else is a folder of numbered images.

use crate::exit::{Failure, usage};
use crate::output::Printer;
use crate::request::{FramesChosen, ResolvedRequest, picture};
use std::path::{Path, PathBuf};

/// Destination of frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// One file for one frame.
    Image(PathBuf),
    /// Frames `<stem>.0001.exr` ... in a folder.
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Name of the scene.
        stem: String,
    },
}

impl Target {
    /// Interprets `out` for a scene named `stem` with `frames` frames.
    pub fn parse(out: Option<&Path>, stem: &str, frames: usize) -> Result<Self, Failure> {
        let Some(out) = out else {
            let (image, folder) = (PathBuf::from(format!("{stem}.exr")), PathBuf::from(stem));
            return Ok(if frames == 1 { Self::Image(image) } else { Self::Folder { folder, stem: stem.to_owned() } });
        };
        let shown = out.display();
        let extension = out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        match extension.as_str() {
            "exr" | "png" if out.is_dir() => {
                Err(usage(format!("-o {shown} is a folder; a name ending in .{extension} is one image")))
            }
            "exr" | "png" => Ok(Self::Image(out.to_owned())),
            "jpg" | "jpeg" | "hdr" | "tif" | "tiff" => {
                Err(usage(format!("-o {shown}: frames are written as EXR or PNG; give NAME.exr or NAME.png")))
            }
            "mp4" | "mkv" | "webm" | "mov" | "gif" | "apng" => Err(usage(format!(
                "-o {shown}: OUT is only for frames; give a folder, and --video {shown} for the clip"
            ))),
            _ if out.is_file() => Err(usage(format!(
                "-o {shown} is a file that does not end in .exr or .png; give NAME.exr for one frame, or a folder"
            ))),
            _ => Ok(Self::Folder { folder: out.to_owned(), stem: stem.to_owned() }),
        }
    }

    /// Returns the frames to write. A single image takes the first frame of a clip if no frames were chosen.
    pub fn frames(&self, resolved: &ResolvedRequest, printer: Printer) -> Result<Vec<u32>, Failure> {
        let frames = &resolved.plan.frames;
        match (self, frames.as_slice(), resolved.frames_chosen) {
            (Self::Image(path), [first, _, ..], FramesChosen::All) => {
                let last = frames.last().copied().unwrap_or(*first);
                let path = path.display();
                printer.note(format!(
                    "{path} is one image: rendering only frame {first} of {first}..{last} (give a folder as OUT for all frames)"
                ));
                Ok(vec![*first])
            }
            (Self::Image(path), [_, _, ..], FramesChosen::Typed) => Err(usage(format!(
                "-o {}: --frames selects {} frames, but this name is for one frame; give a folder, or one frame",
                path.display(),
                frames.len()
            ))),
            _ => Ok(frames.clone()),
        }
    }

    /// Returns the file of a frame.
    pub fn path(&self, frame: u32) -> PathBuf {
        match self {
            Self::Image(path) => path.clone(),
            Self::Folder { folder, stem } => folder.join(frame_name(stem, frame)),
        }
    }

    /// Returns the checkpoint file of the painting, needed to resume after a stop.
    pub fn checkpoint(&self) -> PathBuf {
        match self {
            Self::Image(path) => path.with_extension("painted.part"),
            Self::Folder { folder, .. } => folder.join("painted.part"),
        }
    }

    /// Returns the folder of the state, needed to resume after a stop.
    pub fn state_folder(&self) -> PathBuf {
        match self {
            Self::Image(path) => {
                let mut name = path.clone().into_os_string();
                name.push(".femc");
                name.into()
            }
            Self::Folder { folder, .. } => folder.join(".femc"),
        }
    }

    /// Returns whether the frame is written as a picture.
    pub fn is_picture(&self) -> bool {
        matches!(self, Self::Image(path) if picture::is_picture(path))
    }

    /// Returns the destination as the user wrote it.
    pub fn display(&self) -> String {
        match self {
            Self::Image(path) => path.display().to_string(),
            Self::Folder { folder, .. } => folder.display().to_string(),
        }
    }
}

/// Returns `<stem>.0007.exr`.
pub fn frame_name(stem: &str, frame: u32) -> String {
    format!("{stem}.{frame:04}.exr")
}

/// Returns `<stem>.0007.painted.png`, the painted picture beside a frame.
pub fn painted_name(stem: &str, frame: u32) -> String {
    format!("{stem}.{frame:04}.painted.png")
}

/// Returns `<stem>.0007.png`, the still beside a frame.
pub fn still_name(stem: &str, frame: u32) -> String {
    format!("{stem}.{frame:04}.png")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_out(out: &str, frames: usize) -> Option<Target> {
        Target::parse(Some(Path::new(out)), "fog", frames).ok()
    }

    #[test]
    fn exr_and_png_names_are_images_with_their_state_beside_them() {
        let target = parse_out("a/b.exr", 1).expect("a target");
        assert_eq!(target.path(7), Path::new("a/b.exr"));
        assert_eq!(target.state_folder(), Path::new("a/b.exr.femc"));
        assert!(!target.is_picture() && parse_out("a/b.PNG", 1).is_some_and(|target| target.is_picture()));
    }

    #[test]
    fn any_other_name_is_a_folder_of_numbered_frames() {
        let target = parse_out("clip", 1).expect("a target");
        assert_eq!(target.path(7), Path::new("clip/fog.0007.exr"));
        assert_eq!(target.path(12345), Path::new("clip/fog.12345.exr"));
        assert_eq!(target.state_folder(), Path::new("clip/.femc"));
    }

    #[test]
    fn without_a_name_a_still_is_an_image_and_a_clip_a_folder() {
        assert_eq!(Target::parse(None, "fog", 1).ok(), Some(Target::Image("fog.exr".into())));
        let folder = Target::Folder { folder: "fog".into(), stem: "fog".into() };
        assert_eq!(Target::parse(None, "fog", 2).ok(), Some(folder));
    }

    #[test]
    fn names_that_promise_another_format_are_refused() {
        for out in ["a.tif", "a.JPG", "clip.mp4", "clip.gif"] {
            assert_eq!(parse_out(out, 1), None, "{out}");
        }
    }
}
