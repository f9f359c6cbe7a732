"""A planner of nuPlan with its settings: from the YAML file that came with it, and options."""

from __future__ import annotations

import functools
import importlib.util
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ccdiff_env.errors import ConfigError, DatasetError, MissingFeatureError
from ccdiff_env.interop.nuplan.devkit import INSTALL, VARIABLE, checkouts
from ccdiff_env.system.files import read_text, reading
from ccdiff_env.system.named_objects import named_object, option_values

_PACKAGES = ("nuplan", "torch")  #: Packages whose classes settings may name.


@dataclass(frozen=True)
class Settings:
    """What a planner is made with: its name, arguments with ``_target_``, and their file, if any.

    Planners of nuPlan come with files of settings in ``config/simulation/planner``, which name a
    class as ``_target_``, and its arguments. Of a class, the file that names it is taken, from the
    checkouts and from beside the class; a class without one is made with the options alone.
    Options change single values, those of parts by ``part.name=value``. Interpolations of Hydra
    (``${...}``) are not followed: such values must be given.

    Anybody may have written a file, which names what is called: only classes of nuplan and torch,
    and what the planner's own packages have. Own is the package that the planner is named by, and
    those that lie in a checkout.
    """

    name: str
    values: Mapping[str, Any]
    file: Path | None = None

    @classmethod
    def of(cls, name: str) -> Settings:
        """Return the settings of a name, as :func:`~ccdiff_env.interop.nuplan.nuplan_planner` says.

        Raises as that, and :class:`DatasetError` if the file is damaged.
        """
        path, _, text = name.partition(":")[2].partition("?")
        options = option_values(text, "planner", name) if text else {}
        if path.endswith(".yaml"):
            return cls(name, _changed(read_settings(Path(path)), options, name), Path(path))
        files = _files(path.partition(".")[0])
        for file in files:
            if file.stem == path or ("." in path and path in read_text(file)):
                values = read_settings(file)
                if path in (file.stem, values["_target_"]):
                    return cls(name, _changed(values, options, name), file)
        if "." not in path:
            known = ", ".join(sorted({file.stem for file in files})) or "none"
            raise ConfigError(
                f"planner {name!r}: no settings {path!r} in the checkouts, there are {known}; or "
                "name a class: nuplan:package.module.Class"
            )
        return cls(name, {"_target_": path, **_changed({}, options, name)})

    @property
    def module(self) -> str:
        """Module of the planner's class."""
        return str(self.values["_target_"]).rpartition(".")[0]

    def owns(self, package: str) -> bool:
        """Return whether a package is the planner's own, whatever its file says."""
        path = self.name.partition(":")[2].partition("?")[0]
        if not path.endswith(".yaml") and path.partition(".")[0] == package:
            return True
        folders = [folder.resolve() for folder in checkouts()]
        return any(place.parent in folders for place in _places(package))

    def make(self) -> Any:
        """Make a planner; a :class:`ConfigError` says why it is none, or what it lacks."""
        from nuplan.planning.simulation.observation.observation_type import DetectionsTracks
        from nuplan.planning.simulation.planner.abstract_planner import AbstractPlanner

        kind: Any = _named(self.values["_target_"], self.name, self.owns)
        if not inspect.isclass(kind) or not issubclass(kind, AbstractPlanner):
            raise ConfigError(f"planner {self.name!r}: not a subclass of nuPlan's AbstractPlanner")
        if getattr(kind, "requires_scenario", False):
            raise ConfigError(
                f"planner {self.name!r} asks for nuPlan's scenario, which holds the log's future"
            )
        made = made_of(self.values, self.name, own=self.owns)
        if (seen := made.observation_type()) is not DetectionsTracks:
            raise ConfigError(
                f"planner {self.name!r} observes {seen.__name__}, expected DetectionsTracks: "
                "scenes have no sensors"
            )
        return made


def _files(package: str) -> list[Path]:
    """Files of settings in the checkouts, and beside a package that is installed."""
    folders = [*checkouts(), *(place for place in _places(package) if place.is_dir())]
    unique = dict.fromkeys(folder.resolve() for folder in folders)
    return [file for folder in unique for file in sorted(folder.rglob("simulation/planner/*.yaml"))]


def _places(package: str) -> list[Path]:
    """Folders of a package that can be imported, or the file of a module."""
    try:
        spec = importlib.util.find_spec(package) if package else None
    except (ImportError, ValueError):
        spec = None
    found = list((spec and spec.submodule_search_locations) or ())
    found += [spec.origin] if spec and spec.has_location and spec.origin and not found else []
    return [Path(place).resolve() for place in found]


def of_devkit(pattern: str) -> dict[str, Any]:
    """Return the values of the only file of the devkit's own settings that fits a pattern."""
    import nuplan.planning.script

    (folder,) = nuplan.planning.script.__path__
    (file,) = Path(folder).glob(f"config/{pattern}.yaml")
    return read_settings(file)


def read_settings(file: Path) -> dict[str, Any]:
    """Return the values of a file of Hydra, those of its only entry, or its own, with a target."""
    try:
        import yaml
    except ImportError as error:
        raise MissingFeatureError(f"settings of nuPlan need PyYAML: {INSTALL}") from error
    # PyYAML takes 1e-4 for a text, Hydra for a number
    loader: Any = type("Loader", (yaml.SafeLoader,), {})
    number = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$")
    loader.add_implicit_resolver("tag:yaml.org,2002:float", number, [*"-+0123456789"])
    with reading("settings of a planner", file):
        found = yaml.load(read_text(file), loader)
        if isinstance(found, dict) and "_target_" not in found and len(found) == 1:
            (found,) = found.values()
        if not isinstance(found, dict) or not isinstance(found.get("_target_"), str):
            raise DatasetError("no _target_, expected a planner's class and its arguments")
    return found


def _changed(values: Mapping[str, Any], options: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Values with options in the place of some, by dotted names."""
    changed = dict(values)
    for path, value in options.items():
        part, _, rest = path.partition(".")
        if rest and not isinstance(changed.get(part), dict):
            parts = [key for key, inner in changed.items() if isinstance(inner, dict)]
            raise ConfigError(
                f"planner {name!r}: no part {part!r} in its settings, there are "
                f"{', '.join(parts) or 'none'}"
            )
        changed[part] = _changed(changed[part], {rest: value}, name) if rest else value
    return changed


def made_of(
    value: Any, name: str, path: str = "", *, own: Callable[[str], bool] = lambda _: False
) -> Any:
    """Return what a value of settings means: dictionaries with a target become objects.

    ``name`` is the planner's, for messages, and ``path`` the place in its settings; ``own`` says
    which packages it has beside nuplan and torch. Raises :class:`ConfigError` if there is no such
    target, it is of another package, or its arguments are others.
    """
    if isinstance(value, list):
        return [made_of(item, name, f"{path}[{i}]", own=own) for i, item in enumerate(value)]
    if isinstance(value, str) and ("${" in value or value == "???"):
        raise ConfigError(f"planner {name!r}: {path} is {value!r}, give it as ?{path}=value")
    if not isinstance(value, Mapping):
        return value
    below = {
        key: made_of(item, name, f"{path}.{key}".strip("."), own=own)
        for key, item in value.items()
        # keys by which Hydra is told what to do
        if key not in ("_target_", "_convert_", "_recursive_")
    }
    if "_target_" not in value:
        return below
    kind = _named(value["_target_"], name, own)
    # planners inherit a __new__ that takes everything
    plain = inspect.isclass(kind) and inspect.isfunction(kind.__init__)
    given = inspect.signature(functools.partial(kind.__init__, None) if plain else kind)
    try:
        given.bind(**below)
    except TypeError as error:
        raise ConfigError(
            f"planner {name!r}: {kind.__name__}: {error}; it takes {', '.join(given.parameters)}, "
            "as ?option=value"
        ) from None
    return kind(**below)


def _named(target: Any, name: str, own: Callable[[str], bool]) -> Any:
    """Import what a target names: a class of nuplan or torch, or something of an own package."""
    module, _, attribute = str(target).rpartition(".")
    package = module.partition(".")[0]
    fits, found = package in _PACKAGES or own(package), None
    if fits:  # nothing else is even imported
        try:
            found = named_object(f"{module}:{attribute}", f"planner {name!r}, which names")
        except ModuleNotFoundError as error:
            raise MissingFeatureError(f"planner {name!r} needs {error.name}: {error}") from error
        # a module also has what it imports
        root = str(getattr(found, "__module__", "")).partition(".")[0]
        fits = own(root) or (root in _PACKAGES and inspect.isclass(found))
    if not fits:
        raise ConfigError(
            f"planner {name!r}: _target_ is {target!r:.200}, expected a class of nuplan or torch, "
            f"or what the planner's own package has: the one that it is named by, or in {VARIABLE}"
        )
    return found
