//! Tests of the union of frames of a job.

use crate::synthetic::{merge_parts, path, scope, task, tiles};
use femc_paths::{FrameStatistics, LightStatistics, MergeError, Scope};

/// Creates a frame with this number of samples in each tile.
fn frame(number: u32, samples: u32, keep: u32) -> LightStatistics {
    let scope = Scope { frame: number, ..scope(keep) };
    merge_parts(&scope, tiles(&scope).map(|tile| task(&scope, tile, 0..samples))).into_image_samples(0, |_, _| u32::MAX)
}

fn frames(keep: u32) -> Vec<LightStatistics> {
    [(3, 16), (4, 2), (7, 8)].map(|(number, samples)| frame(number, samples, keep)).to_vec()
}

#[test]
fn union_of_frames_ignores_order_grouping_and_repetition() {
    let all = frames(900);
    let expected = FrameStatistics::from_statistics(all.clone()).unwrap();
    let bytes = expected.encode();
    for order in [[0, 1, 2], [2, 1, 0], [1, 2, 0]] {
        let [a, b, c] = order.map(|place| all[place].clone());
        assert!(FrameStatistics::from_statistics([a.clone(), b.clone(), c.clone()]).unwrap().encode() == bytes);
        let mut grouped = FrameStatistics::from_statistics([c.clone(), a.clone()]).unwrap();
        let rest = FrameStatistics::from_statistics([b, a]).unwrap();
        grouped.merge(rest.into_frames()).unwrap();
        assert!(grouped.encode() == bytes, "by groups, one frame in both");
        grouped.merge([c]).unwrap();
        assert!(grouped.encode() == bytes, "a frame as its own file has it, once more");
    }
    assert!(FrameStatistics::decode(&bytes).is_ok_and(|read| read == expected));
}

#[test]
fn union_keeps_records_with_the_least_hashes_of_all_frames() {
    const KEEP: usize = 900;
    let all = frames(1 << 20);
    let mut wanted: Vec<_> = all.iter().flat_map(|it| it.paths.keys().copied()).collect();
    wanted.sort_unstable();
    wanted.truncate(KEEP);
    let united = FrameStatistics::from_statistics(frames(KEEP as u32)).unwrap();
    let mut found: Vec<_> = united.frames().flat_map(|it| it.paths.keys().copied()).collect();
    found.sort_unstable();
    assert_eq!(found, wanted);
    // Each frame has its share of the samples. Counters and sketches stay those of the frames.
    for (own, alone) in united.frames().zip(frames(KEEP as u32)) {
        assert_eq!(
            (own.samples(), &own.portions, &own.brightest),
            (alone.samples(), &alone.portions, &alone.brightest)
        );
        assert_eq!(own.threshold, united.frames().next().unwrap().threshold);
        assert!(own.paths.values().all(|it| *it == path(&own.scope, it.key)));
    }
}

#[test]
fn united_frames_share_one_box_and_conflicting_ones_are_refused() {
    let [a, b] = [frame(3, 2, 900), frame(4, 2, 900)];
    let mut wider = b.clone();
    (wider.scope.lower[0], wider.scope.upper[1]) = (-5.0, 9.0);
    let united = FrameStatistics::from_statistics([a.clone(), wider.clone()]).unwrap();
    assert!(united.frames().all(|it| (it.scope.lower, it.scope.upper) == ([-5.0, 0.0, 0.0], [4.0, 9.0, 2.5])));
    let mut again = united.clone();
    again.merge([wider, a.clone()]).unwrap();
    assert_eq!(again, united);
    // Decoding works for positions that are on no grid of the larger box.
    assert!(FrameStatistics::decode(&united.encode()).is_ok_and(|read| read == united));
    let mut other = a.clone();
    other.portions.values_mut().for_each(|counters| counters.invalid += 1);
    let before = again.clone();
    assert!(matches!(again.merge([other]), Err(MergeError::Conflict(_))));
    assert_eq!(again, before, "an error changes nothing");
}

#[test]
fn damaged_frames_are_refused() {
    let bytes = FrameStatistics::from_statistics([frame(3, 1, 20), frame(4, 1, 20)]).unwrap().encode();
    for at in (0..bytes.len()).step_by(67).chain(0..16) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        assert!(FrameStatistics::decode(&damaged).is_err(), "byte {at}");
        assert!(FrameStatistics::decode(&bytes[..at]).is_err(), "the first {at} bytes");
    }
    let loose = [frame(3, 16, 900), frame(4, 16, 900)].map(|it| it.encode());
    let mut apart = [&b"FEMCFRAM"[..], &1u32.to_le_bytes(), &2u32.to_le_bytes()].concat();
    loose.iter().for_each(|own| apart.extend([&(own.len() as u64).to_le_bytes()[..], own].concat()));
    assert!(FrameStatistics::decode(&apart).is_err(), "they have more records than one frame keeps");
}
