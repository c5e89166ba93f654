//! Tests of file names: quotes, blanks, and names similar to those of files.

use crate::common::{bundle, try_files};
use femc_import::{Bundle, FileSource, ImportFault, LoadedScene, load_scene_or_all_errors};
use std::{cell::Cell, io};

const LAMP: &str = "TILT=NONE\n1 1 1 3 1 1 2 0 0 0 1 1 1 0 45 90 0 5 5 5\n";
const FLOOR: &str = "v f =\nsph f 1\n";

fn load_with_files(text: &str) -> Result<LoadedScene, String> {
    let files = [
        ("t.mgf", text),
        ("my lamp.ies", LAMP),
        ("two  blanks.ies", LAMP),
        ("Plain.ies", LAMP),
        ("-t odd.ies", LAMP),
        ("my floor.mgf", FLOOR),
        ("parts/old floor.mgf", FLOOR),
    ];
    try_files(&files).map_err(|error| error.to_string())
}

#[test]
fn a_quoted_file_name_may_hold_blanks_and_anything_but_a_quote() {
    for (line, file) in [
        ("i \"my floor.mgf\"", "my floor.mgf"),
        ("i \"my floor.mgf\" -t 1 2 3 -a 2 -rz 90", "my floor.mgf"),
        ("i \"./parts/old floor.mgf\"", "parts/old floor.mgf"),
        ("ies \"my lamp.ies\"", "my lamp.ies"),
        ("  ies\t\"two  blanks.ies\"  -m 2 -rx 90", "two  blanks.ies"),
        ("ies \"-t odd.ies\"", "-t odd.ies"),
        ("ies \"Plain.ies\"\r", "Plain.ies"),
        ("ies \\\n\"my lamp.ies\" \\\n-m 2", "my lamp.ies"),
    ] {
        let loaded = load_with_files(line).unwrap_or_else(|error| panic!("{line}: {error}"));
        assert_eq!(loaded.files[1], file);
        assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    }
}

#[test]
fn quotes_elsewhere_are_letters_of_a_name() {
    let text = "m we\"ird =\n\trd .5\nm 'Neutral.8' =\nm \"both\" =\nc \"red =\nv \"a\" =\no \"hall\"\nm we\"ird\nsph \"a\" 1\nm 'Neutral.8'\nm \"both\"\no\n";
    let scene = load_with_files(text).unwrap().scene;
    let names: Vec<&str> = scene.materials.iter().map(|material| &*material.name).collect();
    assert_eq!(names, ["we\"ird", "'Neutral.8'", "\"both\""]);
    assert_eq!(scene.objects[0].name, "\"hall\"");
}

#[test]
fn a_fault_of_quotes_is_named_at_its_place() {
    for (line, says) in [
        ("i \"my floor.mgf", "t.mgf:1:3: the file name has no closing double quote"),
        ("ies \"my lamp.ies -t 0 0 1", "t.mgf:1:5: the file name has no closing double quote"),
        ("map_rd \"", "t.mgf:1:8: the file name has no closing double quote"),
        ("i \"my \\\nfloor.mgf\"", "t.mgf:1:3: the file name has no closing double quote"),
        ("i \"\\\nparts/old.mgf", "t.mgf:1:3: the file name has no closing double quote"),
        ("ies \"my lamp\".ies", "t.mgf:1:14: found `.ies` directly after the closing double quote"),
        ("i \"\"", "t.mgf:1:3: `` is not a portable path: it names a folder"),
        ("ies \"lost lamp.ies\"", "t.mgf:1:5: cannot read `lost lamp.ies`"),
    ] {
        let error = load_with_files(line).unwrap_err();
        assert!(error.starts_with(says), "{line}: {error}");
    }
}

#[test]
fn a_name_with_blanks_and_no_quotes_says_how_to_write_it() {
    for (line, says) in [
        (
            "i my floor.mgf",
            "the file name `my floor.mgf` contains spaces; write it in double quotes: `i \"my floor.mgf\"`",
        ),
        ("i parts/old floor.mgf -t 1 0 0", "write it in double quotes: `i \"parts/old floor.mgf\"`"),
        ("ies my lamp.ies -t 0 0 2", "write it in double quotes: `ies \"my lamp.ies\"`"),
        ("ies two  blanks.ies", "write it in double quotes: `ies \"two  blanks.ies\"`"),
        ("ies -t odd.ies", "write it in double quotes: `ies \"-t odd.ies\"`"),
        ("ies lost lamp.ies -t 0 0 2", "found `lamp.ies` after the file name `lost`; if it is part of the name"),
        ("ies Plain.ies 2", "found `2` after the file name `Plain.ies`"),
        (
            "map_ed my wood.png",
            "found `wood.png` after the file name `my`; if it is part of the name, write the name in",
        ),
        ("map_rd a b c.png", "`map_rd \"a b c.png\"`"),
    ] {
        let error = load_with_files(line).unwrap_err();
        let column = line.find(' ').unwrap() + 2;
        assert!(error.starts_with(&format!("t.mgf:1:{column}: ")) && error.contains(says), "{line}: {error}");
    }
    // A word that could be an option is one if the file exists.
    assert!(load_with_files("ies Plain.ies -ty 2").unwrap_err().contains("found `-ty`"));
}

#[test]
fn a_name_that_is_nearly_that_of_a_file_names_the_file() {
    for (line, near) in [
        ("ies plain.ies", "`Plain.ies`"),
        ("ies PLAIN.IES", "`Plain.ies`"),
        ("ies my%20lamp.ies", "`\"my lamp.ies\"`"),
        ("ies my_lamp.ies", "`\"my lamp.ies\"`"),
        ("ies \"my lamp.ies \"", "`\"my lamp.ies\"`"),
        ("i parts/Old_Floor.mgf", "`\"old floor.mgf\"`"),
    ] {
        let error = load_with_files(line).unwrap_err();
        assert!(
            error.contains("cannot read ") && error.ends_with(&format!("did you mean {near} in the same folder?")),
            "{line}: {error}"
        );
    }
    let error = try_files(&[("t.mgf", "map_rd lost.png")]).unwrap_err();
    assert!(matches!(&*error.fault, ImportFault::Unreadable { near: None, .. }), "{error}");
}

/// Names in a file are relative to its own folder.
#[test]
fn a_near_name_has_no_folder() {
    for (line, path, near) in [
        ("map_rd Wood.PNG", "house/Wood.PNG", "Wood.png"),
        ("map_rd ../oak.png", "oak.png", "Oak.png"),
        ("map_rd maps/Tile.png", "house/maps/Tile.png", "tile.png"),
    ] {
        let files = [
            ("t.mgf", "i house/room.mgf"),
            ("house/room.mgf", line),
            ("house/Wood.png", ""),
            ("Oak.png", ""),
            ("house/maps/tile.png", ""),
        ];
        let error = try_files(&files).unwrap_err();
        assert!(matches!(&*error.fault, ImportFault::Unreadable { near: Some(name), .. } if name == near), "{error:?}");
        let error = error.to_string();
        assert!(error.starts_with(&format!("house/room.mgf:1:8: cannot read `{path}`")), "{error}");
        assert!(error.ends_with(&format!("; did you mean `{near}` in the same folder?")), "{error}");
    }
}

/// Files that count lookups.
struct CountingFiles(Bundle, Cell<usize>);

impl FileSource for CountingFiles {
    fn size(&self, path: &str) -> io::Result<u64> {
        self.1.set(self.1.get() + 1);
        self.0.size(path)
    }

    fn read(&self, path: &str) -> io::Result<Vec<u8>> {
        self.0.read(path)
    }
}

#[test]
fn a_missing_file_is_looked_up_at_its_first_use_alone() {
    let lookups = |lines: usize| {
        let text = "i lost.mgf -t 1 2 3\nies lost.ies -m 2 -rz 5\n".repeat(lines);
        let files = CountingFiles(bundle(&[("t.mgf", &text)]), Cell::new(0));
        assert_eq!(load_scene_or_all_errors(&files, "t.mgf").unwrap_err().errors.len(), 2);
        files.1.get()
    };
    assert_eq!(lookups(1), lookups(50));
}

#[test]
fn folder_suggests_its_file_names_and_none_outside_the_root() {
    let root = tempfile::tempdir().unwrap();
    std::fs::create_dir(root.path().join("in")).unwrap();
    std::fs::write(root.path().join("Lamp.ies"), LAMP).unwrap();
    let load = |text: &str| {
        std::fs::write(root.path().join("in/t.mgf"), text).unwrap();
        let path = femc_import::ScenePath::with_root(&root.path().join("in"), &root.path().join("in/t.mgf")).unwrap();
        path.load().unwrap_err().to_string()
    };
    std::fs::write(root.path().join("in/My Lamp.ies"), LAMP).unwrap();
    assert!(load("ies \"my lamp.ies\"").ends_with("did you mean `\"My Lamp.ies\"` in the same folder?"));
    assert!(load("ies ../lamp.ies").contains("leaves the scene's root folder"));
}
