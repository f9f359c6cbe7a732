"""The imitation planner: ``python -m tools.imitation --scenes nuscenes:FOLDER/train --out FILE``.

A network of the shipped ego's kind copies the logged driver. It drives half of the worlds itself,
and is told what the driver did at the place where it is (DAgger). What it last did is hidden from
it in three of four samples, so that it looks at the road (Cheng et al.: *PlanTF*, 2024).
``--open`` trains PDM-Open (Dauner et al. 2023): a smaller network sees its own state on the centre
line alone, and gives the driver's next four seconds in place of an action.
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
from ccdiff_env.envs.ego_network import Agent
from ccdiff_env.policies.ego import OBSERVATION, OPEN_OBSERVATION, POSE_S, REACH_S, save_ego
from ccdiff_env.policies.planning import Tracker
from ccdiff_env.record.episode import begin, play
from ccdiff_env.scenes import SceneSet
from ccdiff_env.worlds import Worlds

#: Scenes of a batch, passes over the scenes, epochs after each batch, rows of an update.
SCENES, PASSES, UPDATES, ROWS = 32, 2, 200, 1024
#: Columns of the ego that are hidden, and how often.
HIDDEN, DROPOUT = ("acceleration", "yaw_rate", "last_action_0", "last_action_1"), 0.75
#: Seconds of a plan of PDM-Open, and the width of its layers.
PLAN_S, WIDTH_OPEN = 4.0, 48
#: Metres by which the poses of plans are divided in the loss, and radians.
SCALE = np.array([10.0, 10.0, 1.0], np.float32)


class Driver:
    """What the logged drivers did at the places where the egos are."""

    def __init__(self, worlds: Worlds) -> None:
        self._worlds, dt = worlds, worlds.config.dt_s
        self.ahead, self.every = round(PLAN_S / dt), round(POSE_S / dt)
        self.agents = [worlds.native.slot_agents(i)[0] or 0 for i in range(worlds.num_worlds)]
        logs = [
            (dict[str, Any](scene.tracks()), agent)
            for scene, agent in zip(worlds.scenes, self.agents, strict=True)
        ]
        self._poses = [
            np.column_stack([t["position"][a], t["heading"][a]])[t["valid"][a]] for t, a in logs
        ]

    def __call__(self) -> npt.NDArray[np.float64]:
        """Return their next poses [E, T, 3], a step apart, in the scenes' frames."""
        native, wanted = self._worlds.native, []
        for i, (poses, agent) in enumerate(zip(self._poses, self.agents, strict=True)):
            away = np.hypot(*(poses[:, :2] - native.states(i)["position"][agent]).T)
            # where the driver stood, the step of the clock counts
            near = np.flatnonzero(away < away.min() + 0.3)
            at = near[np.abs(near - native.status(i).step_idx).argmin()]
            wanted.append(poses[np.minimum(at + 1 + np.arange(self.ahead), len(poses) - 1)])
        return np.stack(wanted)

    def plans(self, poses: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
        """Return poses as plans of the network [E, 3 P] in the egos' frames."""
        found = poses[:, self.every - 1 :: self.every].copy()
        for i, agent in enumerate(self.agents):
            states = self._worlds.native.states(i)
            heading = float(states["heading"][agent])
            x, y = (found[i, :, :2] - states["position"][agent]).T
            found[i, :, 0] = x * np.cos(heading) + y * np.sin(heading)
            found[i, :, 1] = y * np.cos(heading) - x * np.sin(heading)
            turned = found[i, :, 2] - heading
            found[i, :, 2] = np.arctan2(np.sin(turned), np.cos(turned))
        return (found / SCALE).reshape(len(found), -1).astype(np.float32)


def batch(
    scenes: SceneSet, agent: Agent, seed: int, config: Any, own: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return observations [B, D] and what the network shall give; it drives a share of them."""
    worlds = begin(scenes, config, seed)
    driver, rng = Driver(worlds), np.random.default_rng(seed)
    tracker = Tracker(worlds, REACH_S)
    follow = Tracker(worlds, REACH_S, pose_s=POSE_S, frame="ego")
    is_open = len(agent.log_std) > 2
    itself = rng.random(worlds.num_worlds) < own
    seen: list[npt.NDArray[np.float32]] = []
    told: list[npt.NDArray[np.float32]] = []

    def act(obs: npt.NDArray[np.float32], running: npt.NDArray[np.bool_]) -> Any:
        poses = driver()
        actions = tracker(poses)
        seen.append(obs[running].copy())
        told.append((driver.plans(poses) if is_open else actions)[running])
        with torch.no_grad():
            mine = agent(agent.normalised(torch.from_numpy(obs)))[0].numpy()
        if is_open:
            mine = follow(mine.reshape(len(mine), -1, 3) * SCALE)
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
    parser.add_argument("--open", action="store_true", help="train PDM-Open")
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    args = parser.parse_args()
    torch.manual_seed(0)
    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    scenes = load(args.scenes)[: args.limit].read()
    fitting: dict[str, Any] = {"observation": OPEN_OBSERVATION if args.open else OBSERVATION}
    config = PROTOCOL.world(None, "imitation", scenes[0].dt)
    config = config.with_options(driver="external", **fitting)
    layout = begin(SceneSet([scenes[0]]), config, 0).layout
    poses = 3 * round(PLAN_S / POSE_S)
    agent = Agent(layout, (0.1,) * poses, WIDTH_OPEN) if args.open else Agent(layout, (0.1, 0.1))
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
    method = "PDM-Open" if args.open else "imitation"
    state = agent.state_dict()
    if args.open:
        for name in ("policy.4.weight", "policy.4.bias"):
            rows = state[name].reshape(poses // 3, 3, -1) * torch.from_numpy(SCALE)[:, None]
            state[name] = rows.reshape(state[name].shape)
    about = {"method": method, "scenes": len(scenes), "licence": "CC-BY-NC-SA-4.0"}
    save_ego(args.out, state, fitting, about)


def _batches(count: int, rng: np.random.Generator) -> list[npt.NDArray[np.int64]]:
    order = rng.permutation(count)
    return [order[i : i + SCENES] for i in range(0, count, SCENES)]


if __name__ == "__main__":
    main()
