//! Type-erased log, so that the coordinator is compiled once and not once per kind of log.

use std::fs::File;
use std::future::Future;
use std::pin::Pin;

use femc_queue::{Batch, LogContents, NotePage, Queue, QueueError};

type QueueFuture<'a, T> = Pin<Box<dyn Future<Output = Result<T, QueueError>> + Send + 'a>>;

/// [`Queue`] with boxed futures.
trait DynQueue: Send {
    fn load(&mut self) -> QueueFuture<'_, LogContents>;
    fn append<'a>(&'a mut self, batch: Batch<'a>) -> QueueFuture<'a, ()>;
    fn snapshot<'a>(&'a mut self, state: &'a [u8]) -> QueueFuture<'a, ()>;
    fn reserve(&mut self, min_incarnation: u32) -> QueueFuture<'_, u32>;
    fn notes(&mut self, subject: u64, from: u64) -> QueueFuture<'_, NotePage>;
    fn check(&mut self) -> Result<(), QueueError>;
    fn copy(&mut self) -> QueueFuture<'_, File>;
    fn close(self: Box<Self>) -> QueueFuture<'static, ()>;
}

impl<Q: Queue> DynQueue for Q {
    fn load(&mut self) -> QueueFuture<'_, LogContents> {
        Box::pin(Queue::load(self))
    }

    fn append<'a>(&'a mut self, batch: Batch<'a>) -> QueueFuture<'a, ()> {
        Box::pin(Queue::append(self, batch))
    }

    fn snapshot<'a>(&'a mut self, state: &'a [u8]) -> QueueFuture<'a, ()> {
        Box::pin(Queue::snapshot(self, state))
    }

    fn reserve(&mut self, min_incarnation: u32) -> QueueFuture<'_, u32> {
        Box::pin(Queue::reserve(self, min_incarnation))
    }

    fn notes(&mut self, subject: u64, from: u64) -> QueueFuture<'_, NotePage> {
        Box::pin(Queue::notes(self, subject, from))
    }

    fn check(&mut self) -> Result<(), QueueError> {
        Queue::check(self)
    }

    fn copy(&mut self) -> QueueFuture<'_, File> {
        Box::pin(Queue::copy(self))
    }

    fn close(self: Box<Self>) -> QueueFuture<'static, ()> {
        Box::pin(Queue::close(*self))
    }
}

/// Log of any kind.
pub(crate) struct AnyQueue(Box<dyn DynQueue>);

impl AnyQueue {
    pub(crate) fn new(queue: impl Queue) -> Self {
        Self(Box::new(queue))
    }
}

impl Queue for AnyQueue {
    async fn load(&mut self) -> Result<LogContents, QueueError> {
        self.0.load().await
    }

    async fn append(&mut self, batch: Batch<'_>) -> Result<(), QueueError> {
        self.0.append(batch).await
    }

    async fn snapshot(&mut self, state: &[u8]) -> Result<(), QueueError> {
        self.0.snapshot(state).await
    }

    async fn reserve(&mut self, min_incarnation: u32) -> Result<u32, QueueError> {
        self.0.reserve(min_incarnation).await
    }

    async fn notes(&mut self, subject: u64, from: u64) -> Result<NotePage, QueueError> {
        self.0.notes(subject, from).await
    }

    fn check(&mut self) -> Result<(), QueueError> {
        self.0.check()
    }

    async fn copy(&mut self) -> Result<File, QueueError> {
        self.0.copy().await
    }

    async fn close(self) -> Result<(), QueueError> {
        self.0.close().await
    }
}
