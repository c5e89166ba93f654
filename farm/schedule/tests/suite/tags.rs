//! Truth table of tags: a worker gets a task if it has each tag of the job and each tag of the stage. The table compares sets of
//! bits.

use crate::common::{TestFarm, config, job_with_graph};
use femc_model::*;
use femc_schedule::Config;

/// Tags that are easily confused.
const TAGS: [&str; 3] = ["lab", "lab2", "Lab"];

fn tags(set: usize) -> Vec<String> {
    (0..3).filter(|bit| set >> bit & 1 == 1).map(|bit| TAGS[bit].to_owned()).collect()
}

/// Lets workers with these tags work until nothing is left to do. Returns the numbers of finished renders and images.
fn finished(job_tags: usize, stage_tags: usize, workers: &[usize]) -> [usize; 2] {
    let mut farm = TestFarm::with_config(Config { prefetch: 0, ..config() });
    let stage = |kind, tasks, made: Role| StageTemplate::new(kind, Scope::Frame, tasks, &[made]);
    let render = stage(StageKind::Render, TaskSizes::even(2, 64), Role::Tile).with_steps(&[4]);
    let image = stage(StageKind::Image, TaskSizes::even(1, 1), Role::Image);
    let mut image = image.with_input(0, Role::Tile, Reach::All).with_loop(0, 1);
    image.tags = tags(stage_tags);
    let graph = Graph { stages: vec![render, image] };
    farm.submit(JobSpec { tags: tags(job_tags), ..job_with_graph(&[1], 2, graph) });
    for (worker, set) in (1..).zip(workers) {
        farm.join_with(worker, tags(*set));
    }
    let mut counts = [0; 2];
    while let Some((worker, held)) = farm.leases.first().cloned() {
        let is_render = held.task.stage.kind == StageKind::Render;
        let needed = if is_render { job_tags } else { job_tags | stage_tags };
        assert_eq!(workers[worker.0 as usize - 1] & needed, needed, "{} on a worker without its tags", held.task);
        counts[usize::from(!is_render)] += 1;
        farm.complete(worker.0, &held, Decision::Done);
    }
    counts
}

#[test]
fn one_worker_takes_what_its_tags_allow() {
    for job in 0..8usize {
        for stage in 0..8usize {
            for worker in 0..8usize {
                let has = |needed: usize| worker & needed == needed;
                let expected = [if has(job) { 2 } else { 0 }, usize::from(has(job) && has(stage))];
                assert_eq!(finished(job, stage, &[worker]), expected, "{job:03b} {stage:03b} on {worker:03b}");
            }
        }
    }
}

#[test]
fn tags_of_two_workers_do_not_add_up() {
    for job in 0..8usize {
        for first in 0..8usize {
            for second in 0..8usize {
                let has = |needed: usize| [first, second].iter().any(|worker| worker & needed == needed);
                let stage = 0b010;
                let expected = [if has(job) { 2 } else { 0 }, usize::from(has(job | stage))];
                assert_eq!(finished(job, stage, &[first, second]), expected, "{job:03b} on {first:03b}, {second:03b}");
            }
        }
    }
}
