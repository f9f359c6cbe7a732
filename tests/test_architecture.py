"""Edges between modules and files; facts that stand once; entries that one edit adds."""

import ast
import functools
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from ccdiff_env.traffic import KINDS, NETWORKS

ROOT = Path(__file__).resolve().parents[1]
CRATES = ("sim", "nuscenes", "render", "nets", "models", "bridge", "py", "py-models", "wasm")
#: Crates that may use others beside the simulator.
USERS = {
    "models": {"sim", "nets"},
    "bridge": {"sim", "nets"},
    "py": {"sim", "nuscenes", "render", "nets", "bridge"},
    "py-models": {"sim", "models", "bridge"},
    "wasm": {"sim", "nuscenes", "nets"},
}

#: Rooms of crates and of folders in them; each may use those before it.
CRATE_ROOMS = {
    "sim": "simd_dispatch named error geom options scene state dynamics events causal metrics "
    "observe stage drivers pdm world planner",
    "sim/world": "rng reward_columns config buffers driver_table episode scenes tick executor "
    "queries",
    "nets": "error config kernels inputs guidance sampling compute networks traffic",
}

Graph = Mapping[str, set[str]]


def circles(graph: Graph) -> list[set[str]]:
    """Sets of files each of which uses, by way of others, all of its set."""

    def reached(start: str) -> set[str]:
        seen, todo = set[str](), [start]
        while todo:
            for found in graph.get(todo.pop(), set()) - seen:
                seen.add(found)
                todo.append(found)
        return seen

    reach = {name: reached(name) for name in graph}
    found: list[set[str]] = []
    for name, there in reach.items():
        if name in there and not any(name in circle for circle in found):
            found.append({other for other in there if name in reach.get(other, set())})
    return found


# Rust


def code_of(file: Path) -> str:
    """Text of a file without comments, visibilities and tests."""
    text = re.sub(r"//.*|pub\([^)]*\)", "", file.read_text(encoding="utf-8"))
    return text.split("#[cfg(test)]")[0]


def paths_in(text: str) -> Iterator[tuple[str, ...]]:
    """Every path that begins with ``crate``, ``super`` or ``self``; groups are taken apart once."""
    for found in re.finditer(
        r"\b((?:crate|super|self)(?:::\w+)*)(?:::\{((?:[^{}]|\{[^{}]*\})*)\})?", text
    ):
        base = tuple(found[1].split("::"))
        names = re.sub(r"::\{[^{}]*\}", "", found[2] or "").split(",")
        for name in names:
            yield (*base, *re.findall(r"\w+", name.split(" as ")[0]))


class Crate:
    """Files of a crate by their path of modules, and who uses whom.

    A path through a room's face (``mod.rs``) uses the face, whoever defines the name. What a face
    takes from its own files (``use child::Name``) is no arrow.
    """

    def __init__(self, name: str) -> None:
        source = ROOT / "rust" / name / "src"
        self.files: dict[tuple[str, ...], Path] = {}
        for file in source.rglob("*.rs"):
            parts = file.relative_to(source).with_suffix("").parts
            self.files[parts[:-1] if parts[-1] in ("mod", "lib") else parts] = file
        self.graph = {
            "/".join(module) or "lib": {
                "/".join(used) or "lib"
                for path in paths_in(code_of(file))
                if (used := self.file_of(module, path)) is not None and used != module
            }
            for module, file in self.files.items()
        }

    def file_of(self, module: tuple[str, ...], path: tuple[str, ...]) -> tuple[str, ...] | None:
        """The file that a path leads to."""
        while path and path[0] in ("crate", "super", "self"):
            module = {"crate": (), "super": module[:-1], "self": module}[path[0]]
            path = path[1:]
        full = (*module, *path)
        for length in range(len(full), -1, -1):
            if full[:length] in self.files:
                return full[:length]
        return None


@pytest.mark.parametrize("name", CRATES)
def test_no_rust_file_is_in_a_circle(name):
    assert [sorted(circle) for circle in circles(Crate(name).graph)] == []


@pytest.mark.parametrize("name", CRATE_ROOMS)
def test_rooms_of_a_crate_use_those_before_them(name):
    (crate, *folder), ordered = name.split("/"), CRATE_ROOMS[name].split()
    graph, depth = Crate(crate).graph, len(folder)
    rooms = {f: [*f.split("/"), "lib"][depth] for f in graph if f.split("/")[:depth] == folder}
    edges = {(rooms[file], rooms[used]) for file in rooms for used in graph[file] & set(rooms)}
    edges = {(a, b) for a, b in edges if a != b and "lib" not in (a, b)}
    assert {room for edge in edges for room in edge} == set(ordered)
    place = {room: i for i, room in enumerate(ordered)}
    assert {(a, b) for a, b in edges if place[b] > place[a]} == set()


def strings_of(file: Path) -> set[str]:
    """Strings in the code of a file of Rust or Python."""
    if file.suffix == ".rs":
        return set(re.findall(r'"([^"\n]*)"', code_of(file)))
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    return {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}


@functools.cache
def strings() -> dict[str, set[str]]:
    """Strings of every file of code, by its path without ``rust`` and ``src``."""
    files = [*(ROOT / "rust").glob("*/src/**/*.rs"), *(ROOT / "ccdiff_env").rglob("*.py")]
    return {
        re.sub("^rust/(.*)/src/", r"\1/", file.relative_to(ROOT).as_posix()): strings_of(file)
        for file in files
    }


def naming(name: str) -> list[str]:
    """Files in whose code a string is."""
    return sorted(file for file, found in strings().items() if name in found)


@pytest.mark.parametrize(
    ("entry", "files"),
    [
        ("leader_gap", ["sim/observe/columns.rs"]),  # a column of observations
        ("log_distance", ["sim/world/reward_columns.rs"]),  # a column of infos
        ("gpudrive", ["ccdiff_env/scenes/sources.py", "nuscenes/gpudrive.rs"]),  # a data source
        ("ccdiff_paper", ["ccdiff_env/bench/methods.py"]),  # a method of benchmarks
        # planners: where one is made, and its title
        ("noop", ["ccdiff_env/planners/built_in.py", "ccdiff_env/view/captions.py"]),
    ],
)
def test_an_entry_of_a_table_is_named_there_alone(entry, files):
    assert naming(entry) == files


def test_a_driver_is_named_where_it_is_declared():
    """A network in one file of each crate of networks.

    Its own methods and marker may be in the benchmark, and the playground says whom it offers.
    """
    for name in sorted(set(NETWORKS) - {"ccdiff"}):
        elsewhere = ("/methods.py", "/plots.py", "/link.py", "/tests.rs")
        named = [file for file in naming(name) if not file.endswith(elsewhere)]
        crates = ["nets"] if KINDS[name].distilled else ["models", "nets"]
        assert [file.split("/")[0] for file in named] == crates, (name, named)
        assert naming(KINDS[name].title) == [named[-1]]


def test_no_crate_knows_its_siblings():
    for name in CRATES:
        manifest = (ROOT / "rust" / name / "Cargo.toml").read_text(encoding="utf-8")
        needs = manifest.split("[dependencies]")[1].split("[dev-dependencies]")[0]
        others = set(re.findall(r"^ccdiff-([\w-]+)", needs, re.MULTILINE))
        allowed = {"sim": set(), **USERS}.get(name, {"sim"})
        assert others <= allowed, name


# Python


EXTENSIONS = ("_native", "_models")  #: Compiled modules of the package.


@functools.cache
def trees() -> dict[str, ast.Module]:
    """The modules of the package, by their names."""
    found = {}
    for file in (ROOT / "ccdiff_env").rglob("*.py"):
        parts = file.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(file.read_text(encoding="utf-8"), str(file))
    return found


@functools.cache
def python_graph() -> dict[str, set[str]]:
    """Imports between the modules of the package, those in functions and for types included."""
    modules = trees()
    graph: dict[str, set[str]] = {}
    for module, tree in modules.items():
        used = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                used |= {name.name for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module is not None:
                for name in node.names:
                    full = f"{node.module}.{name.name}"
                    # an extension is a module, its stub no file of Python
                    used.add(full if full in modules or name.name in EXTENSIONS else node.module)
        graph[module] = (used & set(modules)) - {module}
    return graph


def test_no_python_module_is_in_a_circle():
    found = circles(python_graph())
    assert [sorted(c) for c in found] == []


def test_classes_are_in_files_of_their_own_and_the_face_is_a_table_of_names():
    faces = [file.parent for file in (ROOT / "ccdiff_env").rglob("__init__.py")]
    names = [".".join(folder.relative_to(ROOT).parts) for folder in faces]
    kinds = {name: {type(node) for node in trees()[name].body} for name in names}
    assert [name for name in names if ast.ClassDef in kinds[name]] == []
    # a docstring; imports, those of the extension with what to do where it is missing; __all__
    assert kinds["ccdiff_env"] == {ast.Expr, ast.ImportFrom, ast.Try, ast.Assign}


#: Rooms of the package; each may use those before it. The face, ``__init__``, is not one of them.
ROOMS = [
    "errors", "system", "scenes", "metrics", "traffic", "config", "models", "worlds", "interop",
    "planners", "record", "envs", "training", "view", "bench", "cli",
]  # fmt: skip


def test_rooms_of_the_package_use_those_before_them():
    """Imports in functions and for types count, too."""
    graph = {module: used for module, used in python_graph().items() if "." in module}
    place = {room: i for i, room in enumerate(ROOMS)}
    assert {module.split(".")[1] for module in graph} == set(ROOMS)
    for module, all_used in graph.items():
        room = place[module.split(".")[1]]
        assert [used for used in all_used if "." not in used] == [], f"{module} knows the face"
        up = [used for used in all_used if place[used.split(".")[1]] > room]
        assert up == [], f"{module} imports {up}"


@pytest.mark.parametrize(
    ("module", "unknown"), [("config", "scenes"), ("record.rollout", "config")]
)
def test_modules_that_do_without_a_room_before_them(module, unknown):
    used = python_graph()[f"ccdiff_env.{module}"]
    assert [name for name in used if name.split(".")[1] == unknown] == []


def test_the_package_by_itself_loads_no_benchmark_and_no_page():
    code = "import ccdiff_env, sys; print(*(m for m in sys.modules if m.startswith('ccdiff_env.')))"
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    assert "ccdiff_env.envs" in found
    assert [name for name in found if name.startswith("ccdiff_env.bench")] == []
    assert [name for name in found if name.startswith("ccdiff_env.view.")] == [
        "ccdiff_env.view.notebook"
    ]
