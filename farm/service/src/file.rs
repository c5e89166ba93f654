//! Results of a job that users keep as files, with the names that `femc fetch` gives them.

use femc_model::{Artifact, FrameRecord, Graph, JobSpec, Role, Stage, StageKind};
use serde::Deserialize;

/// A result of a frame or of the whole job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ResultFile {
    /// A result of the frame with this number.
    Frame(u32, FrameFile),
    /// All frames as a clip.
    Clip,
    /// Contact sheet: all frames in one PNG.
    Sheet,
}

/// A result of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FrameFile {
    /// EXR.
    Image,
    /// PNG with the frame's own exposure.
    Preview,
    /// PNG with the common exposure of all frames.
    Still,
    /// PNG in a painted style.
    Painted,
    /// EXR with the layers.
    Layers,
    /// Light statistics.
    Statistics,
    /// Binary glTF with the surfaces.
    Geometry,
    /// Binary glTF with the finite-element solution.
    Solution,
    /// Readings of light as JSON.
    Readings,
    /// Targets of paths as JSON.
    Targets,
}

impl FrameFile {
    /// Every kind.
    pub(crate) const ALL: [Self; 10] = [
        Self::Image,
        Self::Preview,
        Self::Still,
        Self::Painted,
        Self::Layers,
        Self::Statistics,
        Self::Geometry,
        Self::Solution,
        Self::Readings,
        Self::Targets,
    ];

    /// Returns the last segment of the result's HTTP path.
    pub(crate) const fn segment(self) -> &'static str {
        match self {
            Self::Image => "image.exr",
            Self::Preview => "preview.png",
            Self::Still => "still.png",
            Self::Painted => "painted.png",
            Self::Layers => "layers.exr",
            Self::Statistics => "statistics.paths",
            Self::Geometry => "geometry.glb",
            Self::Solution => "solution.glb",
            Self::Readings => "readings.json",
            Self::Targets => "targets.json",
        }
    }

    /// Returns the end of the file name, after the frame number.
    const fn ending(self) -> &'static str {
        match self {
            Self::Image => "exr",
            Self::Preview => "preview.png",
            Self::Still => "png",
            Self::Painted => "painted.png",
            Self::Layers => "layers.exr",
            Self::Statistics => "paths",
            Self::Geometry => "glb",
            Self::Solution => "solution.glb",
            Self::Readings => "readings.json",
            Self::Targets => "targets.json",
        }
    }

    pub(crate) const fn role(self) -> Role {
        match self {
            Self::Image => Role::Image,
            Self::Preview => Role::Preview,
            Self::Still => Role::Still,
            Self::Painted => Role::Painted,
            Self::Layers => Role::LayerImage,
            Self::Statistics => Role::Statistics,
            Self::Geometry => Role::Geometry,
            Self::Solution => Role::Solution,
            Self::Readings => Role::Readings,
            Self::Targets => Role::Targets,
        }
    }
}

/// Data of a frame for the scene view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FrameModel {
    /// The surfaces as triangles.
    Geometry,
    /// The finite-element solution as triangles.
    Solution,
    /// The targets of its paths.
    Targets,
}

impl FrameModel {
    /// Returns the result of a frame that contains the model.
    pub(crate) const fn file(self) -> FrameFile {
        match self {
            Self::Geometry => FrameFile::Geometry,
            Self::Solution => FrameFile::Solution,
            Self::Targets => FrameFile::Targets,
        }
    }
}

impl ResultFile {
    /// Returns the artifact, if the job has made it.
    /// - `records`: finished frames of the job, with the record of the whole job.
    pub(crate) fn artifact(self, spec: &JobSpec, records: &[FrameRecord]) -> Option<Artifact> {
        let record = |frame| records.iter().find(|record| record.frame == frame);
        let of_job = |role| {
            let outputs = record(Stage::JOB_FRAME).map_or(&[][..], |record| &record.outputs);
            outputs.iter().filter(move |output| output.role == role).map(|output| output.artifact)
        };
        match self {
            Self::Clip => of_job(Role::Clip).next(),
            Self::Sheet => of_job(Role::Sheet).next(),
            Self::Frame(Stage::JOB_FRAME, _) => None,
            // The record of the whole job lists these in frame order.
            Self::Frame(frame, file @ (FrameFile::Still | FrameFile::Painted)) => {
                let place = spec.frames.iter().position(|&other| other == frame)?;
                of_job(file.role()).nth(place)
            }
            Self::Frame(frame, file) => record(frame)?.output(file.role()),
        }
    }

    /// Returns the file name.
    /// - `extension`: extension of a clip whose name the job does not specify.
    pub(crate) fn name(self, spec: &JobSpec, extension: &str) -> String {
        let names = FileNames::new(&spec.graph);
        match self {
            Self::Frame(frame, file) => format!("{}.{frame:04}.{}", spec.name, file.ending()),
            Self::Clip => names.clip.unwrap_or_else(|| format!("{}.clip.{extension}", spec.name)),
            Self::Sheet => names.sheet.unwrap_or_else(|| format!("{}.sheet.png", spec.name)),
        }
    }

    /// Returns a description for use in a sentence.
    pub(crate) fn describe(self) -> String {
        match self {
            Self::Frame(frame, file) => format!("{} of frame {frame}", file.segment()),
            Self::Clip => "clip".to_owned(),
            Self::Sheet => "contact sheet".to_owned(),
        }
    }
}

/// File names chosen by the submitter of a job.
#[derive(Debug, Default)]
pub(crate) struct FileNames {
    /// Name of the clip. Its extension selects the format.
    pub(crate) clip: Option<String>,
    /// Name of the contact sheet.
    pub(crate) sheet: Option<String>,
}

/// Options of encode stages: the file names only.
#[derive(Deserialize)]
struct Options {
    sheet: Option<String>,
    video: Option<Video>,
}

#[derive(Deserialize)]
struct Video {
    name: String,
}

impl FileNames {
    /// Reads the names from a job's graph. Names that are not valid file names are ignored.
    pub(crate) fn new(graph: &Graph) -> Self {
        // All stages of a clip have the same options.
        let encode =
            graph.stage_of_kind(StageKind::EncodePicture).or_else(|| graph.stage_of_kind(StageKind::EncodeClip));
        let options = encode.and_then(|(_, template)| serde_json::from_str::<Options>(&template.options).ok());
        let is_file = |name: &String| JobSpec::is_valid_name(name) && !name.starts_with('.');
        let Some(Options { sheet, video }) = options else { return Self::default() };
        Self { clip: video.map(|video| video.name).filter(is_file), sheet: sheet.filter(is_file) }
    }
}

/// Returns the media type and the usual extension of a clip or image, from its first bytes.
/// - `head`: the first 64 bytes or more, or the whole file if it is shorter.
pub(crate) fn media_type(head: &[u8]) -> (&'static str, &'static str) {
    let at = |place: usize, bytes: &[u8]| head.get(place..).is_some_and(|rest| rest.starts_with(bytes));
    let has = |bytes: &[u8]| head.windows(bytes.len()).any(|window| window == bytes);
    match head {
        // An animated PNG is also a PNG.
        _ if at(0, b"\x89PNG\r\n\x1a\n") => ("image/png", "png"),
        _ if at(0, b"GIF8") => ("image/gif", "gif"),
        _ if at(4, b"ftypavi") => ("image/avif", "avif"),
        _ if at(4, b"ftypqt") => ("video/quicktime", "mov"),
        _ if at(4, b"ftyp") => ("video/mp4", "mp4"),
        // EBML, with the format name near its start.
        _ if at(0, b"\x1a\x45\xdf\xa3") && has(b"webm") => ("video/webm", "webm"),
        _ if at(0, b"\x1a\x45\xdf\xa3") => ("video/x-matroska", "mkv"),
        _ if at(0, b"OggS") => ("video/ogg", "ogv"),
        _ if at(0, b"RIFF") && at(8, b"WEBP") => ("image/webp", "webp"),
        _ if at(0, b"RIFF") && at(8, b"AVI ") => ("video/x-msvideo", "avi"),
        _ => ("application/octet-stream", "bin"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bytes_of_a_clip_tell_its_media_type() {
        for (head, kind) in [
            (&b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"[..], "image/png"),
            (b"GIF89a\x01\0", "image/gif"),
            (b"\0\0\0\x20ftypisom\0\0\x02\0isomiso2avc1mp41", "video/mp4"),
            (b"\0\0\0\x14ftypqt  \0\0\x02\0qt  ", "video/quicktime"),
            (b"\x1a\x45\xdf\xa3\x9fB\x86\x81\x01B\xf7\x81\x01B\x82\x84webm", "video/webm"),
            (b"\x1a\x45\xdf\xa3\x9fB\x86\x81\x01B\xf7\x81\x01B\x82\x88matroska", "video/x-matroska"),
            (b"<html>", "application/octet-stream"),
            (b"", "application/octet-stream"),
        ] {
            assert_eq!(media_type(head).0, kind, "{head:?}");
        }
    }
}
