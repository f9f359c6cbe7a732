"""PPO for an ego in thousands of worlds at once: torch and ``make_vec(copy=False)`` alone.

``ccdiff-env train-ego`` is its command. The policy is exported beside the checkpoint, for
:func:`ccdiff_env.planners.load`, ``ccdiff-env bench planners`` and ``ccdiff-env view --driver``.
"""

from __future__ import annotations

import argparse
import io
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import nn

from ccdiff_env.config import AssistedLimits, WorldConfig
from ccdiff_env.envs import make_vec
from ccdiff_env.errors import CheckpointError, ConfigError
from ccdiff_env.planners import load_ego
from ccdiff_env.planners.ego import save_ego
from ccdiff_env.record.bank import load_bank
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.arguments import place_from, scenes_from
from ccdiff_env.scenes.sources import load, parse, settle
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.seeds import spread_seed
from ccdiff_env.system.settings import keep_settings, kept_settings
from ccdiff_env.training.cloning import demonstrations
from ccdiff_env.training.ego_network import Agent
from ccdiff_env.training.networks import licence_of
from ccdiff_env.training.outcomes import Learning, outcomes
from ccdiff_env.training.recipe import (
    BANK,
    DYNAMICS,
    EPOCHS,
    GAMMA,
    LAMBDA,
    LAST,
    LONG,
    LONG_REWARD,
    MINIBATCH,
    REWARD,
    ROLLOUT,
    WORLDS,
    Priced,
    traffic_options,
)

Floats: TypeAlias = np.ndarray[Any, Any]
ASSISTED_GAMMA, CLIP = 0.96, 0.2  # per decision
#: An assisted ego brakes earlier than its base, and is comfortable by its limits.
ASSISTED: dict[str, Any] = {
    "delta_mps2": (-4.0, 0.5),
    "offset_m": (-0.5, 0.5),
    "acceleration_mps2": (-8.0, 2.0),
    "max_jerk_mps3": 2.5,
    "base_jerk_mps3": 2.0,
}
#: Weights of its reward; a place beside the route costs its square.
ASSISTED_WEIGHTS, ASIDE = {"comfort": -0.04, "speed_limit": -0.05}, -0.02
#: Arguments that do not decide what an update does: a run may go on with others.
FREE = ("decisions", "out", "run", "smoke", "threads", "verb")


class Worlds:
    """Vector environments side by side, one for each traffic, as one batch of E worlds."""

    def __init__(self, args: argparse.Namespace, config: WorldConfig, seed: int) -> None:
        scenes = scenes_from(args)
        if args.more_scenes:
            scenes = SceneSet([*scenes, *load(settle(parse(args.more_scenes), "train"))])
        self.scenes = scenes
        # those of a bank met the ego of the data, which started where its log does
        bank = {
            "traffic": "replay",
            "scenes": SceneSet([scene for path in args.bank for scene in load_bank(path)]),
            "start_spread_steps": 10,
        }
        each, shares = args.worlds // len(args.traffic), Counter(args.traffic)
        drawn = {"ego": "any", "standing_share": WORLDS["standing_share"], "start_spread_steps": 0}
        self.drawn = drawn = drawn if args.any_ego else {}
        met = {"scenes": scenes, **drawn}

        def made(traffic: str, count: int) -> Any:
            own = bank if traffic == BANK else met | traffic_options(traffic, args.criticality)
            env = make_vec(
                each * count,
                config=config,
                autoreset_mode="same_step",
                info="end",
                copy=False,
                num_threads=args.threads,
                **own,
            )
            return Priced(env, by_speed=args.long)

        self.envs = [made(*share) for share in shares.items()]
        ends = np.cumsum([env.num_envs for env in self.envs])
        self.parts = [
            slice(end - env.num_envs, end) for env, end in zip(self.envs, ends, strict=True)
        ]
        self.noise = torch.randn(self.parts[-1].stop, *self.envs[0].single_action_space.shape)
        self.learning = Learning(args.out)
        begun = zip(self.envs, self.parts, strict=True)
        self.obs = np.concatenate([env.reset(seed=seed + part.start)[0] for env, part in begun])
        is_assisted = isinstance(config.action.dynamics, AssistedLimits)
        self.aside, self.gamma = (ASIDE, ASSISTED_GAMMA) if is_assisted else (0.0, GAMMA)
        # whether what would come after the clock counts: who sees the clock would else rather crash
        # after the goal than go on at a small price without an end
        self.goes_on = is_assisted

    def step(self, actions: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Rewards [E], ends [E], worlds [N] that were cut off, and what those saw last [N, D]."""
        rewards, ends, cut, last = [], [], [], [np.empty((0, self.obs.shape[1]), np.float32)]
        for env, part in zip(self.envs, self.parts, strict=True):
            self.obs[part], reward, terminated, truncated, info = env.step(actions[part])
            end = terminated | truncated
            reward = reward + self.aside * actions[part, 1] ** 2
            if truncated.any():
                cut.append(np.flatnonzero(truncated) + part.start)
                last.append(np.stack(info["final_obs"][truncated]))
            if end.any():
                self.learning.add(outcomes(env, info))
            rewards.append(reward)
            ends.append(end)
        found = np.concatenate(cut) if cut else np.empty(0, np.int64)
        return np.concatenate(rewards), np.concatenate(ends), found, np.concatenate(last)


def rollout(agent: Agent, worlds: Worlds) -> dict[str, torch.Tensor]:
    """Let all worlds decide ROLLOUT times; tensors [T, E, ...]."""
    size, width, gamma = worlds.obs.shape[0], len(agent.log_std), worlds.gamma
    x, values = torch.empty(ROLLOUT, *worlds.obs.shape), torch.empty(ROLLOUT + 1, size)
    actions, log_prob = torch.empty(ROLLOUT, size, width), torch.empty(ROLLOUT, size)
    rewards, ends = torch.empty(ROLLOUT, size), torch.empty(ROLLOUT, size)
    for t in range(ROLLOUT):
        x[t] = agent.normalised(torch.from_numpy(worlds.obs))
        mean, values[t] = agent(x[t])
        actions[t] = agent.noisy(mean, worlds.noise)
        log_prob[t] = agent.log_prob(mean, actions[t])
        reward, end, cut, last = worlds.step(actions[t].clamp(-1.0, 1.0).numpy())
        rewards[t], ends[t] = torch.from_numpy(reward), torch.from_numpy(end)
        if len(cut) and worlds.goes_on:  # a clock that runs out says nothing about such a state
            rewards[t, cut] += gamma * agent(agent.normalised(torch.from_numpy(last)))[1]
    values[ROLLOUT] = agent(agent.normalised(torch.from_numpy(worlds.obs)))[1]
    advantage, later = torch.empty(ROLLOUT, size), torch.zeros(size)
    for t in reversed(range(ROLLOUT)):
        goes_on = 1.0 - ends[t]
        delta = rewards[t] + gamma * goes_on * values[t + 1] - values[t]
        later = delta + gamma * LAMBDA * goes_on * later
        advantage[t] = later
    found = {"x": x, "actions": actions, "log_prob": log_prob, "advantage": advantage}
    found |= {"returns": advantage + values[:-1]}
    return {name: value.flatten(0, 1) for name, value in found.items()}


def update(
    agent: Agent, optimiser: torch.optim.Optimizer, data: dict[str, torch.Tensor], kl: float = 0.0
) -> None:
    """Some epochs of PPO; ``kl`` is the price of the KL divergence from no action."""
    advantage = data["advantage"]
    data["advantage"] = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    for _ in range(EPOCHS):
        order = torch.randperm(len(advantage))
        for first in range(0, len(order), MINIBATCH):
            index = order[first : first + MINIBATCH]
            mean, values = agent.quick(data["x"][index])
            change = agent.log_prob(mean, data["actions"][index]) - data["log_prob"][index]
            ratio, gain = change.exp(), data["advantage"][index]
            policy = torch.max(-gain * ratio, -gain * ratio.clamp(1.0 - CLIP, 1.0 + CLIP)).mean()
            value = (values - data["returns"][index]).pow(2).mean()
            loss = policy + 0.5 * value
            if kl:
                away = mean / agent.log_std.detach().exp()
                loss = loss + kl * 0.5 * away.pow(2).sum(1).mean()
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def settings_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return what a run is begun with, as its folder keeps it."""
    settings = {n: of for n, of in vars(args).items() if n not in FREE}
    return settings | {"bank": [*map(str, args.bank)]}


def train(args: argparse.Namespace) -> None:
    """Train as the arguments of ``ccdiff-env train-ego`` say; write checkpoint and policy.

    Both are also written where the run is interrupted; one that diverges keeps its last ones.
    A run in ``--out`` goes on; one of other settings is a :class:`ConfigError`.
    """
    if args.smoke:
        args.worlds, args.decisions = 16 * len(args.traffic), 1
    torch.set_num_threads(args.threads)
    goes_on = bool(args.start) and args.start.endswith(".pt")  # the policy is beside it
    policy = Path(args.start).with_name("ego.safetensors") if goes_on else args.start
    given = load_ego(policy) if policy else None
    own = {"assisted": {"assisted": {"base": args.base, **ASSISTED}}, "unicycle": DYNAMICS}
    dynamics: Any = own.get(args.dynamics, args.dynamics)
    asked = WorldConfig().with_options(dynamics=dynamics).action.dynamics
    trained = given.config.action.dynamics if given else asked
    if (type(trained), getattr(trained, "base", "")) != (type(asked), getattr(asked, "base", "")):
        raise ConfigError(f"--start {args.start} drives by {trained}, expected {asked}")
    fitting: dict[str, Any] = {
        "dynamics": trained if given else dynamics,
        "decision_steps": args.decision_steps,
        **({"observation": LONG} if args.long else {}),
    }
    config = WorldConfig().with_options(**fitting, start_spread_steps=50)
    is_assisted = isinstance(config.action.dynamics, AssistedLimits)
    alone = {
        "reward": LONG_REWARD if args.long else REWARD,
        "terminate_at_goal": WORLDS["terminate_at_goal"],
    }
    config = config.with_options(**{"reward": ASSISTED_WEIGHTS} if is_assisted else alone)
    checkpoint = args.out / "checkpoint.pt"
    settings = settings_of(args)
    if not kept_settings(args.out / "run.json", settings) and checkpoint.is_file():
        raise ConfigError(f"{args.out} holds a run without its settings; choose another folder")
    saved = torch.load(checkpoint, weights_only=True) if checkpoint.is_file() else None
    done = {"decisions": 0, "seconds": 0.0, "updates": 0, **(saved["done"] if saved else {})}
    torch.manual_seed((args.seed + done["updates"]) % 2**64)
    worlds = Worlds(args, config, spread_seed(args.seed, done["decisions"]))
    if given is not None:
        given.check(worlds.envs[0].worlds)
    layout = worlds.envs[0].worlds.layout
    agent = Agent(layout, tuple(args.noise), even=args.long)
    optimiser = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5, fused=True)
    if saved:
        agent.load_state_dict(saved["agent"])
        optimiser.load_state_dict(saved["optimiser"])
    elif goes_on:
        agent.load_state_dict(torch.load(args.start, weights_only=True)["agent"])
        agent.log_std.data = torch.tensor(args.noise).log()
    elif given is not None:
        agent.take(given)
    elif args.shown and not is_assisted:
        log = {"config": config.with_options(decision_steps=1), **worlds.drawn}
        steps = {"seed": args.seed, "decision_steps": config.decision_steps}
        obs, actions = map(
            torch.from_numpy, demonstrations(worlds.scenes, args.shown, **steps, **log)
        )
        agent.begin(obs, actions, args.seed)

    bound = licence_of(place_from(args), args.more_scenes)
    if given is not None and "licence" in given.about:
        bound = {"licence": given.about["licence"]}

    def keep() -> None:
        if not all(bool(weights.isfinite().all()) for weights in agent.parameters()):
            raise CheckpointError(
                f"training diverged within {done['decisions']} decisions: weights are not finite; "
                f"{args.out} keeps what was saved before"
            )
        state = {"agent": agent.state_dict(), "optimiser": optimiser.state_dict(), "done": done}
        torch.save(state, packed := io.BytesIO())
        write_aside(checkpoint, packed.getvalue())
        about = {"done": done, **bound}
        save_ego(args.out / "ego.safetensors", agent.tensors(), fitting, about)

    keep_settings(args.out / "run.json", settings)
    begin = kept = time.perf_counter() - done["seconds"]
    try:
        while done["decisions"] < args.decisions:
            left = 1.0 - done["decisions"] / args.decisions
            optimiser.param_groups[0]["lr"] = args.learning_rate * max(left, LAST)
            with torch.no_grad():
                agent.see(torch.from_numpy(worlds.obs))
                data = rollout(agent, worlds)
            update(agent, optimiser, data, args.kl)
            agent.calm(args.noise, max(left, LAST))
            done["decisions"] += len(data["x"])
            done["updates"] += 1
            done["seconds"] = now = time.perf_counter() - begin
            worlds.learning.say(done["decisions"], f"{now / 60:5.1f} min")
            if time.perf_counter() - kept > 120.0:
                keep()
                kept = time.perf_counter()
    except BaseException:
        with suppress(CheckpointError):
            keep()
        raise
    keep()
    worlds.learning.say(done["decisions"], f"{done['seconds'] / 60:5.1f} min", last=True)
    print(f"policy in {args.out / 'ego.safetensors'}")
