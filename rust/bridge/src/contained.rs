//! A driver whose panics stay in the module that made it.

use crate::BoxedDriver;
use crate::cost::raised;
use ccdiff_sim::drivers::{AgentMotion, DriverModel, PlanRequest, PlanState, WorldView};
use ccdiff_sim::{Result, SimError};
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;

struct Contained {
    driver: BoxedDriver,
    /// What the first panic of a motion said.
    fault: OnceLock<String>,
}

/// The same driver, whose panics are errors: at once where it plans, in the next step where it moves an agent.
pub fn contained(driver: BoxedDriver) -> BoxedDriver {
    Box::new(Contained { driver, fault: OnceLock::new() })
}

/// The message of a panic.
pub fn fault(cause: Box<dyn std::any::Any + Send>) -> String {
    let text = cause.downcast_ref::<&str>().map(ToString::to_string);
    let text = text.or_else(|| cause.downcast_ref::<String>().cloned()).unwrap_or_default();
    format!("internal fault, please report it: {text}")
}

impl Contained {
    fn error(&self, message: String) -> SimError {
        SimError::Driver { driver: self.driver.name().into(), message }
    }
}

impl DriverModel for Contained {
    fn name(&self) -> &str {
        self.driver.name()
    }

    fn history_states(&self) -> usize {
        self.driver.history_states()
    }

    fn least_history_states(&self) -> usize {
        self.driver.least_history_states()
    }

    fn follows_route(&self, plan: Option<&PlanState>, agent_idx: usize) -> bool {
        self.driver.follows_route(plan, agent_idx)
    }

    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> Result<Vec<Option<PlanState>>> {
        if let Some(message) = self.fault.get() {
            return Err(self.error(message.clone()));
        }
        let driver = &mut self.driver;
        let plans = catch_unwind(AssertUnwindSafe(|| driver.plan(requests)))
            .unwrap_or_else(|cause| Err(self.error(fault(cause))));
        plans.inspect_err(|error| {
            if let Some(raised) = raised(&error.to_string()) {
                // left where the caller finds it, as by `PythonDriver`
                Python::attach(|py| raised.restore(py));
            }
        })
    }

    fn act(&self, world: &WorldView<'_>, plan: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        catch_unwind(AssertUnwindSafe(|| self.driver.act(world, plan, agent_idx))).unwrap_or_else(|cause| {
            // reported by the next plan, which comes before any further motion
            self.fault.get_or_init(|| fault(cause));
            AgentMotion::Leave
        })
    }
}
