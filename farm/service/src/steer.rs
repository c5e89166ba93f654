//! What people do to jobs, by whichever way.

use std::collections::BTreeSet;

use femc_model::{Control, Digest, JobId, JobState, Refusal};
use femc_store::{Soundness, Store, StoreError};

use crate::access::Caller;
use crate::call::Call;
use crate::farm::Farm;

impl<S> Farm<S> {
    /// Steers a job: a submitter one of its own, others need an operator. Before a retry of a job that is done its images are read,
    /// before one of single frames theirs: those that are damaged or gone are its business again.
    pub async fn steer(
        &self,
        store: &Store,
        caller: Option<&Caller>,
        job: JobId,
        control: Control,
    ) -> Result<(), Refusal> {
        if let Some(caller) = caller {
            caller.may_steer(&self.ask(|reply| Call::Status { job, reply }).await?.owner)?;
        }
        match &control {
            Control::Retry => {
                if self.ask(|reply| Call::Status { job, reply }).await?.state == JobState::Done {
                    self.look_at_images(store, job, |_| true).await?;
                }
            }
            Control::RetryFrames(frames) => {
                let frames: BTreeSet<u32> = frames.iter().copied().collect();
                self.look_at_images(store, job, |frame| frames.contains(&frame)).await?;
            }
            Control::Pause | Control::Resume | Control::Cancel | Control::Priority(_) => {}
        }
        self.ask(|reply| Call::Control { job, control, reply }).await
    }

    async fn look_at_images(&self, store: &Store, job: JobId, is_meant: impl Fn(u32) -> bool) -> Result<(), Refusal> {
        let frames = self.ask(|reply| Call::Frames { job, reply }).await?;
        for frame in frames.into_iter().filter(|frame| is_meant(frame.frame)) {
            for digest in frame.outputs.iter().map(|output| output.artifact.digest) {
                let found = store.verify(&digest).await.map_err(|error| store_refusal(&error))?;
                if !matches!(found, Soundness::Sound(_)) {
                    self.lost(digest).await;
                }
            }
        }
        Ok(())
    }

    /// An artifact that was wanted is not there, or was damaged: whoever made it makes it again.
    pub async fn lost(&self, digest: Digest) {
        if let Err(refusal) = self.ask(|reply| Call::Lost { digest, reply }).await {
            // Whoever asks for it next finds the same.
            tracing::warn!(%digest, %refusal, "an artifact is lost, and its job does not know");
        }
    }
}

/// What the store says, as a refusal.
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
