//! Graphs for tests and benchmarks. An engine's plan makes its own graphs.

use crate::{Graph, Need, Reach, Role, Round, Scope, StageKind, StageTemplate, TaskSizes};

/// Makes a graph of tiles that are rendered in rounds until the image task ends the loop.
/// - `tiles`: the tiles, with units per step.
/// - `fan`: number of tiles in a group that is reduced before the image; 0: the image reads tiles.
pub fn frame_graph(tiles: TaskSizes, rounds: &[u32], fan: u32) -> Graph {
    let carried = Need { stage: 1, role: Role::Sums, reach: Reach::Same, round: Round::Previous, gaps: false };
    let with_sums = |mut template: StageTemplate| {
        if rounds.len() > 1 {
            template.outputs.push(Role::Sums);
            template.needs.push(carried);
        }
        template
    };
    let groups = TaskSizes::even(tiles.tasks().div_ceil(fan.max(1)), 1);
    let render = StageTemplate::new(StageKind::Render, Scope::Frame, tiles, &[Role::Tile]).with_steps(rounds);
    let image =
        StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image, Role::Preview]);
    let image = image.with_loop(0, rounds.len() as u32);
    if fan == 0 {
        return Graph { stages: vec![render, with_sums(image.with_input(0, Role::Tile, Reach::All))] };
    }
    let reduce = StageTemplate::new(StageKind::Reduce, Scope::Frame, groups, &[Role::Pixels]);
    let reduce = with_sums(reduce.with_input(0, Role::Tile, Reach::Fan(fan)));
    Graph { stages: vec![render, reduce, image.with_input(1, Role::Pixels, Reach::All)] }
}
