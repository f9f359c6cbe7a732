"""What logged drivers did, as decisions of an ego, and a policy that begins with them.

A log has no actions: they are those of the dynamics that lead from each logged state to the next.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector.utils import concatenate, create_empty_array

from ccdiff_env.envs import EGO_ID, EgoEnv, make_vec
from ccdiff_env.errors import ConfigError, DatasetError, MissingFeatureError
from ccdiff_env.worlds import Scenes
from ccdiff_env.worlds.spaces import F32

WORLDS, STEPS = 512, 60


def demonstrations(
    scenes: Scenes, number: int, *, seed: int = 0, decision_steps: int = 1, **options: Any
) -> tuple[F32, F32]:
    """Return what logged egos saw and did.

    The action of a decision is the mean of those of its steps, clipped to [-1, 1]; the last action
    that is observed is that of the decision before.

    Args:
        scenes: Scenes, as :func:`ccdiff_env.make_vec` takes them.
        number: Decisions N.
        seed: Seed of the draws.
        decision_steps: Steps of a decision.
        options: Other options of the worlds, such as ``ego="any"``; traffic follows the log.

    Returns:
        obs, actions: Flat observations [N, D], actions [N, W] in [-1, 1].

    Raises:
        ConfigError: If ``number`` or ``decision_steps`` is below 1, the dynamics have no inverse,
            or no episode lasts two decisions.
    """
    for name, count in (("number", number), ("decision_steps", decision_steps)):
        if count < 1:
            raise ConfigError(f"{name} is {count}, expected at least 1")
    goes_on = {"on_collision": "ignore", "on_off_road": "ignore", "terminate_at_goal": False}
    given = options | goes_on | {"traffic": "replay", "driver": "replay"}
    env = make_vec(WORLDS, scenes=scenes, autoreset_mode="same_step", info="none", **given)
    last = last_action_columns(env)
    obs, _ = env.reset(seed=seed)
    k, found, have = decision_steps, list[tuple[F32, F32]](), 0
    steps = STEPS if 2 * k < STEPS else 3 * k
    shape = (steps, *(env.action_space.shape or ()))
    idle, begins = np.zeros(shape[1:], np.float32), np.ones(WORLDS, np.int64)
    while have < number:
        seen = np.empty((steps, *obs.shape), np.float32)
        done = np.empty(shape, np.float32)
        episode = np.empty((steps, WORLDS), np.int64)
        for t in range(steps):
            seen[t], episode[t] = obs, begins
            done[t] = [env.worlds.native.expert_actions(i)[0] for i in range(WORLDS)]
            obs, _, terminated, truncated, _ = env.step(idle)
            begins = begins + (terminated | truncated)
        done = done.clip(-1.0, 1.0)
        for t in range(k, steps - k, k):
            whole = (episode[t - k] == episode[t]) & (episode[t + k - 1] == episode[t])
            row = seen[t, whole]
            row[:, last] = done[t - k : t, whole].mean(axis=0)[:, : len(last)]
            found.append((row, done[t : t + k, whole].mean(axis=0)))
            have += len(row)
        if have == 0:
            raise ConfigError(f"decision_steps is {k}, expected episodes that last two decisions")
    rows, actions = (np.concatenate(parts)[:number] for parts in zip(*found, strict=True))
    return rows, actions


def last_action_columns(env: Any) -> list[int]:
    """Return where flat observations of worlds have the action before."""
    ego = env.worlds.layout.entries[0]
    return [ego.offset + i for i, n in enumerate(ego.columns) if n.startswith("last_action_")]


def export_demonstrations(
    scenes: Scenes,
    driver: str,
    path: str | os.PathLike[str],
    *,
    episodes: int | None = None,
    seed: int = 0,
    **options: Any,
) -> Path:
    """Write episodes of a driver as a data set of Minari, which ``minari.MinariDataset`` opens.

    From its seed and options, an episode is repeated bit for bit by its actions, in the environment
    that ``recover_environment()`` gives where ``scenes`` is a text.

    Args:
        scenes: Scenes, as :class:`EgoEnv` takes them, played in turn.
        driver: ``"replay"``, whose actions lead towards the next logged states, or a planner, as
            ``EgoEnv(driver=)`` takes it.
        path: Folder of the data set, a new one.
        episodes: Number of episodes; one of each scene by default.
        seed: Episode i begins with the seed ``seed + i``.
        options: Other options of :class:`EgoEnv`, such as ``traffic="idm"``.

    Returns:
        path: The folder, with observations [T + 1, ...], actions [T, W] in [-1, 1], rewards,
            terminations and truncations [T] of each episode.

    Raises:
        MissingFeatureError: If Minari is not installed.
        DatasetError: If the folder is not empty.
        ConfigError: If ``episodes`` is below 1, the driver moves the ego without actions, or the
            dynamics have no inverse.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_storage import MinariStorage
    except ModuleNotFoundError as error:
        raise MissingFeatureError(
            f"a Minari data set needs {error.name}: pip install 'ccdiff-env[minari]'"
        ) from None
    out, is_log = Path(path), driver == "replay"
    if out.exists() and any(out.iterdir()):
        raise DatasetError(f"{out} is not empty, expected a new folder")
    options |= {"driver": "external" if is_log else driver}
    env: Any = EgoEnv(scenes=scenes, info="none", **options)
    if env.worlds.config.driver != "external":
        raise ConfigError(f"driver is {driver!r}, expected 'replay' or a planner with actions")
    number = len(env.scenes) if episodes is None else episodes
    if number < 1:
        raise ConfigError(f"episodes is {number}, expected at least 1")
    space, seen, spec = env.action_space, env.observation_space, None
    idle = np.zeros(space.shape, space.dtype)  # a planner at the wheel does not listen
    if isinstance(scenes, str):
        fields = json.loads(env.worlds.config.to_json())
        fields["ego"] = fields.pop("controlled")
        del fields["num_slots"], fields["autoreset"]
        form = options.get("observation", "flat")
        fields["observation"]["form"] = form if isinstance(form, str) else form.get("form", "flat")
        fields |= {n: options[n] for n in ("criticality",) if n in options}
        spec = gymnasium.make(EGO_ID, scenes=scenes, **fields).spec

    def play(i: int) -> Any:
        begin = {"scene": env.scenes[i % len(env.scenes)].name}
        rows, steps = [env.reset(seed=seed + i, options=begin)[0]], list[Any]()
        while not steps or not any(steps[-1][1:]):
            obs, *step, _ = env.step(env.expert_action() if is_log else idle)
            rows.append(obs)
            steps.append(step)
        actions = env.certificate().actions
        actions = actions.clip(-1.0, 1.0) if space.shape else actions[:, 0].astype(np.int64)
        names = ("rewards", "terminations", "truncations")
        room: Any = create_empty_array(seen, len(rows))
        return EpisodeBuffer(
            seed=seed + i,
            options=begin,
            observations=concatenate(seen, rows, room),
            actions=actions,
            **dict(zip(names, map(list, zip(*steps, strict=True)), strict=True)),
        )

    out.mkdir(parents=True, exist_ok=True)
    storage = MinariStorage.new(out, seen, space, spec)
    about = {"dataset_id": f"{out.name}-v0", "minari_version": minari.__version__}
    storage.update_metadata(about | {"algorithm_name": driver})
    storage.update_episodes(map(play, range(number)))
    return out
