from dataclasses import dataclass
PLAN_ARRAYS = {}
@dataclass(frozen=True, eq=False, kw_only=True)
class PlanFields:
    x: int
