//! What can be asked of a farm, whatever the way: every call of gRPC and every request over HTTP is one of these.

use femc_trust::{Holder, Role};

/// What is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Operation {
    /// Queue a job.
    Submit,
    /// See all jobs.
    List,
    /// See one job.
    Status,
    /// See one job as it changes.
    Watch,
    /// Pause, resume, cancel, retry, delete a job, change its priority.
    Control,
    /// See finished frames.
    Frames,
    /// See what there is of frames in work.
    Parts,
    /// Read logs.
    Logs,
    /// See a job frame by frame.
    FrameTable,
    /// See a job task by task.
    Tasks,
    /// See a frame as it grows.
    Picture,
    /// Read a result of a job as a file.
    Download,
    /// See what attempts took.
    Attempts,
    /// See what the owners' jobs used of the farm.
    Usage,
    /// See the workers.
    ListWorkers,
    /// Give workers no more tasks, or tasks again.
    DrainWorkers,
    /// Copy the log.
    Backup,
    /// Take part in rendering.
    Session,
    /// Ask which artifacts are not in the store.
    Missing,
    /// Ask where an upload goes on.
    Offer,
    /// Send an artifact.
    Put,
    /// Read an artifact.
    Get,
    /// Remove from the store what no job refers to.
    Collect,
    /// Ask whether the server serves, and what it offers.
    Health,
    /// See the farm as it changes.
    Feed,
    /// Ask who one is.
    Me,
    /// Load the page, its scripts and styles.
    Page,
    /// Give a token, get a cookie.
    Login,
    /// End the cookie.
    Logout,
    /// Read what was done to the farm, and what was refused.
    ReadAudit,
    /// Whatever else.
    Other,
}

impl Operation {
    /// Those that requests over HTTP are.
    pub const HTTP: [Self; 19] = [
        Self::List,
        Self::Status,
        Self::Control,
        Self::Logs,
        Self::FrameTable,
        Self::Tasks,
        Self::Picture,
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

    /// Its name in the audit record.
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

    /// Who may ask for it.
    pub const fn right(self) -> Right {
        match self {
            Self::Page | Self::Login | Self::Logout => Right::Public,
            Self::Health | Self::Me => Right::Anybody,
            Self::List
            | Self::Status
            | Self::Watch
            | Self::Frames
            | Self::Parts
            | Self::Logs
            | Self::FrameTable
            | Self::Tasks
            | Self::Picture
            | Self::Download
            | Self::Attempts
            | Self::Usage
            | Self::ListWorkers
            | Self::Feed => Right::User(Role::Viewer),
            // Whose job it is decides the call itself.
            Self::Submit | Self::Control => Right::User(Role::Submitter),
            Self::DrainWorkers => Right::User(Role::Operator),
            Self::Session => Right::Worker,
            Self::Get | Self::Missing => Right::WorkerOrUser(Role::Viewer),
            Self::Offer | Self::Put => Right::WorkerOrUser(Role::Submitter),
            Self::Backup | Self::Collect | Self::ReadAudit | Self::Other => Right::User(Role::Admin),
        }
    }

    /// Whether it changes what the farm does: then it is noted, whatever its outcome.
    pub const fn is_change(self) -> bool {
        matches!(self, Self::Submit | Self::Control | Self::DrainWorkers | Self::Session | Self::Collect | Self::Login)
    }
}

/// What an operation takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Right {
    /// Nothing: also who is not known may.
    Public,
    /// Any identity of the farm.
    Anybody,
    /// A worker.
    Worker,
    /// A user of this role or a higher one.
    User(Role),
    /// A worker, or a user of this role or a higher one.
    WorkerOrUser(Role),
}

impl Right {
    /// Whether this holder has it.
    pub fn is_of(self, holder: &Holder) -> bool {
        match (self, holder) {
            (Self::Public | Self::Anybody, _) | (Self::Worker | Self::WorkerOrUser(_), Holder::Worker { .. }) => true,
            (Self::User(least) | Self::WorkerOrUser(least), Holder::User { role, .. }) => *role >= least,
            (Self::Worker | Self::User(_) | Self::WorkerOrUser(_), _) => false,
        }
    }

    /// What whoever is refused would have to be: a worker is never refused what workers may, and no user is told to be one.
    pub fn takes(self) -> String {
        match self {
            Self::Public => "nothing".into(),
            Self::Anybody => "an identity of this farm".into(),
            Self::Worker => "a worker".into(),
            Self::User(role) | Self::WorkerOrUser(role) => format!("a user of role {role}"),
        }
    }
}
