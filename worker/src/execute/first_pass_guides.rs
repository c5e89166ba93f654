//! The first-pass-guides task of earlier versions. Guides are no part of a first pass any more, so its output is empty.

use femc_model::{Failure, Role, StageTemplate};

use super::{Product, Tools};
use crate::task_table::Task;

pub(super) fn first_pass_guides(_: &Task, stage: &StageTemplate, _: &Tools) -> Result<Product, Failure> {
    let mut product = Product::default();
    product.put(stage, Role::SolverState, Vec::new);
    Ok(product)
}
