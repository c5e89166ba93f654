//! Operations of the farm, independent of the protocol. Every gRPC call and every HTTP request is one of these.

use femc_trust::{Holder, Role};

/// Operation that a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Operation {
    /// Queue a job.
    Submit,
    /// See all jobs.
    List,
    /// See one job.
    Status,
    /// Follow the status of one job.
    Watch,
    /// Pause, resume, cancel, retry or delete a job, or change its priority.
    Control,
    /// See finished frames.
    Frames,
    /// See the available outputs of unfinished frames.
    Parts,
    /// Read logs.
    Logs,
    /// See the table of a job's frames.
    FrameTable,
    /// See the table of a job's tasks.
    Tasks,
    /// See a picture of a frame, also before it is finished.
    Picture,
    /// Query the recorded light of frames, also before they are finished.
    Light,
    /// Read a result of a job as a file.
    Download,
    /// See the resource usage of attempts.
    Attempts,
    /// See the farm usage of the owners' jobs.
    Usage,
    /// See the workers.
    ListWorkers,
    /// Drain workers, or end the drain.
    DrainWorkers,
    /// Copy the log.
    Backup,
    /// Open a session as a worker.
    Session,
    /// Ask which artifacts are not in the store.
    Missing,
    /// Ask at which byte an upload continues.
    Offer,
    /// Upload an artifact.
    Put,
    /// Read an artifact.
    Get,
    /// Remove artifacts from the store that no job refers to.
    Collect,
    /// Ask whether the server is healthy, and for its capabilities.
    Health,
    /// Follow the changes of the farm.
    Feed,
    /// Ask for the caller's own identity.
    Me,
    /// Load the web page, its scripts and styles.
    Page,
    /// Exchange a token for a cookie.
    Login,
    /// Delete the cookie.
    Logout,
    /// Read the audit log: changes and refusals.
    ReadAudit,
    /// Any other request.
    Other,
}

impl Operation {
    /// Operations that are available over HTTP.
    pub const HTTP: [Self; 20] = [
        Self::List,
        Self::Status,
        Self::Control,
        Self::Logs,
        Self::FrameTable,
        Self::Tasks,
        Self::Picture,
        Self::Light,
        Self::Download,
        Self::Attempts,
        Self::Usage,
        Self::ListWorkers,
        Self::DrainWorkers,
        Self::Feed,
        Self::Me,
        Self::Page,
        Self::Login,
        Self::Logout,
        Self::ReadAudit,
        Self::Other,
    ];

    /// Returns the name in the audit log.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Submit => "Jobs/Submit",
            Self::List => "Jobs/List",
            Self::Status => "Jobs/Status",
            Self::Watch => "Jobs/Watch",
            Self::Control => "Jobs/Control",
            Self::Frames => "Jobs/Frames",
            Self::Parts => "Jobs/Parts",
            Self::Logs => "Jobs/Logs",
            Self::FrameTable => "Jobs/FrameTable",
            Self::Tasks => "Jobs/Tasks",
            Self::Picture => "Jobs/Picture",
            Self::Light => "Jobs/Light",
            Self::Download => "Jobs/Download",
            Self::Attempts => "Jobs/Attempts",
            Self::Usage => "Jobs/Usage",
            Self::ListWorkers => "Jobs/ListWorkers",
            Self::DrainWorkers => "Jobs/DrainWorkers",
            Self::Backup => "Jobs/Backup",
            Self::Session => "Workers/Session",
            Self::Missing => "Artifacts/Missing",
            Self::Offer => "Artifacts/Offer",
            Self::Put => "Artifacts/Put",
            Self::Get => "Artifacts/Get",
            Self::Collect => "Artifacts/Collect",
            Self::Health => "Health",
            Self::Feed => "Farm/Feed",
            Self::Me => "Farm/Me",
            Self::Page => "Page",
            Self::Login => "Page/Login",
            Self::Logout => "Page/Logout",
            Self::ReadAudit => "Audit/Read",
            Self::Other => "other",
        }
    }

    /// Returns the right that the operation needs.
    pub const fn right(self) -> Right {
        match self {
            Self::Page | Self::Login | Self::Logout => Right::Public,
            Self::Health | Self::Me => Right::AnyIdentity,
            Self::List
            | Self::Status
            | Self::Watch
            | Self::Frames
            | Self::Parts
            | Self::Logs
            | Self::FrameTable
            | Self::Tasks
            | Self::Picture
            | Self::Light
            | Self::Download
            | Self::Attempts
            | Self::Usage
            | Self::ListWorkers
            | Self::Feed => Right::User(Role::Viewer),
            // The call itself checks the owner of the job.
            Self::Submit | Self::Control => Right::User(Role::Submitter),
            Self::DrainWorkers => Right::User(Role::Operator),
            Self::Session => Right::Worker,
            Self::Get | Self::Missing => Right::WorkerOrUser(Role::Viewer),
            Self::Offer | Self::Put => Right::WorkerOrUser(Role::Submitter),
            Self::Backup | Self::Collect | Self::ReadAudit | Self::Other => Right::User(Role::Admin),
        }
    }

    /// Returns whether the operation changes the farm. Changes are always written to the audit log, whatever their outcome.
    pub const fn is_change(self) -> bool {
        matches!(self, Self::Submit | Self::Control | Self::DrainWorkers | Self::Session | Self::Collect | Self::Login)
    }
}

/// Right that an operation needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Right {
    /// None: unauthenticated callers are permitted.
    Public,
    /// Any identity of the farm.
    AnyIdentity,
    /// A worker.
    Worker,
    /// A user of this role or a higher one.
    User(Role),
    /// A worker, or a user of this role or a higher one.
    WorkerOrUser(Role),
}

impl Right {
    /// Returns whether this holder has the right.
    pub fn is_held_by(self, holder: &Holder) -> bool {
        match (self, holder) {
            (Self::Public | Self::AnyIdentity, _) | (Self::Worker | Self::WorkerOrUser(_), Holder::Worker { .. }) => {
                true
            }
            (Self::User(least) | Self::WorkerOrUser(least), Holder::User { role, .. }) => *role >= least,
            (Self::Worker | Self::User(_) | Self::WorkerOrUser(_), _) => false,
        }
    }

    /// Describes the required holder for the message of a refusal. Workers are never refused a right that includes workers, so that
    /// case names only users.
    pub fn required_holder(self) -> String {
        match self {
            Self::Public => "nothing".into(),
            Self::AnyIdentity => "an identity of this farm".into(),
            Self::Worker => "a worker".into(),
            Self::User(role) | Self::WorkerOrUser(role) => format!("a user of role {role}"),
        }
    }
}
