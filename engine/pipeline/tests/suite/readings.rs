//! Measurements in several tasks: their blocks, and the document of a frame.

use crate::layers::scene;
use femc_pipeline::measure::{
    Area, FrameReadings, Grid, MeasureRequest, Measured, MeasurementId, MessageError, Quantity, ReadingBlock,
    ReadingShare, SurfaceSide, join_blocks, measure, resolve_places,
};
use femc_pipeline::{Prepared, SceneSource, Settings, prepare_world};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// A lamp above a gray floor.
fn prepared() -> Prepared {
    let text = "camera main =\n origin 0 -3 1\n target 0 0 0\n fov 40\n film 4 4\n\
        m lamp =\n sides 1\n c\n ed 100\nm floor =\n sides 2\n c\n rd .5\n\
        v c =\n p .3 -.2 1\nm lamp\no bulb\nsph c .1\no\n\
        v a =\n p -1 -1 0\nv b =\n p 1 -1 0\nv d =\n p 1 1 0\nv e =\n p -1 1 0\nm floor\no floor\nf a b d e\no\n";
    let source = SceneSource::new(Arc::new(scene(text)));
    prepare_world(&source, &Settings::default(), 1, None).unwrap_or_else(|error| panic!("{error}"))
}

fn request() -> MeasureRequest {
    let grid = Grid {
        name: "plane".into(),
        quantity: Quantity::Illuminance,
        corner: [-0.5, -0.5, 0.25],
        along: [1.0, 0.0, 0.0],
        across: [0.0, 1.0, 0.0],
        count: [3, 3],
        direction: None,
        observer: None,
    };
    let area = Area { name: "floor".into(), object: "floor".into(), side: SurfaceSide::Front, cells: 8 };
    MeasureRequest { spp: Some(64), by_lamp: true, grid: vec![grid], area: vec![area], ..MeasureRequest::default() }
}

fn id(frame: u32) -> MeasurementId {
    MeasurementId::new(&request(), &request().settings(0, 1), ("build", "scene".into()), frame)
}

/// Returns the blocks of all tasks.
fn blocks(scene: &Prepared, tasks: u32) -> Vec<ReadingBlock> {
    let (request, cancel) = (request(), AtomicBool::new(false));
    let places = resolve_places(scene, &request).expect("places");
    let block = |task| {
        let (share, progress) = (ReadingShare { task, tasks }, AtomicU64::new(0));
        let settings = request.settings(0, 1);
        let block = ReadingBlock::measure(scene, &places, &settings, (id(1), share), &cancel, &progress);
        let block = block.expect("not cancelled");
        assert_eq!(progress.load(Ordering::Relaxed), 64 * block.measured.len() as u64);
        block
    };
    (0..tasks).map(block).collect()
}

fn whole(scene: &Prepared) -> Vec<Measured> {
    let (request, cancel, progress) = (request(), AtomicBool::new(false), AtomicU64::new(0));
    let places = resolve_places(scene, &request).expect("places");
    let read = |(number, place): (u32, &femc_pipeline::measure::Place)| {
        let reading = measure(scene, number, place, &request.settings(0, 1), &cancel, &progress)?;
        Some(Measured { place: place.info.clone(), reading })
    };
    (0..).zip(&places).map(read).collect::<Option<_>>().expect("not cancelled")
}

#[test]
fn joined_blocks_are_the_readings_of_one_task() {
    let scene = prepared();
    let whole = whole(&scene);
    assert_eq!(whole.len(), 17);
    for tasks in [1, 2, 5, 17, 20] {
        let sent: Vec<ReadingBlock> = blocks(&scene, tasks)
            .iter()
            .map(|block| ReadingBlock::decode(&block.encode()).unwrap_or_else(|error| panic!("{error}")))
            .collect();
        let sizes: Vec<usize> = sent.iter().map(|block| block.measured.len()).collect();
        assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1, "{sizes:?}");
        assert_eq!(join_blocks(&id(1), sent).as_deref(), Ok(&whole[..]), "{tasks} tasks");
    }
}

#[test]
fn blocks_that_do_not_belong_together_are_refused() {
    let scene = prepared();
    let refused = |change: &dyn Fn(&mut Vec<ReadingBlock>)| {
        let mut all = blocks(&scene, 4);
        change(&mut all);
        join_blocks(&id(1), all).expect_err("an error")
    };
    let (measurement, task) = (MessageError::Other("measurement or frame"), MessageError::Other("task"));
    assert_eq!(refused(&|all| all[2].id = id(2)), (2, measurement.clone()));
    assert_eq!(refused(&|all| all[1].id.engine = "other".into()), (1, measurement.clone()));
    let other_request = MeasureRequest { spp: Some(96), ..request() };
    let other = MeasurementId::new(&other_request, &request().settings(0, 1), ("build", "scene".into()), 1);
    assert_eq!(refused(&|all| all[3].id = other.clone()), (3, measurement.clone()));
    let other_seed = MeasurementId::new(&request(), &request().settings(0, 2), ("build", "scene".into()), 1);
    assert_eq!(refused(&|all| all[0].id = other_seed.clone()), (0, measurement));
    assert_eq!(refused(&|all| all.swap(0, 1)), (0, task.clone()));
    assert_eq!(refused(&|all| drop(all.pop())), (0, task.clone()));
    assert_eq!(refused(&|all| all[3].total = 16), (3, task));
    assert!(matches!(refused(&Vec::clear), (0, MessageError::Corrupt(_))));
}

#[test]
fn damaged_blocks_are_refused_and_never_panic() {
    let scene = prepared();
    let block = blocks(&scene, 4).remove(1);
    let bytes = block.encode();
    let corrupt = |bytes: &[u8]| matches!(ReadingBlock::decode(bytes), Err(MessageError::Corrupt(_)));
    assert!((0..bytes.len()).all(|length| corrupt(&bytes[..length])), "cut");
    assert!(corrupt(&[&bytes[..], &[0]].concat()), "longer");
    for at in 0..bytes.len() {
        let mut other = bytes.clone();
        other[at] ^= 0x55;
        // Some damage gives other valid values; the store's digest finds that.
        let _ = ReadingBlock::decode(&other);
        assert!(at >= 4 || corrupt(&other), "magic number");
    }
    let mut newer = bytes;
    newer[4] = 2;
    assert_eq!(ReadingBlock::decode(&newer), Err(MessageError::Version { found: 2, expected: 1 }));
    let changed = |change: fn(&mut ReadingBlock)| {
        let mut other = block.clone();
        change(&mut other);
        other.encode()
    };
    assert!(corrupt(&changed(|block| block.measured[0].reading.value = f64::NAN)));
    assert!(corrupt(&changed(|block| block.measured[0].reading.half_width = -1.0)));
    assert!(corrupt(&changed(|block| block.measured[1].reading.lamps[0].value = f64::INFINITY)));
    assert!(corrupt(&changed(|block| block.measured[0].place.position[2] = f64::INFINITY)));
    assert!(corrupt(&changed(|block| block.measured[3].place.area = Some(0.0))));
    assert!(corrupt(&changed(|block| drop(block.measured.pop()))));
    assert!(corrupt(&changed(|block| block.share.task = 4)));
    assert!(corrupt(&changed(|block| block.total = u32::MAX)));
}

#[test]
fn a_document_that_contradicts_itself_is_refused() {
    let document = FrameReadings::new(id(1), 1, &whole(&prepared()));
    assert_eq!(document.check(), Ok(()));
    assert_eq!((document.readings.len(), document.summaries.len()), (34, 4), "all light, and one lamp");
    let refused = |change: fn(&mut FrameReadings)| {
        let mut other = document.clone();
        change(&mut other);
        other.check().expect_err("an error")
    };
    assert_eq!(refused(|it| it.version = 2), MessageError::Version { found: 2, expected: 1 });
    let corrupt = |change| matches!(refused(change), MessageError::Corrupt(_));
    assert!(corrupt(|it| it.format = "femc frame".into()));
    assert!(corrupt(|it| it.readings[0].value = -1.0));
    assert!(corrupt(|it| it.readings[1].half_width = f64::NAN));
    assert!(corrupt(|it| it.readings[0].unit = "cd/m2".into()));
    assert!(corrupt(|it| it.readings[0].color = Some([0.0, f64::NAN, 0.0])));
    assert!(corrupt(|it| it.bad_samples = 1));
    assert!(corrupt(|it| it.not_converged = 1));
    assert!(corrupt(|it| drop(it.readings.pop().and_then(|_| it.readings.pop()))), "a reading is missing");
    assert!(corrupt(|it| it.summaries.clear()));
    assert!(corrupt(|it| it.summaries[0].part = "floor".into()));
}

/// A task has about as many samples as a task of an image.
#[test]
fn tasks_have_about_a_quarter_of_a_million_samples() {
    let tasks = |change: fn(&mut MeasureRequest)| {
        let mut request = request();
        change(&mut request);
        (request.tasks(), request.samples_per_task())
    };
    assert_eq!(tasks(|_| ()), (1, 17 * 64));
    assert_eq!(tasks(|it| it.spp = Some(1 << 17)), (9, 17 * (1 << 17) / 9));
    assert_eq!(tasks(|it| it.spp = Some(1 << 20)).0, 17, "a reading is not divided");
    assert_eq!(tasks(|it| (it.spp, it.error) = (None, Some(0.02))).0, 2);
    assert_eq!(tasks(|it| (it.spp, it.error) = (None, Some(0.005))).0, 17);
    assert_eq!(tasks(|it| it.grid[0].count = [1000, 1000]).0, 245);
    assert_eq!(tasks(|it| (it.grid[0].count, it.spp) = ([1000, 1000], Some(1 << 20))).0, 4096);
}
