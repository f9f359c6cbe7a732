"""Who is turned against the ego: a learned choice beside simple ones, at equal realism cost.

Every adversary policy names vehicles at every plan of CCDiff traffic, one by default, whose plans
guidance then bends towards a contact with the ego. The learned one is MaskablePPO of sb3-contrib,
and names one. A simple one pays for its collisions by the strength of the guidance: its share of
scenes with a collision at another's cost is read off the line through its points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.adversary_policy import MAX_AGENTS, REPLAN_STEPS
from ccdiff_env.bench.intervals import FEW, are_few, spread
from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.scenes import chunks, scene_names, scenes_of
from ccdiff_env.envs.selection.options import SelectionReward
from ccdiff_env.errors import ConfigError
from ccdiff_env.policies.planners import ego_driver
from ccdiff_env.system.table import Block, Column, Table, TableRows, document

__all__ = [
    "ADVERSARY_POLICIES",
    "STRENGTHS",
    "adversary_policy_jobs",
    "choose",
    "selection_table",
    "train_adversary_policy",
    "trial_jobs",
]

#: The simple ones, see :meth:`AdversarySelectionVectorEnv.baseline`; ``fork`` tries every candidate
#: in forks of the world and takes the one that comes nearest to the ego.
ADVERSARY_POLICIES = ("none", "random", "nearest", "ttc", "causal", "fork")
#: Strengths of the guidance at which the simple adversary policies are measured; PPO chooses at 1.
STRENGTHS = (0.25, 0.5, 0.75, 1.0)
NUM_ENVS = 32
#: Rewards of training: a fifth of the default ones, so that the loss of the value function does not
#: rule the features that it shares with the policy.
REWARD = SelectionReward(
    **{
        name: 0.2 * getattr(SelectionReward(), name)
        for name in ("collision", "realism", "off_road", "comfort")
    }
)
#: Scenes that share a batch of the network.
CHUNK = 12
#: Steps of a fork: this decision and the next one.
FORK_STEPS = 40


def _options(ego: str, strength: float, device: str) -> dict[str, Any]:
    return {
        "ego": ego,
        "action_mode": "discrete",
        "budget": 1,
        "max_agents": MAX_AGENTS,
        "num_threads": 1,
        "ccdiff": {"criticality": strength, "replan_steps": REPLAN_STEPS, "device": device},
    }


def adversary_policy_jobs(
    source: str, seeds: Sequence[int], *, ego: str, steps: int, folder: Path
) -> list[Job]:
    """Return the jobs that train one adversary policy per seed; policies go to a folder.

    Parameters
    ----------
    source
        Scenes of training, a text of :func:`ccdiff_env.load`.
    seeds
        Seeds of PPO and of the worlds.
    ego
        Who drives the ego, see :class:`~ccdiff_env.AdversarySelectionEnv`.
    steps
        Decisions per adversary policy.
    folder
        Where policies go.
    """
    return [
        Job(
            f"train-{seed}",
            f"{__name__}:train_adversary_policy",
            {
                "source": source,
                "ego": ego,
                "seed": seed,
                "steps": steps,
                "path": str(folder / f"ppo-{seed}.zip"),
            },
        )
        for seed in seeds
    ]


def train_adversary_policy(
    *, source: str, ego: str, seed: int, steps: int, path: str, device: str = "cpu"
) -> dict[str, Any]:
    """Train MaskablePPO and save it.

    Returns
    -------
    dict
        ``curve``: decisions, mean return and share with a collision of the episodes since the last
        row.
    """
    from sb3_contrib import MaskablePPO

    from ccdiff_env.bench.learning import curve_callback
    from ccdiff_env.envs.sb3 import SelectionSB3VecEnv
    from ccdiff_env.envs.selection import AdversarySelectionVectorEnv
    from ccdiff_env.envs.selection.sb3_policy import CandidatePolicy

    env = SelectionSB3VecEnv(
        AdversarySelectionVectorEnv(
            NUM_ENVS, scenes=scenes_of(source), reward=REWARD, **_options(ego, 1.0, device)
        )
    )
    model = MaskablePPO(
        CandidatePolicy,
        env,
        learning_rate=lambda left: 1e-3 * max(left, 0.05),
        n_steps=16,
        batch_size=128,
        n_epochs=5,
        gamma=0.97,
        ent_coef=0.003,
        seed=seed,
        device="cpu",
    )
    curve = curve_callback()
    model.learn(steps, callback=curve)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    model.save(path)
    env.close()
    return {"curve": curve.rows}


def trial_jobs(
    source: str, policies: Sequence[str], *, ego: str, seed: int, budget: int = 1
) -> list[Job]:
    """Return the jobs that try every adversary policy: policies x strengths x chunks of the scenes.

    ``fork`` is left out where the ego is a policy, whose memory a fork does not hold.

    Raises
    ------
    ConfigError
        For trained adversary policies, which name one vehicle, with another budget.
    """
    if policies and budget != 1:
        raise ConfigError(f"budget is {budget}, expected 1 for adversary policies that are trained")
    conditions = [("none", 0.0)]
    left_out = {"none"} if ego_driver(ego)[1] is None else {"none", "fork"}
    simple = [name for name in ADVERSARY_POLICIES if name not in left_out]
    conditions += [(name, strength) for name in simple for strength in STRENGTHS]
    conditions += [(path, 1.0) for path in policies]
    return [
        Job(
            f"{Path(policy).stem}-{strength:g}-{i:03d}",
            f"{__name__}:choose",
            {
                "source": source,
                "names": names,
                "adversary_policy": policy,
                "strength": strength,
                "ego": ego,
                "seed": seed,
                "budget": budget,
            },
        )
        for policy, strength in conditions
        for i, names in enumerate(chunks(scene_names(source), CHUNK))
    ]


def choose(
    *,
    source: str,
    names: Sequence[str],
    adversary_policy: str,
    strength: float,
    ego: str,
    seed: int,
    budget: int = 1,
    device: str = "cpu",
) -> list[dict[str, Any]]:
    """Let an adversary policy choose in every scene once.

    Parameters
    ----------
    source, names
        The scenes.
    adversary_policy
        One of :data:`ADVERSARY_POLICIES`, or the path of a policy of MaskablePPO.
    strength
        Strength of the guidance (criticality).
    ego
        Who drives the ego.
    seed
        Seed of every episode.
    budget
        Vehicles that it names at most; a policy names one.
    device
        Where the network of the traffic runs.

    Returns
    -------
    list of dict
        Per scene: ``collision`` of the ego with a vehicle that was an adversary, ``at_fault`` of
        the ego, ``realism_cost`` and ``shift_sigmas`` means over decisions, ``adversaries``
        chosen per decision.
    """
    from ccdiff_env.envs.selection import AdversarySelectionVectorEnv

    scenes = scenes_of(source, names)
    options = _options(ego, strength, device)
    if adversary_policy in ADVERSARY_POLICIES:
        options |= {"action_mode": "multibinary", "budget": budget}
    env = AdversarySelectionVectorEnv(len(scenes), scenes=scenes, **options)
    policy = None
    if adversary_policy not in ADVERSARY_POLICIES:
        from sb3_contrib import MaskablePPO

        policy = MaskablePPO.load(adversary_policy, device="cpu")
    obs, _ = env.reset(seed=[seed] * len(scenes), options={"scene": list(range(len(scenes)))})
    rows: list[dict[str, Any]] = [{} for _ in scenes]
    at_fault = np.zeros(len(scenes))
    for decision in range(env.worlds.config.horizon_steps):
        if all(rows):
            break
        if adversary_policy == "fork":
            gaps = env.fork_gaps(FORK_STEPS)
            nearest = gaps.argsort(axis=1, kind="stable").argsort(axis=1) < budget
            actions = (nearest & np.isfinite(gaps)).astype(np.int8)
        elif policy is None:
            actions = env.baseline(adversary_policy, seed=1000 * decision)
        else:
            masks = env.action_masks()
            actions, _ = policy.predict(obs, action_masks=masks, deterministic=True)
        obs, _, terminated, truncated, infos = env.step(actions)
        done = terminated | truncated
        at_fault = np.maximum(at_fault, infos["ego_at_fault"])
        for i in np.flatnonzero(done):
            if not rows[i]:
                metrics = infos["final_info"]["metrics"]
                rows[i] = {
                    "scene": scenes[i].name,
                    "collision": float(metrics["is_success"][i]),
                    "at_fault": float(at_fault[i]),
                    "realism_cost": float(metrics["mean_realism_cost"][i]),
                    "shift_sigmas": float(metrics["mean_shift_sigmas"][i]),
                    "adversaries": float(metrics["mean_adversaries"][i]),
                }
    env.close()
    return rows


def selection_table(rows: Mapping[tuple[str, float], Sequence[Mapping[str, Any]]]) -> str:
    """Return the table in Markdown.

    Parameters
    ----------
    rows
        One dictionary per scene (see :func:`choose`) of every policy at every strength. Files
        ``.../ppo-<seed>.zip`` are shown as one, mean ± spread over seeds.
    """
    keys = ("collision", "at_fault", "realism_cost", "shift_sigmas", "adversaries")
    means = {
        c: {k: float(np.mean([r[k] for r in found])) for k in keys} for c, found in rows.items()
    }
    learned = [m for (name, _), m in means.items() if name.endswith(".zip")]
    columns = (
        Column("collision", "ego collides", "%", digits=1, factor=100.0),
        Column("at_fault", unit="%", digits=1, factor=100.0),
        Column("realism_cost", "C(tau)", digits=3),
        Column("shift_sigmas"),
        Column("adversaries", "chosen"),
    )
    shown: TableRows = [
        [name, f"{strength:g}", *(means[name, strength][c.name] for c in columns)]
        for name, strength in means
        if not name.endswith(".zip")
    ]
    nearest: TableRows = []
    if learned:
        cells = [
            spread(
                c.factor * np.array([m[c.name] for m in learned]),
                c.digits,
                next(iter(rows.values())),
            )
            for c in columns
        ]
        shown.append(["PPO", "1", *cells])
        nearest.append(["PPO", cells[0]])
    whole = Table(["adversary policy", "strength", *columns], shown)
    if learned:
        shift, head = float(np.mean([m["shift_sigmas"] for m in learned])), "PPO"
    elif ("fork", 1.0) in means:
        shift, head = means["fork", 1.0]["shift_sigmas"], "fork"
    else:
        return document(whole)
    floor = next((m for (name, _), m in means.items() if name == "none"), None)
    for name in dict.fromkeys(n for n, _ in means if n != "none" and not n.endswith(".zip")):
        points = [m for (n, _), m in means.items() if n == name]
        points += [] if floor is None else [floor]
        points.sort(key=lambda m: m["shift_sigmas"])
        share = np.interp(
            shift, [m["shift_sigmas"] for m in points], [m["collision"] for m in points]
        )
        nearest.append([name, float(share)])
    return document(
        whole,
        f"At the shift of {head} ({shift:.2f} sigmas), between measured strengths:",
        Table(["adversary policy", columns[0]], nearest),
        *_less_causal(rows),
    )


def _less_causal(
    rows: Mapping[tuple[str, float], Sequence[Mapping[str, Any]]],
) -> list[Block]:
    """Paired differences to the causal ranking at full strength ± standard errors over scenes."""
    if ("causal", 1.0) not in rows:
        return []
    if are_few(rows["causal", 1.0]):
        return [FEW]

    def column(name: str, key: str) -> npt.NDArray[np.float64]:
        return np.array([row[key] for row in rows[name, 1.0]], np.float64)

    shown = []
    for name in (n for n, strength in rows if strength == 1.0 and n != "causal"):
        cells = []
        for key, factor, digits in (("collision", 100.0, 1), ("shift_sigmas", 1.0, 2)):
            less = factor * (column(name, key) - column("causal", key))
            error = less.std(ddof=1) / np.sqrt(len(less)) if len(less) > 1 else np.nan
            cells.append(f"{less.mean():+.{digits}f} ± {error:.{digits}f}")
        shown.append([Path(name).stem, *cells])
    return [
        "Less the causal ranking, both at strength 1, ± standard error over scenes:",
        Table(["adversary policy", "ego collides %", "shift, sigmas"], shown),
    ]
