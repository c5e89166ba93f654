//! Threads for computations of a command outside of workers.

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::exit::{Failure, failed};

/// Creates a pool for one command. Outside of a pool, rayon would start its own with all threads of the machine, and ignore
/// `--threads`.
/// - `threads`: `None` or 0: one per processor.
pub fn pool(threads: Option<u32>) -> Result<ThreadPool, Failure> {
    let pool = ThreadPoolBuilder::new().num_threads(threads.map_or(0, |threads| threads as usize)).build();
    pool.map_err(|error| {
        failed(format!("cannot start threads: {error}; give a smaller --threads, or allow more processes (ulimit -u)"))
    })
}
