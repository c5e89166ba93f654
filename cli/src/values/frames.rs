use serde::Deserialize;
use serde::de::{Deserializer, Error as _};
use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

/// A choice of frames as typed: runs separated by commas, each `K`, `A..B` (inclusive) or `A..B+STEP`; or in the notation of Open
/// Job Description, `A-B` or `A-B:STEP`. Frames count from 1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames {
    /// Runs, at least one.
    runs: Vec<Run>,
}

/// Frames with a constant step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Run {
    first: u32,
    last: u32,
    step: u32,
}

impl Run {
    /// Returns the last frame of the run.
    fn end(self) -> u32 {
        self.first + (self.last - self.first) / self.step * self.step
    }

    /// Returns the frames of the run, ascending.
    fn frames(self) -> impl Iterator<Item = u32> {
        (self.first..=self.end()).step_by(self.step as usize)
    }
}

/// Reasons why a choice of frames is refused.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum FramesError {
    /// The text has none of these forms.
    #[error(
        "`{0}` is not a list of frames; write K, A..B (B included) or A..B+STEP, several with commas, like 7, 1..120, 1..120+10 or 1,5,9"
    )]
    InvalidFormat(String),
    /// Frame 0.
    #[error("frame numbers begin at 1")]
    Zero,
    /// Last before first.
    #[error("the last frame, {last}, comes before the first, {first}; write A..B with A <= B")]
    ReversedRange {
        /// First frame, as typed.
        first: u32,
        /// Last frame, as typed.
        last: u32,
    },
    /// A frame is beyond the clip.
    #[error("frame {wanted} is beyond the clip, which has {}", Available(*.available))]
    OutOfRange {
        /// Largest requested frame.
        wanted: u32,
        /// Number of frames of the clip.
        available: u32,
    },
}

/// Text "one frame" or "frames 1..120".
struct Available(u32);

impl fmt::Display for Available {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            1 => f.write_str("only frame 1 (the scene has no `time`, or a time of one frame)"),
            n => write!(f, "frames 1..{n}"),
        }
    }
}

impl Frames {
    /// Creates a choice of this frame, >= 1.
    pub fn single(frame: u32) -> Self {
        Self { runs: vec![Run { first: frame, last: frame, step: 1 }] }
    }

    /// Creates a choice of these frames, ascending and not empty, if they have a constant step.
    #[cfg(feature = "openjd")]
    pub fn from_even_steps(frames: &[u32]) -> Option<Self> {
        let (&first, &last) = (frames.first()?, frames.last()?);
        let step = frames.get(1).map_or(1, |second| second - first);
        let is_even = frames.windows(2).all(|pair| pair[1] - pair[0] == step);
        is_even.then(|| Self { runs: vec![Run { first, last, step }] })
    }

    /// Creates a choice of these frames, ascending and not empty, with any steps.
    #[cfg(feature = "openjd")]
    pub fn from_list(frames: &[u32]) -> Self {
        let single = |&frame: &u32| Run { first: frame, last: frame, step: 1 };
        Self::from_even_steps(frames).unwrap_or_else(|| Self { runs: frames.iter().map(single).collect() })
    }

    /// Returns the chosen frames, ascending, if `frames` has all of them; else the first missing frame.
    /// - `frames`: ascending.
    pub fn select_from(&self, frames: &[u32]) -> Result<Vec<u32>, u32> {
        let mut named = BTreeSet::new();
        for frame in self.runs.iter().flat_map(|run| run.frames()) {
            // The search ends at the first missing frame, so that a run of billions is not iterated.
            frames.binary_search(&frame).map_err(|_| frame)?;
            named.insert(frame);
        }
        Ok(named.into_iter().collect())
    }

    /// Returns the chosen frames, ascending and without duplicates, of a clip with the frames 1..=`available`.
    pub fn resolve(&self, available: u32) -> Result<Vec<u32>, FramesError> {
        let last = self.runs.iter().map(|run| run.end()).max().unwrap_or(0);
        if last > available {
            return Err(FramesError::OutOfRange { wanted: last, available });
        }
        let named: BTreeSet<u32> = self.runs.iter().flat_map(|run| run.frames()).collect();
        Ok(named.into_iter().collect())
    }
}

impl fmt::Display for Frames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, run) in self.runs.iter().enumerate() {
            let comma = if place == 0 { "" } else { "," };
            write!(f, "{comma}{run}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Run {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, last, step } = *self;
        match step {
            _ if first == last => write!(f, "{first}"),
            1 => write!(f, "{first}..{last}"),
            step => write!(f, "{first}..{last}+{step}"),
        }
    }
}

impl FromStr for Frames {
    type Err = FramesError;

    fn from_str(text: &str) -> Result<Self, FramesError> {
        let runs = text.split(',').map(|part| {
            parse_run(part).map_err(|fault| fault.unwrap_or_else(|| FramesError::InvalidFormat(text.to_owned())))
        });
        Ok(Self { runs: runs.collect::<Result<_, _>>()? })
    }
}

/// Parses one run of a choice. The error is `None` if the text has none of the forms.
fn parse_run(text: &str) -> Result<Run, Option<FramesError>> {
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| None);
    let ends = text.split_once("..").map(|ends| (ends, '+')).or_else(|| Some((text.split_once('-')?, ':')));
    let (first, last, step) = match ends {
        None => {
            let frame = number(text)?;
            (frame, frame, 1)
        }
        Some(((first, rest), before_step)) => match rest.split_once(before_step) {
            None => (number(first)?, number(rest)?, 1),
            Some((last, step)) => (number(first)?, number(last)?, number(step)?),
        },
    };
    match (first, last, step) {
        (0, _, _) => Err(Some(FramesError::Zero)),
        (_, _, 0) => Err(None),
        _ if last < first => Err(Some(FramesError::ReversedRange { first, last })),
        _ => Ok(Run { first, last, step }),
    }
}

impl<'de> Deserialize<'de> for Frames {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "expected a frame number or a text such as \"1..48\"")]
        enum FramesValue {
            One(u32),
            Text(String),
        }
        let text = match FramesValue::deserialize(from)? {
            FramesValue::One(frame) => frame.to_string(),
            FramesValue::Text(text) => text,
        };
        text.parse().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolved(text: &str, available: u32) -> Result<Vec<u32>, FramesError> {
        text.parse::<Frames>()?.resolve(available)
    }

    #[test]
    fn one_frame_a_range_and_a_stepped_range() {
        assert_eq!(resolved("7", 10), Ok(vec![7]));
        assert_eq!(resolved("2..4", 10), Ok(vec![2, 3, 4]));
        assert_eq!(resolved("1..10+4", 10), Ok(vec![1, 5, 9]));
        assert_eq!(resolved("3..3+100", 10), Ok(vec![3]));
    }

    #[test]
    fn several_frames_are_sorted_and_each_counts_once() {
        assert_eq!(resolved("9,1,5", 10), Ok(vec![1, 5, 9]));
        assert_eq!(resolved("3..5, 4, 1..9+4", 10), Ok(vec![1, 3, 4, 5, 9]));
        assert_eq!("9, 1..2,4-8:2".parse::<Frames>().map(|frames| frames.to_string()), Ok("9,1..2,4..8+2".to_owned()));
        assert_eq!(resolved("1,11", 10), Err(FramesError::OutOfRange { wanted: 11, available: 10 }));
        let named: Frames = "2,8..9".parse().unwrap();
        assert_eq!((named.select_from(&[1, 2, 8, 9]), named.select_from(&[2, 8])), (Ok(vec![2, 8, 9]), Err(9)));
    }

    #[test]
    fn frames_may_be_written_as_open_job_description_writes_them() {
        assert_eq!(resolved("2-4", 10), Ok(vec![2, 3, 4]));
        assert_eq!(resolved("1-10:4", 10), Ok(vec![1, 5, 9]));
        assert_eq!("1-10:4".parse::<Frames>().map(|frames| frames.to_string()), Ok("1..10+4".to_owned()));
    }

    #[test]
    fn a_step_that_never_reaches_the_last_frame_does_not_ask_for_it() {
        assert_eq!(resolved("1..12+4", 9), Ok(vec![1, 5, 9]));
    }

    #[test]
    fn frames_that_are_not_there_are_refused() {
        assert_eq!(resolved("1..11", 10), Err(FramesError::OutOfRange { wanted: 11, available: 10 }));
        assert_eq!(resolved("0", 10), Err(FramesError::Zero));
        assert_eq!(resolved("5..2", 10), Err(FramesError::ReversedRange { first: 5, last: 2 }));
    }

    #[test]
    fn what_is_no_choice_of_frames_is_refused() {
        for text in [
            "",
            "a",
            "1..",
            "..3",
            "1..3+0",
            "1..3+",
            "1-3+2",
            "1-",
            "-1",
            "1.5",
            "99999999999",
            ",",
            "1,",
            ",1",
            "1;2",
        ] {
            assert_eq!(text.parse::<Frames>(), Err(FramesError::InvalidFormat(text.to_owned())), "{text}");
        }
    }

    #[test]
    fn the_largest_range_resolves_without_overflow() {
        let top = u32::MAX;
        assert_eq!(resolved(&format!("{}..{top}", top - 1), top), Ok(vec![top - 1, top]));
    }
}
