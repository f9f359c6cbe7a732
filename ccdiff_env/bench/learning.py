"""Egos trained in different traffic, each evaluated in all of it.

Every ego is PPO of stable-baselines3 with the same network, observation and number of steps. All
egos of a seed begin as the same one, which learned to drive in log replay; then each has its own
traffic. Training scenes and evaluation scenes have no scene in common.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import FEW, are_few, mean_interval, spread
from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.config import RewardConfig, WorldConfig
from ccdiff_env.system.seeds import spread_seed
from ccdiff_env.system.table import Block, Table, TableRows, document

__all__ = ["TRAINING_STAGES", "learning_table", "train_ego", "training_jobs"]

#: Traffic of training by name: options of the vector environment.
TRAINING_STAGES: dict[str, dict[str, Any]] = {
    "replay": {"traffic": "replay"},
    "ccdiff": {"traffic": "ccdiff"},
    # criticality is drawn anew for every episode, so that realistic traffic is not forgotten
    "critical": {"traffic": "ccdiff", "criticality": (0.0, 2.0)},
}
#: What the egos see: themselves, their route and the agents. Segments of the map, the time that is
#: left and the like tell one scene from another: egos that see them drive the scenes of training by
#: heart and do worse in unseen ones.
OBSERVATION: dict[str, Any] = {
    "num_map_segments": 0,
    "ego_columns": (
        "speed",
        "acceleration",
        "yaw_rate",
        "last_action_0",
        "last_action_1",
        "route_distance",
        "route_sin",
        "route_cos",
        "off_road",
        "route_remaining",
        "leader_gap",
        "leader_closing",
    ),
}
#: Worlds of training: small rewards, and starts all over the log.
TRAINING: dict[str, Any] = {
    "observation": OBSERVATION,
    "reward": RewardConfig().scaled(0.2),
    "start_spread_steps": 60,
}
PPO_SETTINGS: dict[str, Any] = {
    "batch_size": 512,
    "n_epochs": 6,
    "gamma": 0.98,
    "gae_lambda": 0.95,
}
#: Of pretraining and of the stages: learning rate, which falls to a twentieth, and steps of each
#: world between updates.
BASE = (3e-4, 128)
STAGE = (2e-4, 64)
NUM_ENVS = 64
#: Figures of the table: heading, part of the planner's score, factor.
FIGURES = (
    ("collision %", "collision", 100.0),
    ("at fault %", "no_at_fault_collision", -100.0),
    ("off road %", "on_road", -100.0),
    ("route %", "progress", 100.0),
    ("comfort %", "comfort", 100.0),
    ("score", "score", 1.0),
)


def training_jobs(
    source: str,
    stages: Sequence[str],
    seeds: Sequence[int],
    *,
    steps: int,
    base_steps: int,
    folder: Path,
) -> tuple[list[Job], list[Job]]:
    """Return the jobs that train the egos; policies go to a folder.

    Parameters
    ----------
    source
        Scenes of training, a text of :func:`ccdiff_env.load`.
    stages
        Names of :data:`TRAINING_STAGES`.
    seeds
        Seeds of PPO and of the worlds.
    steps
        Steps of each stage.
    base_steps
        Steps in log replay before the stages.
    folder
        Where policies go.

    Returns
    -------
    base, stages
        Jobs of the common pretraining, one per seed; then those that need it, one per seed and
        stage.
    """
    common = {"source": source}
    train = f"{__name__}:train_ego"
    base = [
        Job(
            f"base-{seed}",
            train,
            {
                **common,
                "stage": "replay",
                "seed": seed,
                "steps": base_steps,
                "path": str(folder / f"base-{seed}.zip"),
            },
        )
        for seed in seeds
    ]
    taught = [
        Job(
            f"train-{stage}-{seed}",
            train,
            {
                **common,
                "stage": stage,
                "seed": seed,
                "steps": steps,
                "path": str(folder / f"{stage}-{seed}.zip"),
                "start": str(folder / f"base-{seed}.zip"),
            },
        )
        for seed in seeds
        for stage in stages
    ]
    return base, taught


def train_ego(
    *,
    source: str,
    stage: str,
    seed: int,
    steps: int,
    path: str,
    start: str | None = None,
    device: str = "cpu",
) -> dict[str, Any]:
    """Train PPO in one kind of traffic, from scratch or from a saved policy, and save it.

    Returns
    -------
    dict
        ``curve``: step, mean return and success rate of the episodes that ended since the last row.
    """
    from stable_baselines3 import PPO

    from ccdiff_env.envs import make_vec
    from ccdiff_env.envs.sb3 import SB3VecEnv
    from ccdiff_env.envs.sb3_rows import rows_policy

    options = dict(TRAINING_STAGES[stage])
    if stage != "replay":
        options["ccdiff"] = {"device": device}
    env = SB3VecEnv(
        make_vec(
            NUM_ENVS,
            scenes=scenes_of(source),
            config=WorldConfig().with_options(**TRAINING),
            autoreset_mode="same_step",
            num_threads=1,
            **options,
        )
    )
    rate, n_steps = BASE if start is None else STAGE
    policy = rows_policy(env.env.worlds.layout)
    model = PPO(
        "MlpPolicy",
        env,
        learning_rate=lambda left: rate * max(left, 0.05),
        n_steps=n_steps,
        **PPO_SETTINGS,
        policy_kwargs={**policy, "net_arch": [128, 128], "log_std_init": -1.0},
        seed=spread_seed(seed),
        device="cpu",
    )
    if start is not None:
        model.set_parameters(start, device="cpu")
    curve = curve_callback()
    model.learn(steps, callback=curve)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    model.save(path)
    env.close()
    return {"curve": curve.rows}


def curve_callback() -> Any:
    """Return a callback of stable-baselines3 whose ``rows`` are a learning curve.

    One row per rollout: step, mean return and success rate of the episodes that ended in it.
    """
    from stable_baselines3.common.callbacks import BaseCallback

    class Curve(BaseCallback):
        """Collects finished episodes."""

        def __init__(self) -> None:
            super().__init__()
            self.rows: list[list[float]] = []
            self.recent: list[tuple[float, float]] = []

        def _on_step(self) -> bool:
            for info in self.locals["infos"]:
                if "episode" in info:
                    self.recent.append((info["episode"]["r"], float(info["is_success"])))
            return True

        def _on_rollout_end(self) -> None:
            if self.recent:
                mean = np.mean(self.recent, axis=0)
                self.rows.append([float(self.num_timesteps), float(mean[0]), float(mean[1])])
                self.recent = []

    return Curve()


def learning_table(rows: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> str:
    """Return the tables in Markdown: mean over scenes, then mean ± spread over seeds; then by seed.

    Parameters
    ----------
    rows
        One dictionary per scene (see :func:`ccdiff_env.bench.planner_score.Judge.row`) of every
        planner (``stage-seed`` for trained egos) in every traffic.
    """
    groups: dict[str, list[str]] = {}
    for planner, _ in rows:
        stage, seed = _stage_of(planner)
        name = planner if seed is None else f"PPO, trained in {stage}"
        if planner not in groups.setdefault(name, []):
            groups[name].append(planner)
    blocks: list[Block] = []
    for traffic in dict.fromkeys(t for _, t in rows):
        shown: TableRows = []
        for name, planners in groups.items():
            cells = []
            for _, part, factor in FIGURES:
                means = np.array([mean_interval(rows[p, traffic], part)[0] for p in planners])
                values = factor * means if factor > 0 else -factor * (1.0 - means)
                digits = 2 if abs(factor) == 1.0 else 1
                cells.append(spread(values, digits, rows[planners[0], traffic]))
            shown.append([name, *cells])
        heads = [name for name, *_ in FIGURES]
        blocks.append(Table(["ego", *heads], shown, f"Evaluated in: {TRAFFIC[traffic].label}"))
    few = FEW if any(map(are_few, rows.values())) else ""
    return document(*blocks, few, _by_seed(rows), _against_replay(rows))


def _stage_of(planner: str) -> tuple[str, str | None]:
    """Return the stage and the seed of a trained ego, the name and ``None`` of another planner."""
    stage, _, seed = Path(planner).stem.rpartition("-")
    return (stage, seed) if stage in TRAINING_STAGES and seed.isdigit() else (planner, None)


def _by_seed(rows: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> Table:
    """Return a table: collisions, and those at fault, of each ego."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for (planner, traffic), found in rows.items():
        stage, seed = _stage_of(planner)
        if seed is not None:
            hit = 100.0 * np.mean([row["collision"] for row in found])
            fault = 100.0 - 100.0 * np.mean([row["no_at_fault_collision"] for row in found])
            cells.setdefault((traffic, stage), {})[seed] = f"{hit:.1f} ({fault:.1f})"
    seeds = sorted({seed for by_seed in cells.values() for seed in by_seed}, key=int)
    shown = [
        [TRAFFIC[traffic].label, stage, *(by_seed.get(seed, "") for seed in seeds)]
        for (traffic, stage), by_seed in cells.items()
    ]
    heads = ["evaluated in", "trained in", *(f"seed {s}" for s in seeds)]
    return Table(heads, shown, "By seed: collision % (at fault %)")


def _against_replay(rows: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> Table:
    """Return a table: other stages less the one in log replay, pair by pair.

    A pair is an episode of two egos of one seed in the same scene and draw of the traffic.
    """
    pairs: dict[tuple[str, str], list[list[float]]] = {}
    for (planner, traffic), found in rows.items():
        stage, seed = _stage_of(planner)
        beside = rows.get((str(Path(planner).with_name(f"replay-{seed}.zip")), traffic))
        if seed is None or stage == "replay" or beside is None:
            continue
        if are_few(found):
            continue
        pairs.setdefault((traffic, stage), []).extend(
            [
                row["collision"] - other["collision"],
                other["no_at_fault_collision"] - row["no_at_fault_collision"],
            ]
            for row, other in zip(found, beside, strict=True)
        )
    shown = []
    for (traffic, stage), differences in pairs.items():
        points = 100.0 * np.array(differences)
        errors = points.std(axis=0, ddof=1) / np.sqrt(len(points))
        cells = [f"{m:+.1f} ± {e:.1f}" for m, e in zip(points.mean(axis=0), errors, strict=True)]
        shown.append([TRAFFIC[traffic].label, stage, *cells])
    title = "Less the egos trained in log replay: percent of paired episodes ± standard error"
    return Table(["evaluated in", "trained in", "collision", "at fault"], shown, title)
