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
pub(super) enum BodyTimeout {
    /// The whole body must arrive within the time.
    Total,
    /// Some part of the body must arrive within each such period.
    PerFrame,
    /// No timeout: a session has its own.
    Unlimited,
}

impl BodyTimeout {
    /// Returns the rule of a call by its path.
    pub(super) fn from_path(path: &str) -> Self {
        match path {
            "/femc.v1.Workers/Session" => Self::Unlimited,
            "/femc.v1.Artifacts/Put" | "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo" => Self::PerFrame,
            _ => Self::Total,
        }
    }

    /// Wraps a body so that it fails if it is late.
    pub(super) fn wrap(self, body: Body, timeout: Duration) -> Body {
        match self {
            Self::Unlimited => body,
            Self::Total | Self::PerFrame if body.is_end_stream() => body,
            Self::Total | Self::PerFrame => {
                let timer = Box::pin(tokio::time::sleep(timeout));
                Body::new(TimedBody { body, rule: self, timeout, timer })
            }
        }
    }
}

struct TimedBody {
    body: Body,
    rule: BodyTimeout,
    timeout: Duration,
    timer: Pin<Box<Sleep>>,
}

impl http_body::Body for TimedBody {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(cx) {
            if self.rule == BodyTimeout::PerFrame {
                let next = Instant::now() + self.timeout;
                self.timer.as_mut().reset(next);
            }
            return Poll::Ready(frame);
        }
        self.timer.as_mut().poll(cx).map(|()| {
            let seconds = self.timeout.as_secs();
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
