//! The fuzzing corpus and its mutations; the tests use them, too.

mod images;

use std::collections::BTreeMap;

/// A small random number generator (SplitMix64). A seed reproduces a finding.
pub struct Rng(u64);

impl Rng {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number in `0..n`; 0 for an empty range.
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }
}

const SCENES: &[&str] = &[
    "c warm =\n\tcct 2700\nc mix =\n\tcmix 1 warm 2 warm\nc spec =\n\tcspec 400 700 .1 .2 .9\nc\n\tcxy .4 .35\nm wall =\n\tsides 2\n\tc warm\n\
     \trd .5\n\trs .2 .1\n\ttd .1\n\tts .1 .3\nm lamp =\n\tsides 1\n\ted 4000\n\tlobe 12\nv a =\n\tp 0 0 0\nv b =\n\tp 4 0 0\nv c =\n\tp 4 4 0\n\
     v d =\n\tp 0 4 0\nv e =\n\tp 1 3 0\nv f =\n\tp 3 3 0\nv g =\n\tp 3 1 0\nv h =\n\tp 1 1 0\nm wall\no room\nf a b c d e f g h e d\n\
     fh a b c d - e f g h\nprism a b c d -2\nm lamp\nf d c b a\no\n",
    "v a =\n p 0 0 1\n n 0 0 1\nv b = a\n p 1 2 3\nm glass =\n sides 1\n ir 1.5 0\n ts .9 0\no things\nxf -t 1 2 3 -rz 30 -s 2\nsph a 1\nsph a -.5\n\
     cyl a .2 b\ncone a 1 b 0\nring a .1 .4\ntorus a .2 .5\ntorus a -.1 -.6\nxf\nxf -a 3 -t 2 0 0 -a 2 -rz 90 -i 2 -t 0 0 1\nsph a .2\nxf -mx\nsph b 1\n\
     xf\nxf\ni part.mgf -t 0 0 5 -a 4 -t 1 0 0\nies lamp.ies -m 2 -rx 10\no\n",
    "camera main =\n origin 0 -5 2\n target 0 0 1\n up 0 0 1\n fov 40\n film 320 180\n lens .01 5\n shutter 0 .5\nmedium fog =\n sigma_s .1\n\
     sigma_a .01\n phase hg .7\n glow 3\n density height 0 10\nmedium thick = fog\n phase schlick -.2\nmbox fog -1 -1 -1 1 1 1\nmglobal thick\n\
     time 0 2 24\npath drive = spline\n key 0 -t 0 0 0\n key 1 -rz 20 -t 1 0 0\n key 2 -t 4 0 0\nxf -path drive -a 2 -t 0 3 0\nv a =\nsph a 1\n\
     mbox fog 0 0 0 1 1 1\nxf\ncamera main\n along drive\nvary medium.fog.sigma_s = 0 .1 1 .2\nm juice =\n sides 1\n ir 1.3 0\n inside fog\n map_rd x.png\n",
];

const LAMPS: &[&str] = &[
    "IESNA:LM-63-2002\n[TEST] 1\nTILT=NONE\n1 1000 1.5 3 2 1 2 .3 .6 .1\n1 1 60\n0 45 90\n0 90\n100 80 10\n90 70 5\n",
    "IESNA91\nTILT=INCLUDE\n1\n2\n0 90\n1 .8\n2 -1 1 3 3 2 1 -.5 0 0\n.9 .95 100\n-90 0 90\n-90 0 90\n1 2 3 4 5 6\n7 8 9\n",
    "TILT=NONE\n1 1 1 2 4 1 1 -1 -1 -1 1 1 1\n0 180\n0,90,180,270 1 2 3 4 5 6 7 8",
    "[X]\nTILT=bend.tlt\n1 1 1 2 1 3 2 0 0 0 1 1 1 0 90 0 3 4\n",
    "IES:LM-63-2019\n[TEST] 1\n[TESTLAB] 2\nTILT=NONE\n1 -1 1 3 1 1 2 -.2 -.2 0\n1 1.10000 60\n0 45 90\n0\n79.6 79.6 79.6\nEND\n",
    "IESNA:LM-63-1995\nTILT=NONE\n1 1000 1 3 2 1 1 0 .6 -.1\n.95 0.9 60\n0, 45, 90\n0, 180\n100.5, 80.25, 10\n90.5, 70, 5\n",
    "IESNA:LM-63-2002\nTILT=NONE\n1 -1 1,0 3 1 1 2 0 0 0\n1 1 20,5\n0 22,5 90\n0\n1200,5 900,25 0,5\n",
    "IESNA95\n\nTILT=INCLUDE\n3 2 -45 90 1 ,8\n1 900 1 2 2 2 1 -.5 -.1 -.3\n1 1 1\n-90 90\n0 90\n1 2 3 4 5\n",
    "IES:LM-63\nTILT=NONE\n1 1 1 2 1 1 2 0 0 0 1 1.1 1\n90 180\n0\n5 5\n",
];

const WORDS: &[&str] = &[
    "0",
    "1",
    "-1",
    ".5",
    "1e9",
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "100000000",
    "4097",
    "-",
    "=",
    "a",
    "b",
    "warm",
    "fog",
    "drive",
    "main",
    "wall",
    "xf",
    "o",
    "v",
    "c",
    "m",
    "f",
    "fh",
    "sph",
    "cyl",
    "cone",
    "ring",
    "torus",
    "prism",
    "p",
    "n",
    "uv",
    "cxy",
    "cspec",
    "cct",
    "cmix",
    "crgb",
    "sides",
    "rd",
    "td",
    "rs",
    "ts",
    "ir",
    "ed",
    "lobe",
    "inside",
    "i",
    "ies",
    "camera",
    "origin",
    "target",
    "up",
    "fov",
    "film",
    "lens",
    "shutter",
    "along",
    "medium",
    "sigma_s",
    "sigma_a",
    "phase",
    "glow",
    "density",
    "mbox",
    "mglobal",
    "time",
    "path",
    "key",
    "vary",
    "map_rd",
    "-t",
    "-rx",
    "-ry",
    "-rz",
    "-s",
    "-mx",
    "-my",
    "-mz",
    "-i",
    "-a",
    "-path",
    "-m",
    "iso",
    "hg",
    "schlick",
    "rayleigh",
    "uniform",
    "height",
    "vdb",
    "linear",
    "spline",
    "part.mgf",
    "\"part.mgf\"",
    "\"",
    "undefined",
    "lost.mgf",
    "map_n",
    "t.mgf",
    "lamp.ies",
    "../x",
    "/x",
    "\\",
    "#",
    "TILT=NONE",
    "TILT=INCLUDE",
    "IESNA91",
    "IES:LM-63-2019",
    "[TEST]",
    "END",
    "1.1",
    "0,5",
    ",5",
    ",",
    "\u{feff}",
    "\n",
    "\r",
    "\0",
    "\x1a",
];

/// Encodes a text with some encoding and some line ends; most texts stay unchanged.
fn encode(rng: &mut Rng, bytes: Vec<u8>) -> Vec<u8> {
    let how = rng.below(72);
    let Some(line_end) = ["\n", "\r", "\r\n"].get(how / 6) else { return bytes };
    let text = String::from_utf8_lossy(&bytes).replace('\n', line_end);
    let wide = |text: &str, bytes: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(bytes).collect();
    let marked = format!("\u{feff}{text}");
    match how % 6 {
        0 => wide(&marked, u16::to_le_bytes),
        1 => wide(&marked, u16::to_be_bytes),
        2 => wide(&text, u16::to_le_bytes),
        3 => wide(&text, u16::to_be_bytes),
        4 => marked.into_bytes(),
        _ => text.into_bytes(),
    }
}

/// Returns a mutated scene `t.mgf` with the files that it names.
pub fn mutate(rng: &mut Rng) -> BTreeMap<String, Vec<u8>> {
    let mut scene = rng.pick(SCENES).as_bytes().to_vec();
    if rng.below(4) == 0 {
        scene = random_words(rng).into_bytes();
    }
    let mut lamp = rng.pick(LAMPS).as_bytes().to_vec();
    for _ in 0..rng.below(6) {
        let text = if rng.below(3) == 0 { &mut lamp } else { &mut scene };
        mutate_text(rng, text);
    }
    match rng.below(6) {
        // Nothing before the photometry can fail.
        0 | 1 => scene = b"ies lamp.ies\n".to_vec(),
        // Nothing before the images can fail.
        2 | 3 => scene = b"map_rd x.png\nmap_n \"x.png\"\nmap_ed x.png\nv a =\nsph a 1\n".to_vec(),
        _ => {}
    }
    let mut bend = b"1 2 0 90 1 .5".to_vec();
    if rng.below(8) == 0 {
        mutate_text(rng, &mut bend);
    }
    let mut encoded = [scene, lamp, bend].map(|text| encode(rng, text));
    if rng.below(8) == 0 {
        let which = rng.below(3);
        mutate_text(rng, &mut encoded[which]);
    }
    let [scene, lamp, bend] = encoded;
    BTreeMap::from([
        ("t.mgf".into(), scene),
        ("part.mgf".into(), SCENES[0].as_bytes().to_vec()),
        ("lamp.ies".into(), lamp),
        ("bend.tlt".into(), bend),
        ("x.png".into(), images::image(rng)),
    ])
}

/// Returns lines of random words.
pub fn random_words(rng: &mut Rng) -> String {
    let mut text = String::from("v a =\nv b =\np 1 0 0\nn 0 0 1\nc warm =\nmedium fog =\npath drive = linear\nkey 0\n");
    for _ in 0..rng.below(30) {
        for _ in 0..1 + rng.below(8) {
            let word: &&str = rng.pick(WORDS);
            text.push_str(word);
            text.push(' ');
        }
        text.push('\n');
    }
    text
}

fn mutate_text(rng: &mut Rng, text: &mut Vec<u8>) {
    let at = rng.below(text.len());
    match rng.below(7) {
        0 if !text.is_empty() => text[at] ^= 1 << rng.below(8),
        1 => text.truncate(at),
        2 => {
            let end = (at + rng.below(20)).min(text.len());
            text.drain(at..end);
        }
        3 => {
            let end = (at + rng.below(60)).min(text.len());
            let piece = text[at..end].to_vec();
            let to = rng.below(text.len());
            text.splice(to..to, piece);
        }
        4 => {
            let word = rng.pick(WORDS).as_bytes().to_vec();
            let spaced = [b" ", &word[..], b" "].concat();
            text.splice(at..at, spaced);
        }
        5 => swap_field(rng, text),
        _ => {
            let byte = rng.next() as u8;
            text.insert(at, byte);
        }
    }
}

/// Replaces a random field by a word.
fn swap_field(rng: &mut Rng, text: &mut Vec<u8>) {
    let starts: Vec<usize> =
        (1..text.len()).filter(|&i| text[i - 1].is_ascii_whitespace() && !text[i].is_ascii_whitespace()).collect();
    if starts.is_empty() {
        return;
    }
    let start = *rng.pick(&starts);
    let end = text[start..].iter().position(u8::is_ascii_whitespace).map_or(text.len(), |n| start + n);
    let word = rng.pick(WORDS).as_bytes().to_vec();
    text.splice(start..end, word);
}
