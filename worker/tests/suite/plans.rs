//! Tests that a scheduler can run the graphs that the engine plans.

use std::num::NonZeroU32;

use femc_film::Tiling;
use femc_graph::tag;
use femc_model::{Graph, Grid, check_graph};
use femc_pipeline::{Method, job_graph, split_first_pass, with_layers, with_statistics};

fn have_tags(graph: &Graph, tags: &[&str]) -> bool {
    graph.stages.iter().all(|stage| tags.iter().all(|tag| stage.tags.iter().any(|own| own == tag)))
}

#[test]
fn planned_graphs_are_valid_and_have_the_tags_of_their_kinds() {
    for film in [[1, 1], [16, 12], [100, 50], [640, 512]] {
        for rounds in [&[4][..], &[4, 8, 16]] {
            for fan in [1, 3, 4, 1000].map(|fan| NonZeroU32::new(fan).unwrap()) {
                let tiling = Tiling::new(film[0], film[1], 16).unwrap();
                for method in [Method::Pt, Method::Fem, Method::Femc] {
                    let case = format!("{film:?} {rounds:?} {fan} {method:?}");
                    let check = |graph: &Graph| assert_eq!(check_graph(graph), Ok(()), "{case}");
                    let graph = job_graph(&tiling, rounds, fan, method);
                    check(&graph);
                    let (number, main) = graph.main_stage().unwrap();
                    assert_eq!((&main.sizes, &main.steps[..]), (&Grid { film, tile: 16 }.sizes(), rounds));
                    assert_eq!(graph.reads_content(number), method.has_first_pass());
                    let tags: &[&str] = match method {
                        Method::Femc => &[tag::FIRST_PASS, tag::TARGETS],
                        _ if method.has_first_pass() => &[tag::FIRST_PASS],
                        _ => &[],
                    };
                    assert!(graph.stages.iter().all(|stage| stage.tags == tags), "{case}");
                    let recorded = with_statistics(graph.clone());
                    check(&recorded);
                    assert!(have_tags(&recorded, &[tag::STATISTICS]), "{case}");
                    for count in [1, 20] {
                        let layered = with_layers(graph.clone(), &tiling, count);
                        check(&layered);
                        assert!(have_tags(&layered, &[tag::LAYERS, tag::FEATURES]), "{case}");
                    }
                    let split = split_first_pass(graph, method, 5);
                    check(&split);
                    assert!(
                        split
                            .main_stage()
                            .is_some_and(|(number, _)| { split.reads_content(number) == method.has_first_pass() })
                    );
                    assert!(!method.has_first_pass() || have_tags(&split, &[tag::FIRST_PASS, tag::TASK_KINDS]));
                }
            }
        }
    }
}
