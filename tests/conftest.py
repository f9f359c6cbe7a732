"""Fixtures that several test files share."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from browser_page import Page

from ccdiff_env.bench import provenance


@pytest.fixture(autouse=True, scope="session")
def _own_folders(tmp_path_factory):
    """Built scenes and training logs of tests go to folders of their own, not to the user's."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("CCDIFF_CACHE", "SB3_LOGDIR"):
            patch.setenv(name, str(tmp_path_factory.mktemp(name.lower())))
        yield


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder with the real data; skips the test where there is none."""
    here = Path(__file__).resolve().parents[1]
    candidates = [os.environ.get("CCDIFF_DATA"), here.parent / "shared" / "data"]
    for candidate in candidates:
        if candidate and (Path(candidate) / "nuscenes").is_dir():
            return Path(candidate)
    pytest.skip("no real data: neither CCDIFF_DATA nor ../shared/data holds a nuscenes folder")


@pytest.fixture(scope="module")
def scenes(request):
    """The embedded scenes of val, so many of them as a module says."""
    from ccdiff_env import embedded_scenes

    return embedded_scenes("val")[: getattr(request.module, "NUM_SCENES", None)]


@pytest.fixture(scope="module")
def browser():
    """Debian's Chromium, without a window."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no chromium on the path: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Replay pages: of a rollout with plans, and of it beside its log."""
    from view_rollouts import planned_rollout

    from ccdiff_env.view import log_rollout, write_page
    from ccdiff_env.view.index import write_pages

    folder = tmp_path_factory.mktemp("pages")
    rollout = planned_rollout()
    write_page(rollout, folder / "one.html")
    log = log_rollout(rollout.scene, like=rollout)
    write_page(rollout, folder / "two.html", compare=[log], titles=("run", "log"))
    runs = [log, rollout, log, rollout]
    write_page(rollout, folder / "grid.html", compare=runs, titles=("one", *"abcd"))
    rollout.save(folder / "a.npz")
    log.save(folder / "b.npz")
    write_pages(folder, folder)
    return folder


@pytest.fixture
def visit(browser, files):
    """Open a page; at the end nothing may have failed and nothing may have been asked for."""
    pages = []

    def go(name, **options):
        pages.append(Page(browser, files / name, **options))
        return pages[-1]

    yield go
    for page in pages:
        assert page.faults == []
        # the page itself; its workers are blobs
        assert len([url for url in page.requests if not url.startswith("blob:")]) == 1
        page.context.close()


@pytest.fixture(scope="session")
def axe():
    """Ask axe-core what people with disabilities cannot use on a page."""
    npm = shutil.which("npm")
    roots = [Path(__file__).resolve().parents[1] / "node_modules"]
    if npm is not None:
        found = subprocess.run([npm, "root", "-g"], capture_output=True, text=True, check=False)
        roots.append(Path(found.stdout.strip()))
    for root in roots:
        if (root / "axe-core" / "axe.min.js").is_file():
            source = (root / "axe-core" / "axe.min.js").read_text(encoding="utf-8")
            ask = f"() => {{ {source}; return axe.run().then((found) => found.violations); }}"
            return lambda page: [(v["id"], v["nodes"][0]["html"]) for v in page.evaluate(ask)]
    pytest.skip("no axe-core: npm install -g axe-core")


@pytest.fixture
def desk(tmp_path, monkeypatch, request):
    """A working folder with a module of one's own, the name and text of ``OWN_CODE``."""
    name, text = request.module.OWN_CODE
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(provenance, "_SEEN", {})
    (tmp_path / f"{name}.py").write_text(text)
    return tmp_path
