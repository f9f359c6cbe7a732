"""Everything that can be chosen about a world, as frozen dataclasses.

Fields, defaults and their documentation come from Rust (``traffic/options.py``), which checks the
ranges; here is what keywords and JSON need.
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

from ccdiff_env.errors import ConfigError, UnknownOptionError
from ccdiff_env.system.files import parsed_object
from ccdiff_env.system.named_objects import named_instance
from ccdiff_env.traffic import (
    KINDS,
    NETWORKS,
    Policy,
    PythonTraffic,
    driver_names,
    read_ranking,
)
from ccdiff_env.traffic.options import (
    DYNAMICS,
    ActionConfig,
    ActionGrid,
    AssistedLimits,
    BevConfig,
    BicycleLimits,
    CcdiffConfig,
    Controlled,
    DeltaPoseLimits,
    Dynamics,
    EgosConfig,
    IdmConfig,
    ObservationConfig,
    Randomization,
    Ranking,
    RewardConfig,
    UnicycleLimits,
    WorldOptions,
)

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ccdiff_env.traffic.keywords import WorldKeywords

__all__ = [
    "ActionConfig",
    "ActionGrid",
    "AssistedLimits",
    "BevConfig",
    "BicycleLimits",
    "CcdiffConfig",
    "DeltaPoseLimits",
    "EgosConfig",
    "IdmConfig",
    "ObservationConfig",
    "Randomization",
    "RewardConfig",
    "UnicycleLimits",
    "WorldConfig",
]

#: A driver by name, or shares of drivers by name.
Traffic: TypeAlias = str | Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class WorldConfig(WorldOptions):
    """Configuration of worlds.

    Examples
    --------
    ``WorldConfig(traffic="idm", reward=RewardConfig(goal=5.0))``, or from plain keywords with
    near-miss messages: ``WorldConfig().with_options(traffic="idm", reward={"goal": 5.0})``.
    """

    #: Options of the drivers that are networks, ``"ccdiff"`` above all.
    ccdiff: CcdiffConfig = field(default_factory=CcdiffConfig)
    #: Further drivers by names of one's own, as options of their kind: two styles of IDM are
    #: ``{"calm": IdmConfig(headway_s=2.0), "hasty": IdmConfig(headway_s=0.6)}``.
    policies: Mapping[str, Policy] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        own = {
            name: policy if isinstance(policy, Policy) else Policy.of(policy)
            for name, policy in self.policies.items()
        }
        object.__setattr__(self, "policies", own)
        for entry in dataclasses.fields(self):
            make: Any = entry.default_factory
            value = getattr(self, entry.name)
            if hasattr(make, "__dataclass_fields__") and not isinstance(value, make):
                # a dictionary of the fields to change
                object.__setattr__(self, entry.name, _fitting(entry.name, value, make, make()))
        for name, policy in own.items():
            kind = KINDS.get(name)
            if name == "external" or (kind and (kind.always or name != policy.kind)):
                raise ConfigError(f"config: policies: {name!r} is a driver already")
        known = driver_names(own)
        for what, names, also in (
            ("traffic", self._shares(), ()),
            ("driver", (self.driver,), ("external",)),
            ("driver", tuple(self.drivers.values()), ("external",)),
        ):
            for name in names:
                if name not in known and name not in also:
                    raise unknown(what, str(name), (*known, *also))

    def with_options(self, **options: Unpack[WorldKeywords]) -> WorldConfig:
        """Return a copy with some fields replaced.

        Parameters
        ----------
        **options
            Fields by name. Nested configurations may be dataclasses, or dictionaries of the fields
            to change. ``dynamics``, ``discrete`` and ``grid`` are taken as fields of ``action``,
            ``bev`` as the field of ``observation``, kinds of drivers without a field of their own
            (``simnet={"weights": ...}``) as entries of ``policies``. Drivers may be given as
            objects (``traffic=PythonTraffic(model)``) and as paths to import (``"module:Class"``,
            ``"module:Class?option=value"``).

        Raises
        ------
        ConfigError
            If a name is unknown (the message names near ones) or a value has the wrong type.
        """
        given: dict[str, Any] = {**options}
        if "ego" in given:
            given["controlled"] = _fitting("ego", given.pop("ego"), Literal["ego", "any"], None)
        shortcuts: dict[str, Any] = {
            k: given.pop(k) for k in ("dynamics", "discrete", "grid") if k in given
        }
        rasters = {"bev": given.pop("bev")} if "bev" in given else {}
        config = _replaced(self, _with_policies(given, self.policies), "")
        if shortcuts:
            action = _replaced(config.action, shortcuts, "action.")
            config = dataclasses.replace(config, action=action)
        if rasters:
            observation = _replaced(config.observation, rasters, "observation.")
            config = dataclasses.replace(config, observation=observation)
        return config

    def check_networks(self) -> None:
        """Refuse options of networks where nobody drives by one that takes them.

        Raises
        ------
        ConfigError
            In one line that says what the traffic is.
        """
        if self.ccdiff != CcdiffConfig() and not self.takes_ccdiff():
            raise ConfigError(
                f"ccdiff: traffic is {self.traffic!r}, expected one of the networks that these "
                f"options are for: {', '.join(NETWORKS)}"
            )

    def takes_ccdiff(self) -> bool:
        """Return whether somebody drives by a network without options of its own."""
        return bool(self._driving() & set(NETWORKS) - set(self.policies))

    def takes_idm(self) -> bool:
        """Return whether the options of ``idm`` differ from the default, or drive somebody: by
        name, in assisted dynamics, or round a network.
        """
        own = [policy.options for policy in self.policies.values()]
        networks = [n for n in (self.ccdiff, *own) if isinstance(n, CcdiffConfig)]
        return (
            self.idm != IdmConfig()
            or "idm" in self._driving()
            or isinstance(self.action.dynamics, AssistedLimits)
            or any(n.background_driver == "idm" or n.plan_radius_m is not None for n in networks)
        )

    def guided_traffic(self, what: str) -> tuple[CcdiffConfig, ...]:
        """Return the options of the networks that drive others than the agents with a slot.

        Raises
        ------
        ConfigError
            If there are none: nobody can be guided; ``what`` was to guide them.
        """
        names = [*self._shares(), *self.drivers.values()]
        own = {name: policy.options for name, policy in self.policies.items()}
        networks = dict.fromkeys(NETWORKS, self.ccdiff)
        options = [own.get(name, networks.get(name)) for name in names]
        found = tuple(one for one in options if isinstance(one, CcdiffConfig))
        if not found:
            raise ConfigError(
                f"{what}: traffic is {self.traffic!r}, expected one that can be guided: "
                f"{', '.join(NETWORKS)}"
            )
        return found

    def _shares(self) -> Iterable[str]:
        return (self.traffic,) if isinstance(self.traffic, str) else self.traffic

    def _driving(self) -> set[str]:
        """Names of drivers by which somebody drives from the start."""
        return {*self._shares(), self.driver, *self.drivers.values()}

    def with_criticality(self, criticality: float) -> WorldConfig:
        """Return the configuration with one criticality for all networks."""
        own = {
            name: Policy(policy.kind, dataclasses.replace(policy.options, criticality=criticality))
            for name, policy in self.policies.items()
            if isinstance(policy.options, CcdiffConfig)
        }
        config = dataclasses.replace(self, policies={**self.policies, **own})
        if not config.takes_ccdiff():
            return config
        return config.with_options(ccdiff={"criticality": criticality})

    def to_json(self) -> str:
        """Return the configuration as JSON, as Rust reads it.

        It holds the options of drivers that drive; all networks share those of CCDiff.
        """
        return json.dumps(_plain(self), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> WorldConfig:
        """Read what :meth:`to_json`, or Rust, wrote; absent fields take their defaults.

        Raises
        ------
        ConfigError
            If the text is no JSON object, or a field is unknown or of the wrong type.
        """
        try:
            fields = parsed_object(text)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"config: not JSON ({error})") from None
        policies = fields.get("policies")
        if isinstance(policies, dict) and isinstance(policies.get("ccdiff"), dict):
            fields |= policies["ccdiff"]
            usual = {name: {name: fields.get("ccdiff")} for name in NETWORKS}
            fields["policies"] = {k: v for k, v in policies.items() if v != usual.get(k)}
        return _replaced(cls(), fields, "")


_C = TypeVar("_C")


def unknown(what: str, name: str, known: typing.Iterable[str]) -> ConfigError:
    """Return the error for a name that does not exist, with the names that come near it."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.6)
    hint = (
        f"did you mean {' or '.join(map(repr, near))}?" if near else f"there are {', '.join(known)}"
    )
    return ConfigError(f"unknown {what} {name!r}; {hint}")


def _fields_of(kind: Any) -> tuple[str, ...]:
    """Names of the fields of a data class; of anything else none."""
    return tuple(f.name for f in dataclasses.fields(kind)) if dataclasses.is_dataclass(kind) else ()


def _replaced(config: _C, options: Mapping[str, Any], path: str) -> _C:
    """Copy of a dataclass with fields replaced, each checked against its annotation."""
    hints = typing.get_type_hints(type(config))
    changes = {}
    for name, value in options.items():
        if name not in hints:
            known = [path + n for n in hints]
            # those of a nested configuration are named by their path
            inner = [f"{n}.{name}" for n, t in hints.items() if str(name) in _fields_of(t)]
            error = unknown("option", path + str(name), inner or known)
            if path:
                raise error
            # wrappers of other libraries look for these words
            words = f"{error} (unexpected keyword argument {str(name)!r})"
            raise UnknownOptionError(words)
        changes[name] = _fitting(path + name, value, hints[name], getattr(config, name))
    return dataclasses.replace(config, **changes)  # type: ignore[type-var]


def _fitting(path: str, value: Any, hint: Any, old: Any) -> Any:
    """Value in the form that an annotation asks for."""
    if hint == Dynamics:
        return _dynamics(path, value, old)
    if hint == Controlled:
        return _controlled(path, value)
    if hint == Traffic:
        if not isinstance(value, (str, Mapping)):
            raise ConfigError(
                f"config: {path} is {value!r}, expected one of the drivers, or shares"
            )
        return value if isinstance(value, str) else by_name(path, value, float)
    if hint == Mapping[str, Policy]:
        return {name: _policy(f"{path}.{name}", v) for name, v in _pairs(path, value)}
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is types.UnionType or origin is typing.Union:
        if value is None and type(None) in args:
            return None
        if hint == Ranking and str(value).endswith(".json"):
            return read_ranking(value)
        if isinstance(value, Mapping) and set(value) == {"list"}:
            value = value["list"]
        if isinstance(value, Mapping):
            mapping = next((a for a in args if typing.get_origin(a) is Mapping), None)
            if mapping is not None:
                return _fitting(path, value, mapping, old)
        literal = next((a for a in args if typing.get_origin(a) is Literal), None)
        if isinstance(value, str) and literal is not None:
            return _fitting(path, value, literal, old)
        chosen = next(a for a in args if a is not type(None) and a is not literal)
        return _fitting(path, value, chosen, old)
    if hint is RewardConfig and isinstance(value, str):
        return _replaced(RewardConfig(), {"form": value}, path + ".")
    if origin is Literal:
        if value not in args or not isinstance(value, str):
            raise ConfigError(f"config: {path} is {value!r}, expected one of {', '.join(args)}")
        return value
    if origin is tuple:
        return _tuple(path, value, args)
    if origin is Mapping:
        return _settings(path, value) if args[1] is Any else by_name(path, value, args[1])
    if dataclasses.is_dataclass(hint):
        return _nested(path, value, typing.cast("type[Any]", hint), old)
    return _scalar(path, value, hint)


def _pairs(path: str, value: Any) -> list[tuple[str, Any]]:
    if not isinstance(value, Mapping):
        raise ConfigError(f"config: {path} is {value!r}, expected values by name")
    return [(_scalar(path, name, str), entry) for name, entry in value.items()]


def by_name(path: str, value: Any, kind: Any) -> dict[str, Any]:
    """Return values of a kind by name, checked."""
    pairs = _pairs(path, value)
    return {name: _fitting(f"{path}[{name!r}]", v, kind, None) for name, v in pairs}


def _policy(path: str, value: Any) -> Policy:
    """A driver under a name of its own: options of its kind, or ``{kind: options}``."""
    if isinstance(value, Policy):
        return value
    if type(value) in (kind.options for kind in KINDS.values()):
        return Policy.of(value)
    known = {name: kind.options for name, kind in KINDS.items() if kind.options is not None}
    if not isinstance(value, Mapping) or len(value) != 1:
        kinds = ", ".join(known)
        raise ConfigError(f"config: {path} is {value!r}, expected {{kind: options}} of {kinds}")
    ((kind, options),) = value.items()
    if kind not in known:
        raise unknown(path, str(kind), known)
    if known[kind] is PythonTraffic and isinstance(options, Mapping):
        try:
            return Policy(kind, PythonTraffic(**options))
        except TypeError as error:
            raise ConfigError(f"config: {path}: {error}") from None
    return Policy(kind, _nested(f"{path}.{kind}", options, known[kind], None))


def _with_policies(options: dict[str, Any], known: Mapping[str, Policy]) -> dict[str, Any]:
    """Options in which drivers that are objects, or paths to import, are policies by name."""
    found: dict[str, Any] = {}
    for kind in KINDS:
        if kind in options and kind not in _fields_of(WorldConfig):
            found[kind] = {kind: options.pop(kind)}
    for field_name in ("traffic", "driver"):
        value = options.get(field_name)
        if isinstance(value, str) and ":" in value:
            made = named_instance(value, "traffic model")
            value = made if isinstance(made, PythonTraffic) else PythonTraffic(made)
        if isinstance(value, PythonTraffic):
            found["python"] = value
            options = {**options, field_name: "python"}
    if found:
        more = options.get("policies", known)
        if not isinstance(more, Mapping):
            raise ConfigError(f"config: policies is {more!r}, expected values by name")
        options = {**options, "policies": {**more, **found}}
    return options


def _controlled(path: str, value: Any) -> Controlled:
    """Agents with a slot; ``{"ids": ...}`` and ``{"per_scene": ...}`` are the forms of Rust."""
    if isinstance(value, Mapping) and set(value) == {"ids"}:
        value = value["ids"]
    if isinstance(value, Mapping):
        scenes = value["per_scene"] if set(value) == {"per_scene"} else value
        if not isinstance(scenes, Mapping):
            raise ConfigError(f"config: {path} is {scenes!r}, expected ids by scene")
        return {
            _scalar(f"{path} scene", name, str): _tuple(f"{path}[{name!r}]", ids, (str, ...))
            for name, ids in scenes.items()
        }
    if isinstance(value, str):
        return typing.cast(
            "Controlled", _fitting(path, value, Literal["ego", "any", "vehicles"], None)
        )
    return _tuple(path, value, (str, ...))


def _dynamics(path: str, value: Any, old: Any) -> Dynamics:
    limits: Any = {}
    if isinstance(value, Mapping) and len(value) == 1:
        ((value, limits),) = value.items()
    if isinstance(value, str):
        if value not in DYNAMICS:
            raise unknown(path, value, DYNAMICS)
        if isinstance(limits, DYNAMICS[value]):
            return limits
        return _nested(f"{path}.{value}", limits, DYNAMICS[value], old)
    if isinstance(value, tuple(DYNAMICS.values())):
        return typing.cast("Dynamics", value)
    raise ConfigError(
        f"config: {path} is {value!r}, expected one of {', '.join(DYNAMICS)}, limits, "
        "or {name: limits}"
    )


def _nested(path: str, value: Any, kind: type[_C], old: Any) -> _C:
    if isinstance(value, kind):
        return value
    if not isinstance(value, Mapping):
        raise ConfigError(f"config: {path} is {value!r}, expected {kind.__name__} or a dictionary")
    if isinstance(old, kind):
        return _replaced(old, value, path + ".")
    try:
        return _replaced(kind(), value, path + ".")
    except TypeError:  # a dataclass with fields that have no default
        hints = typing.get_type_hints(kind)
        for name in value:
            if name not in hints:
                raise unknown("option", f"{path}.{name}", (f"{path}.{n}" for n in hints)) from None
        for name in hints:
            if name not in value:
                raise ConfigError(f"config: {path}.{name} is missing") from None
        return kind(**{n: _fitting(f"{path}.{n}", v, hints[n], None) for n, v in value.items()})


def _tuple(path: str, value: Any, args: tuple[Any, ...]) -> tuple[Any, ...]:
    if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__iter__"):
        raise ConfigError(f"config: {path} is {value!r}, expected a sequence")
    values = list(value)
    if args[-1] is not Ellipsis and len(values) != len(args):
        raise ConfigError(f"config: {path} has {len(values)} entries, expected {len(args)}")
    return tuple(_fitting(f"{path}[{i}]", v, args[0], None) for i, v in enumerate(values))


def _settings(path: str, value: Any) -> dict[str, Any]:
    try:
        settings: dict[str, Any] = json.loads(json.dumps(dict(value), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise ConfigError(f"config: {path}: {error}, expected what JSON can hold") from None
    return settings


def _scalar(path: str, value: Any, kind: Any) -> Any:
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:  # numpy scalars
        value = value.item()
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value) if -3.4e38 < value < 3.4e38 else math.inf
    if type(value) is not kind:
        raise ConfigError(
            f"config: {path} is {value!r} ({type(value).__name__}), expected {kind.__name__}"
        )
    if kind is float and not -3.4e38 < value < 3.4e38:
        raise ConfigError(f"config: {path} is {value}, expected a finite number")
    if kind is int and not 0 <= value < 2**63:
        raise ConfigError(f"config: {path} is {value}, expected a count")
    return value


def _plain(value: Any) -> Any:
    """Form of a value in JSON."""
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    if not dataclasses.is_dataclass(value):
        return list(value) if isinstance(value, tuple) else value
    fields: dict[str, Any] = {
        f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)
    }
    if isinstance(value, WorldConfig) and not isinstance(value.controlled, str):
        form = "per_scene" if isinstance(value.controlled, Mapping) else "ids"
        fields["controlled"] = {form: fields["controlled"]}
    if isinstance(value, WorldConfig):
        own = {name: {p.kind: _plain(p.options)} for name, p in value.policies.items()}
        options = fields.pop("ccdiff")
        fields["policies"] = ({"ccdiff": {"ccdiff": options}} if value.takes_ccdiff() else {}) | own
        if not value.takes_idm():
            del fields["idm"]
    if isinstance(value, PythonTraffic):
        fields["model"] = value.described
    if isinstance(value, CcdiffConfig) and not isinstance(value.ranking, str):
        fields["ranking"] = {"list": fields["ranking"]}
    names = (name for name, kind in DYNAMICS.items() if isinstance(value, kind))
    name = next(names, None)
    return fields if name is None else {name: fields}
