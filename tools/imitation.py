"""The imitation planner: ``python -m tools.imitation --scenes nuscenes:FOLDER/train --out FILE``.

A network of the shipped ego's kind copies the logged driver. It drives half of the worlds itself,
and is told what the driver did at the place where it is (DAgger). What it last did is hidden from
it in three of four samples, so that it looks at the road (Cheng et al.: *PlanTF*, 2024).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from ccdiff_env import load
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.envs.ppo import Agent
from ccdiff_env.policies.ego import OBSERVATION, save_ego
from ccdiff_env.policies.planning import Tracker
from ccdiff_env.record.episode import begin, play
from ccdiff_env.scenes import SceneSet
from ccdiff_env.worlds import Worlds

#: Scenes of a batch, passes over the scenes, epochs after each batch, rows of an update.
SCENES, PASSES, UPDATES, ROWS = 32, 2, 200, 1024
#: Columns of the ego that are hidden, and how often.
HIDDEN, DROPOUT = ("acceleration", "yaw_rate", "last_action_0", "last_action_1"), 0.75
#: Steps ahead of its place on the log at which the driver's pose is aimed at.
AHEAD = 10


class Driver:
    """What the logged drivers did at the places where the egos are."""

    def __init__(self, worlds: Worlds) -> None:
        self._worlds, self._tracker = worlds, Tracker(worlds, AHEAD * worlds.config.dt_s)
        self._agents = [worlds.native.slot_agents(i)[0] or 0 for i in range(worlds.num_worlds)]
        logs = [
            (dict[str, Any](scene.tracks()), agent)
            for scene, agent in zip(worlds.scenes, self._agents, strict=True)
        ]
        self._poses = [
            np.column_stack([t["position"][a], t["heading"][a]])[t["valid"][a]] for t, a in logs
        ]

    def __call__(self) -> npt.NDArray[np.float32]:
        """Return actions [E, 2]."""
        native, wanted = self._worlds.native, []
        for i, (poses, agent) in enumerate(zip(self._poses, self._agents, strict=True)):
            away = np.hypot(*(poses[:, :2] - native.states(i)["position"][agent]).T)
            # where the driver stood, the step of the clock counts
            near = np.flatnonzero(away < away.min() + 0.3)
            at = near[np.abs(near - native.status(i).step_idx).argmin()]
            ahead = np.minimum(at + 1 + np.arange(AHEAD), len(poses) - 1)
            wanted.append(poses[ahead])
        return self._tracker(np.stack(wanted))


def batch(
    scenes: SceneSet, agent: Agent, seed: int, config: Any, own: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return observations [B, D] and the driver's actions [B, 2]; the policy drives a share."""
    worlds = begin(scenes, config, seed)
    driver, rng = Driver(worlds), np.random.default_rng(seed)
    itself = rng.random(worlds.num_worlds) < own
    seen: list[npt.NDArray[np.float32]] = []
    told: list[npt.NDArray[np.float32]] = []

    def act(obs: npt.NDArray[np.float32], running: npt.NDArray[np.bool_]) -> Any:
        actions = driver()
        seen.append(obs[running].copy())
        told.append(actions[running].copy())
        with torch.no_grad():
            mine = agent(agent.normalised(torch.from_numpy(obs)))[0].numpy()
        shaken = np.where(itself[:, None], mine, actions) + rng.normal(0.0, 0.1, actions.shape)
        return np.clip(shaken, -1.0, 1.0)

    for _ in play(worlds, act):
        pass
    return torch.from_numpy(np.concatenate(seen)), torch.from_numpy(np.concatenate(told))


def main() -> None:
    """Train, and write the policy."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default="embedded/train", help="source of the scenes")
    parser.add_argument("--limit", type=int, help="only so many scenes")
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    args = parser.parse_args()
    torch.manual_seed(0)
    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    scenes = load(args.scenes)[: args.limit].read()
    fitting: dict[str, Any] = {"observation": OBSERVATION}
    config = PROTOCOL.world(None, "imitation", scenes[0].dt)
    config = config.with_options(driver="external", **fitting)
    layout = begin(SceneSet([scenes[0]]), config, 0).layout
    agent = Agent(layout, (0.1, 0.1))
    ego = next(entry for entry in layout.entries if entry.name == "ego")
    hidden = [ego.offset + ego.columns.index(name) for name in HIDDEN]
    optimiser = torch.optim.Adam(agent.parameters(), lr=1e-3)
    batches = [b for _ in range(PASSES) for b in _batches(len(scenes), rng)]
    data: list[tuple[torch.Tensor, torch.Tensor]] = []
    for number, chosen in enumerate(batches):
        share = number / len(batches)
        some = SceneSet([scenes[int(i)] for i in chosen])
        data.append(batch(some, agent, number, config, own=min(1.5 * share, 0.75)))
        if share < 1 / PASSES:
            agent.see(data[-1][0])
        obs, actions = (torch.cat(part) for part in zip(*data, strict=True))
        optimiser.param_groups[0]["lr"] = 1e-3 * max(1.0 - share, 0.05)
        losses = []
        for _ in range(UPDATES):
            rows = torch.randint(len(obs), (ROWS,))
            x = agent.normalised(obs[rows])
            x[:, hidden] *= (torch.rand(ROWS, 1) > DROPOUT).float()
            loss = (agent(x)[0] - actions[rows]).abs().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
        print(f"{number + 1} of {len(batches)}: {len(obs)} rows, {np.mean(losses):.4f}", flush=True)
    about = {"method": "imitation", "scenes": len(scenes), "licence": "CC-BY-NC-SA-4.0"}
    save_ego(args.out, agent.state_dict(), fitting, about)


def _batches(count: int, rng: np.random.Generator) -> list[npt.NDArray[np.int64]]:
    order = rng.permutation(count)
    return [order[i : i + SCENES] for i in range(0, count, SCENES)]


if __name__ == "__main__":
    main()
