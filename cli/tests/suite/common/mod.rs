//! Helpers to run the real binary on small scenes in a temporary folder.
#![allow(dead_code)] // each test file uses only a part of this

pub mod http;
pub mod outage;
pub mod proxy;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Timeout that is longer than any step takes on a loaded machine.
pub const STEP_TIMEOUT: Duration = Duration::from_secs(120);

/// A foggy box, 32 x 32 pixels, a clip of 8 frames in which the fog thickens.
pub const FOG: &str = "\
time 0 0.75 10
vary medium.fog.sigma_s = 0 0.02 1 0.3
camera main =
\torigin 0 -3.4 1
\ttarget 0 0 1
\tfov 40
\tfilm 32 32
medium fog =
\tsigma_s 0.1
\tphase hg 0.4
mbox fog -1 -1 0 1 1 2
m wall =
\tsides 2
\trd 0.6
m lamp =
\tsides 2
\ted 300
v a =
\tp -1 -1 0
v b =
\tp 1 -1 0
v c =
\tp 1 1 0
v d =
\tp -1 1 0
v e =
\tp -1 -1 2
v f =
\tp 1 -1 2
v g =
\tp 1 1 2
v h =
\tp -1 1 2
m wall
f a b c d
f h g f e
f d c g h
f a d h e
f c b f g
m lamp
v i =
\tp -0.3 -0.3 1.98
v j =
\tp -0.3 0.3 1.98
v k =
\tp 0.3 0.3 1.98
v l =
\tp 0.3 -0.3 1.98
f i j k l
";

/// Starts a coordinator on this port (0: a free one). Returns it and its address.
pub fn start_coordinator(dir: &TestFolder, port: u16) -> (TestProcess, String) {
    let mut coordinator =
        dir.start(&format!("coordinator --listen 127.0.0.1:{port} --store sqlite:farm.db --artifacts artifacts"));
    let line = coordinator.first_line();
    let url = line.split_whitespace().find(|word| word.starts_with("http://")).expect("the address").to_owned();
    (coordinator, url)
}

/// Queues `fog.mgf`. Returns the job's number.
pub fn submit(dir: &TestFolder, url: &str, settings: &str) -> String {
    let ran = dir.run(&format!("submit fog.mgf {settings} --server {url}")).exits(0);
    let id = ran.stdout().lines().last().expect("a job id").to_owned();
    assert!(!id.is_empty() && !id.contains(' '), "the id stands alone: {id}");
    id
}

/// Returns a job's status.
pub fn status(dir: &TestFolder, url: &str, job: &str) -> serde_json::Value {
    dir.run(&format!("status {job} --json --server {url}")).exits(0).json()
}

/// Returns the farm's workers.
pub fn workers(dir: &TestFolder, url: &str) -> serde_json::Value {
    dir.run(&format!("workers --json --server {url}")).exits(0).json()
}

/// Returns the finished share of the job's samples.
pub fn finished_share(dir: &TestFolder, url: &str, job: &str) -> f64 {
    let status = status(dir, url, job);
    let number = |key: &str| status[key].as_f64().expect("a number");
    number("samples") / number("samples_most")
}

/// Returns the number of drawn samples.
pub fn samples_done(dir: &TestFolder, url: &str, job: &str) -> f64 {
    status(dir, url, job)["samples"].as_f64().expect("a number")
}

/// A temporary folder with `fog.mgf` in it.
pub struct TestFolder {
    folder: tempfile::TempDir,
}

impl TestFolder {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let dir = Self { folder };
        dir.write("fog.mgf", FOG);
        dir
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).expect("the file is written");
    }

    /// Returns the command `femc` with the words of `line`, in this folder, with a clean environment.
    pub fn command(&self, line: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_femc"));
        command.args(line.split_whitespace()).current_dir(self.folder.path());
        command.env_remove("FEMC_IDENTITY").env_remove("FEMC_TOKEN_FILE");
        command.env_remove("FEMC_SERVER").env_remove("FEMC_LOG").env_remove("FEMC_FAULT").stdin(Stdio::null());
        // Hidden, because the name begins with a dot.
        command.env("XDG_STATE_HOME", self.folder.path().join(".state"));
        command
    }

    /// Runs a command to its end.
    pub fn run(&self, line: &str) -> CommandOutput {
        let output = self.command(line).output().expect("femc starts");
        CommandOutput { line: line.to_owned(), output }
    }

    /// Starts a command with its output in the files `NAME.out` and `NAME.err`.
    pub fn start_as(&self, name: &str, line: &str) -> TestProcess {
        self.start_command(name, &mut self.command(line))
    }

    /// Like [`Self::start_as`], for a prepared command.
    pub fn start_command(&self, name: &str, command: &mut Command) -> TestProcess {
        let file = |kind| std::fs::File::create(self.path(&format!("{name}.{kind}"))).expect("a file");
        let line = format!("{command:?}");
        let child = command.stdout(file("out")).stderr(file("err")).spawn().expect("femc starts");
        TestProcess { line, child: Some(child) }
    }

    /// Returns the current content of a file.
    pub fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap_or_default()
    }

    /// Starts a command. A failed test prints its output.
    pub fn start(&self, line: &str) -> TestProcess {
        TestProcess::spawn(&mut self.command(line))
    }
}

/// Starts a coordinator on a free port with its log in `dir` and this artifact store. Returns it and its address.
pub fn start_coordinator_with(dir: &TestFolder, artifacts: &str) -> (TestProcess, String) {
    let line = format!("coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts {artifacts}");
    let mut coordinator = dir.start(&line);
    let url = coordinator.address();
    (coordinator, url)
}

/// A finished run.
pub struct CommandOutput {
    line: String,
    output: Output,
}

impl CommandOutput {
    /// Creates the result of a command that was run by other means.
    pub fn new(line: &str, output: Output) -> Self {
        Self { line: line.to_owned(), output }
    }

    pub fn code(&self) -> Option<i32> {
        self.output.status.code()
    }

    pub fn stdout(&self) -> String {
        String::from_utf8_lossy(&self.output.stdout).into_owned()
    }

    pub fn stderr(&self) -> String {
        String::from_utf8_lossy(&self.output.stderr).into_owned()
    }

    /// Asserts the exit code; prints the output on failure.
    #[track_caller]
    pub fn exits(self, code: i32) -> Self {
        assert_eq!(
            self.code(),
            Some(code),
            "femc {}\n--- stdout\n{}\n--- stderr\n{}",
            self.line,
            self.stdout(),
            self.stderr()
        );
        self
    }

    /// Returns the JSON on stdout.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout()).unwrap_or_else(|e| panic!("{e}: {}", self.stdout()))
    }
}

/// A process that is killed when the test ends.
pub struct TestProcess {
    line: String,
    child: Option<Child>,
}

impl TestProcess {
    /// Starts a command and captures its output.
    pub fn spawn(command: &mut Command) -> Self {
        let line = format!("{command:?}");
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("femc starts");
        Self { line, child: Some(child) }
    }

    /// Returns the process id.
    pub fn id(&self) -> u32 {
        self.child.as_ref().expect("not waited for yet").id()
    }

    /// Kills the process, and returns its whole stderr.
    pub fn kill_for_stderr(&mut self) -> String {
        self.child().kill().expect("killed");
        self.end().stderr()
    }
    fn child(&mut self) -> &mut Child {
        self.child.as_mut().expect("not waited for yet")
    }

    /// Returns whether the process is running.
    pub fn is_running(&mut self) -> bool {
        self.child().try_wait().expect("its state").is_none()
    }

    /// Waits until `condition` holds, while the process runs.
    #[track_caller]
    pub fn wait_until(&mut self, event: &str, mut condition: impl FnMut() -> bool) {
        let start = Instant::now();
        while !condition() {
            if !self.is_running() {
                let line = self.line.clone();
                let ran = self.end();
                panic!("femc {line} ended before {event}\n{}\n{}", ran.stdout(), ran.stderr());
            }
            assert!(start.elapsed() < STEP_TIMEOUT, "femc {}: {event} never came", self.line);
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Sends SIGKILL. Returns false if the process had ended before.
    pub fn kill(&mut self) -> bool {
        let ran = self.is_running();
        if let Some(mut child) = self.child.take() {
            child.kill().expect("killed");
            child.wait().expect("reaped");
        }
        ran
    }

    /// Sends a signal by its name.
    pub fn signal(&mut self, name: &str) {
        let pid = self.child().id().to_string();
        let sent = Command::new("kill").args(["-s", name, &pid]).status().expect("kill runs");
        assert!(sent.success(), "the signal is delivered");
    }

    /// Waits for the end of the process.
    pub fn end(&mut self) -> CommandOutput {
        let child = self.child.take().expect("not waited for yet");
        CommandOutput { line: self.line.clone(), output: child.wait_with_output().expect("its output") }
    }

    /// Returns the address that a coordinator prints.
    pub fn address(&mut self) -> String {
        let line = self.first_line();
        line.split_whitespace().find(|word| word.starts_with("http://")).expect("the address").to_owned()
    }

    /// Returns the first line on stdout.
    pub fn first_line(&mut self) -> String {
        self.lines().next().unwrap_or_default()
    }

    /// Returns the lines on stdout. Each of them is waited for.
    pub fn lines(&mut self) -> impl Iterator<Item = String> + use<> {
        use std::io::{BufRead, BufReader};
        let stdout = self.child().stdout.take().expect("stdout is a pipe");
        BufReader::new(stdout).lines().map(|line| line.expect("a line").trim().to_owned())
    }
}

impl Drop for TestProcess {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Returns the sorted names in a folder that do not begin with a dot.
pub fn file_names(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.retain(|name| !name.starts_with('.'));
    names.sort();
    names
}

/// Size and values of an image.
pub struct Film {
    pub width: u32,
    pub height: u32,
    pub rgb: Vec<f32>,
}

/// Reads the image in a file.
#[track_caller]
pub fn film(path: &Path) -> Film {
    let image = femc_film::exr::read(path).expect("an EXR file").image;
    Film { width: image.width, height: image.height, rgb: image.pixels.concat() }
}

/// Returns the bits of all values in a file.
#[track_caller]
pub fn pixels(path: &Path) -> Vec<u32> {
    film(path).rgb.iter().map(|value| value.to_bits()).collect()
}

/// Returns a short digest of values, for printing.
pub fn digest(bits: &[u32]) -> String {
    let bytes: Vec<u8> = bits.iter().flat_map(|bits| bits.to_le_bytes()).collect();
    blake3::hash(&bytes).to_hex().to_string()
}
