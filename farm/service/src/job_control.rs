//! Actions of users on jobs, independent of the protocol.

use std::collections::BTreeSet;

use bytes::Bytes;
use femc_model::{Control, Digest, JobId, JobState, Refusal};
use femc_store::{Integrity, Store, StoreError};

use crate::access::Caller;
use crate::call::Call;
use crate::farm::Farm;

/// Meaning of an output that is not in the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MissingOutput {
    /// The output is lost: its frame is finished.
    Lost,
    /// Later outputs may have replaced it: its frame is in progress.
    Replaced,
}

impl<S> Farm<S> {
    /// Controls a job. Submitters may control their own jobs; other jobs need an operator. Before a retry of a finished job, its
    /// images are read; before a retry of single frames, the images of these frames. The job then recreates damaged or missing
    /// images.
    pub async fn control_job(
        &self,
        store: &Store,
        caller: Option<&Caller>,
        job: JobId,
        control: Control,
    ) -> Result<(), Refusal> {
        if let Some(caller) = caller {
            caller.check_may_control(&self.call(|reply| Call::Status { job, reply }).await?.owner)?;
        }
        match &control {
            Control::Retry => {
                if self.call(|reply| Call::Status { job, reply }).await?.state == JobState::Done {
                    self.verify_images(store, job, |_| true).await?;
                }
            }
            Control::RetryFrames(frames) => {
                let frames: BTreeSet<u32> = frames.iter().copied().collect();
                // If the job lacks one of the frames, no image is read, and the control is refused below.
                let own = self.call(|reply| Call::Shape { job, reply }).await?.spec.frames;
                if frames.iter().all(|frame| own.contains(frame)) {
                    self.verify_images(store, job, |frame| frames.contains(&frame)).await?;
                }
            }
            Control::Pause | Control::Resume | Control::Cancel | Control::Priority(_) | Control::Delete => {}
        }
        self.call(|reply| Call::Control { job, control, reply }).await
    }

    async fn verify_images(&self, store: &Store, job: JobId, is_selected: impl Fn(u32) -> bool) -> Result<(), Refusal> {
        let frames = self.call(|reply| Call::Frames { job, reply }).await?;
        for frame in frames.into_iter().filter(|frame| is_selected(frame.frame)) {
            for digest in frame.outputs.iter().map(|output| output.artifact.digest) {
                let found = store.verify(&digest).await.map_err(|error| store_refusal(&error))?;
                if !matches!(found, Integrity::Intact(_)) {
                    self.report_lost(digest).await;
                }
            }
        }
        Ok(())
    }

    /// Reads an output of a frame. A lost output is reported, so that its task makes it again.
    /// The result is `None` if the output was replaced.
    pub(crate) async fn read_output(
        &self,
        store: &Store,
        digest: Digest,
        if_missing: MissingOutput,
    ) -> Result<Option<Bytes>, Refusal> {
        match store.get(&digest).await {
            Ok(bytes) => Ok(Some(bytes)),
            Err(StoreError::Missing { .. }) if if_missing == MissingOutput::Replaced => Ok(None),
            Err(error) => {
                if matches!(error, StoreError::Missing { .. } | StoreError::Mismatch { .. }) {
                    self.report_lost(digest).await;
                }
                Err(store_refusal(&error))
            }
        }
    }

    /// Reports that an artifact is missing or damaged. Its task recreates it.
    pub async fn report_lost(&self, digest: Digest) {
        if let Err(refusal) = self.call(|reply| Call::ArtifactLost { digest, reply }).await {
            // The next reader of the artifact will report it again.
            tracing::warn!(%digest, %refusal, "an artifact is lost, but the job did not receive the report");
        }
    }
}

/// Converts an error of the store to a refusal.
pub fn store_refusal(error: &StoreError) -> Refusal {
    match error {
        StoreError::Missing { digest } => Refusal::NoSuchArtifact { digest: *digest },
        StoreError::Mismatch { announced, .. } => Refusal::DigestMismatch { digest: *announced },
        StoreError::TooLarge { limit } => Refusal::ArtifactTooLarge { limit: *limit },
        StoreError::Medium { .. } | StoreError::Url { .. } | StoreError::Unsound { .. } => {
            Refusal::Unavailable { message: error.to_string() }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use femc_model::{ChunkSize, Graph, Grid, JobNotes, JobSpec};
    use tokio::sync::mpsc;

    use super::*;
    use crate::call::JobShape;

    #[tokio::test]
    async fn unknown_frames_are_refused_before_any_image_is_read() {
        let (calls, mut inbox) = mpsc::channel::<Call<()>>(8);
        let read = Arc::new(AtomicUsize::new(0));
        let reads = read.clone();
        tokio::spawn(async move {
            while let Some(call) = inbox.recv().await {
                match call {
                    Call::Shape { reply, .. } => {
                        let spec = JobSpec {
                            name: "fog".into(),
                            bundle: Digest::compute(b"bundle"),
                            entry: "fog.mgf".into(),
                            settings: "{}".into(),
                            frames: vec![3, 4],
                            grid: Grid { film: [8, 8], tile: 8 },
                            graph: Graph::default(),
                            contents: Vec::new(),
                            priority: 50,
                            owner: "me".into(),
                            tags: Vec::new(),
                            notes: JobNotes::default(),
                        };
                        drop(reply.send(Ok(JobShape { spec: Box::new(spec), chunk_size: ChunkSize::Whole })));
                    }
                    Call::Frames { reply, .. } => {
                        reads.fetch_add(1, Ordering::Relaxed);
                        drop(reply.send(Ok(Vec::new())));
                    }
                    Call::Control { job, reply, .. } => drop(reply.send(Err(Refusal::Ended { job }))),
                    other => panic!("nobody asks {other:?}"),
                }
            }
        });
        let (farm, store) = (Farm::new(calls), Store::in_memory());
        for (frames, looks) in [(vec![3, 5], 0), (vec![3, 4], 1)] {
            let steered = farm.control_job(&store, None, JobId(7), Control::RetryFrames(frames)).await;
            assert_eq!(steered, Err(Refusal::Ended { job: JobId(7) }), "the coordinator has the word");
            assert_eq!(read.load(Ordering::Relaxed), looks);
        }
    }
}
