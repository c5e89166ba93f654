//! Tests of photometric files and scenes in every edition, encoding and spacing.

use crate::common::{try_files, try_scene};
use femc_import::{Bundle, LoadedScene, load_scene};
use femc_scene::Photometry;
use proptest::prelude::*;
use std::collections::BTreeMap;

const LINES: [&str; 5] = ["", "IESNA91\n", "IESNA:LM-63-1995\n", "IESNA:LM-63-2002\n", "IES:LM-63-2019\n"];

/// Encodings of a file.
#[derive(Clone, Copy, Debug)]
enum Encoding {
    Plain,
    Marked,
    Utf16Le,
    Utf16Be,
    UnmarkedLe,
    UnmarkedBe,
}

use Encoding::{Marked, Plain, UnmarkedBe, UnmarkedLe, Utf16Be, Utf16Le};

const ENCODINGS: [Encoding; 6] = [Plain, Marked, Utf16Le, Utf16Be, UnmarkedLe, UnmarkedBe];

fn encode(text: &str, encoding: Encoding) -> Vec<u8> {
    let wide = |text: &str, bytes: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(bytes).collect();
    let marked = format!("\u{feff}{text}");
    match encoding {
        Plain => text.as_bytes().to_vec(),
        Marked => marked.into_bytes(),
        Utf16Le => wide(&marked, u16::to_le_bytes),
        Utf16Be => wide(&marked, u16::to_be_bytes),
        UnmarkedLe => wide(text, u16::to_le_bytes),
        UnmarkedBe => wide(text, u16::to_be_bytes),
    }
}

/// Imports a scene of one lamp whose file has these bytes.
fn lamp(bytes: &[u8]) -> Result<LoadedScene, String> {
    let files = [("t.mgf", &b"ies lamp.ies -t 0 0 3\n"[..]), ("lamp.ies", bytes)];
    let files: BTreeMap<String, Vec<u8>> = files.map(|(name, bytes)| (name.to_owned(), bytes.to_vec())).into();
    load_scene(&Bundle(files), "t.mgf").map_err(|error| error.to_string())
}

/// Returns photometry and remarks of a lamp.
fn read(bytes: &[u8]) -> Result<(Photometry, Vec<String>), String> {
    let loaded = lamp(bytes)?;
    let words = loaded.warnings.iter().chain(&loaded.notes).map(|said| said.kind.to_string()).collect();
    Ok((loaded.scene.photometry[0].clone(), words))
}

/// A photometric file as the lines above its numbers and the numbers as written.
#[derive(Clone, Debug)]
struct File {
    head: String,
    /// Number of numbers of `TILT=INCLUDE`; the first two are the geometry and a count.
    tilt: usize,
    numbers: Vec<String>,
}

impl File {
    fn to_text(&self, separators: &[&str]) -> String {
        let mut text = self.head.clone();
        for (i, number) in self.numbers.iter().enumerate() {
            if i > 0 {
                text += separators[i % separators.len()];
            }
            text += number;
        }
        text + "\n"
    }
}

/// Generates a number as files write it: whole or with decimals.
fn number(high: u32) -> impl Strategy<Value = String> {
    prop_oneof![
        (0..high).prop_map(|x| x.to_string()),
        (0..high, 0u32..1000).prop_map(|(x, part)| format!("{x}.{part}")),
        (1u32..100).prop_map(|part| format!(".{part}")),
        (0..high).prop_map(|x| format!("{x}.")),
        (1..high).prop_map(|x| format!("{x}e-1")),
    ]
}

fn file() -> impl Strategy<Value = File> {
    let lists = (1usize..12, 1usize..6, prop::collection::vec(number(3000), 60), 1usize..4, any::<bool>());
    let fields = (number(9), number(5), number(5), prop::collection::vec(number(3), 3), any::<bool>(), "1\\.[01]{5}");
    (0usize..5, lists, fields, any::<bool>()).prop_map(|(edition, lists, fields, keywords)| {
        let (v, h, candela, tilt, tilted) = lists;
        let (lumens, multiplier, ballast, size, feet, second) = fields;
        let positive = |number: String| if number.parse() == Ok(0.0) { "1".to_owned() } else { number };
        let keyword = if keywords { "[TEST] 1,5 and more, of TILT\n[MORE] 3\n" } else { "" };
        let include = if tilted { "INCLUDE" } else { "NONE" };
        let head = format!("{}{keyword}TILT={include}\n", LINES[edition]);
        let mut numbers: Vec<String> = Vec::new();
        let tilt = if tilted { tilt } else { 0 };
        if tilted {
            numbers.extend(["1".to_owned(), tilt.to_string()]);
            numbers.extend((0..tilt).map(|i| format!("{}.5", 20 * i)));
            numbers.extend((0..tilt).map(|i| format!("{}", 1.0 - 0.25 * i as f64)));
        }
        let (v, counts) = (v + 1, [(v + 1).to_string(), h.to_string()]);
        numbers.extend(["1".to_owned(), positive(lumens), positive(multiplier)]);
        numbers.extend(counts);
        numbers.extend(["1".to_owned(), if feet { "1" } else { "2" }.to_owned()]);
        numbers.extend(size);
        numbers.extend([positive(ballast), second, "20.5".to_owned()]);
        numbers.extend((0..v).map(|i| (180.0 / (v - 1) as f64 * i as f64).min(180.0).to_string()));
        numbers.extend((0..h).map(|i| if h == 1 { 0.0 } else { 180.0 / (h - 1) as f64 * i as f64 }.to_string()));
        numbers.extend(candela.into_iter().cycle().take(v * h));
        File { head, tilt: if tilted { 2 + 2 * tilt } else { 0 }, numbers }
    })
}

const SEPARATORS: [&str; 13] = [" ", "  ", "\t", ",", ", ", " , ", "\n", "\r\n", "\r", ",\n", " \r\n", "\n\n", ",\r"];

fn separators() -> impl Strategy<Value = Vec<&'static str>> {
    prop::collection::vec(prop::sample::select(&SEPARATORS[..]), 1..9)
}

/// Damage to the numbers of a file.
#[derive(Clone, Copy, Debug)]
enum Corruption {
    Twice,
    Missing,
    DecimalComma,
    BareDecimalComma,
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// Separators, line ends and encodings change nothing.
    #[test]
    fn a_file_is_the_same_lamp_however_it_is_written(
        file in file(),
        separators in separators(),
        encoding in prop::sample::select(&ENCODINGS[..]),
        line_end in prop::sample::select(&["\n", "\r\n", "\r", "\r\r\n"][..]),
        tail in prop::sample::select(&["", "\n", "END\n", "\n\0\0\x1a", "\x1a\0\0"][..]),
    ) {
        let plain = read(file.to_text(&[" "]).as_bytes()).unwrap();
        let head = file.head.replace('\n', line_end);
        let text = File { head, ..file }.to_text(&separators) + tail;
        prop_assert_eq!(read(&encode(&text, encoding)), Ok(plain), "{:?}", text);
    }

    /// An extra number, a missing number or a decimal comma is an error anywhere.
    #[test]
    fn a_corrupt_file_is_never_another_lamp(
        file in file(),
        separators in separators(),
        at: prop::sample::Index,
        corruption in prop_oneof![
            Just(Corruption::Twice), Just(Corruption::Missing), Just(Corruption::DecimalComma), Just(Corruption::BareDecimalComma),
        ],
        digit in 0u32..10,
    ) {
        let mut corrupt = file.clone();
        // A changed number of tilt factors may by chance leave a valid file.
        let first = if file.tilt > 0 { 2 } else { 0 };
        let at = first + at.index(file.numbers.len() - first);
        match corruption {
            Corruption::Twice => corrupt.numbers.insert(at, file.numbers[at].clone()),
            Corruption::Missing => { corrupt.numbers.remove(at); }
            Corruption::DecimalComma => corrupt.numbers[at] = format!("{},{digit}", at % 300),
            Corruption::BareDecimalComma => corrupt.numbers[at] = format!(" ,{digit}"),
        }
        for separators in [&separators[..], &[" "]] {
            let text = corrupt.to_text(separators);
            prop_assert!(read(text.as_bytes()).is_err(), "{:?} at {}: {:?}", corruption, at, text);
        }
    }
}

const SCENE: &str = "# caf\u{e9}\nv a =\n\tp 0 0 0\nm lamp =\n\ted 10\nm lamp\nsph a \\\n\t1\ncamera main =\n\torigin 0 -5 0\n\ttarget 0 0 0\n";

#[test]
fn scene_is_equal_in_every_encoding_and_line_ending() {
    let expected = try_scene(SCENE).unwrap();
    assert!(expected.warnings.is_empty() && expected.scene.groups[0].quadrics.len() == 1);
    for line_end in ["\n", "\r\n", "\r", "\r\r\n"] {
        for encoding in ENCODINGS {
            let bytes = encode(&SCENE.replace('\n', line_end), encoding);
            let loaded = load_scene(&Bundle([("t.mgf".to_owned(), bytes)].into()), "t.mgf").unwrap();
            assert_eq!(loaded.scene.digest(), expected.scene.digest(), "{encoding:?} {line_end:?}");
            assert!(loaded.warnings.is_empty(), "{encoding:?} {line_end:?}: {:?}", loaded.warnings);
        }
    }
}

#[test]
fn faults_name_their_line_whatever_ends_the_lines() {
    let text = SCENE.replace("ed 10", "ed x");
    for line_end in ["\n", "\r\n", "\r", "\r\r\n"] {
        for encoding in ENCODINGS {
            let bytes = encode(&text.replace('\n', line_end), encoding);
            let error = load_scene(&Bundle([("t.mgf".to_owned(), bytes)].into()), "t.mgf").unwrap_err();
            assert_eq!(error.at.to_string(), "t.mgf:5:5", "{encoding:?} {line_end:?}: {error}");
        }
    }
    let mixed = text.replace("=\n", "=\r").replace("0 0\n", "0 0\r\n");
    assert_eq!(try_scene(&mixed).unwrap_err().at.to_string(), "t.mgf:5:5");
    let lamp_text = "IESNA91\n[TEST]\nTILT=NONE\n1 -1 1 2 1 1 2 0 0 0\n1 1 1\n0 90\n0\n5 x\n";
    for line_end in ["\n", "\r\n", "\r", "\r\r\n"] {
        for encoding in ENCODINGS {
            let error = lamp(&encode(&lamp_text.replace('\n', line_end), encoding)).unwrap_err();
            assert!(error.starts_with("lamp.ies:8:3: `x` is not a number"), "{encoding:?} {line_end:?}: {error}");
        }
    }
}

#[test]
fn files_that_are_not_text_are_refused_where_they_are_named() {
    let image = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x01".to_vec();
    let files =
        |scene: &[u8]| Bundle([("t.mgf".to_owned(), scene.to_vec()), ("a.png".to_owned(), image.clone())].into());
    for (scene, at) in [(&b"\ni a.png"[..], "t.mgf:2:3"), (b"ies a.png", "t.mgf:1:5"), (&image, "t.mgf")] {
        let error = load_scene(&files(scene), "t.mgf").unwrap_err();
        assert_eq!(error.at.to_string(), at);
        assert!(error.to_string().contains("zero byte in line 3, so it is not a text file"), "{error}");
    }
}

#[test]
fn a_lamp_that_is_scaled_has_no_hint_of_1000_lumens() {
    let text = "IESNA91\nTILT=NONE\n1 1000 1 2 1 1 2 0 0 0\n1 1 20\n0 180\n0\n50 50\n";
    let notes = |scene: &str| {
        let loaded = try_files(&[("t.mgf", scene), ("a.ies", text)]).unwrap();
        assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
        let hints: Vec<_> = loaded.notes.iter().filter(|note| note.kind.code() == "photometry").cloned().collect();
        hints.iter().map(|note| note.to_string()).collect::<Vec<_>>()
    };
    assert!(notes("ies a.ies -m 2.5 -t 0 0 1").is_empty());
    for scene in ["ies a.ies", "ies a.ies -m 2\nies a.ies -t 0 0 1\nies a.ies"] {
        let [hint] = &notes(scene)[..] else { panic!("one hint") };
        assert!(hint.starts_with("a.ies:3:3: the flux of this file is 628 lm from lamps of exactly 1000 lm"), "{hint}");
    }
}
