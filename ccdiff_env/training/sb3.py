"""The policy and the recipe of ``ccdiff-env train-ego`` for stable-baselines3's PPO, and SAC's."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.ego import one_world
from ccdiff_env.training.ego_network import Agent
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
#: Settings of SAC for 32 worlds: one gradient step for every four decisions.
SAC_SETTINGS: dict[str, Any] = {
    "buffer_size": 200_000,
    "learning_starts": 4_000,
    "gradient_steps": 8,
    "learning_rate": 5e-4,
    "gamma": 0.96,
    "ent_coef": "auto_0.02",
    "device": "cpu",
    "policy_kwargs": {"net_arch": [128, 128]},
}


def clone(model: PPO, obs: np.ndarray[Any, Any], actions: np.ndarray[Any, Any]) -> None:
    """Let PPO's policy begin with what :func:`~ccdiff_env.training.cloning.demonstrations` show.

    The means of the actions are fitted by their absolute errors.

    Args:
        model: PPO of :class:`SetPolicy`.
        obs: Observations [N, D].
        actions: Actions [N, W].

    Raises:
        ConfigError: If its policy is another one.
    """
    if not isinstance(model.policy, SetPolicy):
        raise ConfigError(f"clone: policy is {type(model.policy).__name__}, expected SetPolicy")
    model.policy.agent.begin(torch.from_numpy(obs), torch.from_numpy(actions), model.seed or 0)
