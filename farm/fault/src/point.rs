//! The places at which a process can stand still.

/// Declares the points with their names.
macro_rules! points {
    ($($(#[$doc:meta])+ $point:ident = $name:literal,)+) => {
        /// A place in the coordinator, the worker or `femc render`.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Point {
            $($(#[$doc])+ $point,)+
        }

        impl Point {
            /// Every point.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$point),+];

            /// As it is asked for.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$point => $name,)+
                }
            }
        }
    };
}

points! {
    /// Facts are known and not in the log.
    CoordinatorBeforeAppend = "coordinator-before-append",
    /// Facts are durable, and nobody has heard of them.
    CoordinatorAfterAppend = "coordinator-after-append",
    /// The log is long enough for a snapshot.
    CoordinatorBeforeSnapshot = "coordinator-before-snapshot",
    /// A snapshot has taken the log's place.
    CoordinatorAfterSnapshot = "coordinator-after-snapshot",
    /// A piece of an artifact has come and is not written; pieces before it are.
    CoordinatorMidUpload = "coordinator-mid-upload",
    /// A submission is durable and not answered.
    CoordinatorBeforeAnswer = "coordinator-before-answer",
    /// A worker has come and is not heard.
    CoordinatorBeforeJoin = "coordinator-before-join",
    /// A task's turn has come.
    WorkerBeforeTask = "worker-before-task",
    /// A task has been under way for a while; it goes on, and what comes of it is not looked at.
    WorkerInTask = "worker-in-task",
    /// A task is done and kept nowhere.
    WorkerAfterTask = "worker-after-task",
    /// A result is about to be sent; meanwhile the outbox writes it.
    WorkerBeforeUpload = "worker-before-upload",
    /// A result's artifacts are in the store; it is not reported.
    WorkerAfterUpload = "worker-after-upload",
    /// A result is reported; no answer is heard.
    WorkerAfterReport = "worker-after-report",
    /// A report is acknowledged; the result is still kept.
    WorkerBeforeForget = "worker-before-forget",
    /// A task that reduces outputs is about to take in another one; those before it are in.
    WorkerMidReduce = "worker-mid-reduce",
    /// A scene's list of pieces is there, and pieces are missing.
    WorkerMidFetch = "worker-mid-fetch",
    /// `femc render` has a frame and has not written its file.
    RenderBeforeFile = "render-before-file",
    /// `femc render` has just written a frame's file.
    RenderAfterFile = "render-after-file",
}
