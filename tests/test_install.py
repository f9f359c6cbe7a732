"""What importing the package costs, and what happens without torch."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import ccdiff_env
from ccdiff_env.models import TORCH, weight_files

ROOT = Path(__file__).resolve().parents[1]

MEASURED = """
import resource, sys
from pathlib import Path
sys.argv = ["ccdiff-env", "--help"]
{code}
used = resource.getrusage(resource.RUSAGE_SELF)
# of this program alone: ru_maxrss begins at what the process had that started it
peak = Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]
print(used.ru_utime + used.ru_stime, int(peak) / 1024, "torch" in sys.modules)
"""


def python(code: str, folder: Path = ROOT, **environment: str) -> str:
    """Last line that a fresh process prints."""
    command, env = [sys.executable, "-c", code], {**os.environ, **environment}
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout.splitlines()[-1]


def cost(code: str, cache: Path) -> tuple[float, float, str]:
    """Least seconds of processor time of four processes, greatest MiB, and whether torch is in.

    The first one compiles, as installers do.
    """
    compiled = {"PYTHONPYCACHEPREFIX": str(cache), "PYTHONDONTWRITEBYTECODE": ""}
    runs = [python(MEASURED.format(code=code), **compiled).split() for _ in range(4)]
    return min(float(r[0]) for r in runs), max(float(r[1]) for r in runs), runs[0][2]


def test_import_is_light_and_leaves_torch_alone(tmp_path):
    # a third of a second on an idle machine; twice as much and more where every core is taken
    seconds, mebibytes, torch = cost("import ccdiff_env", tmp_path)
    assert seconds < 1.0
    assert mebibytes < 100
    assert torch == "False"


def test_help_comes_at_once(tmp_path):
    help_text = "from ccdiff_env_cli import main\ntry: main()\nexcept SystemExit: pass"
    seconds, _, torch = cost(help_text, tmp_path)
    assert seconds < 0.3
    assert torch == "False"


REFUSED = """
import sys, types
import ccdiff_env
{before}
try:
    ccdiff_env.EgoEnv(traffic="{network}", {network}={{"device": "cuda"}})
except ccdiff_env.errors.MissingFeatureError as error:
    assert isinstance(error, ImportError)
    print(error)
"""


@pytest.mark.parametrize(
    ("before", "message"),
    [
        ("sys.modules['torch'] = None", r"need torch .*pip install 'ccdiff-env\[models\]'"),
        (
            "torch = sys.modules['torch'] = types.ModuleType('torch')\n"
            "torch.__version__ = '2.12.0+cpu'",
            r"need torch .*, found 2\.12\.0\+cpu",
        ),
        ("sys.modules['ccdiff_env._models'] = None", r"built without them"),
        (
            "from pathlib import Path\nfrom ccdiff_env.models import weights\n"
            "weights._rivals = lambda: Path('absent')",
            r"weights strive_fast .*pip install 'ccdiff-env\[rivals\]'",
        ),
        ("ccdiff_env._native.build_mark = lambda: 1", r"of different builds"),
    ],
    ids=["no torch", "another torch", "no module", "no weights", "another build"],
)
def test_networks_that_cannot_be_are_one_clear_line(before, message):
    network = "strive" if "strive" in message else "tokens"
    assert re.search(message, python(REFUSED.format(before=before, network=network)))


def test_environments_of_a_learner_that_is_not_there_are_one_clear_line():
    code = "import sys\nsys.modules['stable_baselines3'] = None\ntry: import ccdiff_env.envs.sb3\n"
    assert "ccdiff-env[rl]" in python(f"{code}except ImportError as error: print(error)")


def test_a_source_folder_before_the_installed_package_says_what_to_do(tmp_path):
    (tmp_path / "ccdiff_env").mkdir()
    source = (ROOT / "ccdiff_env" / "__init__.py").read_bytes()
    (tmp_path / "ccdiff_env" / "__init__.py").write_bytes(source)
    (tmp_path / "ccdiff_env" / "_native.pyi").touch()
    code = f"import sys\nsys.path.insert(0, {str(tmp_path)!r})\ntry: import ccdiff_env\n"
    line = python(f"{code}except ImportError as error: print(error)")
    assert re.match(rf"{re.escape(str(tmp_path))}\S* is the source folder.*make setup$", line)


def test_versions_are_written_alike_everywhere():
    def found(file: str, pattern: str) -> str:
        match = re.search(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)
        assert match, file
        return match[1]

    versions = {
        found("Cargo.toml", r'^version = "(.+)"'),
        found("CITATION.cff", r"^version: (.+)"),
        found("tools/rivals/pyproject.toml", r'^version = "(.+)"'),
        found("pyproject.toml", r'"ccdiff-env-rivals==(.+)"'),
        ccdiff_env.__version__,
    }
    assert len(versions) == 1
    torch = {found("pyproject.toml", r"torch==([\d.]+)"), TORCH}
    assert torch == {found("rust/models/build.rs", r'TORCH: &str = "([\d.]+)"')}


SHIPPED = {file.stem.split("_")[0] for file in weight_files()}
RIVALS = sorted(SHIPPED & {"simnet", "trafficsim", "strive", "bits", "ctg", "ctgpp"})
NETWORKS = ",".join(["ccdiff_one_step", "ccdiff", *RIVALS, "tokens"])


@pytest.mark.parametrize(
    "words",
    [
        ["planners", "--planners", "idm", "--traffic", "idm,ccdiff"],
        ["traffic", "--methods", NETWORKS, "--k", "1", "--t", "1"],
    ],
    ids=lambda words: words[0],
)
def test_benchmarks_need_nothing_that_a_bare_installation_lacks(words, tmp_path):
    command = ["bench", *words, "--limit", "1", "--out", str(tmp_path / "run")]
    lacks = ("torch", "ccdiff_env._models", "tqdm", "rich", "matplotlib", "PIL")
    code = f"import sys\nsys.modules.update(dict.fromkeys({lacks}))\n"
    assert python(f"{code}from ccdiff_env_cli import main\nprint(main({command}))") == "0"
