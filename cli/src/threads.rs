//! Threads for what a command computes without a worker.

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::exit::{Failure, failed};

/// A pool for one command. Outside of a pool, rayon starts one of its own with all the machine's threads, whatever `--threads` says.
/// - `threads`: `None` or 0: one for each processor.
pub fn pool(threads: Option<u32>) -> Result<ThreadPool, Failure> {
    let pool = ThreadPoolBuilder::new().num_threads(threads.map_or(0, |threads| threads as usize)).build();
    pool.map_err(|error| {
        failed(format!("cannot start threads: {error}; give a smaller --threads, or allow more processes (ulimit -u)"))
    })
}
