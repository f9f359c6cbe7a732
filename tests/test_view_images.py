"""Rollouts in images, words and notebooks: colours, names, marks, the fate of the ego."""

import base64
import html
import io
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser_page import Page
from test_view import elements, shown_events, unpacked
from view_rollouts import NUM_STEPS, planned_rollout

from ccdiff_env import _native
from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.scenes import with_tracks
from ccdiff_env.view import log_rollout, page_html, render, write_page
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.video import Video

#: Calls of a canvas by what they paint: colour, how opaque, and whether a line or a surface.
WATCH = """() => {
  const seen = window.seen = {}, canvas = CanvasRenderingContext2D.prototype;
  const hex = (c) => c.slice(0, 7);
  for (const kind of ["fill", "stroke"]) {
    const paint = canvas[kind];
    canvas[kind] = function (...given) {
      if (this.canvas.className === "map") {
        const key = `${kind} ${hex(this[`${kind}Style`])} ${this.globalAlpha.toFixed(2)}`;
        seen[key] = (seen[key] || 0) + 1;
      }
      return paint.apply(this, given);
    };
  }
}"""


@pytest.mark.parametrize("theme", render.THEMES)
@pytest.mark.parametrize("step", [20, 30])
def test_a_moment_has_the_same_marks_on_the_page_and_in_pictures(browser, tmp_path, theme, step):
    """Bodies by driver, hollow ones, red outlines and rings, and every colour of the map."""
    run = planned_rollout("queue-01")
    write_page(run, tmp_path / "page.html")
    page = Page(browser, tmp_path / "page.html", "#t=0&up=north", color_scheme=theme)
    page.evaluate("Object.assign(replay.layers, { labels: false, plans: false, trails: false })")
    page.evaluate("replay.followAgent(null); replay.choose(null)")
    page.evaluate(WATCH)
    page.evaluate(f"replay.fit(); replay.camera.scale = 1.5; replay.seek({step / 10})")
    page.frames()
    page.evaluate("for (const key in seen) delete seen[key]; replay.touch()")
    page.frames(1)
    seen = page.evaluate("seen")
    x, y = page.evaluate("[replay.camera.x, replay.camera.y]")
    road = "#{:02x}{:02x}{:02x}".format(*render.legend(theme)["drivable area"])
    frames = seen[f"fill {road} 1.00"]
    page.context.close()
    video = Video(run, size=(1200, 800), span_m=800.0, centre_m=(x, y), captions=False, theme=theme)
    paths = re.findall(r'(fill|stroke)="(#[0-9a-f]{6})".*?(?:fill|stroke)-opacity="([0-9.]+)"',
                       video.svg(step))  # fmt: skip
    drawn = Counter(f"{kind} {colour} {float(alpha):.2f}" for kind, colour, alpha in paths)
    legend = render.legend(theme)
    drivers = ("ego", "ccdiff", "adversary", "replay", "static obstacle")
    alphas = (1.0, render.LOOK["PARKED_ALPHA"])
    for driver, alpha in ((d, a) for d in drivers for a in alphas):
        key = f"fill #{{:02x}}{{:02x}}{{:02x}} {alpha:.2f}".format(*legend[driver])
        assert seen.get(key, 0) == frames * drawn.get(key, 0), (driver, alpha)
    red = "stroke #{:02x}{:02x}{:02x} 1.00".format(*legend["collision"])
    assert seen.get(red, 0) == frames * drawn.get(red, 0) == frames * (3 if step == 30 else 0)
    for layer in ("drivable area", "kerb", "walkway", "car park", "crossing", "stop area",
                  "lane divider", "road divider", "centre line"):  # fmt: skip
        colour = "#{:02x}{:02x}{:02x}".format(*legend[layer])
        there = any(colour in key for key in drawn)
        assert not there or any(colour in key for key in seen), layer
    # surfaces come in the same order: nothing is painted over the road that vehicles drive on
    surfaces = ("walkway", "drivable area", "car park", "stop area")
    colours = ["#{:02x}{:02x}{:02x}".format(*legend[layer]) for layer in surfaces]
    fills = [[key.split()[1] for key in keys if key.startswith("fill")] for keys in (seen, drawn)]
    on_page, in_picture = ([c for c in dict.fromkeys(keys) if c in colours] for keys in fills)
    assert on_page == in_picture
    assert on_page.index(colours[0]) < on_page.index(colours[1])


def test_an_image_says_whom_it_shows_and_what_colours_mean_unless_captions_are_off():
    run = planned_rollout()
    options = {"size": (400, 400), "span_m": 40.0}
    for theme in render.THEMES:
        plain = Video(run, captions=False, theme=theme, **options).frame(20)
        said = Video(run, theme=theme, **options).frame(20)
        legend = render.legend(theme)
        assert tuple(plain[200, 200]) == legend["ego"]
        # the legend: rows of the ego, the network, guided and logged ones, in the corner
        changed = (plain != said).any(-1)[-90:, -120:]
        corner = said[-90:, -120:][changed]
        for driver in ("ego", "ccdiff", "adversary", "replay"):
            assert (corner == legend[driver]).all(-1).any(), driver
        assert not (corner == legend["idm"]).all(-1).any()
        # names: something is written above the ego
        assert (plain != said).any(-1)[170:192, 185:215].any()


def test_images_of_few_colours_keep_those_of_the_legend(tmp_path):
    from PIL import Image

    drawn = Video(planned_rollout(), size=(480, 300), captions=False).frame(20)
    legend = {name: (drawn == rgb).all(-1).any() for name, rgb in render.legend().items()}
    assert legend["ego"]
    assert legend["ccdiff"]
    data = base64.b64decode(render.data_address(drawn).partition(",")[2])
    render.save_gif(np.stack([drawn, drawn]), tmp_path / "two.gif", 10.0)
    for file in (io.BytesIO(data), tmp_path / "two.gif"):
        with Image.open(file) as image:
            colours = np.array([rgb for _, rgb in image.convert("RGB").getcolors(256)])
        for name in (name for name, there in legend.items() if there):
            off = np.abs(colours - render.legend()[name]).max(axis=1).min()
            assert off <= 3, (name, off)


def test_a_collision_is_marked_half_way_between_those_that_met():
    run = planned_rollout()
    x, y = run.position[:2, 30].mean(axis=0).tolist()
    video = Video(run, size=(400, 400), span_m=40.0, centre_m=(x, y), captions=False)
    red = np.array(render.legend()["collision"])
    # a ring of three metres and six pixels: 36 pixels from the middle
    rows, columns = np.mgrid[:400, :400] - 199.5
    ring = np.abs(np.hypot(rows, columns) - 36.0) < 0.7
    share = [np.abs(video.frame(step).astype(int) - red).max(-1)[ring] < 40 for step in (29, 30)]
    assert share[0].mean() < 0.05
    assert share[1].mean() > 0.7


def test_the_caption_has_the_verdict_from_the_contact_on(monkeypatch):
    run, seen = planned_rollout(), {}
    monkeypatch.setattr(_native, "render_arrays", lambda *_, **options: seen.update(options))
    Video(run, title="other").frame(run.num_steps - 1)
    assert seen["caption"].startswith("other  8.0 s  ego drove into 1")
    Video(run).frame(29)
    assert seen["caption"] == "left-turn-00  2.9 s"


def test_an_ego_at_its_goal_is_drawn_where_it_left_the_scene(monkeypatch):
    run = planned_rollout()
    valid = run.valid.copy()
    valid[0, 40:] = False
    arrived = replace(run, valid=valid, events=(RolloutEvent(40, "ego", None, "goal"),))
    seen = {}
    monkeypatch.setattr(_native, "render_arrays", lambda at, *_, **__: seen.update(at=at))
    Video(arrived).frame(40)
    np.testing.assert_allclose(seen["at"][0], run.position[0, 39])
    Video(replace(arrived, events=())).frame(40)
    assert len(seen["at"]) == valid[:, 40].sum()


def test_agents_that_are_absent_now_are_not_drawn(tmp_path):
    run = planned_rollout()
    valid = run.valid.copy()
    valid[1, 40:] = False
    gone = Rollout(**{f: getattr(run, f) for f in run.__dataclass_fields__} | {"valid": valid})
    _, arrays = unpacked(elements(page_html(gone))[0])
    assert arrays["valid"][1, 40:].max() == 0
    assert np.ptp(arrays["x"][1, 39:]) == 0.0
    video = Video(gone, follow=run.agent_ids[1], size=(200, 200), span_m=40.0)
    colour = render.legend()["ccdiff"]
    seen = [bool((video.frame(step) == colour).all(-1)[100, 100]) for step in (39, 41)]
    assert seen == [True, False]


def test_whoever_follows_the_log_into_what_stands_is_no_deed_of_traffic():
    run = planned_rollout()
    kinds, ids = run.scene.agent_types, run.agent_ids
    walker = next(i for i, kind in enumerate(kinds) if kind != "static" and i > 2)
    stands = run.velocity.copy()
    stands[2, 19] = 0.0
    events = (RolloutEvent(20, ids[walker], ids[2], "collision_front"),)
    for velocity, expected in ((run.velocity, ["guided"]), (stands, [])):
        shown = shown_events(replace(run, velocity=velocity, events=events))
        assert [event["lane"] for event in shown] == expected
    assert outcome(replace(run, velocity=stands, events=events)).others == 0


def test_an_ego_that_waits_as_its_log_does_is_not_late():
    run = planned_rollout()
    tracks = {name: values.copy() for name, values in run.scene.tracks().items()}
    tracks["position"][0] = tracks["position"][0, :1]
    waiting = replace(
        run,
        scene=with_tracks(run.scene, tracks),
        position=np.concatenate([tracks["position"][:1, :NUM_STEPS], run.position[1:]]),
        events=(RolloutEvent(NUM_STEPS - 1, "ego", None, "time_limit"),),
    )
    assert outcome(waiting).text == "ego waited, as in its log"
    assert shown_events(waiting)[0]["text"] == "ego waited, as in its log"


@pytest.mark.parametrize(
    ("kinds", "tone", "text"),
    [
        ([(80, "time_limit")], "plain", "ego on its way"),
        ([], "plain", "ego drove 8.0 s, hit nobody"),
        ([(13, "off_road"), (40, "goal")], "bad", "ego left the road at 1.3 s, reached its goal"),
        (
            [(13, "goal"), (40, "off_road")],
            "bad",
            "ego reached its goal at 1.3 s, then left the road at 4.0 s",
        ),
    ],
)
def test_the_outcome_says_what_became_of_the_ego(kinds, tone, text):
    events = tuple(RolloutEvent(step, "ego", None, kind) for step, kind in kinds)
    found = outcome(replace(planned_rollout(), events=events))
    assert (found.tone, found.text, found.others) == (tone, text, 0)


def test_a_collision_of_the_ego_is_told_apart_from_those_of_others():
    run = planned_rollout()
    ids = run.agent_ids
    events = (
        RolloutEvent(9, ids[1], ids[2], "collision_front"),
        RolloutEvent(9, ids[2], ids[1], "collision_rear"),
        RolloutEvent(50, "ego", ids[2], "collision_rear", False),
    )
    found = outcome(replace(run, events=events))
    assert re.fullmatch(r"ego hit from behind by 2 \(\w+\) at 5.0 s, [\d.]+ m/s", found.text)
    assert (found.tone, found.others, found.opening_s) == ("bad", 1, pytest.approx(3.0))
    assert found.line == f"{found.text} · not at fault · others: 1 collision"
    assert outcome(log_rollout(run.scene)).text == "as recorded"


def test_a_rollout_is_its_page_in_a_frame_without_rights():
    text = planned_rollout()._repr_html_()
    head = r'<iframe sandbox="allow-scripts" title="[^"]*" style="[^"]*" '
    found = re.fullmatch(head + r'srcdoc="([^"]*)"></iframe>', text)
    assert html.unescape(found[1]) == page_html(planned_rollout())
    assert repr(planned_rollout()).startswith("Rollout(left-turn-00, 81 steps of 0.1 s")
    assert len(repr(planned_rollout())) < 120


def test_the_frame_shows_a_canvas(browser, tmp_path):
    (tmp_path / "note.html").write_text(planned_rollout()._repr_html_(), encoding="utf-8")
    page = browser.new_page(reduced_motion="reduce")
    faults = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto((tmp_path / "note.html").as_uri())
    frame = page.frame_locator("iframe")
    frame.locator("body[data-ready=yes]").wait_for()
    assert frame.locator("canvas.map").bounding_box()["width"] > 300
    frame.locator("#layer-graph").click()
    page.wait_for_timeout(700)  # the address that it may not change
    assert faults == []
    page.close()


NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "examples/notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_is_kept_without_outputs(path, tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    monkeypatch.setenv("PYTHONPATH", str(path.parents[2]))
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert not cell.outputs
            assert cell.execution_count is None
            # smaller where a line says so: "STEPS = 300_000  # in tests: 2048"
            cell.source = re.sub(r"= [\d_]+  # in tests: (\d+)", r"= \1", cell.source)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(
        notebook, timeout=280, kernel_name="python3", resources=resources
    ).execute()
    assert any(cell.get("outputs") for cell in notebook.cells)
