"""The policy and the recipe of ``ccdiff-env train-ego`` for stable-baselines3's PPO, and SAC's."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.policies import ActorCriticPolicy

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.sb3 import SB3VecEnv
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.ego import one_world
from ccdiff_env.training.cloning import last_action_columns
from ccdiff_env.training.ego_network import Agent, imitate
from ccdiff_env.training.recipe import EPOCHS, GAMMA, LAMBDA, LAST, MINIBATCH, NOISE, RATE, ROLLOUT
from ccdiff_env.worlds.fit import ATTRIBUTE, Fit


def falling_rate(left: float) -> float:
    """Return the learning rate at a share of the training that is left."""
    return RATE * max(left, LAST)


class SetPolicy(ActorCriticPolicy):
    """The policy of ``ccdiff-env train-ego`` for PPO: a set encoder, and noise that goes on.

    It normalises observations itself, by what it saw; ``VecNormalize`` is not for it.

    Args:
        given: What every policy of stable-baselines3 gets.
        noise: Standard deviations of the actions at first; they fall no faster than the learning
            rate does.

    Raises:
        ConfigError: If observations are not the flat ones of this package's worlds, or the noise
            has another width than the actions.
    """

    def __init__(self, *given: Any, noise: tuple[float, ...] = NOISE, **others: Any) -> None:
        self.noise = noise
        super().__init__(*given, **others)

    def _build(self, lr_schedule: Any) -> None:
        space, width = self.observation_space, (self.action_space.shape or (0,))[0]
        fit = Fit.read(getattr(space, ATTRIBUTE, None), "SetPolicy: the observation space")
        if fit.form != "flat" or width != len(self.noise):
            raise ConfigError(
                f"SetPolicy: observations are {fit.form!r} and actions {width} wide, expected "
                f"'flat' and {len(self.noise)}, the width of noise"
            )
        layout = one_world(WorldConfig().with_options(**fit.options)).layout
        self.agent, self._first = Agent(layout, self.noise), lr_schedule(1)
        self.optimizer = self.optimizer_class(
            self.agent.parameters(),
            lr=self._first,  # type: ignore[call-arg]
            **self.optimizer_kwargs,
        )
        self._kept, self._looks = torch.empty(0), True

    def set_training_mode(self, mode: bool) -> None:
        """Look at the observations of the first decision after an update."""
        self._looks |= self.training and not mode
        super().set_training_mode(mode)

    def forward(self, obs: Any, deterministic: bool = False) -> Any:
        """Return actions of the training [E, W], values [E, 1] and log densities [E]."""
        if self._looks:
            self.agent.see(obs)
            self.agent.calm(self.noise, self.optimizer.param_groups[0]["lr"] / self._first)
            self._looks = False
        mean, values = self.agent(self.agent.normalised(obs))
        if self._kept.shape != mean.shape:
            self._kept = torch.randn_like(mean)
        actions = mean if deterministic else self.agent.noisy(mean, self._kept)
        return actions, values.unsqueeze(1), self.agent.log_prob(mean, actions)

    def evaluate_actions(self, obs: Any, actions: torch.Tensor) -> Any:
        """Return values [B, 1], log densities [B] and entropy [B], less constants."""
        mean, values = self.agent.quick(self.agent.normalised(obs))
        entropy = self.agent.log_std.sum().expand(len(mean))
        return values.unsqueeze(1), self.agent.log_prob(mean, actions), entropy

    def get_distribution(self, obs: Any) -> Any:
        """Return the distribution of the actions, without what goes on of the noise."""
        mean, _ = self.agent(self.agent.normalised(obs))
        return self.action_dist.proba_distribution(mean, self.agent.log_std)

    def predict_values(self, obs: Any) -> Any:
        """Return values [B, 1]."""
        return self.agent(self.agent.normalised(obs))[1].unsqueeze(1)


#: Settings of PPO with :class:`SetPolicy` for 512 worlds of :mod:`ccdiff_env.training.recipe`.
PPO_SETTINGS: dict[str, Any] = {
    "n_steps": ROLLOUT,
    "batch_size": MINIBATCH,
    "n_epochs": EPOCHS,
    "learning_rate": falling_rate,
    "gamma": GAMMA,
    "gae_lambda": LAMBDA,
    "device": "cpu",
}
#: Settings of SAC for 256 worlds: one gradient step for about ten decisions.
SAC_SETTINGS: dict[str, Any] = {
    "buffer_size": 400_000,
    "learning_starts": 0,
    "gradient_steps": 24,
    "learning_rate": falling_rate,
    "gamma": GAMMA,
    "ent_coef": "auto_0.002",
    "target_entropy": -3.0,
    "device": "cpu",
    "policy_kwargs": {"net_arch": [128, 128], "optimizer_kwargs": {"fused": True}},
}
#: Options of the ``VecNormalize`` of SAC, whose statistics are those of :func:`clone`.
NORMALIZED: dict[str, Any] = {"norm_reward": False, "clip_obs": 5.0, "epsilon": 1e-4}
PLANNED = 60  #: Decisions of a planner in each world, for the replay buffer of SAC.
CLONE_LOG_STD = -2.0  #: Logarithm of the standard deviations of its clone's actions.
CRITICS_FIRST = 1500  #: Gradient steps before its actor learns.


def clone(
    model: PPO | SAC,
    obs: np.ndarray[Any, Any],
    actions: np.ndarray[Any, Any],
    planned: Any = None,
) -> None:
    """Let a policy begin with what :func:`~ccdiff_env.training.cloning.demonstrations` show.

    The means of the actions are fitted by their absolute errors. SAC begins with what a planner
    does, too, which is in its replay buffer then: its observations are normalised by both from then
    on, and its actor waits for its critics to learn.

    Args:
        model: PPO of :class:`SetPolicy`, or SAC under ``VecNormalize``.
        obs: Observations [N, D].
        actions: Actions [N, W].
        planned: For SAC: as many worlds as its own, with a planner as ``driver``.

    Raises:
        ConfigError: If the model is another one, or has no such worlds.
    """
    if isinstance(model, SAC) and planned is not None and (norm := model.get_vec_normalize_env()):
        _clone_sac(model, norm, obs, actions, SB3VecEnv(planned, clock_ends=True))
        return
    if not isinstance(model.policy, SetPolicy):
        raise ConfigError(
            f"clone: policy is {type(model.policy).__name__}, expected SetPolicy, or that of SAC "
            "under VecNormalize with planned worlds"
        )
    model.policy.agent.begin(torch.from_numpy(obs), torch.from_numpy(actions), model.seed or 0)


def _clone_sac(model: Any, norm: Any, obs: Any, actions: Any, planned: Any) -> None:
    """Fill the replay buffer, fit the statistics and the actor, and let it wait."""
    actor: Any = model.actor
    last = last_action_columns(planned.env.unwrapped)
    rows, done = [obs], [actions]
    planned.seed(model.seed)
    now, idle = planned.reset(), np.zeros((planned.num_envs, len(last)), np.float32)
    for _ in range(PLANNED):
        after, rewards, ended, infos = planned.step(idle)
        met = after.copy()
        for i in np.flatnonzero(ended):
            met[i] = infos[i]["terminal_observation"]
        rows.append(now)
        done.append(met[:, last])
        model.replay_buffer.add(now, met, done[-1], rewards, ended, infos)
        now = after
    seen, norm.training = np.concatenate(rows), False
    norm.obs_rms.mean, norm.obs_rms.var = seen.mean(axis=0), seen.var(axis=0)
    with torch.no_grad():
        actor.log_std.weight.mul_(0.1)
        actor.log_std.bias.fill_(CLONE_LOG_STD)
    imitate(
        lambda x: torch.tanh(actor.mu(actor.latent_pi(x))),
        [w for name, w in actor.named_parameters() if not name.startswith("log_std")],
        torch.from_numpy(norm.normalize_obs(seen)),
        torch.from_numpy(np.concatenate(done)),
        model.seed or 0,
    )
    step, early = actor.optimizer.step, iter(range(CRITICS_FIRST))
    actor.optimizer.step = lambda *given: step(*given) if next(early, None) is None else None
