"""The playground in a real Chromium: its worlds are those of the package."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from browser_page import Page

from ccdiff_env import EgoEnv
from ccdiff_env.scenes.embedded import embedded_scenes
from tools.playground import TRAFFIC, compiled, playground_html, target_is_installed, world_config

pytestmark = pytest.mark.timeout(600)
NAMES = ("cut-in-04", "pedestrians-00")
#: Braking, then a swerve at full throttle: accelerations and yaw rates [T, 2].
ACTIONS = np.array(
    [[-0.3, 0.0]] * 8 + [[1.0, 0.35]] * 6 + [[0.5, -0.8]] * 6 + [[0.1, 0.013]] * 20, np.float32
)


@pytest.fixture(scope="module")
def page_file(browser, tmp_path_factory):
    if shutil.which("cargo") is None or not target_is_installed():
        pytest.skip("no compiler for WebAssembly: rustup target add wasm32-unknown-unknown")
    path = tmp_path_factory.mktemp("playground") / "playground.html"
    scenes = [embedded_scenes()[name] for name in NAMES]
    path.write_text(playground_html(compiled(), scenes), encoding="utf-8")
    return path


@pytest.fixture
def visit(browser, page_file):
    """Open the page; at the end nothing may have failed and nothing may have been asked for."""
    pages = []

    def go(hash="", **options):
        pages.append(Page(browser, page_file, hash, **options))
        return pages[-1]

    yield go
    for page in pages:
        assert page.faults == []
        assert len(page.requests) == 1
        page.context.close()


def played(name, traffic):
    """States [T, A, 5] (place, heading, velocity), presence [T, A] and figures [T, M] in Python."""
    env = EgoEnv(scenes=embedded_scenes()[name], config=world_config(traffic))
    env.reset(seed=0)
    states, there, figures = [], [], []

    def keep():
        now = env.worlds.native.states(0)
        parts = now["position"], now["heading"][:, None], now["velocity"]
        states.append(np.concatenate(parts, axis=1))
        there.append(now["active"])

    keep()
    for action in ACTIONS:
        _, _, terminated, truncated, _ = env.step(action)
        keep()
        figures.append(env.worlds.last.columns[0, 0].copy())
        if terminated or truncated:
            break
    return np.array(states), np.array(there), np.array(figures)


@pytest.mark.parametrize("traffic", TRAFFIC)
@pytest.mark.parametrize("name", NAMES)
def test_a_step_on_the_page_has_the_bits_of_a_step_in_python(visit, name, traffic):
    states, there, figures = played(name, traffic)
    page = visit(f"#scene={name}&traffic={traffic}")
    bits = page.evaluate(
        """actions => {
          const bits = (values) => [...new Uint32Array(new Float32Array(values).buffer)];
          const columns = () => bits(drive.settings.columns.map((name) => drive.info[name]));
          const all = [bits(drive.engine.states)], figures = [];
          for (const action of actions) {
            if (drive.outcome) break;
            drive.advance(action);
            all.push(bits(drive.engine.states));
            figures.push(columns());
          }
          return [all, figures];
        }""",
        ACTIONS.tolist(),
    )
    seen = np.array(bits[0], np.uint32).view(np.float32).reshape(len(bits[0]), -1, 7)
    assert len(seen) == len(states) > 10
    assert np.array_equal(seen[..., 5] > 0, there)
    assert np.array_equal(np.where(there[..., None], seen[..., :5], 0), states)
    assert np.array_equal(np.array(bits[1], np.uint32).view(np.float32), figures)
    assert np.ptp(states[:, 1:, :2], axis=0).max() > 1.0


def test_keys_drive_and_time_waits_for_the_first_one(visit):
    page = visit("#scene=cut-in-04&traffic=idm")
    page.frames(10)
    assert page.evaluate("drive.steps") == 0
    page.keyboard.down("w")
    page.until("drive.steps >= 3")
    page.keyboard.down("ArrowLeft")
    page.until("drive.steer === 1 || drive.outcome")
    page.keyboard.up("w")
    page.keyboard.up("ArrowLeft")
    page.keyboard.press("r")
    assert page.evaluate("[drive.steps, drive.going, drive.held.size]") == [0, False, 0]
    page.keyboard.press("n")
    page.until("drive.runs[0].title === 'pedestrians-00'")
    assert page.url.endswith("#scene=pedestrians-00&traffic=idm")
    page.keyboard.press("?")
    assert page.is_visible("#help")


def test_an_end_has_a_chip_and_says_why(visit):
    page = visit("#scene=cut-in-04&traffic=replay")
    page.keyboard.down("d")
    page.until("drive.outcome")
    text = page.evaluate("drive.outcome.text")
    assert page.inner_text("#outcome") == text == page.inner_text("#said")
    assert "left the road" in text or "hit" in text or "drove into" in text


def test_touch_drives(visit):
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    page = visit("#scene=cut-in-04", **phone)
    assert page.is_visible("[data-key=gas]")
    box = page.locator("[data-key=gas]").bounding_box()
    assert min(box["width"], box["height"]) >= 44
    page.dispatch_event("[data-key=gas]", "pointerdown")
    page.until("drive.steps >= 2")
    assert page.evaluate("drive.action()[0]") == 1
    page.dispatch_event("[data-key=gas]", "pointerup")
    assert page.evaluate("drive.held.size") == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_keeps_people_from_using_it(visit, axe, scheme):
    page = visit(color_scheme=scheme, bypass_csp=True)
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    page.evaluate(axe)
    found = page.evaluate("axe.run().then((r) => r.violations)")
    serious = [v["id"] for v in found if v["impact"] in ("serious", "critical")]
    assert serious == []


def test_what_the_world_refuses_is_said(visit):
    page = visit()
    said = page.evaluate(
        """() => {
          try { drive.engine.reset('{"traffic": "nobody"}'); }
          catch (error) { return error.message; }
        }"""
    )
    assert "nobody" in said
    assert page.evaluate("drive.engine.calls.load()") == 1
