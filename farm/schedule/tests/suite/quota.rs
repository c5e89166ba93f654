//! Tests of the quota of an owner.

use crate::common::{TestFarm, config, job};
use femc_model::{Control, JobId, JobSpec, Refusal};
use femc_schedule::{Answer, Command, Config, Event, Quota, RequestId};

fn job_of(owner: &str, frames: &[u32], tiles: u32) -> JobSpec {
    JobSpec { owner: owner.into(), ..job(frames, tiles, &[4]) }
}

fn answer_to(farm: &mut TestFarm, event: Event) -> Result<JobId, Refusal> {
    let now = farm.now;
    let answers = farm.scheduler.handle(event, now).into_iter().find_map(|command| match command {
        Command::Answer { answer, .. } => Some(answer),
        _ => None,
    });
    answers.expect("an answer").map(|answer| match answer {
        Answer::Submitted(job) | Answer::Controlled(job) => job,
    })
}

fn submit(farm: &mut TestFarm, spec: JobSpec) -> Result<JobId, Refusal> {
    answer_to(farm, Event::Submitted { request: RequestId(1), key: None, spec: Box::new(spec), date: None })
}

fn is_refused(outcome: &Result<JobId, Refusal>, limit: u64) -> bool {
    matches!(outcome, Err(Refusal::TooLarge { limit: reported, .. }) if *reported == limit)
}

#[test]
fn quota_limits_jobs_frames_and_tasks_until_jobs_end() {
    let quota = Quota { jobs: 3, frames: 10, tasks: 48 };
    let mut farm = TestFarm::with_config(Config { quota, ..config() });
    let first = submit(&mut farm, job_of("ann", &[1, 2], 5)).unwrap();
    submit(&mut farm, job_of("ann", &[1], 5)).unwrap();
    assert!(is_refused(&submit(&mut farm, job_of("ann", &[1, 2, 3, 4, 5, 6, 7, 8], 1)), 10), "frames");
    assert!(is_refused(&submit(&mut farm, job_of("ann", &[1, 2, 3, 4, 5], 6)), 48), "tasks");
    submit(&mut farm, job_of("ann", &[1], 5)).unwrap();
    assert!(is_refused(&submit(&mut farm, job_of("ann", &[1], 1)), 3), "jobs");
    submit(&mut farm, job_of("bob", &[1], 1)).unwrap();
    let control = Event::Controlled { request: RequestId(2), job: first, control: Control::Cancel };
    answer_to(&mut farm, control).unwrap();
    submit(&mut farm, job_of("ann", &[1], 1)).unwrap();
}

#[test]
fn the_same_submission_again_is_the_same_job_at_the_limit_too() {
    let mut farm = TestFarm::with_config(Config { quota: Quota { jobs: 1, ..Quota::default() }, ..config() });
    let again = |farm: &mut TestFarm, key: &str| {
        let spec = Box::new(job_of("ann", &[1], 1));
        answer_to(farm, Event::Submitted { request: RequestId(1), key: Some(key.into()), spec, date: None })
    };
    let first = again(&mut farm, "a").unwrap();
    assert_eq!(again(&mut farm, "a"), Ok(first));
    assert!(is_refused(&again(&mut farm, "b"), 1));
    assert!(is_refused(&again(&mut farm, &"x".repeat(1025)), 1024));
    let mut farm = TestFarm::new();
    assert!(again(&mut farm, &"x".repeat(1024)).is_ok(), "as long as it may be");
}
