//! Results that a farm makes of several frames or tasks, computed once more from the finished files by other code.
//!
//! Two farms that agree may both be wrong. So the formulas here come from the documentation, and share no code with the farm.

use crate::common::{FOG, Film, TestFolder, TestProcess, file_names, film, start_coordinator, status};
use femc_film::Picture;
use femc_pipeline::paths::{LightStatistics, PathEnd};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Frames of a clip. The last is forty times as bright as the first, and colored light shows a mix-up of
/// channels.
const FRAMES: u32 = 5;

/// Creates a folder with `clip.mgf`, a scene whose brightness and colors change from frame to frame.
fn clip_folder() -> TestFolder {
    let dir = TestFolder::new();
    let scene = FOG
        .replacen("vary medium.fog.sigma_s = 0 0.02 1 0.3", "vary material.lamp.ed = 0 30 1 3000", 1)
        .replacen("time 0 0.75 10", "time 0 0.4 10", 1)
        .replacen("m wall =\n", "m red =\n\tsides 2\n\tc\n\t\tcxy 0.5 0.35\n\trd 0.6\nm wall =\n", 1)
        .replacen("f h g f e\n", "f h g f e\nm red\n", 1);
    dir.write("clip.mgf", &scene);
    dir
}

fn start_workers(dir: &TestFolder, url: &str, count: u32) -> Vec<TestProcess> {
    (0..count).map(|_| dir.start(&format!("worker --join {url} --threads 1"))).collect()
}

/// Renders a job on a farm of two workers, and fetches its results into the folder `out`.
fn render_on_farm(dir: &TestFolder, settings: &str) {
    let (_farm, url) = start_coordinator(dir, 0);
    let _workers = start_workers(dir, &url, 2);
    let job = dir.run(&format!("submit clip.mgf {settings} --server {url}")).exits(0).stdout();
    let job = job.lines().last().expect("a job");
    dir.run(&format!("fetch {job} --wait -o out --server {url}")).exits(0);
}

fn picture(path: &Path) -> Picture {
    Picture::from_png(&std::fs::read(path).expect("a file")).expect("a PNG")
}

/// Returns the luminance of a color with the primaries and the white point of Rec.709.
fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.212639 * r + 0.715169 * g + 0.072192 * b
}

fn color(film: &Film, x: u32, y: u32) -> [f64; 3] {
    let at = 3 * (y * film.width + x) as usize;
    [0, 1, 2].map(|channel| f64::from(film.rgb[at + channel]))
}

/// Returns the mean luminance of the pixels from column `x0` to `x1` and from row `y0` to `y1`, without the last ones.
fn mean_luminance(film: &Film, [x0, y0, x1, y1]: [u32; 4]) -> f64 {
    let pixels = (y0..y1).flat_map(|y| (x0..x1).map(move |x| [x, y]));
    let (sum, count) = pixels.fold((0.0, 0.0), |(sum, n), [x, y]| (sum + luminance(color(film, x, y)), n + 1.0));
    sum / count
}

/// Returns the exposure that maps the log-average luminance to 0.18. Black values do not count, and values below 1e-4 of the mean
/// count as 1e-4 of it.
fn auto_exposure(luminances: &[f64]) -> f64 {
    let lit: Vec<f64> = luminances.iter().copied().filter(|y| *y > 0.0).collect();
    let mean = lit.iter().sum::<f64>() / lit.len() as f64;
    let logs = lit.iter().map(|y| y.max(1e-4 * mean).ln()).sum::<f64>();
    0.18 / (logs / lit.len() as f64).exp()
}

/// Returns the mean luminances of the blocks of 8 x 8 pixels of a film.
fn block_luminances(film: &Film) -> Vec<f64> {
    let starts = |size: u32| (0..size).step_by(8);
    let blocks = starts(film.height).flat_map(|y| starts(film.width).map(move |x| [x, y]));
    blocks.map(|[x, y]| mean_luminance(film, [x, y, (x + 8).min(film.width), (y + 8).min(film.height)])).collect()
}

/// Returns the values 0 to 255, not rounded, with which a color is shown under an exposure.
fn shown(exposure: f64, color: [f64; 3]) -> [f64; 3] {
    let x = exposure * luminance(color);
    let gain = exposure * (1.0 + x / 64.0) / (1.0 + x);
    color.map(|channel| {
        let linear = (channel * gain).min(1.0);
        255.0 * if linear <= 0.0031308 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
    })
}

/// Returns the least and the greatest exposure under which every color of a film is shown as in the picture.
fn exposures(film: &Film, picture: &Picture) -> [f64; 2] {
    let mut bounds = [0.0f64, f64::INFINITY];
    for (at, bytes) in picture.pixels.iter().enumerate() {
        let color = color(film, at as u32 % film.width, at as u32 / film.width);
        for channel in 0..3 {
            // The exposure at which the channel is shown with a value. The value grows with the exposure.
            let exposure_of = |value: f64| {
                let (mut low, mut high) = (-30.0f64, 30.0f64);
                for _ in 0..80 {
                    let middle = 0.5 * (low + high);
                    if shown(middle.exp(), color)[channel] < value { low = middle } else { high = middle }
                }
                low.exp()
            };
            let byte = f64::from(bytes[channel]);
            if color[channel] > 0.0 && bytes[channel] > 0 {
                bounds[0] = bounds[0].max(exposure_of(byte - 0.51));
            }
            if color[channel] > 0.0 && bytes[channel] < 255 {
                bounds[1] = bounds[1].min(exposure_of(byte + 0.51));
            }
        }
    }
    bounds
}

/// Returns the frames of an animated PNG in order, each as a picture.
fn animation_frames(bytes: &[u8]) -> Vec<Picture> {
    let crc = |data: &[u8]| {
        !data.iter().fold(!0u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 })
        })
    };
    let (signature, mut rest) = bytes.split_at(8);
    let (mut header, mut frames) = (Vec::new(), Vec::<Vec<u8>>::new());
    while !rest.is_empty() {
        let length = u32::from_be_bytes(rest[..4].try_into().expect("a length")) as usize;
        let (kind, data) = (&rest[4..8], &rest[8..8 + length]);
        match kind {
            b"IHDR" => header = data.to_vec(),
            b"fcTL" => frames.push(Vec::new()),
            b"IDAT" => frames.last_mut().expect("a frame").extend(data),
            // A sequence number comes first.
            b"fdAT" => frames.last_mut().expect("a frame").extend(&data[4..]),
            _ => {}
        }
        rest = &rest[12 + length..];
    }
    let chunk = |kind: &[u8], data: &[u8]| {
        let named = [kind, data].concat();
        [&(data.len() as u32).to_be_bytes()[..], &named, &crc(&named).to_be_bytes()].concat()
    };
    let file = |data: &Vec<u8>| {
        [signature.to_vec(), chunk(b"IHDR", &header), chunk(b"IDAT", data), chunk(b"IEND", b"")].concat()
    };
    frames.iter().map(|data| Picture::from_png(&file(data)).expect("a frame")).collect()
}

#[test]
fn a_clip_has_the_exposure_that_its_images_give() {
    let dir = clip_folder();
    // The film is wider than a picture of the contact sheet, and its size is no multiple of a block.
    render_on_farm(
        &dir,
        &format!("--frames 1..{FRAMES} --size 330x20 --spp 4 --preview --video clip.png --contact-sheet sheet.png"),
    );
    let name = |frame: u32, kind: &str| dir.path(&format!("out/clip.{frame:04}.{kind}"));
    let films: Vec<Film> = (1..=FRAMES).map(|frame| film(&name(frame, "exr"))).collect();
    let stills: Vec<Picture> = (1..=FRAMES).map(|frame| picture(&name(frame, "png"))).collect();
    let means: Vec<f64> = films.iter().map(|film| mean_luminance(film, [0, 0, film.width, film.height])).collect();
    assert!(means[4] > 20.0 * means[0], "the clip gets brighter: {means:?}");
    let bounds = films.iter().zip(&stills).map(|(film, still)| exposures(film, still));
    let [low, high] = bounds.fold([0.0, f64::INFINITY], |all: [f64; 2], one| [all[0].max(one[0]), all[1].min(one[1])]);
    let expected = auto_exposure(&films.iter().flat_map(block_luminances).collect::<Vec<_>>());
    println!("exposure {low} to {high}, expected {expected}");
    assert!(low <= high && high / low < 1.01, "the frames have no common exposure: {low} to {high}");
    // The farm counts blocks in bins of a 16th of an octave.
    let half_bin = 2f64.powf(1.0 / 32.0);
    assert!(expected * half_bin >= low && expected / half_bin <= high, "{low} to {high}, expected {expected}");
    assert!(animation_frames(&std::fs::read(dir.path("out/clip.png")).expect("a clip")) == stills, "clip and stills");
    check_sheet(&picture(&dir.path("out/sheet.png")), &stills);
}

/// Checks that a contact sheet shows pictures, halved, in three columns with gaps of 4 pixels.
fn check_sheet(sheet: &Picture, pictures: &[Picture]) {
    let [width, height] = [165, 10];
    assert_eq!([sheet.width, sheet.height], [4 + 3 * (width + 4), 4 + 2 * (height + 4)]);
    let paper = [24; 3];
    for (at, pixel) in (0..).zip(&sheet.pixels) {
        let [x, y] = [at % sheet.width, at / sheet.width];
        let place = |at: u32, edge: u32| at.checked_sub(4).map(|at| [at / (edge + 4), at % (edge + 4)]);
        let cell = place(x, width).zip(place(y, height)).filter(|([_, u], [_, v])| *u < width && *v < height);
        let picture =
            cell.and_then(|([column, u], [row, v])| Some((pictures.get((3 * row + column) as usize)?, [2 * u, 2 * v])));
        let Some((picture, [u, v])) = picture else {
            assert_eq!(*pixel, paper, "column {x}, row {y}");
            continue;
        };
        let value = |channel: usize| {
            let block = [[u, v], [u + 1, v], [u, v + 1], [u + 1, v + 1]];
            let sum: u32 =
                block.iter().map(|[x, y]| u32::from(picture.pixels[(y * picture.width + x) as usize][channel])).sum();
            (sum + 2) / 4
        };
        assert_eq!(pixel.map(u32::from), [0, 1, 2].map(value), "column {x}, row {y}");
    }
}

/// Reads a table. Returns its columns by name.
fn table(path: &Path) -> BTreeMap<String, Vec<String>> {
    let text = std::fs::read_to_string(path).expect("a table");
    // The names of variants have commas, so they are in quotation marks.
    let cells = |line: &str| {
        let (mut cells, mut is_quoted) = (vec![String::new()], false);
        for c in line.chars() {
            match c {
                '"' => is_quoted = !is_quoted,
                ',' if !is_quoted => cells.push(String::new()),
                c => cells.last_mut().expect("a cell").push(c),
            }
        }
        cells
    };
    let mut lines = text.lines().map(cells);
    let mut columns: Vec<(String, Vec<String>)> =
        lines.next().expect("names").into_iter().map(|name| (name, Vec::new())).collect();
    for line in lines {
        assert_eq!(line.len(), columns.len(), "{text}");
        columns.iter_mut().zip(line).for_each(|((_, column), cell)| column.push(cell));
    }
    columns.into_iter().collect()
}

fn assert_close(found: &str, expected: f64, place: &str) {
    let value: f64 = found.parse().unwrap_or_else(|error| panic!("{place}: `{found}`: {error}"));
    assert!((value - expected).abs() <= 1e-5 * expected.abs(), "{place}: {value}, expected {expected}");
}

#[test]
fn tables_of_a_sweep_follow_from_its_images() {
    let dir = clip_folder();
    let regions = [("left", [0, 2, 9, 11]), ("right", [11, 3, 24, 14])];
    let listed: String = regions.iter().map(|(name, bounds)| format!("{name} = {bounds:?}\n")).collect();
    dir.write(
        "job.toml",
        &format!(
            "scene = \"clip.mgf\"\nframes = \"1..4\"\nsize = \"24x16\"\nspp = 4\n[sweep]\n\
             \"medium.fog.sigma_s\" = [0.05, 0.2]\n\"material.red.rd\" = [0.1, 0.6, 0.9]\n\
             [regions]\n{listed}[contrasts]\nseen = [\"left\", \"right\"]\nagain = [\"right\", \"left\"]\n"
        ),
    );
    dir.run("sweep job.toml -o out --local").exits(0);
    let [frames, variants] = ["frames", "variants"].map(|name| table(&dir.path(&format!("out/{name}.csv"))));
    let films: Vec<Film> = frames["file"].iter().map(|file| film(&dir.path("out").join(file))).collect();
    assert_eq!((films.len(), variants["variant"].len()), (24, 6));
    let whole = [0, 0, 24, 16];
    let weber = |target: f64, background: f64| (target - background) / background;
    let measures = |film: &Film| {
        let [left, right] = regions.map(|(_, bounds)| mean_luminance(film, bounds));
        [mean_luminance(film, whole), left, right, weber(left, right), weber(right, left)]
    };
    let columns = ["mean_luminance", "luminance.left", "luminance.right", "contrast.seen", "contrast.again"];
    let mut means = BTreeMap::<&str, Vec<[f64; 5]>>::new();
    for (row, film) in films.iter().enumerate() {
        let expected = measures(film);
        let (variant, frame) = (&frames["variant"][row], &frames["frame"][row]);
        for (column, expected) in columns.iter().zip(expected) {
            assert_close(&frames[*column][row], expected, &format!("{variant}, frame {frame}: {column}"));
        }
        let values = ["medium.fog.sigma_s", "material.red.rd"].map(|axis| frames[axis][row].as_str());
        assert_eq!(*variant, format!("sigma_s={},rd={}", values[0], values[1]));
        assert_eq!(frames["file"][row], format!("{variant}/clip.{:0>4}.exr", frame));
        assert_eq!(frames["spp"][row].parse(), Ok(4.0));
        means.entry(variant).or_default().push(expected);
    }
    for (row, variant) in variants["variant"].iter().enumerate() {
        let own = &means[variant.as_str()];
        assert_eq!((own.len(), variants["frames"][row].as_str()), (4, "4"), "{variant}");
        for (at, column) in columns.iter().enumerate() {
            let mean = own.iter().map(|of_frame| of_frame[at]).sum::<f64>() / own.len() as f64;
            assert_close(&variants[*column][row], mean, &format!("{variant}: {column}"));
        }
        let of_frames = |column: &str| -> Vec<f64> {
            let rows = (0..films.len()).filter(|at| frames["variant"][*at] == *variant);
            rows.map(|at| frames[column][at].parse().expect("a number")).collect()
        };
        let worst = of_frames("relative_error").into_iter().fold(0.0, f64::max);
        assert_close(&variants["relative_error"][row], worst, &format!("{variant}: relative_error"));
        assert_close(&variants["seconds"][row], of_frames("seconds").iter().sum(), &format!("{variant}: seconds"));
    }
    check_sweep_sheet(&picture(&dir.path("out/contact.png")), &films);
}

/// Checks that the contact sheet of a sweep shows its images in order, a row for each variant, under one exposure.
fn check_sweep_sheet(sheet: &Picture, films: &[Film]) {
    let luminances: Vec<f64> = films
        .iter()
        .flat_map(|film| {
            (0..film.width * film.height).map(|at| luminance(color(film, at % film.width, at / film.width)))
        })
        .collect();
    let expected = auto_exposure(&luminances);
    // Gaps of 6 pixels, cells of 96 columns for captions, and lines of text of 18 rows above and below the pictures.
    for (at, film) in (0..).zip(films) {
        let [left, top] = [6 + at % 4 * (96 + 6), 6 + at / 4 * (18 + film.height + 18 + 6) + 18];
        let rows = (top..top + film.height).map(|y| (y * sheet.width + left) as usize);
        let pixels = rows.flat_map(|start| sheet.pixels[start..start + film.width as usize].iter().copied());
        let cell = Picture { width: film.width, height: film.height, pixels: pixels.collect() };
        let [low, high] = exposures(film, &cell);
        assert!(low <= expected && expected <= high, "picture {at}: {low} to {high}, expected {expected}");
    }
}

/// Sums of the samples of a half of a pixel.
#[derive(Clone, Copy, Default)]
struct HalfSums {
    color: [f64; 3],
    depth: u32,
    samples: u32,
}

/// Checks that the union of the tasks' statistics has every sample of the film once, and that all counts and the image itself follow
/// from the recorded samples.
#[test]
fn counts_and_image_of_a_frame_follow_from_its_samples() {
    let dir = clip_folder();
    let [width, height, spp] = [40u32, 24, 4];
    render_on_farm(&dir, &format!("--frames 2..3 --size {width}x{height} --spp {spp} --stats=full"));
    for frame in [2, 3] {
        let name = |kind: &str| dir.path(&format!("out/clip.{frame:04}.{kind}"));
        let all = LightStatistics::decode(&std::fs::read(name("paths")).expect("a file")).expect("statistics");
        let keys: BTreeSet<[u32; 3]> =
            all.paths.values().map(|path| [path.key.frame, path.key.pixel, path.key.sample]).collect();
        let samples = (0..width * height).flat_map(|pixel| (0..spp).map(move |sample| [frame, pixel, sample]));
        assert!(keys == samples.collect() && keys.len() == all.paths.len(), "each sample once");
        let totals = all.totals();
        let count = |end: PathEnd| all.paths.values().filter(|path| path.end == end).count() as u64;
        assert!(PathEnd::ALL.iter().map(|end| count(*end)).eq(totals.ends));
        let film = film(&name("exr"));
        // Even samples are one half of a pixel, odd samples the other.
        let mut halves = vec![[HalfSums::default(); 2]; (width * height) as usize];
        for path in all.paths.values() {
            let half = &mut halves[path.key.pixel as usize][path.key.sample as usize % 2];
            (0..3).for_each(|channel| half.color[channel] += f64::from(path.radiance[channel]));
            half.depth += path.depth;
            half.samples += 1;
        }
        let columns = width.div_ceil(all.scope.tile_size);
        let mut pixels = 0;
        for (portion, counters) in &all.portions {
            let [left, top] = [portion.tile % columns, portion.tile / columns].map(|at| at * all.scope.tile_size);
            let tile_width = all.scope.tile_size.min(width - left);
            for (at, pixel) in (0..).zip(&counters.pixels) {
                let (x, y) = (left + at % tile_width, top + at / tile_width);
                let half = halves[(y * width + x) as usize][usize::from(portion.half)];
                assert_eq!((pixel.samples, pixel.depth), (half.samples, half.depth), "column {x}, row {y}");
                let (found, expected) = (pixel.luminance as f64 / 65536.0, luminance(half.color));
                assert!((found - expected).abs() <= 1e-4 * (1.0 + expected), "column {x}, row {y}: {found} {expected}");
                pixels += 1;
            }
        }
        assert_eq!(pixels, 2 * width * height, "each half of each pixel once");
        for (at, [even, odd]) in halves.iter().enumerate() {
            let pixel = color(&film, at as u32 % width, at as u32 / width);
            for channel in 0..3 {
                let mean = (even.color[channel] + odd.color[channel]) / f64::from(spp);
                let error = (pixel[channel] - mean).abs();
                assert!(error <= 1e-5 * mean, "pixel {at} of frame {frame}: {pixel:?}, samples {mean}");
            }
        }
    }
    // The union of both frames has the rows of each.
    let rows = |line: &str| -> BTreeMap<String, u64> {
        let rows = dir.run(&format!("paths {line} --table histograms --json")).exits(0).json();
        let mut counts = BTreeMap::new();
        for row in rows.as_array().expect("rows") {
            let key = ["table", "attribute", "from", "to"].map(|key| row[key].to_string()).join(" ");
            *counts.entry(key).or_default() += row["samples"].as_u64().expect("a number");
        }
        counts
    };
    let [second, third, both] = ["out/clip.0002.paths", "out/clip.0003.paths", "out --union"].map(rows);
    let mut sum = second;
    third.into_iter().for_each(|(key, count)| *sum.entry(key).or_default() += count);
    assert!(sum.len() > 20 && sum == both, "{sum:?} {both:?}");
}

/// Returns the artifacts of a farm that are the brushwork of painted frames.
fn brushwork(dir: &TestFolder) -> Vec<PathBuf> {
    let mut folders = vec![dir.path("artifacts")];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for path in file_names(&folder).iter().map(|name| folder.join(name)) {
            if path.is_dir() {
                folders.push(path);
            } else if std::fs::read(&path).is_ok_and(|bytes| bytes.starts_with(b"FEMCBRSH")) {
                found.push(path);
            }
        }
    }
    found
}

/// Returns the number of finished attempts to paint a frame.
fn paintings(dir: &TestFolder, url: &str, job: &str) -> usize {
    let attempts = dir.run(&format!("stats {job} --by attempt --json --server {url}")).exits(0).json();
    let is_painted = |row: &&serde_json::Value| row["stage"] == "paint" && row["ending"] == "done";
    attempts.as_array().expect("rows").iter().filter(is_painted).count()
}

#[test]
fn painted_frames_go_on_from_brushwork_that_was_lost() {
    let dir = clip_folder();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let submitted = format!("submit clip.mgf --frames 1..{FRAMES} --size 48x32 --spp 4 --style oil --server {url}");
    let job = dir.run(&submitted).exits(0).stdout().trim().to_owned();
    let mut first = dir.start(&format!("worker --join {url} --threads 1"));
    farm.wait_until("some frames are painted", || paintings(&dir, &url, &job) >= 2);
    assert!(first.kill(), "the worker was at work");
    assert!(status(&dir, &url, &job)["state"] != "done", "there is more to paint");
    // The coordinator keeps the latest artifacts in memory.
    assert!(farm.kill(), "it was alive");
    for path in brushwork(&dir) {
        std::fs::remove_file(path).expect("an artifact");
    }
    let (_farm, url) = start_coordinator(&dir, 0);
    let _second = dir.start(&format!("worker --join {url} --threads 1"));
    dir.run(&format!("fetch {job} --wait -o out --server {url}")).exits(0);
    let painted = paintings(&dir, &url, &job);
    assert!(painted > FRAMES as usize, "{painted} frames were painted");
    // The painting of the finished layers, in one process without a farm.
    let targets: Vec<String> = (1..=FRAMES).map(|frame| format!("out/clip.{frame:04}.layers.exr")).collect();
    dir.run(&format!("stylize --style oil --target {} -o alone/", targets.join(" "))).exits(0);
    for frame in 1..=FRAMES {
        let [on_farm, alone] = ["out", "alone"].map(|folder| {
            let name = if folder == "out" { "painted.png" } else { "png" };
            picture(&dir.path(&format!("{folder}/clip.{frame:04}.{name}")))
        });
        assert!(on_farm == alone, "frame {frame}");
    }
}
