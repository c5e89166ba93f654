//! Contact sheet of a sweep: all variants with one exposure, so that brightness can be compared.

use super::folder::SweepFolder;
use super::resolved::{PlannedVariant, ResolvedSweep};
use crate::exit::{Failure, failed};
use crate::output::Printer;
use femc_film::{Image, SheetCell, SheetRow, ToneCurve, exr, labeled_sheet};
use std::path::PathBuf;

/// Width of a picture in pixels.
const THUMBNAIL: u32 = 240;
/// Largest number of pictures per row.
const MAX_COLUMNS: usize = 10;
/// Largest number of rows that viewers can open and people look at.
const MAX_ROWS: usize = 200;
/// Largest number of pictures that determine the exposure.
const MAX_EXPOSED: usize = 32;

/// A future picture of the sheet: its file and its caption.
struct SheetPicture {
    file: PathBuf,
    caption: String,
}

/// Writes `contact.png`, if there is anything to show.
pub fn write(sweep: &ResolvedSweep, folder: &SweepFolder, printer: Printer) -> Result<Option<String>, Failure> {
    let rows = if sweep.first.settings.measure_only { Vec::new() } else { rows(sweep, folder) };
    let all: Vec<&SheetPicture> = rows.iter().take(MAX_ROWS).flat_map(|(_, row)| row).collect();
    if all.is_empty() {
        return Ok(None);
    }
    let small = |shown: &SheetPicture| Ok(exr::read(&shown.file).map_err(failed)?.image.shrunk_to(THUMBNAIL));
    let exposed = all.iter().step_by(all.len().div_ceil(MAX_EXPOSED)).map(|shown| small(shown));
    let curve = ToneCurve::auto(&exposed.collect::<Result<Vec<Image>, Failure>>()?);
    let cell =
        |shown: &SheetPicture| Ok(SheetCell { picture: curve.picture(&small(shown)?), caption: shown.caption.clone() });
    let row = |(title, row): &(String, Vec<SheetPicture>)| {
        Ok(SheetRow { title: title.clone(), cells: row.iter().map(cell).collect::<Result<_, Failure>>()? })
    };
    let sheet: Vec<SheetRow> = rows.iter().take(MAX_ROWS).map(row).collect::<Result<_, Failure>>()?;
    let path = folder.join("contact.png");
    let png = labeled_sheet(&sheet).to_png().map_err(failed)?;
    femc_film::file::write_atomic(&path, &png).map_err(failed)?;
    if rows.len() > MAX_ROWS {
        printer.note(format!("{}: the first {MAX_ROWS} of {} rows", path.display(), rows.len()));
    }
    Ok(Some(path.display().to_string()))
}

/// Returns the rows of the sheet. For clips, each variant has a row; for single frames, each row contains all values of the last
/// axis.
fn rows(sweep: &ResolvedSweep, folder: &SweepFolder) -> Vec<(String, Vec<SheetPicture>)> {
    let there = |variant: &PlannedVariant| -> Vec<(u32, PathBuf)> {
        let ready = variant.frames.iter().filter(|p| folder.has(&variant.file(p.frame), &p.key));
        ready.map(|planning| (planning.frame, folder.join(&variant.file(planning.frame)))).collect()
    };
    if sweep.variants.iter().any(|variant| variant.frames.len() > 1) {
        let row = |variant: &PlannedVariant| (sweep.title(variant), spread(there(variant)));
        return sweep.variants.iter().map(row).filter(|(_, row)| !row.is_empty()).collect();
    }
    let titled =
        |variant: &PlannedVariant| there(variant).into_iter().map(|(_, file)| (sweep.title(variant), file)).collect();
    group_rows(sweep.variants.iter().flat_map(|variant| -> Vec<(String, PathBuf)> { titled(variant) }))
}

/// Groups consecutive pictures whose titles are equal but for the last axis. A full row is followed by another of its title.
/// - `pictures`: title, with all axes, and file of each picture.
fn group_rows(pictures: impl Iterator<Item = (String, PathBuf)>) -> Vec<(String, Vec<SheetPicture>)> {
    let mut rows: Vec<(String, Vec<SheetPicture>)> = Vec::new();
    for (title, file) in pictures {
        let (title, caption) = title.rsplit_once(", ").unwrap_or(("", &title));
        let shown = SheetPicture { file, caption: caption.to_owned() };
        match rows.last_mut().filter(|(last, row)| last == title && row.len() < MAX_COLUMNS) {
            Some((_, row)) => row.push(shown),
            None => rows.push((title.to_owned(), vec![shown])),
        }
    }
    rows
}

/// Returns frames spread evenly over a clip, including the first and the last.
fn spread(frames: Vec<(u32, PathBuf)>) -> Vec<SheetPicture> {
    let (count, last) = (frames.len().min(MAX_COLUMNS), frames.len().saturating_sub(1));
    let mut places = (0..count).map(|at| at * last / (count - 1).max(1)).peekable();
    let chosen = |(at, (frame, file)): (usize, (u32, PathBuf))| {
        places.next_if_eq(&at).map(|_| SheetPicture { file, caption: format!("frame {frame}") })
    };
    frames.into_iter().enumerate().filter_map(chosen).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns title and captions of each row.
    fn captions(rows: &[(String, Vec<SheetPicture>)]) -> Vec<(&str, Vec<&str>)> {
        let mut all = Vec::new();
        for (title, row) in rows {
            all.push((title.as_str(), row.iter().map(|shown| shown.caption.as_str()).collect()));
        }
        all
    }

    #[test]
    fn a_row_has_the_values_of_the_last_axis() {
        let titles =
            ["fog = 1, spp = 4", "fog = 1, spp = 8", "fog = 2, spp = 4", "fog = 2, spp = 8", "fog = 1, spp = 4"];
        let rows = group_rows(titles.iter().map(|title| ((*title).to_owned(), PathBuf::from(title))));
        let expected = vec![
            ("fog = 1", vec!["spp = 4", "spp = 8"]),
            ("fog = 2", vec!["spp = 4", "spp = 8"]),
            ("fog = 1", vec!["spp = 4"]),
        ];
        assert_eq!(captions(&rows), expected);
        assert!(rows.iter().flat_map(|(_, row)| row).zip(titles).all(|(shown, title)| shown.file.as_os_str() == title));
    }

    #[test]
    fn rows_have_at_most_ten_pictures() {
        let rows = |count: usize| group_rows((0..count).map(|at| (format!("spp = {at}"), PathBuf::new())));
        let lengths = |count| rows(count).iter().map(|(_, row)| row.len()).collect::<Vec<_>>();
        assert_eq!([lengths(0), lengths(9), lengths(10), lengths(11)], [vec![], vec![9], vec![10], vec![10, 1]]);
        assert_eq!(lengths(25), [10, 10, 5]);
        let frames = |count: u32| spread((1..=count).map(|frame| (frame, PathBuf::new())).collect());
        let captions = |count| frames(count).into_iter().map(|shown| shown.caption).collect::<Vec<_>>();
        assert_eq!(captions(1), ["frame 1"]);
        assert_eq!(captions(3), ["frame 1", "frame 2", "frame 3"]);
        let long = captions(100);
        assert_eq!((long.len(), &*long[0], &*long[1], &*long[9]), (10, "frame 1", "frame 12", "frame 100"));
    }
}
