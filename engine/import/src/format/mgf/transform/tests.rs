use super::{super::lexer::Lexer, *};

fn spec(text: &str) -> Result<TransformSpec> {
    let text = format!("xf {text}");
    let mut tokens = Vec::new();
    Lexer::new(text.as_bytes()).next_line(&mut tokens).unwrap();
    let find = |name: &str| match name {
        "p" => Ok(PathId(0)),
        _ => Err(undefined_path(name, vec![])),
    };
    parse(Args::new("t.mgf", 0, &tokens).tail(0), &find)
}

fn at(t: &Transform, x: f64, y: f64, z: f64) -> [f64; 3] {
    t.transform_point3(DVec3::new(x, y, z)).to_array()
}

#[test]
fn arguments_apply_left_to_right() {
    assert_eq!(at(&spec("-t 1 0 0 -rz 90").unwrap().baked, 0.0, 0.0, 0.0), [0.0, 1.0, 0.0]);
    assert_eq!(at(&spec("-rz 90 -t 1 0 0").unwrap().baked, 1.0, 0.0, 0.0), [1.0, 1.0, 0.0]);
    assert_eq!(at(&spec("-s 2 -t 1 0 0").unwrap().baked, 1.0, 1.0, 0.0), [3.0, 2.0, 0.0]);
}

#[test]
fn rotations_are_counterclockwise_and_exact_at_right_angles() {
    assert_eq!(at(&spec("-rx 90").unwrap().baked, 0.0, 1.0, 0.0), [0.0, 0.0, 1.0]);
    assert_eq!(at(&spec("-ry 90").unwrap().baked, 0.0, 0.0, 1.0), [1.0, 0.0, 0.0]);
    assert_eq!(at(&spec("-rz -270").unwrap().baked, 1.0, 0.0, 0.0), [0.0, 1.0, 0.0]);
    let [x, y, _] = at(&spec("-rz 30").unwrap().baked, 1.0, 0.0, 0.0);
    assert!((x - 0.75f64.sqrt()).abs() < 1e-15 && (y - 0.5).abs() < 1e-15);
}

#[test]
fn a_repetition_takes_all_arguments_up_to_the_next_one() {
    let spec = spec("-i 3 -t 1 0 0 -s 2 -i 1 -t 0 0 5").unwrap();
    assert_eq!(at(&spec.baked, 0.0, 0.0, 0.0), [14.0, 0.0, 5.0]);
    assert!(spec.layers.is_empty());
}

#[test]
fn no_repetitions_are_the_identity() {
    assert_eq!(spec("-i 0 -t 1 0 0").unwrap().baked, Transform::IDENTITY);
}

#[test]
fn a_power_equals_repeated_application() {
    let t = spec("-rz 10 -t 1 2 3").unwrap().baked;
    let slow = (0..13).fold(Transform::IDENTITY, |done, _| t * done);
    assert!(power(t, 13).abs_diff_eq(slow, 1e-12));
}

#[test]
fn arrays_become_layers_and_what_is_before_them_is_baked() {
    let spec = spec("-t 1 0 0 -a 3 -t 0 1 0 -a 2 -t 0 0 1 -i 1 -s 2").unwrap();
    assert_eq!(at(&spec.baked, 0.0, 0.0, 0.0), [1.0, 0.0, 0.0]);
    assert_eq!(spec.layers.iter().map(|layer| layer.count).collect::<Vec<_>>(), [3, 2]);
    let place = |layer: &InstanceLayer, k| Motion { steps: layer.motion(k) }.as_static().unwrap();
    let both = place(&spec.layers[1], 1) * place(&spec.layers[0], 2) * spec.baked;
    assert_eq!(at(&both, 0.0, 0.0, 0.0), [2.0, 4.0, 2.0]);
}

#[test]
fn an_array_of_one_is_no_array() {
    assert!(spec("-a 1 -t 1 0 0").unwrap().layers.is_empty());
}

#[test]
fn path_takes_surrounding_steps_and_joins_the_next_array() {
    let spec = spec("-t 1 0 0 -path p -rz 90 -a 2 -t 5 0 0").unwrap();
    let [layer] = &spec.layers[..] else { panic!("one layer") };
    assert_eq!(layer.count, 2);
    assert_eq!(layer.motion(0).len(), 2);
    assert_eq!(layer.motion(0)[0], MotionStep::Along(PathId(0)));
    assert_eq!(layer.motion(1).len(), 2, "rotation and copy become one step");
}

#[test]
fn paths_inside_arrays_are_repeated_within_bounds() {
    assert_eq!(spec("-a 3 -path p").unwrap().layers[0].motion(2).len(), 2);
    assert!(matches!(*spec("-a 200 -path p").unwrap_err().fault, ImportFault::TooMany { .. }));
    assert!(matches!(*spec("-i 10000000 -path p").unwrap_err().fault, ImportFault::TooMany { .. }));
}

#[test]
fn bad_arguments_name_their_column() {
    for (text, column) in [("-t 1 2", 4), ("-q", 4), ("-s 0", 7), ("-a 0", 7), ("-rz x", 8), ("-path q", 10)] {
        assert_eq!(spec(text).unwrap_err().at.column, column, "{text}");
    }
    assert!(matches!(*spec("-i 5000 -s 10").unwrap_err().fault, ImportFault::NotFinite { .. }));
}
