//! Tests of broken scenes: each gives one error that names file, line and column, and the fault.

use crate::common::try_files;

/// Name of the case; the scene `t.mgf`; position of the error; a part of its message.
pub const TABLE: &[(&str, &str, &str, &str)] = &[
    // Numbers and arguments.
    ("word for a number", "v a =\np 1 two 3", "t.mgf:2:5", "`two` is not a number"),
    ("infinite coordinate", "v a =\np 1 inf 3", "t.mgf:2:5", "coordinate (m) is not finite"),
    ("NaN", "v a =\np nan 0 0", "t.mgf:2:3", "not finite"),
    ("overflow", "v a =\np 1 1e999 3", "t.mgf:2:5", "not finite"),
    ("hexadecimal number", "v a =\np 0x10 0 0", "t.mgf:2:3", "`0x10` is not a number"),
    ("rubbish after a number", "v a =\np 1,5 0 0", "t.mgf:2:3", "`1,5` is not a number"),
    ("two coordinates", "v a =\np 1 2", "t.mgf:2:1", "`p` takes x y z, found 2"),
    ("four coordinates", "v a =\np 1 2 3 4", "t.mgf:2:1", "found 4"),
    ("fault in a joined line", "v a =\np 1 \\\n  \\\n  x 3", "t.mgf:4:3", "`x` is not a number"),
    ("context without =", "v a b", "t.mgf:1:5", "expected `=`"),
    ("context with too much", "m a = b c", "t.mgf:1:1", "found 4"),
    // Names.
    (
        "undefined vertex",
        "v v1 =\nv v2 =\nf v1 v2 vv1",
        "t.mgf:3:9",
        "undefined vertex `vv1`; define it before this line (`v vv1 =` and `p x y z`), or use a similar name: `v1`, `v2`",
    ),
    ("vertex without any", "sph a 1", "t.mgf:1:5", "define it before this line: `v a =` and `p x y z`"),
    ("undefined template", "v a = b", "t.mgf:1:7", "undefined vertex `b`"),
    ("undefined color", "c red", "t.mgf:1:3", "undefined color `red`"),
    ("undefined material", "m wood =\nm woood", "t.mgf:2:3", "similar name: `wood`"),
    ("undefined camera template", "camera a = b", "t.mgf:1:12", "undefined camera `b`"),
    ("undefined medium in mglobal", "mglobal fog", "t.mgf:1:9", "undefined medium `fog`"),
    ("undefined medium in mbox", "mbox fog 0 0 0 1 1 1", "t.mgf:1:6", "undefined medium `fog`"),
    ("undefined medium inside", "m a =\ninside fog", "t.mgf:2:8", "undefined medium `fog`"),
    ("undefined path", "xf -path drive", "t.mgf:1:10", "undefined path `drive`"),
    ("undefined camera path", "camera c =\nalong drive", "t.mgf:2:7", "undefined path `drive`"),
    ("undefined color in a mixture", "c a =\ncmix 1 a 1 b", "t.mgf:2:12", "undefined color `b`"),
    // Colors.
    ("negative chromaticity", "cxy .3 -.1", "t.mgf:1:8", "y is -0.1; it must be in [0, 1]"),
    ("chromaticity outside the diagram", "cxy .7 .6", "t.mgf:1:5", "x + y is 1.2999"),
    ("spectrum without a positive value", "cspec 400 700 -1 0 -1", "t.mgf:1:1", "no visible light"),
    ("spectrum backwards", "cspec 700 400 1 1", "t.mgf:1:11", "greater than the first wavelength"),
    ("spectrum of one value", "cspec 400 700 1", "t.mgf:1:1", "at least two values"),
    ("invisible spectrum", "cspec 900 1000 1 1", "t.mgf:1:1", "no visible light"),
    ("cold black body", "cct 0", "t.mgf:1:5", "temperature (K) is 0"),
    ("mixture of halves of pairs", "c a =\ncmix 1 a 2", "t.mgf:2:1", "pairs of weight"),
    ("weightless mixture", "c a =\ncmix 0 a", "t.mgf:2:6", "sum of the weights is 0"),
    ("mixture with black", "c a =\ncrgb 0 0 0\ncmix 1 a", "t.mgf:3:8", "black color"),
    ("negative raw color", "crgb 1 -1 1", "t.mgf:1:8", "color component is -1"),
    // Materials.
    ("three sides", "sides 3", "t.mgf:1:7", "number of sides is 3; it must be 1 or 2"),
    ("reflectance above one", "rd 1.5", "t.mgf:1:4", "it must be in [0, 1]"),
    ("negative reflectance", "rd -.5", "t.mgf:1:4", "it must be in [0, 1]"),
    ("roughness missing", "rs .5", "t.mgf:1:1", "a fraction and a roughness"),
    ("roughness above one", "rs .5 2", "t.mgf:1:7", "roughness is 2"),
    ("negative emittance", "ed -1", "t.mgf:1:4", "emittance (lm/m2) is -1"),
    ("index of refraction 0", "ir 0 0", "t.mgf:1:4", "real index of refraction is 0"),
    ("index of refraction without its imaginary part", "ir 1.5", "t.mgf:1:1", "imaginary part"),
    ("negative lobe", "lobe -1", "t.mgf:1:6", "exponent of the lobe is -1"),
    ("texture that is not there", "map_rd wood.png", "t.mgf:1:8", "cannot read `wood.png`"),
    ("texture that is none", "map_rd part.mgf", "t.mgf:1:8", "not a PNG, JPEG or EXR image"),
    // Surfaces.
    ("face of two vertices", "v a =\nf a a", "t.mgf:2:1", "at least three vertices"),
    ("hole of two vertices", "v a =\nfh a a a - a a", "t.mgf:2:1", "fewer than three vertices"),
    ("hole at the end", "v a =\nfh a a a -", "t.mgf:2:1", "fewer than three vertices"),
    ("sphere of radius 0", "v a =\nsph a 0", "t.mgf:2:7", "radius (m) is 0"),
    ("cylinder of no length", "v a =\ncyl a 1 a", "t.mgf:2:1", "both ends are at one point"),
    ("cone of two signs", "v a =\nv b =\np 1 0 0\ncone a 1 b -1", "t.mgf:4:12", "of the same sign"),
    ("cone of two points", "v a =\nv b =\np 1 0 0\ncone a 0 b 0", "t.mgf:4:8", "nonzero at one or both ends"),
    ("ring inside out", "v a =\nn 0 0 1\nring a 2 1", "t.mgf:3:10", "> the inner radius"),
    ("ring without a normal", "v a =\nring a 1 2", "t.mgf:2:6", "no normal"),
    ("torus inside out", "v a =\nn 0 0 1\ntorus a 2 1", "t.mgf:3:11", "farther from 0"),
    ("torus of two signs", "v a =\nn 0 0 1\ntorus a -1 1", "t.mgf:3:12", "farther from 0"),
    ("prism without length", "v a =\nprism a a a 0", "t.mgf:2:13", "length (m) is 0"),
    ("prism without a base", "v a =\nprism a a a 1", "t.mgf:2:1", "no area"),
    // Transforms and objects.
    ("xf closed too often", "xf\n", "t.mgf:1:1", "`xf` closes nothing"),
    ("object closed too often", "o a\no\no\n", "t.mgf:3:1", "`o` closes nothing"),
    (
        "include closes the includer's transform",
        "xf -t 1 0 0\ni closes.mgf\nxf",
        "closes.mgf:1:1",
        "`xf` closes nothing",
    ),
    ("unknown transform", "xf -t 1 0 0 -ty 3", "t.mgf:1:13", "found `-ty`; expected -t x y z"),
    ("translation of two numbers", "xf -t 1 0", "t.mgf:1:4", "`-t` takes three numbers, found 2"),
    ("scale 0", "xf -s 0", "t.mgf:1:7", "scale factor is 0"),
    ("no copies", "xf -a 0 -t 1 0 0", "t.mgf:1:7", "number of copies is 0"),
    ("half a copy", "xf -a 1.5 -t 1 0 0", "t.mgf:1:7", "a whole number"),
    ("too many copies", "xf -a 1e9 -t 1 0 0", "t.mgf:1:7", "[1, 1e8]"),
    (
        "product of arrays",
        "v a =\nxf -a 100000 -t 1 0 0 -a 100000 -t 0 1 0\nsph a 1\nxf",
        "t.mgf:2:1",
        "10000000000 primitives",
    ),
    ("repeated beyond all bounds", "xf -i 100000 -s 2", "t.mgf:1:1", "transform is not finite"),
    ("transforms beyond all bounds", "xf -s 1e90\nxf -s 1e90", "t.mgf:2:1", "not finite"),
    ("coordinates beyond all bounds", "v a =\np 1e300 0 0\nxf -s 1e100\nsph a 1\nxf", "t.mgf:4:1", "not finite"),
    // Files.
    ("include that is not there", "\ni lost.mgf", "t.mgf:2:3", "cannot read `lost.mgf`"),
    ("absolute include", "i /etc/passwd", "t.mgf:1:3", "absolute path"),
    ("include out of the root", "i ../x.mgf", "t.mgf:1:3", "leaves the scene's root folder"),
    ("include with backslashes", "i parts\\x.mgf", "t.mgf:1:3", "backslash"),
    ("file that includes itself", "# one\ni t.mgf", "t.mgf:2:3", "t.mgf > t.mgf"),
    ("fault in an included file", "i part.mgf", "part.mgf:2:3", "`x` is not a number"),
    ("photometry that is not there", "ies lost.ies", "t.mgf:1:5", "cannot read `lost.ies`"),
    ("photometry cut short", "ies short.ies", "short.ies:3:1", "the file ends before the intensity"),
    ("photometry that is none", "ies part.mgf", "part.mgf:2", "no TILT= line"),
    ("multiplier missing", "ies lamp.ies -m", "t.mgf:1:14", "`-m` takes one number"),
    // Cameras, media, time.
    ("field without a camera", "fov 40", "t.mgf:1:1", "`fov` outside a camera context"),
    ("camera without a name", "camera", "t.mgf:1:1", "`camera` takes NAME"),
    ("field of view of 180 degrees", "camera c =\nfov 180", "t.mgf:2:5", "in (0, 180)"),
    ("film without pixels", "camera c =\nfilm 0 10", "t.mgf:2:6", "film size (pixels) is 0"),
    ("film of half pixels", "camera c =\nfilm 10.5 10", "t.mgf:2:6", "a whole number"),
    ("film too large", "camera c =\nfilm 40000 10", "t.mgf:2:6", "[1, 32768]"),
    ("film of too many pixels", "camera c =\nfilm 32768 32768", "t.mgf:2:1", "too many pixels of film"),
    ("camera that looks nowhere", "v a =\ncamera c =\norigin 1 1 1\ntarget 1 1 1", "t.mgf:2:1", "no view direction"),
    ("camera with parallel up", "camera c =\ntarget 0 0 5", "t.mgf:1:1", "`up` is parallel"),
    ("camera without up", "camera c =\nup 0 0 0", "t.mgf:2:1", "no direction"),
    ("negative lens", "camera c =\nlens -1 2", "t.mgf:2:6", "lens radius (m) is -1"),
    ("lens without focus", "camera c =\nlens 1 0", "t.mgf:2:8", "focus distance (m) is 0"),
    ("shutter backwards", "camera c =\nshutter .5 .2", "t.mgf:2:12", "at or after the opening"),
    ("shutter beyond the frame", "camera c =\nshutter 0 2", "t.mgf:2:11", "in [0, 1]"),
    ("field without a medium", "sigma_s 1", "t.mgf:1:1", "`sigma_s` outside a medium context"),
    ("negative scattering", "medium a =\nsigma_s -1", "t.mgf:2:9", "scattering coefficient (1/m) is -1"),
    ("unknown phase function", "medium a =\nphase mie", "t.mgf:2:7", "found `mie`"),
    ("phase function without its parameter", "medium a =\nphase hg", "t.mgf:2:1", "its parameter"),
    ("phase parameter 1", "medium a =\nphase hg 1", "t.mgf:2:10", "in (-1, 1)"),
    ("flat fog", "medium a =\ndensity height 0 0", "t.mgf:2:18", "scale height (m) is 0"),
    ("grid medium", "medium a =\ndensity vdb smoke.vdb", "t.mgf:2:9", "not supported yet"),
    ("unknown density", "medium a =\ndensity thick", "t.mgf:2:9", "found `thick`"),
    ("box without volume", "medium a =\nmbox a 0 0 0 1 1 0", "t.mgf:2:1", "no volume"),
    (
        "box on a path",
        "path p = linear\nkey 0\nmedium a =\nxf -path p\nmbox a 0 0 0 1 1 1\nxf",
        "t.mgf:5:1",
        "moves along a path",
    ),
    ("clip backwards", "time 5 1 24", "t.mgf:1:8", "at or after the start"),
    ("no frames a second", "time 0 1 0", "t.mgf:1:10", "frames per second is 0"),
    ("too many frames", "time 0 1e9 24", "t.mgf:1:1", "too many frames"),
    ("unknown interpolation", "path p = cubic", "t.mgf:1:10", "found `cubic`"),
    ("path twice", "path p = linear\nkey 0\npath p = linear", "t.mgf:3:6", "already defined at line 1"),
    ("path without keys", "path p = linear", "t.mgf:1:1", "no keys"),
    ("key without a path", "key 0", "t.mgf:1:1", "`key` outside a path context"),
    ("keys out of order", "path p = linear\nkey 1\nkey 1", "t.mgf:3:5", "time 1 is not later than 1"),
    ("key with an array", "path p = linear\nkey 1 -a 2 -t 1 0 0", "t.mgf:2:1", "a key holds a single pose"),
    ("key with a mirror", "path p = linear\nkey 1 -mx", "t.mgf:2:1", "cannot mirror"),
    ("vary without =", "vary a.b.c 0 1 2 3", "t.mgf:1:12", "expected `=`"),
    ("vary with half a pair", "vary a.b.c = 0 1 2", "t.mgf:1:1", "pairs of time and value"),
    ("vary out of order", "vary a.b.c = 1 1 0 1", "t.mgf:1:18", "time 0 is not later than 1"),
];

#[test]
fn each_broken_scene_gives_its_error() {
    let mut wrong = Vec::new();
    for (what, text, at, says) in TABLE {
        let files = [
            ("t.mgf", *text),
            ("closes.mgf", "xf\n"),
            ("part.mgf", "v a =\np x 0 0\n"),
            ("lamp.ies", "TILT=NONE\n1 1 1 2 1 1 1 0 0 0 1 1 1 0 90 0 5 5\n"),
            ("short.ies", "TILT=NONE\n1 1 1 2 1 1 1 0 0 0 1 1 1 0 90 0 5\n"),
        ];
        match try_files(&files) {
            Ok(_) => wrong.push(format!("{what}: no error")),
            Err(error) => {
                let shown = error.to_string();
                if error.at.to_string() != *at || !shown.starts_with(&format!("{at}: ")) || !shown.contains(says) {
                    wrong.push(format!("{what}: expected {at} and `{says}`, got\n    {shown}"));
                }
                assert!(!shown.contains('\n'), "one line: {shown}");
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn the_missing_scene_itself_is_an_error_without_a_line() {
    let error = femc_import::load_scene_file(std::path::Path::new("no/such/scene.mgf")).unwrap_err();
    assert!(error.to_string().starts_with("scene.mgf: cannot read"), "{error}");
}

#[test]
fn includes_are_limited_in_depth_and_circles_are_found() {
    let chain = |n: usize| -> Vec<(String, String)> {
        let file = |k: usize| format!("f{k}.mgf");
        (0..n).map(|k| (file(k), if k + 1 < n { format!("i {}\n", file(k + 1)) } else { String::new() })).collect()
    };
    let load = |files: &[(String, String)]| {
        try_files(&files.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect::<Vec<_>>())
    };
    assert!(load(&chain(65)).is_ok(), "64 levels below the scene");
    let error = load(&chain(66)).unwrap_err();
    assert_eq!(error.at.to_string(), "f64.mgf:1:3");
    assert!(error.to_string().contains("deeper than 64 levels"), "{error}");
    let mut circle = chain(5);
    circle[4].1 = "# back\ni f2.mgf\n".into();
    let error = load(&circle).unwrap_err();
    assert_eq!(error.at.to_string(), "f4.mgf:2:3");
    assert!(error.to_string().contains("f2.mgf > f3.mgf > f4.mgf > f2.mgf"), "{error}");
}

#[test]
fn doubling_includes_are_stopped_by_the_included_file_limit() {
    let files: Vec<(String, String)> = (0..40)
        .map(|k| (format!("f{k}.mgf"), format!("i f{0}.mgf\ni f{0}.mgf\n", k + 1)))
        .chain([("f40.mgf".into(), String::new())])
        .collect();
    let error = try_files(&files.iter().map(|(n, t)| (n.as_str(), t.as_str())).collect::<Vec<_>>()).unwrap_err();
    assert!(error.to_string().contains("the includes add up to more than 1000000 files"), "{error}");
}

/// Files that claim a huge size, and fail the test if they are read.
struct HugeFile;

impl femc_import::FileSource for HugeFile {
    fn size(&self, _: &str) -> std::io::Result<u64> {
        Ok(300 << 20)
    }
    fn read(&self, path: &str) -> std::io::Result<Vec<u8>> {
        panic!("{path} was read in spite of its size")
    }
}

#[test]
fn a_file_beyond_the_limit_is_refused_before_it_is_read() {
    let error = femc_import::load_scene(&HugeFile, "t.mgf").unwrap_err();
    assert!(error.to_string().contains("has 314572800 bytes; the limit for text files is 268435456"), "{error}");
}

#[test]
fn a_line_beyond_the_limit_is_refused() {
    let error = try_files(&[("t.mgf", &format!("v a =\nf{}\n", " a".repeat(2048)))]).unwrap_err();
    assert_eq!(error.at.to_string(), "t.mgf:2");
    assert!(error.to_string().contains("more than 4096 characters"), "{error}");
}
