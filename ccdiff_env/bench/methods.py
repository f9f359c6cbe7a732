"""Methods of the traffic benchmark: who drives the control set, and how."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import Any, TypeVar, cast
from urllib.parse import quote

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, DatasetError, UnknownNameError, meant
from ccdiff_env.interop.nuplan import PREFIX
from ccdiff_env.models import guidance_preset, shipped_weights, weights_path
from ccdiff_env.planners.built_in import is_of_package
from ccdiff_env.system.files import parse_object, reading
from ccdiff_env.system.named_objects import named_object, strip_title, title_of
from ccdiff_env.system.tensors import read_tensors
from ccdiff_env.traffic import KINDS, NETWORKS, SWIFT, CcdiffConfig, read_driver
from ccdiff_env.view.captions import is_taken, planner_title

_T = TypeVar("_T")
_D = TypeVar("_D", bound="Drivers")


@dataclass(frozen=True)
class Drivers:
    """Who drives the others, under a name."""

    label: str  #: Name in tables.
    driver: str  #: As :class:`~ccdiff_env.config.WorldConfig` names them.
    #: Fields of :class:`~ccdiff_env.traffic.CcdiffConfig`, where a network drives.
    ccdiff: Mapping[str, Any] = field(default_factory=dict)
    own_weights: str = ""  #: Name of ``--weights`` that drive, where it is not the network's.

    def weights_of(self, given: Mapping[str, str]) -> str | None:
        """Return what is given for the network, unless its weights are named here already."""
        return None if "weights" in self.ccdiff else given.get(self.own_weights or self.driver)

    def with_weights(self: _D, weights: Mapping[str, str]) -> _D:
        """Return the drivers with a file of ``weights``, by name, unless they name their own."""
        file = self.weights_of(weights)
        return self if file is None else replace(self, ccdiff={**self.ccdiff, "weights": file})


@dataclass(frozen=True)
class Method(Drivers):
    """A way to drive the vehicles of the control set.

    ``ranking`` says who is in the control set. With ``greedy`` and ``gradient``, CCDiff finds the
    set itself, at its first plan.
    """

    ranking: str = "cliques"
    #: What differs from the preset that ``ccdiff`` names.
    guidance: Mapping[str, Any] = field(default_factory=dict)

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
    moved: _T = replace(found, ccdiff={**found.ccdiff, "device": device})
    return moved


def resolved(drivers: _T) -> _T:
    """Return a method, or traffic, by path, whose object is options of a planning network, as
    CCDiff with these options; others as they are.
    """
    found: Any = drivers
    if ":" not in found.driver:
        return drivers
    options = named_object(found.driver, "traffic")
    if not isinstance(options, CcdiffConfig):
        return drivers
    usual = CcdiffConfig()
    names = (f.name for f in fields(usual) if getattr(options, f.name) != getattr(usual, f.name))
    made: _T = replace(
        found, driver="ccdiff", ccdiff={name: getattr(options, name) for name in names}
    )
    return made


_GUIDED: dict[str, Any] = {"criticality": 1.0, "num_samples": 5, "guidance": "rl"}

OWN_RANKINGS = ("greedy", "gradient", "reach")  #: Rankings that only a planning network can make.


class NamedDrivers(dict[str, _T]):
    """Entries by name, with options as ``name?option=value``; a custom model by its path,
    ``module:Class?option=value``.

    ``kind`` makes the entry of such a path from its label and the path; ``what`` is what errors
    call an entry.
    """

    def __init__(
        self, what: str, kind: Callable[[str, str], _T], entries: Mapping[str, _T]
    ) -> None:
        super().__init__(entries)
        self._what, self._kind = what, kind

    def __contains__(self, name: object) -> bool:
        stem, _, options = str(name).partition("?")
        return super().__contains__(name) or ":" in stem or (bool(options) and stem in self)

    def __missing__(self, name: str) -> _T:
        stem, _, given = name.partition("?")
        if ":" not in stem and given:
            return self._with_options(name, self[stem])
        if ":" not in stem:
            near = meant(name, self) or f"--help lists them, {', '.join([*self][:5])} and more"
            raise UnknownNameError(f"no {self._what} {name!r}; {near}")
        own = title_of(name) or name.partition(":")[2]
        taken = {getattr(entry, "label", "") for entry in self.values()}
        return self._kind(name if own in taken else own, name)

    def _with_options(self, name: str, entry: Any) -> _T:
        """Return an entry with the options that follow its name, ``name?option=value``."""
        options, given = read_driver(name, self._what)[1], name.partition("?")[2]
        driver = f"{entry.driver}?{given}"
        WorldConfig().with_options(traffic=driver)  # refuses options that it does not have
        stem = name.partition("?")[0]
        if "criticality" in options and "-" in stem:
            raise ConfigError(f"{name}: {stem} says how critical it is, leave the option out")
        named = KINDS[stem].title if stem in KINDS else entry.label
        label = title_of(name) or f"{named}, {given.replace('&', ', ')}"
        if entry.driver in NETWORKS:
            return cast("_T", replace(entry, label=label, ccdiff={**entry.ccdiff, **options}))
        return cast("_T", replace(entry, label=label, driver=driver))

    def add(self, weights: Mapping[str, str]) -> None:
        """Add, under each name of weights that is no network's, what there is of their network:
        ``mine``, ``mine_careful``, ``mine-1``.

        A name that something else has is a :class:`ConfigError`.
        """
        for own, file in weights.items():
            if own in NETWORKS:
                continue
            kind = network_of(file)
            for name, entry in list(self.items()):
                end = name.removeprefix(kind)
                drivers: Any = entry
                if end == name or end[:1] not in ("", "_", "-") or "weights" in drivers.ccdiff:
                    continue
                if getattr(self.get(own + end), "own_weights", own) != own:
                    raise ConfigError(f"--weights {own}=...: {own + end} is {self._what} already")
                label = drivers.label.replace(KINDS[kind].title, own, 1)
                self[own + end] = replace(drivers, label=label, own_weights=own)


def network_of(file: str) -> str:
    """Return the kind of network that a file of weights is of."""
    with reading("weights", file):
        kind = parse_object(read_tensors(Path(file))[1]["ccdiff_env"])["kind"]
        if kind not in NETWORKS:
            raise DatasetError(f"weights of {kind!r}, expected one of {', '.join(NETWORKS)}")
    return str(kind)


def plan_steps(drivers: Drivers) -> int:
    """Return how many steps the plans of a network have, as its weights say."""
    file = weights_path(drivers.ccdiff.get("weights", "fast"), drivers.driver)
    with reading("weights", file):
        return int(parse_object(read_tensors(file)[1]["ccdiff_env"])["model"]["horizon_steps"])


def titled(names: Iterable[str]) -> list[str]:
    """Return who drives, each once, with titles: those given (``?title=Ours``), and ``name`` of
    classes and objects that are given by path. Policies of one name are called by their paths.

    A title of the package, or of another one of them, is a :class:`ConfigError`.
    """
    found: dict[str, str] = {}
    texts = list(dict.fromkeys(names))
    files = [text for text in texts if text.endswith((".zip", ".safetensors")) and ":" not in text]
    shown = Counter(map(planner_title, files))
    for text in texts:
        title = title_of(text)
        own = None if title or ":" not in text or text.startswith(PREFIX) else _name_of(text)
        own = text if text in files and shown[planner_title(text)] > 1 else own
        if own:
            text = f"{text}{'&' if '?' in text else '?'}title={quote(own)}"
        title = title or own
        taken = title is not None and (is_taken(title) or title in found)
        if title is not None and (
            taken or not title.isprintable() or is_of_package(strip_title(text))
        ):
            raise ConfigError(f"{text}: the title {title!r} is another one's, or no line of words")
        found[title or text] = text
    return list(found.values())


def _name_of(path: str) -> str | None:
    """Return the ``name`` of what a path leads to, where that is a text."""
    if path.startswith("adversary:"):
        return None
    name = getattr(named_object(path, "name"), "name", None)
    return name if isinstance(name, str) else None


class _Methods(NamedDrivers[Method]):
    """The methods by name; ``NAME-C`` is the guided method of a name at criticality C."""

    def __contains__(self, name: object) -> bool:
        known = super().__contains__(name) or self.without_strength(str(name)) is not None
        return known or _composed(str(name)) is not None

    def __missing__(self, name: str) -> Method:
        found = None if "?" in name else self.without_strength(name)
        if found is None:
            return _composed(name) or super().__missing__(name)
        stem, strength = found
        label = f"{self[stem].label}, criticality {strength:g}"
        ccdiff = {**self[stem].ccdiff, "criticality": strength}
        return replace(self[stem], label=label, ccdiff=ccdiff)

    def with_strength(self, name: str, strength: float) -> str:
        """Return the name of a method at a criticality, before its options."""
        stem, mark, options = name.partition("?")
        return f"{stem}-{strength:g}{mark}{options}"

    def without_strength(self, name: str) -> tuple[str, float] | None:
        """Return a method and the criticality that its name ends in, before its options; ``None``
        without one.
        """
        whole, mark, options = name.partition("?")
        stem, _, number = whole.rpartition("-")
        method = self.get(stem) or _composed(stem)
        if method is None or "criticality" not in method.ccdiff:
            return None
        try:
            return f"{stem}{mark}{options}", float(number)
        except ValueError:
            return None


#: What a name's middle adds to the titles of methods and of traffic, and to a network's options,
FORMS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "": ("", "", {}),
    "_routes": (" with routes", ", routes", {"follow_route": True}),
    "_one_step": (", one denoising step", ", one step", {"denoising_steps": 1}),
    "_routes_one_step": (
        " with routes, one denoising step",
        ", routes, one step",
        {"follow_route": True, "denoising_steps": 1},
    ),
}
#: and what its end adds: whether plans are guided. Of several samples that nothing guides, the one
#: that touches least and stays on the road drives, as in the released code.
_ENDS: dict[str, tuple[str, dict[str, Any]]] = {
    "": ("", _GUIDED),
    "_unguided": (", no guidance", {"num_samples": 5}),
    "_one_sample": (", no guidance, N=1", {"num_samples": 1}),
    "_careful": (", careful, N=1", {"careful": True}),
    # likely speeds of the log: less sure than the network, and vehicles that stay what they are
    "_calibrated": (
        ", careful, calibrated, N=1",
        {"careful": True, "keep_noise": True, "temperature": 1.2},
    ),
}
_TWO = ("", "_unguided")
#: The networks of the paper's table, and CTG++.
_RIVALS = [name for name in NETWORKS if name not in ("ccdiff", "tokens", SWIFT)]


def _network(
    name: str,
    title: str,
    forms: Iterable[str] = ("",),
    ends: Iterable[str] = ("",),
    **own: Any,
) -> dict[str, Method]:
    """Return the methods of a network, whose name has its driver's first; ``own`` come last."""
    driver = name if name in NETWORKS else "ccdiff"
    found = {}
    for form, end in product(forms, ends):
        middle, _, options = FORMS[form]
        ccdiff = {**_ENDS[end][1], **options, **own}
        label = title + middle + _ENDS[end][0]
        if end == "_unguided" and ccdiff["num_samples"] > 1:
            label += f", safest of {ccdiff['num_samples']}"
        found[name + form + end] = Method(label, driver, ccdiff=ccdiff)
    return found


def _composed(name: str) -> Method | None:
    """Return the method of a network, a form and a mode, where a name is put together so."""
    for network, form, end in product(NETWORKS, FORMS, _ENDS):
        if name == network + form + end and network != SWIFT:
            own = {"num_samples": 1} if KINDS[network].one_plan else {}
            return _network(network, KINDS[network].title, (form,), (end,), **own)[name]
    return None


#: What a name may be put together from, for the help.
GRAMMAR = (
    "NAME or NAME?option=value&option=value, where NAME is one of "
    f"replay, constant_velocity, idm, {SWIFT}, module:name of yours, and NETWORK[_FORM][_MODE]"
    f"[-CRITICALITY]: a network ({', '.join(n for n in NETWORKS if n != SWIFT)}), a form "
    f"({', '.join(filter(None, FORMS))}), a mode ({', '.join(filter(None, _ENDS))}; guided "
    "without one)"
)

#: The methods by name. More may be added: a driver is all that one needs.
METHODS = _Methods(
    "method",
    Method,
    {
        "replay": Method("Log replay", "replay"),
        "constant_velocity": Method("Constant velocity", "constant_velocity"),
        "idm": Method(KINDS["idm"].title, "idm"),
        **_network("ccdiff", "CCDiff", FORMS, _ENDS),
        **_network("tokens", KINDS["tokens"].title, ("", "_routes"), _ENDS),
        SWIFT: Method(KINDS[SWIFT].title, SWIFT),
    },
)
METHODS |= _network("ccdiff_no_enc", "CCDiff, no causal graph", graph="full")
METHODS |= _network("ccdiff_paper", "CCDiff, guidance of the paper", guidance="paper")
# classifier-free guidance by the causal graph, from the paper's range of weights
for _x in (1.3, 1.6, 1.9):
    METHODS |= _network(f"ccdiff_cfg-{_x:g}", f"CCDiff, w = {_x:g}", ends=_TWO, cfg_weight=_x)
_THREE = (*_TWO, "_one_sample")
METHODS |= {name + end: METHODS[name + end] for name in _RIVALS for end in _THREE}
_weights = str(shipped_weights("ccdiff_equal"))  # CCDiff, trained as the rivals were
METHODS |= _network("ccdiff_equal", "CCDiff, equal training", ends=_THREE, weights=_weights)
# BITS chooses among its plans and does not move them
METHODS["bits"] = replace(METHODS["bits"], guidance={"gradient_steps": 0})


def _variant(name: str, end: str, title: str, **changes: Any) -> None:
    """Add a method that differs from another one."""
    old = METHODS[name]
    METHODS[f"{name}_{end}"] = replace(old, label=f"{old.label}, {title}", **changes)


for _end, _title, _ranking in (
    ("distance", "ranking by distance", "distance_cliques"),
    ("first", "scene's order", "first"),
    ("random", "random ranking", "random"),
    ("greedy", "greedy cliques on G", "greedy"),
    ("gradient", "aligned gradients", "gradient"),
    ("reach", "ranking by reach", "reach"),
):
    _variant("ccdiff", _end, _title, ranking=_ranking)
# as the paper most likely ran its rivals (docs/rivals.md): SimNet's one plan and STRIVE's first are
# ``simnet_unguided`` and ``strive_one_sample``
for _name in ("trafficsim", "strive", "bits"):
    _variant(_name, "samples", "choice among samples", guidance={"gradient_steps": 0})

#: Methods of the paper's table with shipped weights, each guided and not: ``--methods all``.
PAPER_METHODS: tuple[str, ...] = tuple(
    f"{name}{suffix}"
    for name in (*_RIVALS, "ccdiff_equal", "ccdiff")
    if shipped_weights(name).exists()
    for suffix in ("", "_unguided")
)

OTHERS = ("replay", "idm")  #: Drivers of vehicles outside of the control set.
#: Methods that differ from ``ccdiff`` in who comes first: the same where all are controlled.
REORDERED = {name for name, method in METHODS.items() if method.ranking != "cliques"}


def label_of(method: str, own_weights: str = "") -> str:
    """Return the title of a method in tables; its name if it is none of :data:`METHODS`.

    ``own_weights`` is the SHA-256 of weights other than the shipped ones.
    """
    label = METHODS[method].label if method in METHODS else method
    return f"{label}, own weights {own_weights[:8]}" if own_weights else label
