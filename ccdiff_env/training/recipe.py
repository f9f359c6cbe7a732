"""What an ego that learns from nothing meets and is paid, and how, whatever the learner."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorWrapper

from ccdiff_env.envs.vector import EgoVectorEnv
from ccdiff_env.errors import ConfigError
from ccdiff_env.traffic import NETWORKS, read_driver
from ccdiff_env.worlds.policy_file import LEARNED

#: Weights of its reward. Arriving is worth most; a speed too low to arrive in time costs, so that
#: standing still does not pay.
REWARD = {"goal": 5.0, "lagging": -0.002, "comfort": -0.02, "lane_keeping": -0.02}
#: Its motion: it speeds up comfortably (nuPlan's limit of 2.4 m/s² counts smoothed values, which
#: overshoot), can brake at once, and does not turn where it stands.
DYNAMICS: dict[str, Any] = {
    "unicycle": {
        "acceleration_mps2": (-8.0, 2.2),
        "min_yaw_rate_radps": 0.001,
        "max_curvature_1pm": 0.3,
        "max_lateral_acceleration_mps2": 4.5,
        "max_jerk_mps3": 25.0,
        "max_yaw_acceleration_radps2": 1.9,
    }
}
GAMMA, LAMBDA = 0.985, 0.95  #: Discount of a decision, and that of advantages beside it.
ROLLOUT = 16  #: Decisions of each world between updates.
EPOCHS, MINIBATCH = 3, 2048
RATE, LAST = 5e-4, 0.05  #: Learning rate at first, and the share of it that stays.
#: Standard deviations of the actions at first: with much noise it is off the road within a second,
#: unless it is assisted. They fall no faster than the learning rate does.
NOISE, ASSISTED_NOISE = (0.18, 0.12), (0.4, 0.2)
#: Share of a decision's noise that stays in the next: it tries to brake, not to tremble.
CORRELATION = 0.7
#: What a collision costs more where it is the ego's fault, an episode with the ego in a lane of the
#: other way, and a decision after which contact is a second away (grows from 0 at 1.6 s), one with
#: a jerk of 6 m/s³ (from 3), and one after which it brakes with 4 m/s² (from 3).
AT_FAULT, WRONG_WAY, CLOSE, ROUGH, HARD = -6.0, -2.0, -0.3, -0.1, -0.1
BANK = "bank"  #: Name of what was recorded as traffic of training.
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
    "reward": REWARD | {"red_light": -40.0},
    "on_red_light": "terminate",
    "start_spread_steps": 50,
}  # fmt: skip
#: Columns beside the default where an ego learns for long: the way to the end of the road, and how
#: others turn and brake.
ROAD = ["road_left", "road_front_left", "road_front", "road_front_right", "road_right"]
LONG: dict[str, Any] = {
    "ego_columns": ["default", *ROAD],
    "agent_columns": ["default", "acceleration", "yaw_rate"],
}
#: Leaving the road costs about what a fault does: where it was cheaper, an ego evaded to there.
LONG_REWARD = REWARD | {"off_road": -10.0}
#: What is priced by the ego's speed v costs v / 4 m/s as much if it is a close call, at most twice,
#: and 0.5 + v / 5 m/s as much if it is a fault.
CLOSE_MPS, FAULT_MPS = 4.0, 5.0


def traffic_options(traffic: str, criticality: float | None = None) -> dict[str, Any]:
    """Return what :func:`ccdiff_env.make_vec` takes for an entry of ``--traffic``.

    A network draws the criticality of each episode from 0 to this one, if one is given, unless its
    options fix it.
    CCDiff denoises in one step, two to three times as fast, unless its options say otherwise.
    """
    name, options = read_driver(traffic, "--traffic")
    if name == LEARNED:
        if options:
            raise ConfigError(f"--traffic is {traffic!r}, expected {name} without options")
        name, traffic = "ccdiff", f"ccdiff?replan_steps=20&adversary_policy={LEARNED}"
    if name == "ccdiff" and "denoising_steps" not in options:
        traffic += f"{'&' if '?' in traffic else '?'}denoising_steps=1"
    draws = criticality is not None and name in NETWORKS and "criticality" not in options
    return {"traffic": traffic, **({"criticality": (0.0, criticality)} if draws else {})}


class Priced(VectorWrapper):
    """Worlds of :func:`ccdiff_env.make_vec` whose rewards pay these prices, too.

    Args:
        env: Worlds with flat observations that have rows of agents; put into ``SAME_STEP`` mode, if
            they have not been reset.
        by_speed: Whether close calls and faults cost more the faster the ego is, so that it learns
            to brake, not to slip past.

    Raises:
        ConfigError: If their observations are others.
    """

    def __init__(self, env: EgoVectorEnv, *, by_speed: bool = False) -> None:
        super().__init__(env)
        if not env.begun:
            env.set_autoreset_mode(AutoresetMode.SAME_STEP)
        self.worlds, layout = env.worlds, env.worlds.layout
        entries = {entry.name: entry for entry in layout.entries}
        if env.single_observation_space.shape != (layout.size,) or "agents" not in entries:
            raise ConfigError("Priced: expected flat observations with rows of agents")
        ego, rows, mask = (entries[name] for name in ("ego", "agents", "agents_mask"))
        self._mask = slice(mask.offset, mask.offset + mask.size)
        first = rows.offset + rows.columns.index("ttc")
        self._ttc = slice(first, rows.offset + rows.size, rows.shape[1])
        self._acceleration = ego.offset + ego.columns.index("acceleration")
        self._speed, self._by_speed = ego.offset + ego.columns.index("speed"), by_speed
        config = env.worlds.config
        self._decision_s = config.decision_steps * config.dt_s

    def reset(self, **given: Any) -> tuple[Any, dict[str, Any]]:
        """Reset as the worlds do."""
        obs, infos = self.env.reset(**given)
        self._before = obs.copy()
        return obs, infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step as the worlds do, and charge."""
        obs, reward, terminated, truncated, infos = self.env.step(actions)
        end = terminated | truncated
        before_mps2 = self._before[:, self._acceleration]
        change_mps2 = 10.0 * np.abs(obs[:, self._acceleration] - before_mps2)
        ttc_s = 10.0 * np.where(obs[:, self._mask] > 0, obs[:, self._ttc], 1.0).min(axis=1)
        close = CLOSE * np.clip((1.6 - ttc_s) / 0.6, 0.0, 1.0)
        if self._by_speed:
            close *= np.clip(20.0 * obs[:, self._speed] / CLOSE_MPS, 0.0, 2.0)
        rough = ROUGH * np.clip(change_mps2 / self._decision_s / 3.0 - 1.0, 0.0, 1.0)
        hard = HARD * np.clip(-10.0 * obs[:, self._acceleration] - 3.0, 0.0, 1.0)
        reward = reward + (close + rough + hard) * ~end
        if end.any():
            metrics = infos["final_info"]["metrics"]
            fault = np.full(len(end), AT_FAULT)
            if self._by_speed:
                fault *= 0.5 + 20.0 * self._before[:, self._speed] / FAULT_MPS
            reward[end] += fault[end] * metrics["at_fault"][end]
            reward[end] += WRONG_WAY * metrics["wrong_way"][end]
        self._before = obs.copy()
        return obs, reward.astype(np.float32), terminated, truncated, infos
