//! Batches small messages of a session that are ready at the same time, because most of a message's cost is its envelope.

use futures_util::StreamExt as _;
use futures_util::stream::{self, Stream};

use crate::wire;

/// Largest number of messages in a batch.
const MAX_BATCH: usize = 128;

/// Size in bytes above which a message is sent alone, so that a batch stays far below the size limit of a message.
const MAX_BATCHED_SIZE: usize = 4 << 10;

/// A message type that can contain a batch of its own kind.
pub(crate) trait Batch: prost::Message + Sized {
    /// Combines several messages into one.
    fn join(messages: Vec<Self>) -> Self;

    /// Splits a batch into its messages; returns the message itself if it is not a batch.
    fn split(self) -> Result<Vec<Self>, Self>;
}

impl Batch for wire::ToWorker {
    fn join(messages: Vec<Self>) -> Self {
        Self { message: Some(wire::to_worker::Message::Many(wire::ManyToWorker { messages })) }
    }

    fn split(self) -> Result<Vec<Self>, Self> {
        match self.message {
            Some(wire::to_worker::Message::Many(many)) => Ok(many.messages),
            message => Err(Self { message }),
        }
    }
}

impl Batch for wire::FromWorker {
    fn join(messages: Vec<Self>) -> Self {
        Self { message: Some(wire::from_worker::Message::Many(wire::ManyFromWorker { messages })) }
    }

    fn split(self) -> Result<Vec<Self>, Self> {
        match self.message {
            Some(wire::from_worker::Message::Many(many)) => Ok(many.messages),
            message => Err(Self { message }),
        }
    }
}

/// Batches the messages that are ready. It never waits for more.
pub(crate) fn batch_ready<T: Batch + Send + 'static>(messages: impl Stream<Item = T>) -> impl Stream<Item = T> {
    messages.ready_chunks(MAX_BATCH).flat_map(|ready| stream::iter(pack(ready)))
}

fn pack<T: Batch>(messages: Vec<T>) -> Vec<T> {
    let (mut packed, mut small) = (Vec::new(), Vec::new());
    let close = |small: &mut Vec<T>, packed: &mut Vec<T>| match small.len() {
        0 => {}
        1 => packed.append(small),
        _ => packed.push(T::join(std::mem::take(small))),
    };
    for message in messages {
        if message.encoded_len() <= MAX_BATCHED_SIZE {
            small.push(message);
        } else {
            close(&mut small, &mut packed);
            packed.push(message);
        }
    }
    close(&mut small, &mut packed);
    packed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn failed_message(message: usize) -> wire::FromWorker {
        let failure = wire::Failure {
            cause: Some(wire::failure::Cause::Store(wire::failure::Text { message: "x".repeat(message) })),
        };
        let failed = wire::Failed { failure: Some(failure), ..wire::Failed::default() };
        wire::FromWorker { message: Some(wire::from_worker::Message::Failed(failed)) }
    }

    #[test]
    fn the_order_stays_and_large_ones_travel_alone() {
        let messages: Vec<_> = [1, 2, 9_000, 3, 9_001, 4, 5, 6].into_iter().map(failed_message).collect();
        let packed = pack(messages.clone());
        assert_eq!(packed.len(), 5);
        let again: Vec<_> = packed.into_iter().flat_map(|one| one.split().unwrap_or_else(|one| vec![one])).collect();
        assert_eq!(again, messages);
        assert!(pack(Vec::<wire::FromWorker>::new()).is_empty());
    }
}
