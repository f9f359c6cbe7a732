"""Methods of the traffic benchmark: who drives the control set, and how."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from ccdiff_env.errors import UnknownNameError
from ccdiff_env.models import guidance_preset, shipped_weights
from ccdiff_env.traffic import KINDS, NETWORKS, SWIFT

_T = TypeVar("_T")


@dataclass(frozen=True)
class Method:
    """A way to drive the vehicles of the control set.

    Args:
        label: Name in tables.
        driver: Driver of the control set, as :class:`~ccdiff_env.config.WorldConfig` names them.
        ranking: ``cliques``, ``distance_cliques``, ``first`` or ``random``: who is in the control
            set. With ``greedy`` and ``gradient``, CCDiff finds the set itself, at its first plan.
        ccdiff: Fields of :class:`~ccdiff_env.traffic.CcdiffConfig`, where a network drives.
        guidance: What differs from the preset that ``ccdiff`` names.
    """

    label: str
    driver: str
    ranking: str = "cliques"
    ccdiff: Mapping[str, Any] = field(default_factory=dict)
    guidance: Mapping[str, Any] = field(default_factory=dict)

    def with_weights(self, weights: Mapping[str, str]) -> Method:
        """Return the method with weights of a file, where one is given for its network.

        Args:
            weights: Weight files by driver. A method that names its own weights keeps them.
        """
        if self.driver not in weights or "weights" in self.ccdiff:
            return self
        return dataclasses.replace(self, ccdiff={**self.ccdiff, "weights": weights[self.driver]})

    def options(self) -> dict[str, Any]:
        """Return ``ccdiff`` with the whole guidance where it differs from a preset."""
        if not self.guidance:
            return dict(self.ccdiff)
        preset = guidance_preset(self.ccdiff["guidance"])
        return {**self.ccdiff, "guidance": {**preset, **self.guidance}}


def on_device(drivers: _T, device: str) -> _T:
    """Return a method, or traffic, whose network, if one drives, runs on a device."""
    found: Any = drivers
    if device == "cpu" or found.driver not in NETWORKS:
        return drivers
    moved: _T = dataclasses.replace(found, ccdiff={**found.ccdiff, "device": device})
    return moved


_GUIDED: dict[str, Any] = {"criticality": 1.0, "num_samples": 5, "guidance": "rl"}

OWN_RANKINGS = ("greedy", "gradient")  #: Rankings that only a planning network can make.


class NamedDrivers(dict[str, _T]):
    """Entries by name; a custom model by its path, ``module:Class?option=value``.

    ``kind`` makes the entry of such a path from its label and the path; ``what`` is what errors
    call an entry.
    """

    def __init__(
        self, what: str, kind: Callable[[str, str], _T], entries: Mapping[str, _T]
    ) -> None:
        super().__init__(entries)
        self._what, self._kind = what, kind

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or ":" in str(name)

    def __missing__(self, name: str) -> _T:
        if ":" not in name:
            raise UnknownNameError(f"no {self._what} {name!r}, there are {', '.join(self)}")
        return self._kind(name.partition(":")[2], name)


_ROUTES, _ONE_STEP = {"follow_route": True}, {"denoising_steps": 1}
#: CCDiff's methods: what is added to its name and title, and options.
_CCDIFF: dict[str, tuple[str, dict[str, Any]]] = {
    "": ("", _GUIDED),
    "_unguided": (", no guidance", {"num_samples": 5}),
    "_one_sample": (", no guidance, N=1", {}),
    "_careful": (", careful, N=1", {"careful": True}),
    "_routes": (" with routes", {**_GUIDED, **_ROUTES}),
    "_routes_unguided": (" with routes, no guidance", {"num_samples": 5, **_ROUTES}),
    "_routes_one_sample": (" with routes, no guidance, N=1", _ROUTES),
    "_routes_careful": (" with routes, careful, N=1", {**_ROUTES, "careful": True}),
    # likely speeds of the log: less sure than the network, and vehicles that stay what they are
    "_routes_calibrated": (
        " with routes, careful, calibrated, N=1",
        {**_ROUTES, "careful": True, "keep_noise": True, "temperature": 1.2},
    ),
    "_one_step": (", one denoising step", {**_GUIDED, **_ONE_STEP}),
    "_one_step_unguided": (", one denoising step, no guidance", {"num_samples": 5, **_ONE_STEP}),
    "_one_step_one_sample": (", one denoising step, no guidance, N=1", _ONE_STEP),
    "_routes_one_step_one_sample": (
        " with routes, one denoising step, no guidance, N=1",
        {**_ONE_STEP, **_ROUTES},
    ),
}
#: Rankings of the guided one: name, title, ranking.
_RANKINGS = (
    ("distance", "ranking by distance", "distance_cliques"),
    ("first", "scene's order", "first"),
    ("random", "random ranking", "random"),
    ("greedy", "greedy cliques on G", "greedy"),
    ("gradient", "aligned gradients", "gradient"),
)

#: The methods by name. More may be added: a driver is all that one needs.
METHODS: dict[str, Method] = NamedDrivers(
    "method",
    Method,
    {
        "replay": Method("Log replay", "replay"),
        "constant_velocity": Method("Constant velocity", "constant_velocity"),
        "idm": Method(KINDS["idm"].title, "idm"),
        **{
            f"ccdiff{name}": Method(f"{KINDS['ccdiff'].title}{title}", "ccdiff", ccdiff=options)
            for name, (title, options) in _CCDIFF.items()
        },
        **{
            f"ccdiff_{name}": Method(f"CCDiff, {title}", "ccdiff", ranking, _GUIDED)
            for name, title, ranking in _RANKINGS
        },
        "ccdiff_no_enc": Method(
            "CCDiff, no causal graph", "ccdiff", ccdiff={**_GUIDED, "graph": "full"}
        ),
        "ccdiff_released": Method(
            "CCDiff, released guidance", "ccdiff", ccdiff={**_GUIDED, "guidance": "released"}
        ),
    },
)

# the same guidance, less and more of it: ``ccdiff`` has criticality 1
for _strength in (0.25, 0.5, 0.75, 1.5, 2.0):
    METHODS[f"ccdiff-{_strength:g}"] = Method(
        f"CCDiff, criticality {_strength:g}", "ccdiff", ccdiff={**_GUIDED, "criticality": _strength}
    )

# classifier-free guidance by the causal graph, from the paper's range of weights
for _weight in (1.3, 1.6, 1.9):
    _cfg = {"cfg_weight": _weight, "num_samples": 5}
    _label = f"CCDiff, w = {_weight:g}"
    METHODS[f"ccdiff_cfg-{_weight:g}"] = Method(_label, "ccdiff", ccdiff={**_GUIDED, **_cfg})
    METHODS[f"ccdiff_cfg-{_weight:g}_unguided"] = Method(
        f"{_label}, no guidance", "ccdiff", ccdiff=_cfg
    )

#: The networks of the paper's table, CTG++, and CCDiff trained as they were, by name.
_NETWORKS = {
    **{
        name: KINDS[name].title
        for name in NETWORKS
        if name not in ("ccdiff", "tokens") and not KINDS[name].distilled
    },
    "ccdiff_equal": "CCDiff, equal training",
}
for _name, _label in _NETWORKS.items():
    _driver = _name.removesuffix("_equal")
    _one = KINDS[_driver].one_plan
    _own: dict[str, Any] = {"num_samples": 1 if _one else 5}
    if _driver != _name:
        _own["weights"] = str(shipped_weights(_name))
    METHODS[_name] = Method(_label, _driver, ccdiff={**_GUIDED, **_own})
    METHODS[f"{_name}_unguided"] = Method(f"{_label}, no guidance", _driver, ccdiff=_own)
    if not _one:
        METHODS[f"{_name}_one_sample"] = Method(
            f"{_label}, no guidance, N=1", _driver, ccdiff={**_own, "num_samples": 1}
        )
# BITS chooses among its plans and does not move them
METHODS["bits"] = dataclasses.replace(METHODS["bits"], guidance={"gradient_steps": 0})
#: Gradient steps as the authors have them (docs/rivals.md), of which those that do not denoise make
#: four times as many. SimNet's are those of all.
_AUTHORS: dict[str, dict[str, Any]] = {
    "trafficsim": {"gradient_steps": 10},
    "strive": {"gradient_steps": 10, "learning_rate": 0.1},
    "bits": {"gradient_steps": 1},
    **{name: {"gradient_steps": 1} for name in ("ctg", "ctgpp", "ccdiff_equal")},
}
for _name, _settings in _AUTHORS.items():
    METHODS[f"{_name}_authors"] = dataclasses.replace(
        METHODS[_name], label=f"{METHODS[_name].label}, authors' effort", guidance=_settings
    )
# who published a choice among samples without the signs of the weights
for _name in ("strive", "ctg", "ctgpp", "ccdiff_equal"):
    METHODS[f"{_name}_published"] = dataclasses.replace(
        METHODS[_name],
        label=f"{METHODS[_name].label}, published filter",
        guidance={"filter_weights": "unweighted"},
    )
# next tokens: guided, one draw, careful, with routes told and without
METHODS["tokens"] = Method(KINDS["tokens"].title, "tokens", ccdiff=_GUIDED)
for _routes, _told in (("", {}), ("_routes", {"follow_route": True})):
    _label = KINDS["tokens"].title + (" with routes" if _told else "")
    METHODS[f"tokens{_routes}_one_sample"] = Method(
        f"{_label}, no guidance, N=1", "tokens", ccdiff=_told
    )
    METHODS[f"tokens{_routes}_careful"] = Method(
        f"{_label}, careful", "tokens", ccdiff={**_told, "careful": True}
    )

METHODS[SWIFT] = Method(KINDS[SWIFT].title, SWIFT)

#: Methods of the paper's table with shipped weights, each guided and not: ``--methods all``.
PAPER_METHODS: tuple[str, ...] = tuple(
    f"{name}{suffix}"
    for name in (*_NETWORKS, "ccdiff")
    if shipped_weights(name).exists()
    for suffix in ("", "_unguided")
)

#: Methods that differ from ``ccdiff`` in who comes first: the same where all are controlled.
REORDERED = {
    name
    for name, method in METHODS.items()
    if method.ccdiff is _GUIDED and method.ranking != "cliques"
}


def label_of(method: str) -> str:
    """Return the title of a method in tables; its name if it is none of :data:`METHODS`."""
    return METHODS[method].label if method in METHODS else method
