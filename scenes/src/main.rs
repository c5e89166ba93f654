//! Writes the generated scenes.
//!
//! `femc-scenes NAME` prints the scene file, `femc-scenes --write DIR` writes every generated file below DIR.

use femc_scenes::{NAMES, SceneFile, generate_all, generate_scene};
use std::{
    io::{self, Write},
    path::Path,
    process::ExitCode,
};

fn write_all(folder: &Path) -> io::Result<()> {
    for SceneFile { path, bytes } in generate_all() {
        let target = folder.join(path);
        if let Some(parent) = target.parent() {
            std::fs::create_dir_all(parent)?;
        }
        std::fs::write(target, bytes)?;
    }
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words.as_slice() {
        ["--write", folder] => write_all(Path::new(folder)),
        [name] if generate_scene(name).is_some() => {
            let files = generate_scene(name).unwrap_or_default();
            match files.iter().find(|f| f.path.ends_with(".mgf") && !f.path.contains('/')) {
                Some(file) => io::stdout().write_all(&file.bytes),
                None => files.iter().try_for_each(|f| writeln!(io::stdout(), "{}", f.path)),
            }
        }
        _ => {
            eprintln!("usage: femc-scenes NAME | femc-scenes --write DIR\nnames: {}", NAMES.join(", "));
            return ExitCode::from(2);
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("femc-scenes: cannot write: {error}");
            ExitCode::FAILURE
        }
    }
}
