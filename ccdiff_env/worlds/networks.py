"""Policies of networks, for the native worlds."""

from __future__ import annotations

import json
from collections.abc import Sequence

from ccdiff_env import _native
from ccdiff_env.config import EgosConfig, WorldConfig
from ccdiff_env.errors import CheckpointError, UnknownNameError
from ccdiff_env.models import needs_torch, require_networks, weights_path
from ccdiff_env.scenes import Scene
from ccdiff_env.traffic import EGOS
from ccdiff_env.worlds.policy_file import adversary_policy_path, egos_policy


def network_policies(
    config: WorldConfig, scenes: Sequence[Scene], num_threads: int
) -> dict[str, object]:
    """Return the policies of a configuration that need a network, by name, for the native worlds.

    They plan on ``num_threads`` threads; plans do not depend on their number. Raises
    :class:`MissingFeatureError` where a network needs torch, :class:`UnknownNameError` where no
    scene has an agent that contacts shall be aimed at, and errors that name settings, weights or
    scenes that do not fit.
    """

    def made(name: str, kind: str, options: str) -> object:
        settings = json.loads(options)
        if kind == EGOS:
            return egos_policy(EgosConfig(**settings), config.dt_s)
        if targets := set(settings.get("targets", ())):
            for nobody in sorted(targets.difference(*(scene.agent_ids for scene in scenes))):
                raise UnknownNameError(f"{name}.targets: no scene has an agent {nobody!r}")
        weights = weights_path(
            settings["weights"], kind, settings["denoising_steps"], settings["follow_route"]
        )
        if settings.get("adversary_policy") is not None:
            policy = adversary_policy_path(settings["adversary_policy"])
            options = json.dumps({**settings, "adversary_policy": str(policy)})
        make = _native.traffic_policy
        if needs_torch(weights, settings["device"]):
            require_networks()
            from ccdiff_env import _models

            make = _models.traffic_policy
        try:
            return make(name, kind, options, weights, config.dt_s, num_threads, list(scenes))
        except OSError as error:
            raise CheckpointError(str(error)) from None

    wanted = _native.networks_wanted(config.to_json())
    return {name: made(name, kind, options) for name, kind, options in wanted}
