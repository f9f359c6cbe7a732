"""What an ego that learns from nothing meets and is paid, whatever the learner."""

from __future__ import annotations

from typing import Any

#: Weights of its reward. Arriving is worth most; a speed too low to arrive in time costs, so that
#: standing still does not pay.
REWARD = {"goal": 5.0, "lagging": -0.002, "comfort": -0.02, "lane_keeping": -0.02}
#: Its motion: what changes no faster is comfortable, and nothing turns where it stands.
DYNAMICS: dict[str, Any] = {
    "unicycle": {
        "acceleration_mps2": (-8.0, 2.4),
        "min_yaw_rate_radps": 0.001,
        "max_curvature_1pm": 0.3,
        "max_lateral_acceleration_mps2": 4.5,
        "max_jerk_mps3": 9.0,
        "max_yaw_acceleration_radps2": 1.9,
    }
}
GAMMA = 0.985  #: Discount of a decision.
#: Options of its worlds: any vehicle of a scene may be the ego, in a tenth of the episodes also one
#: whose log stands; an action is held for three steps; driving goes on after the goal, as in the
#: benchmark.
WORLDS: dict[str, Any] = {
    "ego": "any",
    "standing_share": 0.1,
    "dynamics": DYNAMICS,
    "terminate_at_goal": False,
    "decision_steps": 3,
    "reward": REWARD,
}
#: What is added where scenes have traffic lights: the ego sees the next one, and its episode ends
#: where it runs red.
LIGHTS: dict[str, Any] = {
    "observation": {
        "ego_columns": [
            "default", "light_green", "light_yellow", "light_red", "light_distance", "light_since",
            "light_braking",
        ]
    },
    "reward": REWARD | {"red_light": -20.0},
    "on_red_light": "terminate",
}  # fmt: skip
