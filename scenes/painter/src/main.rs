//! `femc-painter`: see the crate's README.

use femc_film::{exr, file};
use femc_painter::{Guides, RenderView, STYLES};
use std::path::Path;
use std::process::ExitCode;

const USAGE: &str = "\
usage: femc-painter guides FRAME.exr OUT.exr    writes the guides of a frame (rendered with `--layers guides`) to one file
       femc-painter paint GUIDES.exr DIR        paints DIR/hatching.png, watercolor.png, oil.png, cel.png";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match arguments[..] {
        ["guides", frame, out] => guides(Path::new(frame), Path::new(out)),
        ["paint", guides, folder] => paint(Path::new(guides), Path::new(folder)),
        ["--help" | "-h"] => {
            println!("{USAGE}");
            return ExitCode::SUCCESS;
        }
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("femc-painter: error: {error}");
            ExitCode::FAILURE
        }
    }
}

type CommandResult = Result<(), Box<dyn std::error::Error>>;

fn guides(frame: &Path, out: &Path) -> CommandResult {
    let guides = Guides::from_frame(frame)?;
    let mut attributes = exr::read_attributes(&frame.with_extension("layers.exr"))?;
    attributes.retain(|name, _| name.starts_with(exr::ATTRIBUTE_PREFIX));
    Ok(file::write_atomic(out, &guides.encode(&attributes)?)?)
}

fn paint(guides: &Path, folder: &Path) -> CommandResult {
    let view = RenderView::from_guides(&Guides::read(guides)?)?;
    let view = &view;
    let painted = std::thread::scope(|scope| {
        let painters = STYLES.map(|style| scope.spawn(move || (style.paint)(view)));
        painters.map(|painter| painter.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    });
    for (style, picture) in STYLES.iter().zip(painted) {
        let path = folder.join(style.name).with_extension("png");
        file::write_atomic(&path, &picture.to_png()?)?;
        println!("{}", path.display());
    }
    Ok(())
}
