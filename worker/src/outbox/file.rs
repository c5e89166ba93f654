//! File format of a stored result:
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCDONE` |
//! | 4 | format version, 6 |
//! | 32 | BLAKE3 of all that follows |
//! | 8 | length of the head |
//! | | the head, in postcard: build of the engine, assignment, job, result, usage, log, lengths of the artifacts |
//! | | the artifacts |

use bytes::Bytes;
use femc_model::{Assignment, Digest, JobSpec, ResourceUsage, TaskResult};
use serde::{Deserialize, Serialize};

use crate::execute::Product;
use crate::task_table::Task;

const MAGIC: &[u8; 8] = b"FEMCDONE";
const VERSION: u32 = 6;
/// Bytes before the head.
const HEADER_BYTES: usize = 8 + 4 + 32 + 8;

/// A result from before the restart.
#[derive(Debug)]
pub(crate) struct RestoredResult {
    pub(crate) assignment: Assignment,
    pub(crate) spec: JobSpec,
    pub(crate) product: Product,
    /// Usage of the task, without the upload of the result.
    pub(crate) usage: Option<ResourceUsage>,
    /// Duration of the task in seconds, and the log's text.
    pub(crate) log: Option<(f64, String)>,
}

#[derive(Serialize, Deserialize)]
struct Head {
    engine: String,
    assignment: Assignment,
    spec: JobSpec,
    result: TaskResult,
    usage: Option<ResourceUsage>,
    log: Option<(f64, String)>,
    lengths: Vec<u64>,
}

/// Encodes a result as a whole file: the front, the head and the artifacts.
pub(super) fn encode(task: &Task, product: &Product, engine: &str) -> Result<Vec<u8>, postcard::Error> {
    let head = Head {
        engine: engine.into(),
        assignment: task.assignment.clone(),
        spec: (*task.spec).clone(),
        result: product.result.clone(),
        usage: task.usage(),
        log: task.final_log().cloned(),
        lengths: product.artifacts.iter().map(|bytes| bytes.len() as u64).collect(),
    };
    let head = postcard::to_stdvec(&head)?;
    let mut body = (head.len() as u64).to_le_bytes().to_vec();
    body.extend(&head);
    product.artifacts.iter().for_each(|bytes| body.extend_from_slice(bytes));
    let mut file = MAGIC.to_vec();
    file.extend(VERSION.to_le_bytes());
    file.extend(Digest::compute(&body).as_bytes());
    file.extend(body);
    Ok(file)
}

/// Decodes a file of [`encode`] from the same engine build; `None` for anything else.
pub(crate) fn decode(file: &Bytes, engine: &str) -> Option<RestoredResult> {
    let front = file.get(..HEADER_BYTES)?;
    let is_ours = front[..8] == *MAGIC && front[8..12] == VERSION.to_le_bytes();
    if !is_ours || Digest::compute(&file[44..]).as_bytes()[..] != front[12..44] {
        return None;
    }
    let length = usize::try_from(u64::from_le_bytes(front[44..].try_into().ok()?)).ok()?;
    let end = HEADER_BYTES.checked_add(length)?;
    let Head { engine: of, assignment, spec, result, usage, log, lengths } =
        postcard::from_bytes(file.get(HEADER_BYTES..end)?).ok()?;
    if of != engine {
        return None;
    }
    let (mut at, mut artifacts) = (end, Vec::new());
    for length in lengths {
        let end = at.checked_add(usize::try_from(length).ok()?)?;
        file.get(at..end)?;
        artifacts.push(file.slice(at..end));
        at = end;
    }
    (at == file.len()).then_some(RestoredResult {
        assignment,
        spec,
        product: Product { result, artifacts },
        usage,
        log,
    })
}
