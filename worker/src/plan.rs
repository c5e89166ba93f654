//! Translates the engine's plan into the farm's job graph.

use femc_model::{Graph, Loop, Need, Reach, Role, Round, Scope, StageKind, StageTemplate};
use femc_pipeline as engine;

/// Tag of workers that support first passes. Workers of earlier versions cannot read the graph of a job with a first pass, so all
/// stages of such a job require this tag.
pub const FIRST_PASS: &str = "first-pass";

/// Tag of workers that support first passes in blocks. All stages of a job that has them require it, as for [`FIRST_PASS`].
pub const FIRST_PASS_BLOCKS: &str = "first-pass-blocks";

/// Tag of workers that support light statistics. All stages of a job that has them require it, as for [`FIRST_PASS`].
pub const STATISTICS: &str = "statistics";

/// Tag of workers that support layers. All stages of a job that has them require it, as for [`FIRST_PASS`].
pub const LAYERS: &str = "layers";

/// Tag of workers that support features and the layer format with room for them. All stages of a job with layers require it.
pub const FEATURES: &str = "features";

/// Tag of workers that support painted styles. The stage that paints requires it.
pub const PAINTING: &str = "painting";

/// Translates the stages of a plan into a job's graph.
pub fn job_graph(stages: &[engine::Stage]) -> Graph {
    let has_first_pass = stages.iter().any(|stage| stage.kind == engine::StageKind::FirstPass);
    let has_blocks = stages.iter().any(|stage| stage.kind == engine::StageKind::FirstPassBlock);
    let has_statistics = stages.iter().any(|stage| stage.makes.contains(&engine::Role::Statistics));
    let has_layers = stages.iter().any(|stage| stage.makes.contains(&engine::Role::LayerImage));
    let known = [
        (has_first_pass, FIRST_PASS),
        (has_blocks, FIRST_PASS_BLOCKS),
        (has_statistics, STATISTICS),
        (has_layers, LAYERS),
        (has_layers, FEATURES),
    ];
    let tags: Vec<&str> = known.iter().filter(|it| it.0).map(|it| it.1).collect();
    Graph { stages: stages.iter().map(|stage| template(stage).with_tags(&tags)).collect() }
}

fn template(stage: &engine::Stage) -> StageTemplate {
    let engine::Stage { kind, scope, sizes, steps, needs, makes, closes } = stage;
    StageTemplate {
        kind: match kind {
            engine::StageKind::Render => StageKind::Render,
            engine::StageKind::Reduce => StageKind::Reduce,
            engine::StageKind::Decide => StageKind::Decide,
            engine::StageKind::Image => StageKind::Image,
            engine::StageKind::FirstPass => StageKind::FirstPass,
            engine::StageKind::FirstPassBlock => StageKind::FirstPassBlock,
        },
        scope: match scope {
            engine::Scope::Job => Scope::Job,
            engine::Scope::Frame => Scope::Frame,
            engine::Scope::Content => Scope::Content,
        },
        sizes: sizes.iter().copied().collect(),
        steps: steps.clone(),
        needs: needs.iter().map(need).collect(),
        hints: Vec::new(),
        outputs: makes.iter().map(role).collect(),
        closes: closes.map(|engine::Loop { first, rounds }| Loop { first, rounds }),
        options: String::new(),
        tags: Vec::new(),
    }
}

fn need(need: &engine::Need) -> Need {
    let &engine::Need { stage, role: of, reach, round } = need;
    Need {
        stage,
        role: role(&of),
        reach: match reach {
            engine::Reach::All => Reach::All,
            engine::Reach::Same => Reach::Same,
            engine::Reach::Fan(tasks) => Reach::Fan(tasks.get()),
        },
        round: match round {
            engine::Round::Same => Round::Same,
            engine::Round::Before => Round::Previous,
            engine::Round::Every => Round::Every,
        },
        gaps: false,
    }
}

fn role(role: &engine::Role) -> Role {
    match role {
        engine::Role::Tile => Role::Tile,
        engine::Role::Sums => Role::Sums,
        engine::Role::Pixels => Role::Pixels,
        engine::Role::Errors => Role::Errors,
        engine::Role::Stops => Role::Stops,
        engine::Role::Image => Role::Image,
        engine::Role::Preview => Role::Preview,
        engine::Role::Field => Role::Field,
        engine::Role::Paths => Role::Paths,
        engine::Role::Statistics => Role::Statistics,
        engine::Role::Elements => Role::Elements,
        engine::Role::Links => Role::Links,
        engine::Role::Rays => Role::Rays,
        engine::Role::Guides => Role::Guides,
        engine::Role::Layers => Role::Layers,
        engine::Role::LayerPixels => Role::LayerPixels,
        engine::Role::LayerImage => Role::LayerImage,
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU32;

    use femc_film::Tiling;
    use femc_model::Grid;

    use super::*;

    #[test]
    fn what_the_engine_plans_is_a_graph_that_can_be_run() {
        for film in [[1, 1], [16, 12], [100, 50], [640, 512]] {
            for rounds in [&[4][..], &[4, 8, 16]] {
                for fan in [1, 3, 4, 1000].map(|fan| NonZeroU32::new(fan).unwrap()) {
                    let tiling = Tiling::new(film[0], film[1], 16).unwrap();
                    for method in [engine::Method::Pt, engine::Method::Fem] {
                        let stages = engine::job_stages(&tiling, rounds, fan, method);
                        let with_statistics = job_graph(&engine::with_statistics_stages(stages.clone()));
                        assert_eq!(with_statistics.check(), Ok(()), "{film:?} {rounds:?} {fan} {method:?}");
                        let has_tag = |stage: &StageTemplate| stage.tags.iter().any(|tag| tag == STATISTICS);
                        assert!(with_statistics.stages.iter().all(has_tag));
                        for count in [1, 20] {
                            let with_layers = job_graph(&engine::with_layer_stages(stages.clone(), &tiling, count));
                            assert_eq!(with_layers.check(), Ok(()), "{film:?} {rounds:?} {fan} {method:?}");
                            assert!(with_layers.stages.iter().all(|stage| stage.tags.iter().any(|tag| tag == LAYERS)));
                        }
                        let cut = job_graph(&engine::split_first_pass(stages.clone(), method, 5));
                        let graph = job_graph(&stages);
                        assert_eq!(graph.check(), Ok(()), "{film:?} {rounds:?} {fan} {method:?}");
                        let (number, main) = graph.main_stage().unwrap();
                        assert_eq!((&main.sizes, &main.steps[..]), (&Grid { film, tile: 16 }.sizes(), rounds));
                        assert_eq!(graph.reads_content(number), method.has_first_pass());
                        let tags: &[&str] = if method.has_first_pass() { &[FIRST_PASS] } else { &[] };
                        assert!(graph.stages.iter().all(|stage| stage.tags == tags), "{method:?}");
                        if method.has_first_pass() {
                            assert_eq!(cut.check(), Ok(()), "{film:?} {rounds:?} {fan} {method:?}");
                            let tags = [FIRST_PASS, FIRST_PASS_BLOCKS];
                            assert!(cut.stages.iter().all(|stage| stage.tags == tags), "{method:?}");
                            assert!(cut.main_stage().is_some_and(|(number, _)| cut.reads_content(number)));
                        }
                    }
                }
            }
        }
    }
}
