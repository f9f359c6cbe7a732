"""Everything that can be chosen about a world, as frozen dataclasses.

Fields, defaults and their documentation come from Rust (``traffic/options.py``), which checks the
ranges; here is what keywords and JSON need.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from typing import Any, TypeAlias, TypeVar

from ccdiff_env.errors import ConfigError, MissingFeatureError, unknown, unknown_option
from ccdiff_env.system.files import parse_object
from ccdiff_env.system.named_objects import named_instance, object_name
from ccdiff_env.traffic import (
    KINDS,
    NETWORKS,
    NamedDriver,
    PythonTraffic,
    driver_names,
    read_driver,
)
from ccdiff_env.traffic.checked_options import check
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

__all__ = [
    "ActionConfig", "ActionGrid", "AssistedLimits", "BevConfig", "BicycleLimits", "CcdiffConfig",
    "DeltaPoseLimits", "EgosConfig", "IdmConfig", "ObservationConfig", "Randomization",
    "RewardConfig", "UnicycleLimits", "WorldConfig",
]  # fmt: skip

Traffic: TypeAlias = str | Mapping[str, float]  #: A driver by name, or shares of drivers by name.


@dataclass(frozen=True, kw_only=True)
class WorldConfig(WorldOptions):
    """Configuration of worlds.

    Examples:
        ``WorldConfig(traffic="idm", reward=RewardConfig(goal=5.0))``, or from plain keywords with
        near-miss messages: ``WorldConfig().with_options(traffic="idm", reward={"goal": 5.0})``.
    """

    #: Options of the drivers that are networks, ``"ccdiff"`` above all.
    ccdiff: CcdiffConfig = field(default_factory=CcdiffConfig)
    #: Further drivers by custom names, as options of their kind: two styles of IDM are
    #: ``{"calm": IdmConfig(headway_s=2.0), "hasty": IdmConfig(headway_s=0.6)}``.
    named_drivers: Mapping[str, NamedDriver] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        own = {
            name: driver if isinstance(driver, NamedDriver) else NamedDriver.of(driver)
            for name, driver in self.named_drivers.items()
        }
        object.__setattr__(self, "named_drivers", own)
        for entry in dataclasses.fields(self):
            make: Any = entry.default_factory
            value = getattr(self, entry.name)
            if hasattr(make, "__dataclass_fields__") and not isinstance(value, make):
                # a dictionary of the fields to change
                object.__setattr__(self, entry.name, _form_value(entry.name, value, make, make()))
        for name, driver in own.items():
            kind = KINDS.get(name)
            if name == "external" or (kind and (kind.always or name != driver.kind)):
                raise ConfigError(f"config: named_drivers: {name!r} is a driver already")
        known = driver_names(own)
        for what, names, also in (
            ("traffic", self._shares(), ()),
            ("driver", (self.driver,), ("external",)),
            ("driver", tuple(self.drivers.values()), ("external",)),
        ):
            for name in names:
                if name not in known and name not in also:
                    raise unknown(what, str(name), (*known, *also))

    def with_options(self, **options: Any) -> WorldConfig:
        """Return a copy with some fields replaced.

        Args:
            **options: Fields by name. Nested configurations may be dataclasses, or dictionaries of
                the fields to change. ``dynamics``, ``discrete`` and ``grid`` are taken as fields of
                ``action``, ``bev`` as the field of ``observation``, kinds of drivers without a
                field of their own (``simnet={"weights": ...}``) as entries of ``named_drivers``.
                Drivers may be given as objects (``traffic=PythonTraffic(model)``) and as paths to
                import (``"module:Class"``, ``"module:Class?option=value"``).

        Raises:
            ConfigError: If a name is unknown (the message names near ones) or a value has the wrong
                type.
        """
        given = dict(options)
        if "ego" in given:
            given["controlled"] = given.pop("ego")
            if given["controlled"] not in ("ego", "any"):
                raise ConfigError(
                    f"config: ego is {given['controlled']!r}, expected one of ego, any"
                )
        inner = ("dynamics", "discrete", "grid")
        shortcuts: dict[str, Any] = {name: given.pop(name) for name in inner if name in given}
        rasters = {"bev": given.pop("bev")} if "bev" in given else {}
        _name_drivers(given, self.named_drivers)
        config = _made(WorldConfig, self, given, "")
        action = _made(ActionConfig, config.action, shortcuts, "action.")
        observation = _made(ObservationConfig, config.observation, rasters, "observation.")
        return dataclasses.replace(config, action=action, observation=observation)

    def check_networks(self) -> None:
        """Refuse options of networks where nobody drives by one that takes them.

        Raises:
            ConfigError: In one line that says what the traffic is.
        """
        if self.ccdiff != CcdiffConfig() and not self.takes_ccdiff():
            raise ConfigError(
                f"ccdiff: traffic is {self.traffic!r}, expected one of the networks that these "
                f"options are for: {', '.join(NETWORKS)}"
            )

    def takes_ccdiff(self) -> bool:
        """Return whether somebody drives by a network without options of its own."""
        return bool(self._driving() & set(NETWORKS) - set(self.named_drivers))

    def takes_idm(self) -> bool:
        """Return whether the options of ``idm`` differ from the default, or drive somebody: by
        name, in assisted dynamics, or round a network.
        """
        own = [driver.options for driver in self.named_drivers.values()]
        networks = [n for n in (self.ccdiff, *own) if isinstance(n, CcdiffConfig)]
        return (
            self.idm != IdmConfig()
            or "idm" in self._driving()
            or isinstance(self.action.dynamics, AssistedLimits)
            or any(n.background_driver == "idm" or n.plan_radius_m is not None for n in networks)
        )

    def networks_in_traffic(self) -> tuple[CcdiffConfig, ...]:
        """Return the options of the networks that drive others than the agents with a slot."""
        names = [*self._shares(), *self.drivers.values()]
        own = {name: driver.options for name, driver in self.named_drivers.items()}
        networks = dict.fromkeys(NETWORKS, self.ccdiff)
        options = [own.get(name, networks.get(name)) for name in names]
        return tuple(one for one in options if isinstance(one, CcdiffConfig))

    def guided_traffic(self, what: str) -> tuple[CcdiffConfig, ...]:
        """Return :meth:`networks_in_traffic`.

        Raises:
            ConfigError: If there are none: nobody can be guided; ``what`` was to guide them.
        """
        if not (found := self.networks_in_traffic()):
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
            name: NamedDriver(
                driver.kind, dataclasses.replace(driver.options, criticality=criticality)
            )
            for name, driver in self.named_drivers.items()
            if isinstance(driver.options, CcdiffConfig)
        }
        config = dataclasses.replace(self, named_drivers={**self.named_drivers, **own})
        if not config.takes_ccdiff():
            return config
        return config.with_options(ccdiff={"criticality": criticality})

    def to_json(self) -> str:
        """Return the configuration as JSON, as Rust reads it.

        It holds the options of drivers that drive; all networks share those of CCDiff.
        """
        return json.dumps(plain(self), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> WorldConfig:
        """Read what :meth:`to_json`, or Rust, wrote; absent fields take their defaults.

        Raises:
            ConfigError: If the text is no JSON object, or a field is unknown or of the wrong type.
        """
        try:
            fields = parse_object(text)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"config: not JSON ({error})") from None
        named = fields.get("named_drivers")
        if isinstance(named, dict) and isinstance(named.get("ccdiff"), dict):
            fields |= named["ccdiff"]
            fields["named_drivers"] = {k: v for k, v in named.items() if k != "ccdiff"}
        return _made(cls, cls(), fields, "")


_C = TypeVar("_C")


def _fields_of(kind: Any) -> tuple[str, ...]:
    """Names of the fields of a data class; of anything else none."""
    return tuple(f.name for f in dataclasses.fields(kind)) if dataclasses.is_dataclass(kind) else ()


#: Names of options of worlds, short ones of nested fields and kinds of drivers among them.
OPTION_NAMES = frozenset(
    {*_fields_of(WorldConfig), *KINDS, "bev", "discrete", "dynamics", "ego", "grid"}
)


def check_option(name: str, arguments: Iterable[str] = ()) -> None:
    """Refuse a keyword that is no option of worlds and none of the ``arguments`` beside them."""
    if name not in OPTION_NAMES:
        hints = typing.get_type_hints(WorldConfig)
        # those of a nested configuration are named by their path
        inner = [f"{n}.{name}" for n, t in hints.items() if str(name) in _fields_of(t)]
        raise unknown_option(str(name), inner or {*OPTION_NAMES, *arguments})


def _made(kind: type[_C], old: _C | None, options: Mapping[str, Any], path: str) -> _C:
    """Options as a dataclass, with what is not named from an old one: checked by Rust's walker."""
    hints = typing.get_type_hints(kind)
    changes = {}
    for name, value in options.items():
        if name not in hints:
            if not path:
                check_option(name)
            raise unknown("option", path + str(name), [path + n for n in hints])
        changes[name] = _form_value(path + name, value, hints[name], getattr(old, name, None))
    checked = {n: _plain_field(n, v) for n, v in changes.items() if n not in ("ccdiff", "model")}
    table = "PythonOptions" if kind is PythonTraffic else kind.__name__
    check(table, path.removesuffix("."), checked)
    try:
        return kind(**changes) if old is None else dataclasses.replace(old, **changes)  # type: ignore[type-var]
    except TypeError as error:  # a field without default is missing
        raise ConfigError(f"config: {path.removesuffix('.')}: {error}") from None


def _form_value(path: str, value: Any, hint: Any, old: Any) -> Any:
    """Value in the form of an annotation; what does not fit is left for Rust to refuse."""
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:  # numpy scalars
        value = value.item()
    union = typing.get_origin(hint) in (types.UnionType, typing.Union)
    parts = typing.get_args(hint) if union else (hint,)
    if hint == Dynamics and isinstance(value, str):
        value = {value: {}}
    if hint == Dynamics and isinstance(value, Mapping) and len(value) == 1:
        ((name, value),) = value.items()
        if name not in DYNAMICS:
            raise unknown(path, str(name), DYNAMICS)
        path, parts = f"{path}.{name}", (DYNAMICS[name],)
    classes: Any = tuple(part for part in parts if dataclasses.is_dataclass(part))
    if value is None or isinstance(value, classes):
        return value
    if hint is RewardConfig and isinstance(value, str):
        value = {"form": value}
    if (classes and hint != Dynamics) or len(classes) == 1:
        kind = classes[0]
        if not isinstance(value, Mapping):
            expected = f"{kind.__name__} or a dictionary of its fields"
            raise ConfigError(f"config: {path} is {value!r}, expected {expected}")
        return _made(kind, old if isinstance(old, kind) else None, value, path + ".")
    if hint in (Ranking, Controlled) and isinstance(value, Mapping):  # as Rust writes them
        forms = ("list",) if hint == Ranking else ("ids", "per_scene")
        value = next((value[form] for form in forms if set(value) == {form}), value)
    if hint is float and type(value) is int:
        return float(value) if abs(value) < 2**128 else math.inf
    if isinstance(value, Mapping):
        if not all(isinstance(name, str) for name in value):
            raise ConfigError(f"config: {path} is {value!r}, expected values by name")
        of = next((typing.get_args(p)[1] for p in parts if typing.get_origin(p) is Mapping), Any)
        form = _named_driver if of is NamedDriver else _form_value
        return {name: form(f"{path}.{name}", entry, of, None) for name, entry in value.items()}
    if hasattr(value, "__iter__") and not isinstance(value, (str, bytes)):
        of = next((typing.get_args(p)[0] for p in parts if typing.get_origin(p) is tuple), Any)
        return tuple(_form_value(f"{path}[{i}]", entry, of, None) for i, entry in enumerate(value))
    return value


def _named_driver(path: str, value: Any, *_: Any) -> NamedDriver:
    """Options of a kind of driver, also as ``{kind: options}``."""
    if isinstance(value, NamedDriver):
        return value
    known: dict[str, Any] = {k: kind.options for k, kind in KINDS.items() if kind.options}
    if isinstance(value, tuple(known.values())):
        return NamedDriver.of(typing.cast("Any", value))
    if not isinstance(value, Mapping) or len(value) != 1:
        kinds = ", ".join(known)
        raise ConfigError(f"config: {path} is {value!r}, expected {{kind: options}} of {kinds}")
    ((name, options),) = value.items()
    if name not in known:
        raise unknown(path, str(name), known)
    return NamedDriver(name, _form_value(f"{path}.{name}", options, known[name], None))


def _name_drivers(options: dict[str, Any], known: Mapping[str, NamedDriver]) -> None:
    """Make drivers that are objects, or paths to import, named drivers of the options."""
    found: dict[str, Any] = {}
    for what in ("traffic", "driver"):
        value = options.get(what)
        if isinstance(value, Mapping):
            value = {_take_options(text, options, what, value): of for text, of in value.items()}
        value = _take_options(value, options, what)
        if isinstance(value, str) and ":" in value:
            value = named_instance(value, "traffic model")
            if isinstance(value, CcdiffConfig):  # of the network that is called so
                options["ccdiff"], value = value, "ccdiff"
            elif not isinstance(value, PythonTraffic):
                value = PythonTraffic(value)
        if callable(value):
            raise ConfigError(
                f"config: {what} is a function or object, expected PythonTraffic(it) "
                "(docs/own_traffic.md), a name, or shares"
            )
        if isinstance(value, PythonTraffic):
            found["python"], value = value, "python"
        options |= {what: value} if what in options else {}
    for kind in KINDS:
        if kind in options and kind not in _fields_of(WorldConfig):
            found[kind] = {kind: options.pop(kind)}
    if found:
        more = options.get("named_drivers", known)
        if not isinstance(more, Mapping):
            raise ConfigError(f"config: named_drivers is {more!r}, expected values by name")
        options["named_drivers"] = {**more, **found}


def _take_options(text: Any, options: dict[str, Any], what: str, shares: Iterable[Any] = ()) -> Any:
    """Name of a driver in ``name?option=value``, whose options are put among the others."""
    if not isinstance(text, str) or "?" not in text or ":" in text.partition("?")[0]:
        return text
    name, own = read_driver(text, what)
    if own and (name not in KINDS or KINDS[name].options is None):
        takes = ", ".join(n for n, kind in KINDS.items() if kind.options)
        raise ConfigError(f"{what} {text!r}: options are for {takes}")
    if (own and name in options) or [str(t).partition("?")[0] for t in shares].count(name) > 1:
        raise ConfigError(f"{what} {text!r}: {name} has options of its own beside it")
    options |= {name: own} if own else {}
    return name


def _plain_field(name: str, value: Any) -> Any:
    """Form of a field in JSON."""
    form = plain(value)
    if name == "controlled" and not isinstance(value, str):
        return {"per_scene" if isinstance(value, Mapping) else "ids": form}
    return {"list": form} if name == "ranking" and isinstance(value, Mapping) else form


def plain(value: Any) -> Any:
    """Return the form of a value in JSON, with functions by their names."""
    if isinstance(value, Mapping):
        if value.get("kind") == "python":
            if find_spec("torch") is not None:
                import_module("torch")  # not by a thread that plans, in which it hangs or crashes
            elif not value.get("own_gradient"):
                raise MissingFeatureError("costs in Python need torch: pip install torch")
        return {
            name: object_name(entry, name)
            if isinstance(entry, types.FunctionType)
            else plain(entry)
            for name, entry in value.items()
        }
    if isinstance(value, (tuple, list)):
        return [plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON has none: Rust refuses the text by the field's name
    if not dataclasses.is_dataclass(value):
        return value
    fields: dict[str, Any] = {
        f.name: _plain_field(f.name, getattr(value, f.name)) for f in dataclasses.fields(value)
    }
    if isinstance(value, WorldConfig):
        own = {name: {p.kind: plain(p.options)} for name, p in value.named_drivers.items()}
        options = fields.pop("ccdiff")
        fields["named_drivers"] = (
            {"ccdiff": {"ccdiff": options}} if value.takes_ccdiff() else {}
        ) | own
        if not value.takes_idm():
            del fields["idm"]
    if isinstance(value, PythonTraffic):
        fields["model"] = value.described
    name = next((name for name, kind in DYNAMICS.items() if isinstance(value, kind)), None)
    return fields if name is None else {name: fields}
