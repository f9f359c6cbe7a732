"""What vector environments share: many worlds that are one object, with a row or more for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ccdiff_env.envs.attributes import Attributes
from ccdiff_env.envs.drawing import Image
from ccdiff_env.envs.image import image
from ccdiff_env.errors import ConfigError
from ccdiff_env.worlds import StepArrays, exact_seed, normalize_seed
from ccdiff_env.worlds.spaces import F32, U8, Bool, Form

Info = dict[str, Any]
_NOBODY_NEAR_S = 10.0  #: Greatest time to contact.


class AsVector(Attributes, VectorEnv[Any, Any, Any]):
    """Spaces, seeds and options of resets, and infos."""

    #: Options that a reset takes for all worlds, or for each.
    reset_option_names: ClassVar[tuple[str, ...]]
    _render_options: dict[str, Any]
    _form: Form
    _info: str
    _seeded = False

    def _offer_spaces(self, num_envs: int) -> None:
        """Set the spaces of so many rows of the worlds."""
        self.num_envs = num_envs
        self.single_observation_space: gymnasium.Space[Any] = self.worlds.observation_space(
            self._form
        )
        self.single_action_space: gymnasium.Space[Any] = self.worlds.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._action_shape = (num_envs, *self.worlds.action_shape)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """When an ended world restarts."""
        mode: AutoresetMode = self.metadata["autoreset_mode"]
        return mode

    def render(self) -> tuple[Image, ...] | None:
        """Return an image [H, W, 3] of every world; ``None`` without a render mode."""
        if self.render_mode is None:
            return None
        worlds = range(self.worlds.num_worlds)
        return tuple(image(self.worlds, i, **self._render_options) for i in worlds)

    def close_extras(self, **kwargs: Any) -> None:
        """Do nothing: the worlds go with the environment."""

    def _per_world(self, name: str, value: Any) -> list[Any]:
        """Return what a reset is given, world by world; refuse what differs within a world."""
        found = []
        for rows in self._rows(name, value):
            said = [one for one in rows if one is not None]
            if any(one != said[0] for one in said):
                raise ConfigError(f"{name} is {rows} in the rows of one world, expected the same")
            found.append(said[0] if said else None)
        return found

    def _rows(self, name: str, value: Any) -> list[list[Any]]:
        """Return what the rows of each world are given."""
        num_worlds, num_envs = self.worlds.num_worlds, self.num_envs
        if not isinstance(value, (list, tuple, np.ndarray)) or not np.ndim(value):
            return [[value]] * num_worlds
        listed = list(value)
        if len(listed) not in (num_worlds, num_envs):
            known = (
                f"num_worlds={num_worlds} or " * (num_worlds < num_envs) + f"num_envs={num_envs}"
            )
            raise ConfigError(f"{name} has {len(listed)} entries, expected {known}")
        size = len(listed) // num_worlds
        return [listed[i : i + size] for i in range(0, len(listed), size)]

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """Return seeds of the worlds; ``None`` goes on with a world's generator."""
        num_worlds = self.worlds.num_worlds
        seeds: list[int | None] = [None] * num_worlds
        if not self._seeded:
            seeds = [int(n) for n in self.np_random.integers(2**63, size=num_worlds)]
        if isinstance(seed, (list, tuple, np.ndarray)):
            pairs = zip(self._rows("seed", seed), seeds, strict=True)
            seeds = [fresh if one is None else normalize_seed(one) for (one, *_), fresh in pairs]
        elif seed is not None:
            super().reset(seed=normalize_seed(seed))
            first = exact_seed(seed)
            seeds = [normalize_seed(first + i) for i in range(num_worlds)]
        self._seeded = True
        return seeds

    def _seen(self, out: StepArrays, *, copied: bool = False) -> Any:
        """Observations [N, ...] of all rows in the chosen form."""
        rows = out.obs.reshape(self.num_envs, -1)
        bev = None if out.bev is None else out.bev.reshape(self.num_envs, *out.bev.shape[2:])
        if copied:
            rows, bev = rows.copy(), None if bev is None else bev.copy()
        return self.worlds.layout.observation(self._form, rows, bev)

    def _final(self, rows: F32, bev: U8 | None, ended: Bool, info: dict[str, Any]) -> Info:
        """Last observations of rows that ended [N], of [N, ...], and what is said of them."""
        final = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(ended):
            raster = None if bev is None else bev[i].copy()
            final[i] = self.worlds.layout.observation(self._form, rows[i].copy(), raster)
        return masked({"final_obs": final, "final_info": info}, ended)

    def _figures(self, columns: F32, mask: Bool, stepped: Bool | None = None) -> Info:
        """Info columns [E, C, M] of some rows [N].

        Values are those of the rows that ``stepped`` (by default the same), so that rewards can be
        made from them without masks; in the others nothing happens: zero, and nobody near.
        """
        values = columns.reshape(self.num_envs, -1).T.copy()
        stepped = mask if stepped is None else stepped
        if not stepped.all():
            values[:, ~stepped] = 0.0
            values[self.worlds.column_names.index("ttc"), ~stepped] = _NOBODY_NEAR_S
        return masked(dict(zip(self.worlds.column_names, values, strict=True)), mask)

    def _episodes(self, ended: Bool) -> Info:
        """Scene, seed and so on of the episodes of rows [N] that ended, as their resets said."""
        infos: Info = {}
        for row in np.flatnonzero(ended).tolist() if self._info != "none" else ():
            self._put(infos, row, self.worlds.episodes[row // self.worlds.num_slots])
        return infos

    def _metrics(self, ended: Bool, done: Bool) -> Info:
        """Metrics of slots whose episode ended [E, C], in worlds of which some are done [E]."""
        names, native, over = self.worlds.metric_names, self.worlds.native, np.flatnonzero(done)
        values = np.zeros((len(names), *ended.shape))
        values[:, over] = native.ended_metrics(over.tolist()).transpose(2, 0, 1)
        for e in np.flatnonzero(ended.any(axis=1) & ~done).tolist():
            values[:, e] = native.metrics(e).T
        values[:, ~ended] = 0.0
        found = dict(zip(names, values.reshape(len(names), -1), strict=True))
        return masked({"metrics": masked(found, ended.ravel())}, ended.ravel())

    def _put(self, infos: Info, row: int, values: Info) -> None:
        """Write values of a row into arrays with masks."""
        for name, value in values.items():
            if name not in infos:
                kind = type(value) if isinstance(value, (int, float)) else object
                infos[name] = np.full(self.num_envs, None if kind is object else 0, dtype=kind)
                infos["_" + name] = np.zeros(self.num_envs, np.bool_)
            infos[name][row] = value
            infos["_" + name][row] = value is not None


def masked(found: Mapping[str, Any], mask: Bool) -> Info:
    """Arrays [E] by name, each with a mask of its own."""
    masks = np.tile(mask, (len(found), 1))
    entries = zip(found.items(), masks, strict=True)
    return {k: v for (name, of), own in entries for k, v in ((name, of), (f"_{name}", own))}
