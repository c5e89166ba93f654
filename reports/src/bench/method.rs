//! Methods that can be measured.

use femc_pipeline::StopCondition;

/// A rendering method and the kind of its budgets.
#[derive(Debug, PartialEq, Eq)]
pub struct Method {
    /// Name on the command line.
    pub name: &'static str,
    /// Description in one line.
    pub about: &'static str,
    /// Light transport method.
    pub transport: femc_pipeline::Method,
    /// Kind of budget that ends a frame.
    pub budget: Budget,
}

/// Kind of budget that ends a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// Samples per pixel (`--spp`).
    Spp,
    /// Relative error of every block (`--error`).
    Error,
}

/// All methods. Add a line for a new one.
#[rustfmt::skip]
pub const METHODS: [Method; 8] = [
    Method { name: "pt", about: "path tracing, the same number of samples for every pixel", transport: femc_pipeline::Method::Pt, budget: Budget::Spp },
    Method { name: "adaptive", about: "path tracing, each tile until it reaches the requested error", transport: femc_pipeline::Method::Pt, budget: Budget::Error },
    Method { name: "fem", about: "only the finite-element solution (biased), the same number of samples for every pixel", transport: femc_pipeline::Method::Fem, budget: Budget::Spp },
    Method { name: "femc", about: "path tracing guided by the finite-element solution, the same number of samples for every pixel", transport: femc_pipeline::Method::Femc, budget: Budget::Spp },
    Method { name: "femc-adaptive", about: "path tracing guided by the finite-element solution, each tile until it reaches the requested error", transport: femc_pipeline::Method::Femc, budget: Budget::Error },
    Method { name: "1998", about: "path tracing guided by tables of directions, as in the method of 1998, the same number of samples for every pixel", transport: femc_pipeline::Method::Femc1998, budget: Budget::Spp },
    Method { name: "1998-adaptive", about: "path tracing guided as in 1998, each tile until it reaches the requested error", transport: femc_pipeline::Method::Femc1998, budget: Budget::Error },
    Method { name: "auto", about: "`pt` or `femc`, as a pilot chooses, the same number of samples for every pixel", transport: femc_pipeline::Method::Auto, budget: Budget::Spp },
];

impl Method {
    /// Returns the method of a name.
    /// - errors: the name is unknown. The message lists the known names.
    pub fn from_name(name: &str) -> Result<&'static Self, String> {
        METHODS.iter().find(|method| method.name == name).ok_or_else(|| {
            let names: Vec<&str> = METHODS.iter().map(|method| method.name).collect();
            format!("unknown method `{name}` (methods: {})", names.join(", "))
        })
    }

    /// Returns the stop criterion for a budget.
    pub fn stop(&self, budget: f64) -> StopCondition {
        match self.budget {
            // Budgets of this kind are whole numbers.
            Budget::Spp => StopCondition::Spp(budget as u32),
            Budget::Error => StopCondition::Error(budget),
        }
    }

    /// Formats a budget: `16 spp`, `error 0.5`.
    pub fn format_budget(&self, budget: f64) -> String {
        match self.budget {
            Budget::Spp => format!("{budget} spp"),
            Budget::Error => format!("error {budget}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_method_is_found_by_name_and_error_lists_all_methods() {
        for method in &METHODS {
            assert_eq!(Method::from_name(method.name), Ok(method));
        }
        let refused = Method::from_name("magic").expect_err("no method");
        assert!(METHODS.iter().all(|method| refused.contains(method.name)), "{refused}");
    }
}
