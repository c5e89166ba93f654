//! What later versions of the ledger have added.

use femc_model::Drain;
use serde::{Deserialize, Serialize};

/// The ledger's later fields. New ones go to the end.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Annex {
    /// Workers that an operator has drained, by their process, the latest at the end.
    drained: Vec<u64>,
}

impl Annex {
    /// Most workers that are remembered as drained: processes end, and nobody says that they will not come back.
    const DRAINED: usize = 4096;

    pub(super) fn drain(&mut self, instance: u64, drain: Drain) {
        self.drained.retain(|&other| other != instance);
        if drain == Drain::Begin {
            self.drained.push(instance);
            let surplus = self.drained.len().saturating_sub(Self::DRAINED);
            self.drained.drain(..surplus);
        }
    }

    pub(crate) fn is_drained(&self, instance: u64) -> bool {
        self.drained.contains(&instance)
    }
}

#[cfg(test)]
mod tests {
    use crate::{Fact, Ledger};

    use super::*;

    #[test]
    fn a_snapshot_of_before_the_annex_is_read() {
        let mut ledger = Ledger::default();
        ledger.apply(&Fact::Opened { incarnation: 7 }, femc_model::Tick(3));
        let old = postcard::to_extend(&ledger, vec![1]).unwrap();
        assert_eq!(Ledger::decode(&old), Ok(ledger.clone()));
        ledger.apply(&Fact::Drained { instance: 5, drain: Drain::Begin }, femc_model::Tick(4));
        let new = ledger.encode().unwrap();
        assert_eq!(Ledger::decode(&new), Ok(ledger.clone()));
        assert!(ledger.annex.is_drained(5) && !ledger.annex.is_drained(6));
        for end in 0..new.len() {
            assert!(Ledger::decode(&new[..end]).is_err(), "cut at {end}");
        }
        ledger.apply(&Fact::Drained { instance: 5, drain: Drain::Undo }, femc_model::Tick(5));
        assert!(!ledger.annex.is_drained(5));
    }
}
