"""The project's main job in one command: train an ego, compare it, draw it.

``python examples/demo.py`` trains a stable-baselines3 PPO ego on training scenes, first in IDM
traffic, then in safety-critical CCDiff traffic that it records for this; drives it on held-out
scenes beside constant velocity, IDM and log replay, in IDM traffic and in realistic and
safety-critical CCDiff traffic; and leaves a table, a learning curve and a replay. Its actions
change what IDM would do (assisted driving). ``--scenes`` names others than the embedded ones.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import dataclasses
import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import ccdiff_env
from ccdiff_env.config import RewardConfig, WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.policies.ego import OBSERVATION
from ccdiff_env.record.recorder import Recorder
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    place_from,
    scenes_from,
)
from ccdiff_env.scenes.sources import title
from ccdiff_env.system.table import Column, Table
from ccdiff_env.system.terminal import say, say_page
from ccdiff_env.view import write_page

#: Figures of an episode that the table shows: (heading, key of the final info, how to read it).
FIGURES = (
    ("success", "is_success"),
    ("collision", "collision"),
    ("at fault", "at_fault"),
    ("off road", "off_road"),
    ("route", "route_completion"),
)
#: Traffic of the evaluation, by the name in the table.
TRAFFIC: dict[str, dict[str, Any]] = {
    "IDM": {"traffic": "idm"},
    "CCDiff": {"traffic": "ccdiff"},
    "critical CCDiff": {"traffic": "ccdiff", "criticality": 1.0},
}
#: Learning rate of each part: what was learned in the first is not to be lost in the second.
LEARNING_RATES = (7e-4, 4e-4)
#: Traffic of each part.
PHASES = ("IDM", "recorded CCDiff")
NUM_ENVS = 128
#: Decisions of each environment between two updates.
NUM_STEPS = 32
#: Episodes that are recorded of each training scene.
DRAWS = 3
#: The ego sees less than by default, so that it learns faster and does not know scenes by heart.
CONFIG = WorldConfig().with_options(
    observation=dict(OBSERVATION), dynamics="assisted", decision_steps=3
)

#: Worlds of training: small rewards.
TRAINING = dataclasses.replace(CONFIG, reward=RewardConfig().scaled(0.2))

Act = Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]


def evaluate(
    scenes: Any, traffic: dict[str, Any], *, act: Act | None = None, driver: str = "external"
) -> list[dict[str, Any]]:
    """Drive every scene once and return the figures of each episode.

    Parameters
    ----------
    scenes : SceneSet
        N scenes.
    traffic : dict
        Options of the environment.
    act : callable, optional
        Actions [N, 2] from observations [N, D]; for ``driver="external"``.
    driver : str
        Who drives the ego.
    """
    env = ccdiff_env.make_vec(len(scenes), scenes=scenes, config=CONFIG, driver=driver, **traffic)
    obs, _ = env.reset(seed=0, options={"scene": list(range(len(scenes)))})
    results: list[dict[str, Any]] = [{} for _ in scenes]
    open_worlds = np.ones(len(scenes), dtype=bool)
    collided = np.zeros(len(scenes), dtype=bool)
    actions = np.zeros(env.action_space.shape or (), dtype=np.float32)
    while open_worlds.any():
        if act is not None:
            actions = act(obs)
        obs, _, terminated, truncated, infos = env.step(actions)
        collided |= infos["collision"].astype(bool) & open_worlds
        for i in np.flatnonzero((terminated | truncated) & open_worlds):
            results[i] = {key: float(infos[key][i]) for _, key in FIGURES}
            results[i] |= {"scene": scenes[i].name, "collision": float(collided[i])}
            results[i]["steps"] = int(infos["metrics"]["length"][i])
        open_worlds &= ~(terminated | truncated)
    env.close()
    return results


def constant(rate: float) -> Callable[[float], float]:
    """Schedule of a learning rate that stays."""
    return lambda _: rate


def train(scenes: Any, steps: tuple[int, int], seed: int, out: Path) -> Any:
    """Train PPO for some decisions in each traffic and write its learning curve; returns it."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import configure
    from tqdm import tqdm

    from ccdiff_env.envs.sb3 import SB3VecEnv
    from ccdiff_env.envs.sb3_rows import rows_policy

    class Curve(BaseCallback):
        """Collects finished episodes, and shows how the last ones went."""

        def __init__(self) -> None:
            super().__init__()
            self.rows: list[tuple[int, float, float]] = []
            self.bar: Any = None
            self.phase = ""

        def _on_step(self) -> bool:
            for info in self.locals["infos"]:
                if "episode" in info:
                    row = (self.num_timesteps, info["episode"]["r"], float(info["is_success"]))
                    self.rows.append(row)
            self.bar.update(NUM_ENVS)
            return True

        def _on_rollout_end(self) -> None:
            self.logger.record("phase", self.phase)
            if self.rows:
                _, reward, success = np.mean(self.rows[-100:], axis=0)
                self.bar.set_postfix_str(f"return {reward:.2f}, success {success:.0%}")

    torch.set_num_threads(1)
    bank = ccdiff_env.record_bank(scenes, out / "bank", criticality=1.0, draws=DRAWS, seed=seed)
    envs = [
        SB3VecEnv(
            ccdiff_env.make_vec(
                NUM_ENVS,
                scenes=some,
                config=dataclasses.replace(TRAINING, start_spread_steps=spread),
                traffic=traffic,
                autoreset_mode="same_step",
                info="end",
            )
        )
        # what is recorded met an ego that started where the log does
        for some, traffic, spread in ((scenes, "idm", 50), (bank, "replay", 10))
    ]
    model = PPO(
        "MlpPolicy",
        envs[0],
        n_steps=NUM_STEPS,
        batch_size=1024,
        n_epochs=4,
        learning_rate=LEARNING_RATES[0],
        gamma=0.98,
        gae_lambda=0.95,
        ent_coef=0.0,
        policy_kwargs={
            **rows_policy(envs[0].env.worlds.layout),
            "net_arch": [128, 128],
            "log_std_init": -1.4,
        },
        seed=seed,
        device="cpu",
    )
    model.set_logger(configure(str(out / "log"), ["csv"]))
    curve = Curve()
    for phase, count, env, rate in zip(PHASES, steps, envs, LEARNING_RATES, strict=True):
        curve.phase = phase
        if count > 0:
            env.seed(seed)
            model.set_env(env)
            model.lr_schedule = constant(rate)
            whole = NUM_ENVS * NUM_STEPS * math.ceil(count / (NUM_ENVS * NUM_STEPS))
            with tqdm(total=whole, unit="step", unit_scale=True, dynamic_ncols=True) as curve.bar:
                model.learn(count, callback=curve, reset_num_timesteps=False)
    model.save(out / "ego_ppo.zip")
    draw_curve(curve.rows, out / "learning_curve.png", change=steps[0])
    for env in envs:
        env.close()
    return model


def draw_curve(rows: list[tuple[int, float, float]], path: Path, *, change: int) -> None:
    """Return and success rate of training episodes against decisions, in windows of 200 episodes.

    A line marks where recorded CCDiff traffic takes over.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    window = max(1, min(200, len(rows) // 10))
    data = np.array(rows, dtype=float).reshape(-1, 3)
    kernel = np.ones(window) / window
    smooth = [np.convolve(data[:, k], kernel, mode="valid") for k in (1, 2)]
    steps = data[window - 1 :, 0]
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), constrained_layout=True)
    for axis, values, label in zip(axes, smooth, ("return", "success rate"), strict=True):
        axis.plot(steps, values, color="#1f77b4")
        if data[-1:, 0].sum() > change:
            axis.axvline(change, color="#888888", linestyle=":", linewidth=1)
            place = {"xy": (change, 0.02), "xycoords": ("data", "axes fraction")}
            for text, side in zip(PHASES, ("right", "left"), strict=True):
                axis.annotate(f"  {text}  ", **place, ha=side, color="#555555")
        axis.set_xlabel("decisions")
        axis.set_ylabel(f"{label}, mean of {window} episodes")
        axis.grid(alpha=0.3)
    axes[1].set_ylim(0, 1)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def record_episode(scenes: Any, index: int, traffic: dict[str, Any], act: Act) -> Rollout:
    """Record one episode of a scene."""
    config = dataclasses.replace(CONFIG, decision_steps=1)
    env = ccdiff_env.make_vec(1, scenes=scenes, config=config, **traffic)
    obs, _ = env.reset(seed=0, options={"scene": [index]})
    recorder = Recorder(env, planner="PPO")
    recorder.start()
    done, step = False, 0
    while not done:
        if step % CONFIG.decision_steps == 0:
            actions = act(obs)
        obs, _, terminated, truncated, _ = env.step(actions)
        recorder.step()
        done, step = bool(terminated[0] or truncated[0]), step + 1
    env.close()
    return recorder.rollout()


def table(results: dict[tuple[str, str], list[dict[str, Any]]]) -> str:
    """Markdown table: one row per traffic and ego, mean over scenes in percent."""
    columns = [Column(name, unit="%", digits=0, factor=100.0) for name, _ in FIGURES]
    shown = [
        [traffic, ego, *(float(np.mean([r[key] for r in rows])) for _, key in FIGURES)]
        for (traffic, ego), rows in results.items()
    ]
    return str(Table(["traffic", "ego", *columns], shown))


def main() -> None:
    """Run the demo."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "test")
    parser.add_argument(
        "--steps",
        type=int,
        nargs=2,
        default=(120_000, 150_000),
        metavar=("IDM", "CCDIFF"),
        help="decisions of training in either traffic",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/demo"))
    parser.add_argument("--smoke", action="store_true", help="next to no training, two scenes")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    start = time.time()
    train_scenes, test_scenes = scenes_from(args), scenes_from(args, other=True)
    name = f"{title(place_from(args))}; {title(other_place(args))}"
    print("about two minutes: trains PPO, compares it with IDM and the log, and opens a replay")
    print(f"{len(train_scenes)} training and {len(test_scenes)} held-out scenes ({name})")
    if args.smoke:
        train_scenes, test_scenes, args.steps = train_scenes[:2], test_scenes[:2], (1, 1)
    first, second = args.steps
    print(
        f"training PPO: {first:,} decisions in IDM traffic, {second:,} in recorded CCDiff traffic"
    )
    model = train(train_scenes, (first, second), args.seed, args.out)

    def ppo(obs: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return np.asarray(model.predict(obs, deterministic=True)[0])

    results = {}
    for name_of, traffic in TRAFFIC.items():
        results[name_of, "PPO"] = evaluate(test_scenes, traffic, act=ppo)
        for driver in ("constant_velocity", "idm", "replay"):
            key = (name_of, driver.replace("_", " "))
            results[key] = evaluate(test_scenes, traffic, driver=driver)
    text = table(results)
    (args.out / "table.md").write_text(text + "\n")
    with (args.out / "episodes.csv").open("w", newline="") as file:
        columns = ["traffic", "ego", "scene", "steps", *(key for _, key in FIGURES)]
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        for (name_of, ego), rows in results.items():
            writer.writerows({"traffic": name_of, "ego": ego, **row} for row in rows)
    drawn = "critical CCDiff"
    longest = int(np.argmax([row["steps"] for row in results[drawn, "PPO"]]))
    episode = record_episode(test_scenes, longest, TRAFFIC[drawn], ppo)
    episode.save(args.out / "episode.npz")
    write_page(episode, args.out / "episode.html")
    summary: dict[str, Any] = {"scenes": name, "steps": list(args.steps), "seed": args.seed}
    summary["seconds"] = time.time() - start
    (args.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    say(f"\n{len(test_scenes)} held-out scenes:\n\n{text}")
    print(f"results in {args.out}/; a replay:")
    with contextlib.suppress(ConfigError):  # no browser
        say_page(args.out / "episode.html", open_it=sys.stdout.isatty())


if __name__ == "__main__":
    main()
