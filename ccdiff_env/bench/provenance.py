"""What results follow from: hashes of the package, of planners and of scenes, and the machine."""

from __future__ import annotations

import ast
import os
import platform
import site
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from functools import lru_cache
from importlib import metadata
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.interop.nuplan import PREFIX, nuplan_planner
from ccdiff_env.models import weight_files
from ccdiff_env.system.files import read_bytes, read_text
from ccdiff_env.system.named_objects import named_object
from ccdiff_env.system.settings import sha256
from ccdiff_env.system.version import __version__

_PACKAGE = Path(__file__).resolve().parents[1]
#: Files of the package that show results and decide none.
_SHOW = ("view", "terminal.py", "progress.py", "page.py", "plots.py", "cli.py", "view_command.py")
_SEEN: dict[str, str] = {}  #: Digest of each planner's source when this process first saw it.


def sha256_of(*files: Path) -> str:
    """Return the SHA-256 of the bytes of files, one after another."""
    return sha256(*map(read_bytes, files))


@lru_cache(maxsize=1)
def package_digest() -> str:
    """Return the SHA-256 of all that decides results in the package: code, networks, protocols."""
    endings = (".py", ".so", ".safetensors", ".json", ".zip")
    files = sorted(file for file in _PACKAGE.rglob("*") if file.suffix in endings)
    files += [file for file in weight_files() if file not in files]
    shows = [
        file.name.endswith("_report.py") or any(part in _SHOW for part in file.parts)
        for file in files
    ]
    return sha256_of(*(file for file, show in zip(files, shows, strict=True) if not show))


def commit() -> str | None:
    """Return the commit of the source that the package runs from, if it is a clone of it."""
    folder = _PACKAGE.parent
    if not (folder / ".git").exists():
        return None
    words = ("describe", "--always", "--exclude=*", "--abbrev=40", "--dirty= with changes")
    try:
        done = subprocess.run(["git", "-C", folder, *words], capture_output=True, text=True)
    except OSError:  # no git here
        return None
    return done.stdout.strip() or None


@lru_cache(maxsize=1)
def processor() -> str:
    """Return the name of the processor."""
    try:
        lines = read_text("/proc/cpuinfo").splitlines()
    except (OSError, DatasetError):
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def made_with() -> dict[str, Any]:
    """Return what a run is made with: version, commit, package, processor, libraries."""
    libraries = {"python": platform.python_version()}
    for name in ("numpy", "gymnasium", "torch", "stable_baselines3"):
        try:
            libraries[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {
        "version": __version__,
        "commit": commit(),
        "package": package_digest(),
        "processor": processor(),
        "libraries": libraries,
    }


def scene_hashes(source: str, names: Sequence[str] | None = None) -> dict[str, str]:
    """Return the content hashes of scenes by name."""
    return {scene.name: scene.hash for scene in scenes_of(source, names)}


def source_digest(name: str) -> str | None:
    """Return the SHA-256 of what a planner, or a model of traffic, is made of; ``None`` of the
    package's.

    Of a file that is its bytes. Of ``module:name``, and of a planner of nuPlan, it is the source of
    the module, of all that it imports from outside of installed packages, and the bytes of the
    files that its optional attribute ``files``, or an option, names. A :class:`ConfigError` refuses
    a source that has changed since this process first saw it: what is imported stays as it was.
    """
    path = name.partition("?")[0]
    kind, _, rest = path.partition(":")
    if kind == "adversary" and rest:
        path = rest
    elif rest:
        return _of_module(name)
    if not path.endswith((".zip", ".safetensors")) and path == kind:
        return None
    if not Path(path).is_file():
        raise DatasetNotFoundError(f"no policy at {path}")
    return sha256_of(Path(path))


def _of_module(name: str) -> str:
    if name.startswith(PREFIX):
        target: Any = nuplan_planner(name)
        module = target.module
    else:
        target, module = named_object(name, "code"), name.partition(":")[0]
    sources = _sources(module)
    files = [Path(file) for file in getattr(target, "files", ())]
    given = (part.partition("=")[2] for part in name.partition("?")[2].split("&"))
    files += [Path(value) for value in given if value and Path(value).is_file()]
    missing = [file for file in files if not file.is_file()]
    if missing:
        raise DatasetNotFoundError(f"{name}: files names {missing[0]}, which is not there")
    digest = sha256_of(*(sources[module] for module in sorted(sources)), *files)
    if _SEEN.setdefault(name, digest) != digest:
        raise ConfigError(f"{name} has changed since it was imported: start a new process")
    return digest


def _sources(module: str) -> dict[str, Path]:
    """Return the files of a module and of what it imports from outside of installed packages.

    Nothing is imported to find them: that would run what nobody asked for.
    """
    own = _spec(module.partition(".")[0])
    installed = _list_installed(Path(own.origin) if own is not None and own.origin else None)
    found: dict[str, Path] = {}
    seen, waiting = {module}, [module]
    while waiting:
        name = waiting.pop()
        spec = _spec(name)
        path = Path(spec.origin or "") if spec is not None else Path()
        foreign = name.partition(".")[0] != module.partition(".")[0]
        if path.suffix != ".py" or not path.is_file():
            continue
        if foreign and any(folder in path.resolve().parents for folder in installed):
            continue
        found[name] = path
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        waiting += (new := set(_imports(path, package)) - seen)
        seen |= new
    return found


def _spec(module: str) -> ModuleSpec | None:
    """Return where a module is, without importing the packages that it is in."""
    spec: ModuleSpec | None = None
    try:
        for end in [i for i, letter in enumerate(f"{module}.") if letter == "."]:
            folders = None if spec is None else list(spec.submodule_search_locations or [])
            known = getattr(sys.modules.get(module[:end]), "__spec__", None)
            spec = known or PathFinder.find_spec(module[:end], folders)
            if spec is None:
                return None
    except Exception:  # of finders of others, and of packages without a file
        return None
    return spec


def _list_installed(own: Path | None) -> set[Path]:
    """Folders of Python and of installed packages, those that .pth files name among them.

    ``own`` is the file of a planner's package: its folder may be one that such a file names.
    """
    libraries = {sysconfig.get_path(n) for n in ("stdlib", "platstdlib", "purelib", "platlib")}
    sites = {*site.getsitepackages(), site.getusersitepackages()}
    named: set[Path] = set()
    for folder in map(Path, sites | libraries):
        for file in folder.glob("*.pth"):
            lines = read_bytes(file).decode(errors="replace").splitlines()
            named |= {folder / s for line in lines if (s := line.strip()) and s[0] != "#"}
    beside = set() if own is None else set(own.resolve().parents)
    named = {folder.resolve() for folder in named if os.path.isdir(folder)} - beside
    return {Path(folder).resolve() for folder in sites | libraries} | named | {_PACKAGE}


def _imports(path: Path, package: str) -> Iterator[str]:
    try:
        tree = ast.parse(read_bytes(path), str(path))
    except (OSError, RecursionError, SyntaxError, ValueError):  # such a file cannot be imported
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.rsplit(".", node.level - 1)[0]
                base = f"{above}.{base}".strip(".")
            if base and base not in sys.builtin_module_names:
                yield base
                yield from (f"{base}.{alias.name}" for alias in node.names)
