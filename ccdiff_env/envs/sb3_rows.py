"""A features extractor of stable-baselines3 that treats rows of the observation as a set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from ccdiff_env.worlds.spaces import Layout

__all__ = ["RowsExtractor", "rows_policy"]

#: Entries whose rows are a set, with the width of their network.
WIDTHS = {"agents": 48, "map": 32}


class RowsExtractor(BaseFeaturesExtractor):
    """Agents and map segments each pass one network; of every feature the greatest stays.

    So what is learned of one row holds for all rows, and their order means nothing (Qi et al.,
    PointNet, CVPR 2017). Ego and route are handed on as they are. Output: [B, F] of the ego, route
    and route mask entries, then 48 features of the agents and 32 of the map; zeros where no row is
    there.

    Parameters
    ----------
    observation_space
        Box [D] of flat observations.
    entries
        Name, first float and shape of the entries, see :func:`rows_policy`.
    """

    def __init__(
        self,
        observation_space: gymnasium.Space[Any],
        entries: Sequence[tuple[str, int, tuple[int, ...]]],
    ) -> None:
        places = {name: (offset, shape) for name, offset, shape in entries}
        sets = [name for name in WIDTHS if f"{name}_mask" in places]
        rest = [n for n in places if n.removesuffix("_mask") not in sets]
        sizes = {name: torch.Size(shape).numel() for name, (_, shape) in places.items()}
        width = sum(sizes[name] for name in rest) + sum(WIDTHS[name] for name in sets)
        super().__init__(observation_space, width)
        self._places, self._sizes, self._sets, self._rest = places, sizes, sets, rest
        self.networks = nn.ModuleDict(
            {
                name: nn.Sequential(
                    nn.Linear(places[name][1][1], WIDTHS[name]),
                    nn.ReLU(),
                    nn.Linear(WIDTHS[name], WIDTHS[name]),
                    nn.ReLU(),
                )
                for name in sets
            }
        )

    def _part(self, rows: torch.Tensor, name: str) -> torch.Tensor:
        offset, shape = self._places[name]
        return rows[:, offset : offset + self._sizes[name]].reshape(-1, *shape)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Features [B, F] of flat observations [B, D]."""
        parts = [self._part(rows, name).flatten(1) for name in self._rest]
        for name in self._sets:
            mask = self._part(rows, f"{name}_mask").unsqueeze(-1)
            # features are not negative, so that absent rows never are the greatest
            parts.append((self.networks[name](self._part(rows, name)) * mask).amax(dim=1))
        return torch.cat(parts, dim=1)


def rows_policy(layout: Layout) -> dict[str, Any]:
    """Return the ``policy_kwargs`` that make "MlpPolicy" use a :class:`RowsExtractor`.

    Parameters
    ----------
    layout
        Schema of the flat observations, ``env.worlds.layout``; with masks.

    Examples
    --------
    ``PPO("MlpPolicy", env, policy_kwargs=rows_policy(env.env.worlds.layout))``
    """
    entries = [(entry.name, entry.offset, entry.shape) for entry in layout.entries]
    return {
        "features_extractor_class": RowsExtractor,
        "features_extractor_kwargs": {"entries": entries},
    }
