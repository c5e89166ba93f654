//! Formats of the store, the log and workers' disks.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use bytes::Bytes;
use femc_field::{DirectionTable, DirectionTables, FogCell, FogLine, FogTree, TABLE_CELLS, TableExtent, TargetGuide};
use femc_film::tile::NONE_HELD;
use femc_film::{
    AovPiece, AovTile, ErrorStatistics, FeatureLayout, FeatureSums, FeatureTile, Frame, ImagePiece, LayerPiece,
    LayerSetLight, LayerTile, LightBuffer, LuminanceLevels, Rect, Sample, Tile, Tiling,
};
use femc_geometry::Hit;
use femc_import::Bundle;
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_model::{
    Artifact, Assignment, AttemptRecord, ChunkSize, Control, Digest, Drain, Epoch, Grid, JobId, JobNotes, JobSpec,
    LeaseEnding, Manifest, NextRound, Output, Role, Stage, StageKind, TaskKey, TaskResult, TaskSpec, Tick,
    testing::frame_graph,
};
use femc_pipeline::measure::{
    FrameReadings, LampShare, Measured, MeasurementId, PlaceInfo, Quantity, Reading, ReadingBlock, ReadingShare,
    join_blocks,
};
use femc_pipeline::paths::histogram::{Histograms, Table};
use femc_pipeline::paths::{FrameStatistics, LightStatistics};
use femc_pipeline::radiosity::{GuideKind, RayHits, SolveOptions, SolverState};
use femc_pipeline::{
    Field, Layer, LayerPlan, Outputs, Prepared, Preset, RenderTask, SceneSource, Settings, Side, StatisticsPlan,
    StopCondition, encode_solution, prepare_world, solve_first_pass,
};
use femc_schedule::{Fact, Ledger, decode_attempts, encode_attempts};
use femc_stylize::{Brushwork, ChannelImage, Example};
use femc_worker::{Parcel, testing};

use super::Target;

/// Size limit of a scene, in bytes.
const LIMIT: u64 = 1 << 20;

pub(super) fn targets() -> Vec<Target> {
    let mut all = scenes();
    all.extend(film());
    all.extend(layers());
    all.extend(aov_targets());
    all.extend(brushwork());
    all.extend(first_pass());
    all.extend(paths());
    all.extend(readings());
    all.extend(log());
    all
}

fn brushwork() -> Vec<Target> {
    let style = ChannelImage::new(8, 6, 3, (0..144).map(|at| at as f32 / 144.0).collect()).expect("an image");
    let (example, target) = (Example { style: &style, guides: &style }, style.clone());
    let painted = femc_stylize::stylize(example, &target, None, &Default::default(), None, &()).expect("a picture");
    let (motion, depth) = ([&[0.5f32; 48][..], &[-1.0; 48]], [2.0f32; 48]);
    let seeds = [(None, None), (Some(motion), None), (Some(motion), Some(&depth[..]))]
        .map(|(motion, depth)| Brushwork::new(&painted.field, motion, depth).encode());
    let accepts = move |bytes: &[u8]| {
        let Ok(brushwork) = Brushwork::decode(bytes) else { return false };
        let again = brushwork.encode();
        assert!(Brushwork::decode(&again).is_ok_and(|twice| twice.encode() == again));
        !matches!(brushwork.reproject(&style), Some(Err(_)))
    };
    let front = seeds[0][..12].to_vec();
    let payloads = seeds.iter().map(|seed| zstd::bulk::decompress(&seed[12..], 1 << 20).expect("compressed")).collect();
    let add_envelope =
        move |payload: &[u8]| [&front[..], &zstd::bulk::compress(payload, 1).expect("it compresses")].concat();
    vec![
        Target::new("brushwork", seeds.to_vec(), accepts.clone()),
        Target::with_envelope("brushwork, inside", payloads, add_envelope, accepts),
    ]
}

fn bundle() -> Bundle {
    let file = |name: &str, size: usize| (name.to_owned(), (0..size).map(|n| ((n * n) >> 3) as u8).collect());
    Bundle(BTreeMap::from([file("main.mgf", 300), file("lamps/a.ies", 70), file("wall.png", 2000), file("empty", 0)]))
}

fn scenes() -> Vec<Target> {
    let parcel = Parcel::pack(&bundle()).expect("a parcel");
    let encoded = bundle().encode().expect("a bundle");
    let payload = zstd::bulk::decompress(&encoded[20..], 1 << 20).expect("what was compressed");
    let front = encoded[..12].to_vec();
    let add_envelope = move |payload: &[u8]| {
        let compressed = zstd::bulk::compress(payload, 1).expect("it compresses");
        [&front[..], &(payload.len() as u64).to_le_bytes(), &compressed].concat()
    };
    let accepts = |bytes: &[u8]| {
        let decoded = Bundle::decode(bytes, LIMIT);
        // An accepted bundle must stay inside its folder, and must encode again.
        decoded.is_ok_and(|bundle| bundle.0.keys().all(|name| is_inside_folder(name)) && bundle.encode().is_ok())
    };
    let manifest = Manifest::decode(&parcel.manifest).expect("a manifest");
    let (of_pieces, of_manifests) = (manifest.clone(), parcel.pieces.clone());
    vec![
        Target::new("bundle", vec![encoded], accepts),
        Target::with_envelope("bundle, inside", vec![payload], add_envelope, accepts),
        Target::new("manifest", vec![parcel.manifest.to_vec()], move |bytes| {
            let Ok(manifest) = Manifest::decode(bytes) else { return false };
            assert!(manifest.files.keys().all(|name| is_inside_folder(name)));
            assert_eq!(manifest.encode().as_deref(), Ok(bytes), "one encoding for one content");
            testing::is_scene(&manifest, &of_manifests)
        }),
        Target::new("piece of a scene", parcel.pieces.iter().map(|piece| piece.to_vec()).collect(), move |bytes| {
            let mut pieces: Vec<Bytes> = parcel.pieces.clone();
            pieces[0] = Bytes::copy_from_slice(bytes);
            testing::is_scene(&of_pieces, &pieces)
        }),
        Target::new("kept result", vec![b"FEMCDONE\x06\0\0\0".to_vec()], testing::is_stored_result),
        Target::with_envelope(
            "kept result, inside",
            vec![result_body()],
            with_result_header,
            testing::is_stored_result,
        ),
    ]
}

/// Adds the header of a kept result to a body.
fn with_result_header(body: &[u8]) -> Vec<u8> {
    [b"FEMCDONE\x06\0\0\0", &Digest::compute(body).as_bytes()[..], body].concat()
}

/// Returns the kept result of a tile of three bytes.
fn result_body() -> Vec<u8> {
    let tile = Artifact::from_bytes(b"abc");
    let outputs = vec![Output { role: Role::Tile, artifact: tile }];
    let result = TaskResult { outputs, units: 256, seconds: 0.5, ..TaskResult::default() };
    let (inputs, taken, more) = (vec![], [4, 8].into_iter().collect(), NextRound::Impossible);
    let work = TaskSpec {
        item: 3,
        steps: 0..4,
        inputs,
        hints: Vec::new(),
        steps_taken: taken,
        next_round: more,
        elapsed: 0,
        busy_seconds: 0.0,
    };
    let assignment = Assignment { task: task(), epoch: Epoch(7), lease: 4500, copy_of: None, spec: work };
    let head = postcard::to_stdvec(&(assignment, spec(), result, vec![3u64])).expect("a head");
    [&(head.len() as u64).to_le_bytes()[..], &head, b"abc"].concat()
}

fn task() -> TaskKey {
    TaskKey { job: JobId(1), stage: Stage { frame: 2, round: 0, number: 0, kind: StageKind::Render }, index: 3 }
}

fn spec() -> JobSpec {
    JobSpec {
        name: "fog".into(),
        bundle: Digest::compute(b"scene"),
        entry: "fog.mgf".into(),
        settings: "{}".into(),
        frames: vec![1, 2, 5],
        grid: Grid { film: [64, 64], tile: 16 },
        graph: frame_graph(Grid { film: [64, 64], tile: 16 }.sizes(), &[4, 8], 4),
        contents: vec![],
        priority: 50,
        owner: "ann".into(),
        tags: vec!["big".into()],
        notes: JobNotes::default(),
    }
}

/// Checks that a path stays inside its folder.
///
/// # Panics
/// If the path leads elsewhere.
fn is_inside_folder(name: &str) -> bool {
    let is_odd = |part: &str| matches!(part, "" | "." | "..");
    assert!(!name.split('/').any(is_odd) && !name.contains(['\\', '\0']), "{name:?} leaves the folder");
    true
}

fn film() -> Vec<Target> {
    let tiling = Tiling::new(12, 8, 8).expect("a tiling");
    let mut frame = Frame::new(tiling);
    let mut tiles = Vec::new();
    for rect in tiling.rects() {
        let mut tile = Tile::new(rect, 0..4).expect("a tile");
        let Rect { x, y, .. } = rect;
        tile.add(x, y, 0, &Sample { color: Rgb::new(1.0, 2.0, 0.5), ..Sample::MISS });
        tile.add(x + 1, y + 1, 3, &Sample { color: Rgb::new(f32::NAN, 2.0, 0.5), ..Sample::MISS });
        tiles.push(tile.encode());
        frame.insert(tile).expect("its place");
    }
    let piece = ImagePiece::from_frame(&frame, 0..2).expect("a piece").encode();
    let errors = ErrorStatistics::from_frame(&frame, 0..2).expect("errors").encode();
    let mut sums = b"FEMCSUMS\x01\0\0\0\x02\0\0\0".to_vec();
    for tile in &tiles {
        sums.extend((tile.len() as u64).to_le_bytes());
        sums.extend(tile);
    }
    let thumbnail = frame.tile(0).expect("it is there").thumbnail().encode_thumbnail();
    let levels = LuminanceLevels::default().encode();
    let is_tile = |bytes: &[u8]| {
        let Ok(tile) = Tile::decode(bytes) else { return false };
        assert!(Tile::decode(&tile.encode()).is_ok_and(|again| again == tile));
        true
    };
    let is_piece = |bytes: &[u8]| ImagePiece::decode(bytes).is_ok();
    let are_errors = |bytes: &[u8]| {
        let Ok(errors) = ErrorStatistics::decode(bytes) else { return false };
        assert!(ErrorStatistics::decode(&errors.encode()).is_ok_and(|again| again == errors));
        true
    };
    vec![
        Target::new("tile", tiles.clone(), is_tile),
        Target::with_envelope("tile, inside", tiles, with_checksum, is_tile),
        Target::new("piece", vec![piece.clone()], is_piece),
        Target::with_envelope("piece, inside", vec![piece], with_checksum, is_piece),
        Target::new("errors", vec![errors.clone()], are_errors),
        Target::with_envelope("errors, inside", vec![errors], with_checksum, are_errors),
        Target::new("thumbnail", vec![thumbnail], |bytes| Tile::decode_thumbnail(bytes).is_ok()),
        Target::new("levels", vec![levels], |bytes| LuminanceLevels::decode(bytes).is_ok()),
        Target::new("sums", vec![sums], |bytes| femc_film::sums::decode(bytes).is_ok()),
    ]
}

/// Targets for layers of a tile of a foggy floor: sums, resolved layers, and layer expressions.
fn layers() -> Vec<Target> {
    let requested_layers: Vec<Layer> = [Preset::Guides, Preset::Direct, Preset::Fog]
        .into_iter()
        .flat_map(|preset| preset.layers([]).expect("layers without lamps"))
        .chain([Layer::new("floor", "C<RD'floor'>[^D]*(<L.['lamp''lamp/lamp']>|O)?")])
        .collect();
    let settings = Settings { stop: StopCondition::Spp(3), layers: requested_layers.clone(), ..Settings::default() };
    let prepared = prepare_world(&SceneSource::new(crate::parse_scene(FLOOR)), &settings, 1, None).expect("a frame");
    let (plan, rect) =
        (LayerPlan::new(&prepared, &settings).expect("a plan"), Rect { x: 4, y: 0, width: 4, height: 4 });
    let task = RenderTask::new(&prepared, &settings, rect, 0..3);
    let rendered = task.render(Outputs { layers: Some(&plan), ..Outputs::default() }).expect("a tile");
    let tile = rendered.aovs.light.expect("layers");
    let tiling = Tiling::new(8, 4, 4).expect("a tiling");
    let mut piece = LayerPiece::new(tiling, 1);
    piece.put(&tile, NONE_HELD).expect("its place");
    let (tile, piece) = (tile.encode(), piece.encode());
    let is_tile = move |bytes: &[u8]| {
        let Ok(tile) = LayerTile::decode(bytes) else { return false };
        // An accepted tile must encode to itself, merge with itself, and resolve.
        assert!(LayerTile::decode(&tile.encode()).is_ok_and(|again| again == tile));
        let twice = LayerTile::from_parts(vec![tile.clone(), tile.clone()], 0, NONE_HELD);
        assert!(twice.is_ok_and(|twice| twice == tile));
        let _ = LayerPiece::new(tiling, 1).put(&tile, NONE_HELD);
        true
    };
    let is_piece = |bytes: &[u8]| {
        let Ok(piece) = LayerPiece::decode(bytes) else { return false };
        let encoded = piece.encode();
        assert!(LayerPiece::decode(&encoded).is_ok_and(|again| again.encode() == encoded));
        true
    };
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let written = requested_layers.iter().map(|layer| format!("{}={}", layer.name, layer.expression).into_bytes());
    let written_settings = serde_json::to_vec(&settings).expect("they are written");
    let mut all = vec![
        Target::new("layer", written.collect(), move |bytes| text(bytes).parse::<Layer>().is_ok()),
        Target::new("layers of settings", vec![written_settings], |bytes| {
            let settings = serde_json::from_slice::<Settings>(bytes);
            settings.is_ok_and(|settings| settings.layers.iter().all(|layer| layer.parse().is_ok()))
        }),
    ];
    all.extend(compressed_targets(["layer tile", "layer tile, header", "layer tile, inside"], tile, is_tile));
    all.extend(compressed_targets(["layer piece", "layer piece, header", "layer piece, inside"], piece, is_piece));
    all
}

/// Targets for bytes that end with a compressed frame: mutated as they are, with the checksum repaired, and with mutated contents
/// of the frame.
fn compressed_targets(
    [bytes, header, inside]: [&'static str; 3],
    encoded: Vec<u8>,
    decode: impl Fn(&[u8]) -> bool + Copy + 'static,
) -> Vec<Target> {
    let frame = encoded.windows(4).position(|at| at == ZSTD).expect("a frame");
    let (front, planes) = (encoded[..frame].to_vec(), zstd::bulk::decompress(&encoded[frame..], 1 << 26));
    let add_envelope = move |planes: &[u8]| {
        let compressed = zstd::bulk::compress(planes, 1).expect("it compresses");
        with_checksum(&[&front[..], &compressed].concat())
    };
    vec![
        Target::new(bytes, vec![encoded.clone()], decode),
        Target::with_envelope(header, vec![encoded], with_checksum, decode),
        Target::with_envelope(inside, vec![planes.expect("what was compressed")], add_envelope, decode),
    ]
}

/// Magic number of a zstd frame.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Targets for layers and features of a tile, alone and merged.
fn aov_targets() -> Vec<Target> {
    let (tiling, rect) = (Tiling::new(4, 3, 8).expect("a tiling"), Rect { x: 0, y: 0, width: 4, height: 3 });
    let (mut light, mut features) = (LightBuffer::default(), FeatureSums::new(FeatureLayout { values: 2, ids: 2 }));
    light.add(1, Rgb::new(1.0, 2.0, 0.5));
    let light = LayerSetLight { layers: 1, sums: vec![light.take().expect("light"); 12] };
    for pixel in 0..12 {
        features.begin_pixel();
        features.add(None);
        features.add(Some((&[1.5, -f64::from(pixel)], &[pixel, 0x3f80_0000])));
        features.add(Some((&[0.5, 3.0], &[7, 0x3f00_0000])));
    }
    let tile = AovTile {
        light: Some(LayerTile::new(rect, 0..4, 1, vec![[0, 1]; 12], vec![light]).expect("layers")),
        features: Some(FeatureTile::new(rect, 0..4, features).expect("features")),
    };
    let mut piece = AovPiece::new(tiling, 0);
    piece.put(&tile, NONE_HELD).expect("the first tile");
    let features = tile.features.as_ref().map(FeatureTile::encode).expect("they are there");
    // Skip the header of features: magic, version, checksum, eight words, and one for each kind of ids.
    let (front, planes) = features.split_at(28 + 10 * 4);
    let (front, planes) = (front.to_vec(), zstd::bulk::decompress(planes, 1 << 16).expect("what was compressed"));
    let add_envelope = move |planes: &[u8]| {
        with_checksum(&[&front[..], &zstd::bulk::compress(planes, 1).expect("it compresses")].concat())
    };
    let is_tile = |bytes: &[u8]| {
        let Ok(tile) = AovTile::decode(bytes) else { return false };
        assert!(AovTile::decode(&tile.encode()).is_ok_and(|again| again == tile));
        true
    };
    let are_features = |bytes: &[u8]| {
        let Ok(tile) = FeatureTile::decode(bytes) else { return false };
        assert!(FeatureTile::decode(&tile.encode()).is_ok_and(|again| again == tile));
        // An accepted tile must merge with itself and resolve.
        let AovTile { features, .. } =
            AovTile::from_parts(vec![AovTile { light: None, features: Some(tile) }], 0, NONE_HELD).expect("one part");
        features.is_some()
    };
    let is_piece = |bytes: &[u8]| AovPiece::decode(bytes).is_ok();
    vec![
        Target::with_envelope("features, inside", vec![features], with_checksum, are_features),
        Target::with_envelope("features, sums", vec![planes], add_envelope, are_features),
        Target::new("beside", vec![tile.encode()], is_tile),
        Target::with_envelope("beside, inside", vec![tile.encode()], with_checksum, is_tile),
        Target::new("piece beside", vec![piece.encode()], is_piece),
        Target::with_envelope("piece beside, inside", vec![piece.encode()], with_checksum, is_piece),
    ]
}

/// Targets for the first pass's light of a floor, a ball and fog.
fn first_pass() -> Vec<Target> {
    let text = "camera main =\n  origin .2 .2 .2\n  target .8 .8 .8\n  fov 60\n  film 8 8\n\
        medium air =\n  sigma_s .5\nmbox air 0 0 0 1 1 1\nm lamp =\n  ed 100\nv l =\n  p .5 .5 .9\nsph l .05\n\
        m wall =\n  sides 1\n  rd .5\nv a =\n  p 0 0 0\nv b =\n  p 1 0 0\nv c =\n  p 1 1 0\nv d =\n  p 0 1 0\nf a b c d\n\
        v e =\n  p .2 .9 .8\nf a b e\nv f =\n  p .6 .5 .3\nsph f .2\n";
    let source = SceneSource::new(crate::parse_scene(text));
    let prepared = prepare_world(&source, &Settings::default(), 1, None).expect("a frame");
    let mut solution =
        solve_first_pass(&prepared, femc_pipeline::Method::Femc, &AtomicBool::new(false)).expect("a solution");
    // A small part of the fog is enough.
    let leaf = |k: usize| FogCell::Leaf(*solution.field.fog.leaves().nth(k).expect("a box of fog"));
    let [min, max] = solution.field.fog.bounds();
    let cells = [FogCell::Split { axis: 1, at: 0.5 * (min.y + max.y) }, leaf(0), leaf(1)];
    solution.field.fog = FogTree::new([min, max], &cells).expect("boxes of fog");
    // One leaf has a table of directions.
    let table = DirectionTable::new(TableExtent::Hemisphere(Vec3A::Z), &[1.0; TABLE_CELLS]);
    let [leaves, fog] = [solution.field.leaves.len(), 2].map(|count| vec![None; count]);
    let leaves = std::iter::once(table).chain(leaves).take(solution.field.leaves.len()).collect();
    solution.field.tables = DirectionTables::new(leaves, fog);
    let encoded = encode_solution(&solution);
    let tables = zstd::bulk::decompress(&encoded[FIELD_FRONT..], 1 << 26).expect("what was compressed");
    let front = encoded[..FIELD_FRONT - 8].to_vec();
    let add_envelope = move |tables: &[u8]| {
        let compressed = zstd::bulk::compress(tables, 1).expect("it compresses");
        with_checksum(&[&front[..], &(tables.len() as u64).to_le_bytes(), &compressed].concat())
    };
    let is_field = |bytes: &[u8]| {
        let Ok((field, statistics)) = Field::decode(bytes) else { return false };
        // An accepted field must answer for light at all of its surfaces, and must encode again.
        let mut line = FogLine::default();
        for (instance, sides) in (0..).zip(&field.sides) {
            for primitive in 0..sides.len() as u32 {
                let hit = Hit { t: 1.0, instance, primitive, u: 0.3, v: 0.6 };
                let [front, _] =
                    [Side::Front, Side::Back].map(|side| field.irradiance(&hit, side, test_point(), Vec3A::Z));
                let error = field.irradiance_error(&hit, Side::Front, test_point());
                let _ = (front, error, field.fog.scattered_radiance(test_point(), Vec3A::X));
                if let Some(table) = field.table_at(&hit, Side::Front, test_point()) {
                    assert!(table.pdf(table.sample([0.3, 0.7])).is_finite());
                }
                field.fog.radiance_along(test_point(), Vec3A::Z, 0.0, f32::INFINITY, &mut line);
                if let Some(point) = line.sample(0.4) {
                    assert!(point.pdf == line.pdf(point.t));
                }
                let targets = TargetGuide::without_targets(&field);
                let _ = targets.at(&field, &hit, Side::Front, test_point());
            }
        }
        assert!(Field::decode(&field.encode(&statistics)).is_ok());
        true
    };
    let mut all = vec![
        Target::new("field", vec![encoded.clone()], is_field),
        Target::with_envelope("field, header", vec![encoded], with_checksum, is_field),
        Target::with_envelope("field, tables", vec![tables], add_envelope, is_field),
    ];
    all.extend(first_pass_steps(prepared));
    all
}

/// Targets for data between the steps of a first pass in blocks. A memory limit of 0 keeps the elements few. There is one ray of
/// each part.
fn first_pass_steps(prepared: Prepared) -> Vec<Target> {
    let (options, cancel) = (SolveOptions { error: 1.0, memory: 0, guides: GuideKind::None }, AtomicBool::new(false));
    let state = SolverState::new(&prepared, &options, &cancel).expect("elements");
    let links = state.encode_links();
    let casting = state.plan_rays(&prepared, &options);
    let hits = casting.cast(&prepared, 0, 1);
    let corrected = casting.apply_hits(&prepared, &options, vec![hits.clone()], &cancel).expect("nobody cancels");
    let corrected = corrected.expect("its own rays");
    let elements = corrected.encode_elements();
    let (of_links, of_elements, prepared) = (links.clone(), elements.clone(), Arc::new(prepared));
    let (of, again) = (prepared.clone(), SolverState::new(&prepared, &options, &cancel).expect("elements"));
    let casting = Arc::new(again.plan_rays(&prepared, &options));
    let is_state = move |elements: &[u8], links: &[u8]| {
        let Ok(read) = SolverState::decode(&prepared, elements, links) else { return false };
        // An accepted state must be able to continue, and must encode again.
        let again = SolverState::decode(&prepared, &read.encode_elements(), &read.encode_links());
        assert!(again.is_ok_and(|again| again.solution(&prepared, &options).report.links == read.report().links));
        true
    };
    let with_links = is_state.clone();
    // The name and the version of the format are before the columns.
    let header: [u8; 12] = elements[..12].try_into().expect("a header");
    let columns = |bytes: &[u8]| zstd::bulk::decompress(&bytes[12..], 1 << 26).expect("what was compressed");
    let add_envelope =
        move |columns: &[u8]| [&header[..], &zstd::bulk::compress(columns, 1).expect("it compresses")].concat();
    let are_rays = move |bytes: &[u8]| {
        let Ok(sights) = RayHits::decode(bytes) else { return false };
        assert!(RayHits::decode(&sights.encode()).is_ok());
        casting.apply_hits(&of, &options, vec![sights], &AtomicBool::new(false)).is_ok_and(|applied| applied.is_some())
    };
    let (rays, is_rays) = (hits.encode(), are_rays.clone());
    vec![
        Target::with_envelope("elements", vec![columns(&elements)], add_envelope, move |bytes| {
            is_state(bytes, &of_links)
        }),
        Target::with_envelope("links", vec![columns(&links)], add_envelope, move |bytes| {
            with_links(&of_elements, bytes)
        }),
        Target::new("rays", vec![rays.clone()], is_rays),
        Target::with_envelope("rays, inside", vec![columns(&rays)], add_envelope, are_rays),
    ]
}

/// A foggy floor under a lamp.
const FLOOR: &str = "camera main =\n  origin .5 .5 2\n  target .5 .5 0\n  up 0 1 0\n  fov 60\n  film 8 4\n\
    medium air =\n  sigma_s .2\nmbox air 0 0 0 1 1 3\n\
    m lamp =\n  ed 100\nv l =\n  p .5 .5 1.5\no lamp\nsph l .05\no\n\
    m wall =\n  rd .5\nv a =\n  p 0 0 0\nv b =\n  p 1 0 0\nv c =\n  p 1 1 0\nv d =\n  p 0 1 0\no floor\nf a b c d\no\n";

/// Targets for light statistics of a tile of a foggy floor under a lamp: of recorded samples, of all samples, and of two frames.
fn paths() -> Vec<Target> {
    let some = statistics(1, false);
    let mut all = statistics_targets(["paths", "paths, header", "paths, tables"], &some);
    all.extend(statistics_targets(["full paths", "full paths, header", "full paths, tables"], &statistics(1, true)));
    let frames = FrameStatistics::from_statistics([some, statistics(2, false)]).expect("a union").encode();
    let are_frames = |bytes: &[u8]| {
        let Ok(read) = FrameStatistics::decode(bytes) else { return false };
        // Accepted statistics must merge, and must encode to themselves.
        let mut twice = read.clone();
        assert!(twice.merge(read.clone().into_frames()).is_ok() && twice == read);
        assert!(FrameStatistics::decode(&read.encode()).is_ok_and(|again| again == read));
        true
    };
    all.push(Target::new("paths of frames", vec![frames.clone()], are_frames));
    let add_envelope = |bytes: &[u8]| {
        // Repair the checksum of the first frame.
        let mut bytes = bytes.to_vec();
        if let Some((front, rest)) = bytes.split_at_mut_checked(FRAMES_FRONT)
            && let Ok(length) = usize::try_from(u64::from_le_bytes(*front.last_chunk().expect("it has a length")))
            && let Some((own, _)) = rest.split_at_mut_checked(length)
        {
            let whole = with_checksum(own);
            own.copy_from_slice(&whole);
        }
        bytes
    };
    all.push(Target::with_envelope("paths of frames, inside", vec![frames], add_envelope, are_frames));
    all
}

fn readings() -> Vec<Target> {
    let id = MeasurementId { engine: "1".into(), scene: "ab".into(), request: "cd".into(), frame: 3 };
    let measured = |number| {
        let place = PlaceInfo {
            part: "floor".into(),
            number,
            quantity: Quantity::Illuminance,
            position: [1.0, -2.5, 0.125],
            cell: Some([number, 0]),
            area: (number > 1).then_some(0.5),
        };
        let lamp = LampShare { lamp: "panel".into(), value: 3.0, half_width: 0.25 };
        let reading = Reading {
            color: [4.0, 5.0, 6.0],
            value: 5.0,
            half_width: 0.5,
            samples: 64,
            bad_samples: 1,
            rays: 300,
            is_converged: true,
            lamps: vec![lamp],
        };
        Measured { place, reading }
    };
    let block = |task: u32, numbers: &[u32]| ReadingBlock {
        id: id.clone(),
        share: ReadingShare { task, tasks: 2 },
        total: 3,
        measured: numbers.iter().map(|&number| measured(number)).collect(),
    };
    let (first, second) = (block(0, &[0, 2]), block(1, &[1]));
    let seeds = vec![first.encode(), second.encode()];
    let all = join_blocks(&id, vec![first.clone(), second.clone()]).expect("both blocks");
    let document = serde_json::to_vec(&FrameReadings::new(id.clone(), 1, &all)).expect("JSON");
    vec![
        Target::new("block of readings", seeds, move |bytes| {
            let Ok(block) = ReadingBlock::decode(bytes) else { return false };
            assert!(ReadingBlock::decode(&block.encode()).is_ok_and(|again| again.encode() == block.encode()));
            let blocks = if block.share.task == 0 { vec![block, second.clone()] } else { vec![first.clone(), block] };
            // What is joined can be summed up.
            join_blocks(&id, blocks).is_ok_and(|all| FrameReadings::new(id.clone(), 1, &all).check().is_ok())
        }),
        Target::new("document of readings", vec![document], |bytes| {
            serde_json::from_slice::<FrameReadings>(bytes).is_ok_and(|document| document.check().is_ok())
        }),
    ]
}

fn statistics(frame: u32, full_statistics: bool) -> LightStatistics {
    let settings = Settings { stop: StopCondition::Spp(3), full_statistics, ..Settings::default() };
    let prepared =
        prepare_world(&SceneSource::new(crate::parse_scene(FLOOR)), &settings, frame, None).expect("a frame");
    let (plan, rect) = (StatisticsPlan::new(&prepared, &settings, 4), Rect { x: 4, y: 0, width: 4, height: 4 });
    let task = RenderTask::new(&prepared, &settings, rect, 0..3);
    let rendered = task.render(Outputs { statistics: Some(&plan), ..Outputs::default() });
    rendered.expect("a tile").statistics.expect("statistics")
}

fn statistics_targets([bytes, header, inside]: [&'static str; 3], statistics: &LightStatistics) -> Vec<Target> {
    let encoded = statistics.encode();
    let tables = zstd::bulk::decompress(&encoded[PATHS_FRONT..], 1 << 26).expect("what was compressed");
    let front = encoded[..PATHS_FRONT - 8].to_vec();
    let add_envelope = move |tables: &[u8]| {
        let compressed = zstd::bulk::compress(tables, 1).expect("it compresses");
        with_checksum(&[&front[..], &(tables.len() as u64).to_le_bytes(), &compressed].concat())
    };
    let are_paths = |bytes: &[u8]| {
        let Ok(read) = LightStatistics::decode(bytes) else { return false };
        // Accepted statistics must support counting, merge with themselves, and encode again.
        for table in Table::ALL {
            assert_eq!(Histograms::from_statistics(&read, table).table, table);
            assert_eq!(Histograms::attributes_of_all_samples(&read, table).is_some(), read.scope.has_full_histograms);
        }
        let mut twice = read.clone();
        assert!(twice.merge(read.clone()).is_ok() && twice == read);
        assert!(LightStatistics::decode(&read.clone().into_image_samples(1, |_, _| 2).encode()).is_ok());
        true
    };
    vec![
        Target::new(bytes, vec![encoded.clone()], are_paths),
        Target::with_envelope(header, vec![encoded], with_checksum, are_paths),
        Target::with_envelope(inside, vec![tables], add_envelope, are_paths),
    ]
}

/// Bytes of encoded frames before the statistics of the first frame.
const FRAMES_FRONT: usize = 8 + 4 + 4 + 8;

/// Bytes of encoded light statistics before their tables.
const PATHS_FRONT: usize = 28 + 4 + 8 + 7 * 4 + 6 * 8 + 8 + 7 * 4 + 8;

/// Bytes of an encoded field before its tables.
const FIELD_FRONT: usize = 28 + 8 * 8 + 4 + 12 * 4 + 8;

fn test_point() -> Vec3A {
    Vec3A::new(0.4, 0.3, 0.2)
}

/// Repairs the checksum of encoded bytes.
fn with_checksum(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    if let Some((front, body)) = bytes.split_at_mut_checked(28) {
        front[12..28].copy_from_slice(&blake3::hash(body).as_bytes()[..16]);
    }
    bytes
}

fn log() -> Vec<Target> {
    let facts = [
        Fact::CoordinatorStarted { incarnation: 7 },
        Fact::Submitted {
            job: JobId(1),
            key: Some("key".into()),
            spec: Box::new(spec()),
            chunk_size: ChunkSize::Whole,
            date: Some(7),
            announces: true,
        },
        Fact::Controlled { job: JobId(1), control: Control::Priority(70) },
        Fact::Drained { instance: 5, drain: Drain::Begin },
        Fact::JobRemoved { job: JobId(3) },
    ];
    let mut ledger = Ledger::default();
    facts.iter().for_each(|fact| drop(ledger.apply(fact, Tick(3))));
    let records: Vec<Vec<u8>> = facts.iter().map(|fact| fact.encode(Tick(3)).expect("a record")).collect();
    let attempt = AttemptRecord {
        task: task(),
        epoch: Epoch(7),
        worker: "node-7".into(),
        instance: 5,
        granted: Tick(3),
        ended: Tick(90),
        ending: LeaseEnding::Done,
        samples: 256,
        relative_error: Some(0.02),
        usage: None,
    };
    let note = encode_attempts(&[attempt.clone(), attempt]).expect("a note");
    let snapshot = ledger.encode().expect("a snapshot");
    vec![
        Target::new("record of the log", records, |bytes| {
            let Ok((now, fact)) = Fact::decode(bytes) else { return false };
            assert!(fact.encode(now).is_ok());
            true
        }),
        Target::new("snapshot", vec![snapshot], |bytes| {
            Ledger::decode(bytes).is_ok_and(|ledger| ledger.encode().is_ok())
        }),
        Target::new("note of attempts", vec![note], |bytes| decode_attempts(bytes).is_ok()),
    ]
}
