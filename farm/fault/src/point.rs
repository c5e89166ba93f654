//! Points at which a process can stop.

/// Declares the points with their names.
macro_rules! points {
    ($($(#[$doc:meta])+ $point:ident = $name:literal,)+) => {
        /// A point in the code of the coordinator, the worker or `femc render`.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Point {
            $($(#[$doc])+ $point,)+
        }

        impl Point {
            /// Every point.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$point),+];

            /// Returns the point's name in `FEMC_FAULT`.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$point => $name,)+
                }
            }
        }
    };
}

points! {
    /// Facts are known but not yet in the log.
    CoordinatorBeforeAppend = "coordinator-before-append",
    /// Facts are durable but not yet acknowledged to anyone.
    CoordinatorAfterAppend = "coordinator-after-append",
    /// The log is long enough for a snapshot.
    CoordinatorBeforeSnapshot = "coordinator-before-snapshot",
    /// A snapshot has replaced the log.
    CoordinatorAfterSnapshot = "coordinator-after-snapshot",
    /// A piece of an artifact has been received but not written; the pieces before it are written.
    CoordinatorMidUpload = "coordinator-mid-upload",
    /// A submission is durable but not answered.
    CoordinatorBeforeAnswer = "coordinator-before-answer",
    /// A worker has connected and is not registered yet.
    CoordinatorBeforeJoin = "coordinator-before-join",
    /// A task is about to be executed.
    WorkerBeforeTask = "worker-before-task",
    /// A task has been running for a while. It keeps running, but its outcome is not read while this point waits.
    WorkerInTask = "worker-in-task",
    /// A task is done and its result is not saved anywhere.
    WorkerAfterTask = "worker-after-task",
    /// A result is about to be sent; the outbox writes it at the same time.
    WorkerBeforeUpload = "worker-before-upload",
    /// A result's artifacts are in the store; the result is not reported.
    WorkerAfterUpload = "worker-after-upload",
    /// A result is reported; no answer is received yet.
    WorkerAfterReport = "worker-after-report",
    /// A report is acknowledged; the result is still kept.
    WorkerBeforeForget = "worker-before-forget",
    /// A reduce task is about to read another input; the inputs before it are merged.
    WorkerMidReduce = "worker-mid-reduce",
    /// A scene's list of pieces has arrived, but some pieces are missing.
    WorkerMidFetch = "worker-mid-fetch",
    /// `femc render` has finished a frame and not written its file.
    RenderBeforeFile = "render-before-file",
    /// `femc render` has just written a frame's file.
    RenderAfterFile = "render-after-file",
}
