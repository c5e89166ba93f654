//! Tests of answers that have only the new rows of growing data.

use super::*;
use femc_service::RowIdentity;
use std::path::Path;

/// An answer, and the identities of its rows.
struct Answered {
    bytes: Vec<u8>,
    rows: Option<Arc<[RowIdentity]>>,
}

fn ask_since(light: &Arc<dyn LightData>, call: &LightCall, earlier: Option<&EarlierRows>) -> Answered {
    match light.answer(call, earlier, &AtomicBool::new(false)).unwrap() {
        LightAnswer::Rows { columns, identities } => Answered { bytes: columns, rows: Some(identities) },
        LightAnswer::Columns(bytes) | LightAnswer::Json(bytes) => Answered { bytes, rows: None },
    }
}

/// Rows of intersections or lights of each path.
fn rows_by_path(owners: &[Option<usize>], paths: usize) -> Vec<Vec<usize>> {
    let mut all = vec![Vec::new(); paths];
    owners.iter().enumerate().for_each(|(row, owner)| all[owner.unwrap()].push(row));
    all
}

/// Rebuilds a full answer from an earlier one and the difference, by the text of `docs/http.md`.
fn rebuild(earlier: &Decoded, difference: &Decoded) -> Decoded {
    const NONE: f64 = u32::MAX as f64;
    let kept = difference.numbers("paths.kept");
    let counts = |answer: &Decoded| answer.column("paths.frame").len();
    let mut new = 0;
    // For each row: the answer that has its values, and its row there.
    let sources: Vec<(&Decoded, usize)> = kept
        .iter()
        .map(|kept| {
            kept.map_or_else(
                || {
                    new += 1;
                    (difference, new - 1)
                },
                |row| (earlier, row),
            )
        })
        .collect();
    assert_eq!(new, counts(difference));
    let mut header = difference.header.clone();
    header.as_object_mut().unwrap().remove("since").expect("the tag of the earlier answer");
    let mut columns: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for whole in ["paths.number", "paths.weight", "paths.selected", "intersections.selected", "lights.selected"] {
        if let Some(column) = difference.columns.get(whole) {
            columns.insert(whole.to_owned(), column.clone());
        }
    }
    let own = |answer: &Decoded, table: &str| rows_by_path(&answer.numbers(&format!("{table}.path")), counts(answer));
    for (name, column) in &difference.columns {
        let is_value = name.starts_with("paths.") && !columns.contains_key(name);
        if is_value && !["paths.kept", "paths.first_intersection", "paths.first_light"].contains(&name.as_str()) {
            assert_eq!(column.len(), new);
            columns.insert(name.clone(), sources.iter().map(|(answer, row)| answer.column(name)[*row]).collect());
        }
    }
    let mut first_intersections = Vec::new();
    for (table, first_number, parent) in
        [("intersections", "paths.first_intersection", "parent"), ("lights", "paths.first_light", "intersection")]
    {
        let is_own = |name: &&String| name.starts_with(&format!("{table}.")) && !name.ends_with(".selected");
        let names: Vec<String> = difference.columns.keys().filter(is_own).cloned().collect();
        let by_path = [own(earlier, table), own(difference, table)];
        let intersections = [own(earlier, "intersections"), own(difference, "intersections")];
        let mut all: BTreeMap<String, Vec<f64>> = names.iter().map(|name| (name.clone(), Vec::new())).collect();
        all.insert(format!("{table}.number"), Vec::new());
        let mut next = 0;
        for (at, (answer, row)) in sources.iter().enumerate() {
            let from = usize::from(!std::ptr::eq(*answer, earlier));
            if table == "intersections" {
                first_intersections.push(next);
            }
            for (index, source) in by_path[from][*row].iter().enumerate() {
                for name in &names {
                    let value = answer.column(name)[*source];
                    let value = match name.split_once('.').unwrap().1 {
                        "path" => at as f64,
                        word if word == parent && value != NONE => {
                            value - intersections[from][*row][0] as f64 + first_intersections[at] as f64
                        }
                        _ => value,
                    };
                    all.get_mut(name).unwrap().push(value);
                }
                let first = difference.column(first_number)[at];
                let number = if first == NONE { NONE } else { first + index as f64 };
                all.get_mut(&format!("{table}.number")).unwrap().push(number);
            }
            next += by_path[from][*row].len();
        }
        columns.extend(all);
    }
    Decoded { header, columns }
}

/// Checks that two answers have the same header and columns, to the bit.
fn assert_same(a: &Decoded, b: &Decoded, place: &str) {
    let without_layout = |answer: &Decoded| {
        let mut header = answer.header.clone();
        header.as_object_mut().unwrap().remove("columns");
        header
    };
    assert_eq!(without_layout(a), without_layout(b), "{place}");
    let names = |answer: &Decoded| answer.columns.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(a), names(b), "{place}");
    for (name, column) in &a.columns {
        let bits = |column: &[f64]| column.iter().map(|it| it.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(column), bits(b.column(name)), "{place}: {name}");
    }
}

/// Pseudo-random draws.
struct Draws(u64);

impl Draws {
    fn below(&mut self, count: usize) -> usize {
        self.0 += 1;
        let key = PathKey { frame: 1, pixel: (self.0 >> 32) as u32, sample: self.0 as u32 };
        (key.hash(77) >> 32) as usize % count
    }
}

/// Parts of two frames.
fn all_parts() -> Vec<(u32, LightStatistics)> {
    let ranges = [0..2, 2..6, 6..9, 9..SAMPLES];
    let part = |frame, tile, samples: &std::ops::Range<u32>| (frame, part(&scope(frame), tile, samples.clone()));
    let of_tile = |(frame, tile)| ranges.iter().map(move |samples| part(frame, tile, samples)).collect::<Vec<_>>();
    [(3, 0), (3, 1), (4, 0), (4, 1)].into_iter().flat_map(of_tile).collect()
}

fn open_parts(parts: &[&(u32, LightStatistics)], is_growing: bool) -> Arc<dyn LightData> {
    let sources = [3, 4].map(|frame| {
        let own = parts.iter().filter(|(own, _)| *own == frame).map(|(_, part)| part.clone());
        LightSource { is_growing, ..source(&format!("frame {frame}"), &own.collect::<Vec<_>>()) }
    });
    open(sources.into_iter().filter(|source| !source.parts.is_empty()).collect())
}

#[test]
fn rows_rebuilt_from_a_difference_are_those_of_the_full_answer() {
    let all = all_parts();
    let (mut differences, mut kept) = (0, 0);
    for seed in 0..24 {
        let mut draws = Draws(seed << 40);
        let mut order: Vec<usize> = (0..all.len()).collect();
        (1..order.len()).for_each(|at| order.swap(at, draws.below(at + 1)));
        let mut earlier: Option<(EarlierRows, Decoded)> = None;
        let mut end = 1 + draws.below(4);
        loop {
            let is_growing = end < all.len();
            let light = open_parts(&order[..end].iter().map(|at| &all[*at]).collect::<Vec<_>>(), is_growing);
            let kind = match draws.below(4) {
                0 => brightest(1 + draws.below(60) as u32),
                _ => all_paths(1 + draws.below(500) as u32),
            };
            let condition = [None, Some("depth > 1"), Some("any(object == plant)")][draws.below(3)];
            let call = call(kind, condition);
            let place = format!("seed {seed}, {end} parts, {call:?}");
            let full = ask_since(&light, &call, None);
            let decoded = decode(&full.bytes);
            assert_eq!(decoded.header["growing"], json!(is_growing));
            assert!(decoded.header.get("since").is_none());
            assert_eq!(full.rows.is_some(), is_growing, "{place}");
            if let Some((rows, before)) = &earlier {
                let answered = ask_since(&light, &call, Some(rows));
                assert_eq!(answered.rows, full.rows, "{place}");
                let difference = decode(&answered.bytes);
                if difference.header.get("since").is_some() {
                    assert_eq!(difference.header["since"], json!(rows.tag));
                    differences += 1;
                    kept += difference.numbers("paths.kept").iter().flatten().count();
                    assert_same(&rebuild(before, &difference), &decoded, &place);
                } else {
                    assert_eq!(answered.bytes, full.bytes, "{place}");
                }
            }
            let Some(identities) = full.rows else { break };
            earlier = Some((EarlierRows { tag: format!("answer {end}"), identities }, decoded));
            end = (end + 1 + draws.below(3)).min(all.len());
        }
    }
    assert!(differences > 60 && kept > 5000, "{differences} differences, {kept} kept rows");
}

#[test]
fn answers_that_share_few_rows_are_full() {
    let all = all_parts();
    let light = open_parts(&all.iter().take(4).collect::<Vec<_>>(), true);
    let call = call(all_paths(100), None);
    let full = ask_since(&light, &call, None);
    let other = [[7; 16]; 100];
    let rows = |own: usize| {
        let own = full.rows.iter().flat_map(|rows| rows.iter().copied()).take(own);
        EarlierRows { tag: "other".into(), identities: own.chain(other).collect() }
    };
    for few in [0, 9] {
        assert_eq!(ask_since(&light, &call, Some(&rows(few))).bytes, full.bytes);
    }
    assert!(ask_since(&light, &call, Some(&rows(40))).bytes.len() < full.bytes.len());
}

/// Answers for the tests of the page, in `web/tests/unit/light-growth`. With `FEMC_WRITE_FIXTURES=1`, this test writes them.
#[test]
fn the_answers_in_the_tests_of_the_page_are_current() {
    let all = all_parts();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../web/tests/unit/light-growth");
    let call = call(all_paths(40), None);
    let [before, after] = [5, 7].map(|end| open_parts(&all.iter().rev().take(end).collect::<Vec<_>>(), true));
    let earlier = ask_since(&before, &call, None);
    let rows = EarlierRows { tag: "earlier".into(), identities: earlier.rows.unwrap() };
    let [full, difference] = [None, Some(&rows)].map(|earlier| ask_since(&after, &call, earlier).bytes);
    assert!(decode(&difference).header.get("since").is_some());
    for (name, bytes) in [("earlier", earlier.bytes), ("full", full), ("difference", difference)] {
        let file = folder.join(format!("{name}.bin"));
        if std::env::var_os("FEMC_WRITE_FIXTURES").is_some() {
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(&file, &bytes).unwrap();
        }
        let known = std::fs::read(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        assert!(known == bytes, "{}: run this test with FEMC_WRITE_FIXTURES=1", file.display());
    }
}
