use super::*;

/// Creates a field with one of everything.
fn one_of_everything() -> Field {
    let v = |k: f32| Vec3A::new(k, -k, 0.5 * k);
    let pose = Affine3A { matrix3: Mat3A::from_diagonal(v(2.0).into()), translation: v(7.0) };
    let facing = Facing::Inward;
    let curved = |shape| Form::Curved { shape, pose };
    let forms = [
        Form::Triangle([v(1.0), v(2.0), v(-0.0)]),
        Form::Parallelogram([v(3.0), v(f32::MIN_POSITIVE / 4.0), v(5.0)]),
        curved(Quadric::Sphere { center: v(1.0), radius: 2.0, facing }),
        curved(Quadric::Cone { start: v(1.0), end: v(2.0), start_radius: 0.1, end_radius: 0.0, facing }),
        curved(Quadric::Ring { center: v(1.0), normal: v(9.0), inner: 0.0, outer: 4.0 }),
        curved(Quadric::Torus { center: v(1.0), axis: v(2.0), major: 3.0, minor: 1.0, facing: Facing::Outward }),
    ];
    let surface = |(k, form): (u32, Form)| {
        let side = if k % 2 == 0 { Side::Front } else { Side::Back };
        Surface { instance: k / 4, primitives: [k % 4 / 2, k % 2], material: 3 * k, side, form }
    };
    let outline = |k: f32| Outline { corner: Vec2::new(k, 0.1), edges: [Vec2::X, Vec2::new(0.3, k)] };
    let cell = |split, next| Cell { outline: outline(next as f32), split, next };
    let (none, half) = (Split::None, Split::Half(1));
    let of_fog = |sigma_s| {
        let mean = [Vec3A::splat(9.0), v(2.0), v(3.0), v(-1.0)];
        let anisotropy = Vec3A::new(0.5, -1.0, 0.25);
        FogCell::Leaf(FogLeaf {
            mean,
            anisotropy,
            sigma_s: Vec3A::splat(sigma_s),
            sigma_t: Vec3A::new(0.5, 0.25, 1e-9),
        })
    };
    let fog = [
        FogCell::Split { axis: 1, at: 0.5 },
        of_fog(0.0),
        FogCell::Split { axis: 2, at: -1.0 },
        of_fog(0.5),
        of_fog(1.0),
    ];
    let fog = FogTree::new([Vec3A::NEG_ONE, Vec3A::ONE], &fog).expect("boxes of fog");
    let cells =
        vec![cell(half, 1), cell(none, 0), cell(none, 1), cell(Split::Bisection, 4), cell(none, 2), cell(none, 2)];
    let leaves = vec![
        Leaf::Curved(Harmonics([v(1.0); 9])),
        Leaf::Triangle([v(1.0), v(f32::INFINITY), v(3.0)]),
        Leaf::Rectangle([v(1.0), v(2.0), v(3.0), v(4.0)]),
    ];
    let direct = vec![
        Leaf::Curved(Harmonics([v(0.25); 9])),
        Leaf::Triangle([v(0.5); 3]),
        Leaf::Rectangle([v(0.0), v(8.0), v(1.0), v(4.0)]),
    ];
    let roots = vec![0, NONE, 3, 5, NONE, 0];
    let table = |extent, cell: usize| {
        let mut light = [1.0; TABLE_CELLS];
        light[cell] = 100.0;
        DirectionTable::new(extent, &light)
    };
    let leaf_tables = vec![None, table(TableExtent::Hemisphere(Vec3A::Y), 7), None];
    let fog_tables = fog.leaves().map(|leaf| table(TableExtent::Sphere, leaf.sigma_s.x as usize)).collect();
    let tables = DirectionTables::new(leaf_tables, fog_tables);
    Field {
        surfaces: (0..).zip(forms).map(surface).collect(),
        roots,
        cells,
        direct,
        leaves,
        errors: vec![0.0, 1.5, 0.25],
        tables,
        sides: vec![vec![[0, 1], [2, NONE]], vec![[4, NONE], [NONE, 5]], vec![]],
        fog,
    }
}

const STATISTICS: SolveStatistics = SolveStatistics {
    elements: 1,
    leaves: 2,
    links: u64::MAX,
    lamp_links: 4,
    inexact_links: 5,
    rays: 6,
    iterations: 7,
    bytes: 8,
    residual: 1e-5,
};

#[test]
fn a_field_comes_back_to_the_bit() {
    for field in [Field::default(), one_of_everything()] {
        let bytes = field.encode(&STATISTICS);
        let (again, statistics) = Field::decode(&bytes).unwrap();
        assert_eq!(format!("{again:?}"), format!("{field:?}"));
        assert_eq!(statistics, STATISTICS);
        assert!(again.encode(&statistics) == bytes, "the same field, the same bytes");
    }
}

#[test]
fn a_damaged_byte_is_found_and_another_version_is_named() {
    let bytes = one_of_everything().encode(&STATISTICS);
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x10;
        assert!(Field::decode(&damaged).is_err(), "byte {at}");
        assert!(Field::decode(&bytes[..at]).is_err(), "the first {at} bytes");
    }
    let mut newer = bytes;
    newer[8] = 9;
    assert_eq!(Field::decode(&newer).err(), Some(FieldError::Version { found: 9, expected: 8 }));
}

#[test]
fn indices_that_lead_astray_are_refused() {
    let refused = |change: fn(&mut Field)| {
        let mut field = one_of_everything();
        change(&mut field);
        Field::decode(&field.encode(&STATISTICS)).is_err()
    };
    assert!(refused(|field| field.cells[0].next = 0), "a cell in itself");
    assert!(refused(|field| field.cells[3].next = 5), "half of a pair");
    assert!(refused(|field| field.cells[1].next = 3), "no such leaf");
    assert!(refused(|field| field.roots[0] = 6), "no such cell");
    assert!(refused(|field| field.sides[0][0][0] = 6), "no such surface");
    assert!(refused(|field| field.surfaces[0].primitives[1] = 2), "no such primitive");
    assert!(refused(|field| field.surfaces[0].instance = 3), "no such instance");
    assert!(!refused(|_| ()));
}

/// Tables for other numbers of leaves, and a table that is no distribution.
#[test]
fn tables_of_directions_that_do_not_fit_are_refused() {
    let table = || DirectionTable::new(TableExtent::Sphere, &[1.0; TABLE_CELLS]);
    let decode = |leaves: usize, fog: usize| {
        let tables = DirectionTables::new(vec![table(); leaves], vec![table(); fog]);
        Field::decode(&Field { tables, ..one_of_everything() }.encode(&STATISTICS))
            .map(|(field, _)| field.tables.count())
    };
    assert_eq!(decode(3, 3), Ok([3, 3]));
    assert_eq!(decode(0, 0), Ok([0, 0]));
    assert!(decode(2, 3).is_err() && decode(3, 2).is_err() && decode(4, 0).is_err());
    let flat = Box::new([0.5; TABLE_CELLS]);
    assert!(DirectionTable::from_sums(TableExtent::Sphere, flat).is_none());
    let rising = Box::new(std::array::from_fn(|at| (at + 1) as f32 / TABLE_CELLS as f32));
    assert!(DirectionTable::from_sums(TableExtent::Hemisphere(Vec3A::X * 2.0), rising.clone()).is_none());
    assert!(DirectionTable::from_sums(TableExtent::Hemisphere(Vec3A::X), rising).is_some());
}

#[test]
fn a_field_fits_the_surfaces_that_it_was_made_of() {
    let field = one_of_everything();
    assert!(field.matches_primitives([2, 2, 0].into_iter()));
    assert!(!field.matches_primitives([2, 2].into_iter()) && !field.matches_primitives([2, 1, 0].into_iter()));
}

#[test]
fn errors_are_numbers_of_at_least_0_one_for_each_leaf() {
    for errors in [vec![0.0, f32::NAN, 0.0], vec![0.0, -1.0, 0.0], vec![f32::INFINITY; 3], vec![0.0; 2]] {
        let bytes = Field { errors, ..one_of_everything() }.encode(&STATISTICS);
        assert!(matches!(Field::decode(&bytes), Err(FieldError::Corrupt(_))));
    }
    let bytes = Field { errors: Vec::new(), ..one_of_everything() }.encode(&STATISTICS);
    assert!(Field::decode(&bytes).is_ok_and(|(field, _)| field.errors.is_empty()));
}

#[test]
fn direct_light_is_of_the_kinds_of_the_leaves_or_absent() {
    let decode = |change: fn(&mut Vec<Leaf>)| {
        let mut field = one_of_everything();
        change(&mut field.direct);
        Field::decode(&field.encode(&STATISTICS)).map(|(field, _)| field.direct.len())
    };
    assert!(matches!(decode(|direct| direct.swap(0, 1)), Err(FieldError::Corrupt(_))));
    assert!(matches!(decode(|direct| direct.truncate(2)), Err(FieldError::Corrupt(_))));
    assert_eq!(decode(Vec::clear), Ok(0));
}
