//! The farm as those see it who ask it.

use std::fmt;

use femc_model::Refusal;
use tokio::sync::{mpsc, oneshot};

use crate::call::{Call, Reply};

/// The way to the coordinator; clones lead to the same one.
pub struct Farm<S>(mpsc::Sender<Call<S>>);

impl<S> Clone for Farm<S> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<S> fmt::Debug for Farm<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Farm")
    }
}

impl<S> Farm<S> {
    /// Over this queue.
    pub fn new(calls: mpsc::Sender<Call<S>>) -> Self {
        Self(calls)
    }

    /// Passes a call on and waits for its answer.
    pub async fn ask<T>(&self, call: impl FnOnce(Reply<T>) -> Call<S>) -> Result<T, Refusal> {
        let stopping = || Refusal::Unavailable { message: "the coordinator is stopping".into() };
        let (reply, answer) = oneshot::channel();
        self.0.send(call(reply)).await.map_err(|_| stopping())?;
        answer.await.map_err(|_| stopping())?
    }

    /// Passes on a call that is answered in another way; false: the coordinator is stopping.
    pub async fn tell(&self, call: Call<S>) -> bool {
        self.0.send(call).await.is_ok()
    }

    /// Ends when the coordinator does.
    pub async fn ended(&self) {
        self.0.closed().await;
    }
}
