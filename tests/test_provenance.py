"""What a custom planner is made of: found without running anything."""

import sys

import pytest

from ccdiff_env.bench import provenance
from ccdiff_env.bench.provenance import source_digest
from ccdiff_env.errors import ConfigError, DatasetNotFoundError


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """The working folder, where modules are found."""
    before = set(sys.modules)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(provenance, "_SEEN", {})
    yield tmp_path
    for name in set(sys.modules) - before:
        del sys.modules[name]


def test_a_planner_that_changes_while_it_is_played_is_refused(desk):
    (desk / "files.bin").write_bytes(b"1")
    (desk / "reads.py").write_text("def act(obs):\n    return obs\nact.files = ['files.bin']\n")
    first = source_digest("reads:act")
    (desk / "files.bin").write_bytes(b"2")
    with pytest.raises(ConfigError, match="reads:act has changed since it was imported"):
        source_digest("reads:act")
    (desk / "files.bin").write_bytes(b"1")
    assert source_digest("reads:act") == first
    (desk / "files.bin").unlink()
    with pytest.raises(DatasetNotFoundError, match=r"files\.bin"):
        source_digest("reads:act")


def digest_of(desk, number, text, files):
    """Digest of a new planner with other files beside it."""
    for name, source in files.items():
        (desk / name).parent.mkdir(exist_ok=True)
        (desk / name).write_text(source)
    (desk / f"planner_{number}.py").write_text(f"def act(obs):\n    return obs\n{text}")
    return source_digest(f"planner_{number}:act")


RAISES = "raise AssertionError\n"


@pytest.mark.parametrize(
    ("text", "files"),
    [
        ("if 0:\n    from dies.sub import x\n", {"dies/__init__.py": RAISES, "dies/sub.py": ""}),
        (
            "if 0:\n    import dies.sub.deeper\n",
            {"dies/__init__.py": RAISES, "dies/sub.py": RAISES},
        ),
        ("if 0:\n    import dies\n", {"dies.py": "print 'of Python 2'\n"}),
        ("if 0:\n    import dies\n", {"dies.py": "x = " + "(" * 10_000}),
        ("if 0:\n    import dies\n", {"dies.py": "\0"}),
        ("if 0:\n    import none_such.sub\n    from ...... import y\n", {}),
        ("if 0:\n    import prompt_toolkit.eventloop.win32\n    import distutils.x\n", {}),
        ("def later():\n    import xml.dom.expatbuilder.x, lib2to3.tests, idlelib.run\n", {}),
    ],
)
def test_imports_that_would_fail_or_cost_are_not_run(desk, text, files):
    before = set(sys.modules)
    assert digest_of(desk, 0, text, files)
    assert not {"dies", "xml.dom", "lib2to3", "idlelib"} & (set(sys.modules) - before)


def test_a_module_deep_in_packages_counts(desk):
    text = "def later():\n    from deep.under import module\n"
    found = [
        digest_of(
            desk,
            number,
            text,
            {
                "deep/__init__.py": RAISES,
                "deep/under.py": "from . import beside\n",
                "deep/beside.py": beside,
            },
        )
        for number, beside in enumerate(["X = 1\n", "X = 1\n", "X = 2\n"])
    ]
    assert found[0] == found[1] != found[2]


def test_packages_that_a_pth_file_names_are_installed(desk, tmp_path_factory, monkeypatch):
    elsewhere, site = tmp_path_factory.mktemp("elsewhere"), tmp_path_factory.mktemp("site")
    (site / "x.pth").write_text(f"import {'x' * 5000}\n# none\n{elsewhere}\n{desk}\n")
    monkeypatch.syspath_prepend(str(elsewhere))
    monkeypatch.setattr("site.getsitepackages", lambda: [str(site)])
    (elsewhere / "elsewhere_module.py").write_text("X = 1\n")
    text = "import elsewhere_module, beside_module\n"
    first = digest_of(desk, 0, text, {"beside_module.py": ""})
    (elsewhere / "elsewhere_module.py").write_text("X = 2\n")
    assert digest_of(desk, 1, text, {}) == first
    assert digest_of(desk, 2, text, {"beside_module.py": "Y = 1\n"}) != first
