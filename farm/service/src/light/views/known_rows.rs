//! Rows of answers about growing data. A client that has such an answer receives only the new rows of the next one.

use std::collections::VecDeque;

use super::LightTarget;
use crate::light::EarlierRows;

/// Rows of the latest answers, the oldest first.
#[derive(Debug, Default)]
pub(super) struct KnownRows {
    answers: VecDeque<(LightTarget, EarlierRows)>,
    /// Number of rows of all answers.
    rows: usize,
}

impl KnownRows {
    /// Maximum number of rows: 16 MiB of identities, or 200 answers of 5000 paths.
    const MAX_ROWS: usize = 1 << 20;

    /// Adds the rows of an answer, and drops the oldest answers beyond the limit.
    pub(super) fn add(&mut self, target: LightTarget, rows: EarlierRows) {
        self.answers.retain(|(own, known)| *own != target || known.tag != rows.tag);
        self.answers.push_back((target, rows));
        self.rows = self.answers.iter().map(|(_, known)| known.identities.len()).sum();
        while self.rows > Self::MAX_ROWS
            && let Some((_, dropped)) = self.answers.pop_front()
        {
            self.rows -= dropped.identities.len();
        }
    }

    /// Returns the rows of an answer about a target.
    pub(super) fn find(&self, target: &LightTarget, tag: &str) -> Option<EarlierRows> {
        let is_wanted = |(own, rows): &&(LightTarget, EarlierRows)| own == target && rows.tag == tag;
        self.answers.iter().find(is_wanted).map(|(_, rows)| rows.clone())
    }
}

#[cfg(test)]
mod tests {
    use femc_model::JobId;

    use super::*;

    fn rows(tag: &str, count: usize) -> EarlierRows {
        EarlierRows { tag: tag.to_owned(), identities: vec![[0; 16]; count].into() }
    }

    #[test]
    fn rows_beyond_the_limit_are_dropped_the_oldest_first() {
        let mut known = KnownRows::default();
        let target = LightTarget::File(0);
        for tag in ["a", "b", "a", "c"] {
            known.add(target.clone(), rows(tag, KnownRows::MAX_ROWS / 2));
        }
        let is_known = |tag: &str| known.find(&target, tag).is_some();
        assert_eq!(["a", "b", "c"].map(is_known), [true, false, true], "a was added again after b");
        assert_eq!(known.rows, KnownRows::MAX_ROWS);
        known.add(target.clone(), rows("d", KnownRows::MAX_ROWS + 1));
        assert!(known.answers.is_empty() && known.rows == 0, "one answer beyond the limit is not kept");
    }

    #[test]
    fn rows_belong_to_their_target() {
        let mut known = KnownRows::default();
        known.add(LightTarget::Frames(JobId(1), vec![2]), rows("a", 3));
        assert_eq!(known.find(&LightTarget::Frames(JobId(1), vec![2]), "a"), Some(rows("a", 3)));
        assert_eq!(known.find(&LightTarget::Frames(JobId(2), vec![2]), "a"), None);
    }
}
