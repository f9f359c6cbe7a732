//! A driver whose panics stay in the module that made it.

use crate::BoxedDriver;
use ccdiff_sim::drivers::{AgentMotion, DriverModel, PlanRequest, PlanState, WorldView};
use ccdiff_sim::{Result, SimError};
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

fn text(cause: Box<dyn std::any::Any + Send>) -> String {
    let text = cause.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| cause.downcast_ref::<String>().cloned()).unwrap_or_default()
}

impl Contained {
    fn error(&self, fault: &str) -> SimError {
        let message = format!("internal fault, please report it: {fault}");
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

    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> Result<Vec<Option<PlanState>>> {
        if let Some(fault) = self.fault.get() {
            return Err(self.error(fault));
        }
        let driver = &mut self.driver;
        catch_unwind(AssertUnwindSafe(|| driver.plan(requests)))
            .unwrap_or_else(|cause| Err(self.error(&text(cause))))
    }

    fn act(&self, world: &WorldView<'_>, plan: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        catch_unwind(AssertUnwindSafe(|| self.driver.act(world, plan, agent_idx))).unwrap_or_else(|cause| {
            // reported by the next plan, which comes before any further motion
            self.fault.get_or_init(|| text(cause));
            AgentMotion::Leave
        })
    }
}
