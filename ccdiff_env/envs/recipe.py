"""What an ego that learns from nothing meets and is paid, whatever the learner."""

from __future__ import annotations

from typing import Any

#: Weights of its reward. Arriving is worth most; a speed too low to arrive in time costs, so that
#: standing still does not pay.
REWARD = {"goal": 5.0, "lagging": -0.002, "comfort": -0.02, "lane_keeping": -0.02}
#: Options of its worlds: any vehicle of a scene may be the ego, in a tenth of the episodes also one
#: whose log stands, and an action is held for three steps.
WORLDS: dict[str, Any] = {
    "ego": "any",
    "standing_share": 0.1,
    "dynamics": "unicycle",
    "decision_steps": 3,
    "reward": REWARD,
}
