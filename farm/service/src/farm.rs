//! Client side of the coordinator.

use std::fmt;

use femc_model::{FrameRecord, JobId, Refusal};
use tokio::sync::{OwnedMutexGuard, mpsc, oneshot};

use crate::call::{Call, JobShape, Reply};
use crate::times::{JobTimes, TimesCache};

/// Handle to the coordinator. Clones refer to the same one.
pub struct Farm<S> {
    calls: mpsc::Sender<Call<S>>,
    times: TimesCache,
}

impl<S> Clone for Farm<S> {
    fn clone(&self) -> Self {
        Self { calls: self.calls.clone(), times: self.times.clone() }
    }
}

impl<S> fmt::Debug for Farm<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Farm")
    }
}

impl<S> Farm<S> {
    /// Makes a handle from the sending end of the coordinator's queue.
    pub fn new(calls: mpsc::Sender<Call<S>>) -> Self {
        Self { calls, times: TimesCache::default() }
    }

    /// Sends a call and waits for its answer.
    pub async fn call<T>(&self, call: impl FnOnce(Reply<T>) -> Call<S>) -> Result<T, Refusal> {
        let stopping = || Refusal::Unavailable { message: "the coordinator is stopping".into() };
        let (reply, answer) = oneshot::channel();
        self.calls.send(call(reply)).await.map_err(|_| stopping())?;
        answer.await.map_err(|_| stopping())?
    }

    /// Returns the times of a job's ended attempts; `None`: there are more than [`TimesCache::MAX_ATTEMPTS`].
    pub async fn times(&self, job: JobId, shape: &JobShape) -> Result<Option<OwnedMutexGuard<JobTimes>>, Refusal> {
        self.times.get(self, job, shape).await
    }

    /// Returns the finished frames of a job with the times of their attempts.
    pub async fn frames_with_times(&self, job: JobId) -> Result<Vec<FrameRecord>, Refusal> {
        let shape = self.call(|reply| Call::Shape { job, reply }).await?;
        let mut frames = self.call(|reply| Call::Frames { job, reply }).await?;
        if let Some(times) = self.times(job, &shape).await? {
            frames.iter_mut().for_each(|record| record.times = times.frame(record.frame));
        }
        Ok(frames)
    }

    /// Sends a call whose answer takes another path. Returns false if the coordinator is stopping.
    pub async fn send(&self, call: Call<S>) -> bool {
        self.calls.send(call).await.is_ok()
    }

    /// Completes when the coordinator stops.
    pub async fn stopped(&self) {
        self.calls.closed().await;
    }
}
