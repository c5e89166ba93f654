//! Timeouts for request bodies.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use http_body::{Body as _, Frame, SizeHint};
use tokio::time::{Instant, Sleep};
use tonic::Status;
use tonic::body::Body;

/// Timeout rule for a request's body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Pace {
    /// The whole body must arrive within the time.
    Whole,
    /// Some part of the body must arrive within each such period.
    Steady,
    /// No timeout: a session has its own.
    Free,
}

impl Pace {
    /// Returns the rule of a call by its path.
    pub(super) fn of(path: &str) -> Self {
        match path {
            "/femc.v1.Workers/Session" => Self::Free,
            "/femc.v1.Artifacts/Put" | "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo" => Self::Steady,
            _ => Self::Whole,
        }
    }

    /// Wraps a body so that it fails if it is late.
    pub(super) fn hold(self, body: Body, patience: Duration) -> Body {
        match self {
            Self::Free => body,
            Self::Whole | Self::Steady if body.is_end_stream() => body,
            Self::Whole | Self::Steady => {
                let due = Box::pin(tokio::time::sleep(patience));
                Body::new(Punctual { body, pace: self, patience, due })
            }
        }
    }
}

struct Punctual {
    body: Body,
    pace: Pace,
    patience: Duration,
    due: Pin<Box<Sleep>>,
}

impl http_body::Body for Punctual {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(cx) {
            if self.pace == Pace::Steady {
                let next = Instant::now() + self.patience;
                self.due.as_mut().reset(next);
            }
            return Poll::Ready(frame);
        }
        self.due.as_mut().poll(cx).map(|()| {
            let seconds = self.patience.as_secs();
            Some(Err(Status::deadline_exceeded(format!("the request did not arrive within {seconds} s"))))
        })
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
