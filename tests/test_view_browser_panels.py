"""The replay page in a real Chromium: what stands beside the map, other pages, phones."""

from dataclasses import replace

import pytest
from array_scenes import rebuilt
from browser_page import Page
from test_view_outcome import behind_a_car
from view_rollouts import planned_rollout

from ccdiff_env.record.rollout import RolloutEvent
from ccdiff_env.view import log_rollout, write_page
from ccdiff_env.view.index import write_index

pytestmark = pytest.mark.timeout(120)


def test_collisions_stand_on_the_time_line(visit):
    page = visit("one.html")
    red = page.evaluate(
        """() => {
          const c = document.getElementById('timeline');
          const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
          const xs = [];
          for (let i = 0; i < d.length; i += 4)
            if (d[i] > 200 && d[i + 1] < 60 && d[i + 2] < 70) xs.push((i / 4) % c.width / c.width);
          return [Math.min(...xs), Math.max(...xs)];
        }"""
    )
    assert red[0] == pytest.approx(3.0 / 8.0, abs=0.03)
    assert red[1] < 0.45


def test_one_run_alone_is_spoken_of_alone(visit):
    page = visit("two.html")
    page.evaluate("replay.seek(2)")
    page.keyboard.press("2")
    page.frames()
    assert page.evaluate("replay.told.map((run) => run.title)") == ["log"]
    assert "drove" not in page.inner_text("#events")
    meets = page.evaluate("replay.runs[1].meeting(0, 20)?.[2] <= 4")
    assert ("on course" in page.inner_text("#captions")) == meets


def test_the_verdict_and_the_events_are_listed_and_a_click_goes_there(visit):
    page = visit("one.html")
    assert "ego drove into 1" in page.inner_text("#outcome .verdict")
    assert page.inner_text("#outcome .verdict").endswith(" m/s")
    assert page.inner_text("#outcome .fault") == page.inner_text(".event .fault") == "at fault"
    assert page.inner_text(".events-head") == "Ego: 1 event"
    events = page.locator(".event")
    assert events.count() == 1
    page.evaluate("replay.seek(7)")
    events.first.click()
    page.until("replay.playing && replay.time > replay.start + 1 && replay.time < replay.start + 3")


def test_every_control_is_reached_by_the_keyboard(visit):
    page = visit("two.html")
    wanted = set(
        page.evaluate(
            """() => [...document.querySelectorAll("#app :is(button, select, summary, canvas)")]
              .filter((node) => node.checkVisibility() && node.tabIndex === 0)
              .map((node, i) => (node.dataset.nth = i))"""
        )
    )
    seen = set()
    for _ in range(len(wanted) + 3):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("+(document.activeElement.dataset.nth ?? -1)"))
    assert wanted - seen == set()
    # a key presses the button that has the focus, and does nothing else
    page.focus("#layer-graph")
    page.keyboard.press("Space")
    assert page.state("layers.graph") is True
    assert page.state("playing") is False
    page.keyboard.press("t")
    assert page.state("layers.trails") is True


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("name", ["one.html", "two.html", "grid.html", "index.html"])
def test_axe_finds_nothing(browser, files, axe, name, theme):
    context = browser.new_context(color_scheme=theme, reduced_motion="reduce", bypass_csp=True)
    page = context.new_page()
    page.goto((files / name).as_uri())
    if name != "index.html":
        page.wait_for_function("document.body.dataset.ready === 'yes'")
    assert axe(page) == []
    context.close()


def test_colours_that_are_forced_and_prints_keep_what_colours_say(visit):
    page = visit("two.html", color_scheme="dark", forced_colors="active")
    style = "getComputedStyle(document.querySelector({!r})).{}"
    assert page.evaluate(style.format(".legend-item i", "forcedColorAdjust")) == "none"
    assert page.evaluate(style.format("#layer-plans[aria-pressed=true]", "outlineWidth")) == "3px"
    for event, theme in (("beforeprint", "light"), ("afterprint", "dark")):
        page.evaluate(f"dispatchEvent(new Event({event!r}))")
        assert page.state("theme") == theme


def test_menus_of_an_index_choose_replays(browser, tmp_path):
    run, late = planned_rollout(), (RolloutEvent(60, "ego", None, "goal"),)
    fates = [run, replace(run, events=late)] * 4
    index = write_index([(f"r{i}", ["r"], [of]) for i, of in enumerate(fates)], tmp_path, "all")
    page = browser.new_page()
    page.goto(index.as_uri())
    (menu,) = page.locator(".above select").all()  # all else is the same for all
    for wanted, names in (("is unharmed", "1357"), ("drives into somebody", "0246")):
        menu.select_option(wanted)
        heads = page.locator(".card:visible h2").all_inner_texts()
        assert heads == [f"r{n} · {run.scene.name}" for n in names]
    menu.select_option("")
    assert page.locator(".card:visible").count() == 8
    page.close()


def test_two_runs_keep_step_and_share_the_view(visit):
    page = visit("two.html")
    assert page.locator(".pane").count() == 2
    assert page.locator(".pane-caption b").all_inner_texts() == ["run", "log"]
    assert page.locator(".pane-caption .badge").all_inner_texts() == ["A", "B"]
    page.keyboard.press("End")
    page.frames()
    steps = page.evaluate("replay.panes.map(p => p.run.stepAt(replay.time))")
    assert steps == [80, 80]
    first, second = page.locator(".map").all()
    a, b = first.bounding_box(), second.bounding_box()
    assert a["y"] == b["y"]
    assert b["x"] > a["x"] + 300


def test_a_phone_has_room_for_everything(visit):
    page = visit("two.html", viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    width = page.evaluate("document.documentElement.scrollWidth")
    assert width == 390
    first, second = page.locator(".map").all()
    assert second.bounding_box()["y"] > first.bounding_box()["y"] + 200
    page.tap("#play")
    page.until("replay.time > replay.start + 0.1")
    box = page.locator("#play").bounding_box()
    assert box["y"] + box["height"] <= 844
    sizes = page.evaluate(  # at once: the lists change while it plays
        """() => [...document.querySelectorAll("#app button, #app select")]
          .filter((control) => control.checkVisibility())
          .map((control) => [control.offsetWidth, control.offsetHeight, control.innerText])"""
    )
    assert len(sizes) > 10
    assert [size for size in sizes if min(size[:2]) < 44] == []
    page.evaluate("window.scrollTo(0, document.documentElement.scrollHeight)")
    page.frames()
    box = page.locator("#play").bounding_box()  # still there while one reads the panels
    assert box["y"] >= 0
    assert box["y"] + box["height"] <= 844
    page.tap("#help-button")
    assert page.is_visible("#help")


def test_two_fingers_zoom(visit):
    page = visit("one.html", viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    session = page.context.new_cdp_session(page.page)
    scale = page.state("camera.scale")

    def touch(kind, *points):
        session.send(
            "Input.dispatchTouchEvent",
            {
                "type": kind,
                "touchPoints": [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)],
            },
        )

    touch("touchStart", (180, 300), (210, 300))
    for gap in (30, 60, 90):
        touch("touchMove", (180 - gap, 300), (210 + gap, 300))
    touch("touchEnd")
    assert page.state("camera.scale") > 2 * scale


def boxes(page):
    """Places of the panes that are seen: left, top, width, height."""
    found = [pane.bounding_box() for pane in page.locator(".pane").all() if pane.is_visible()]
    return [(b["x"], b["y"], b["width"], b["height"]) for b in found]


def test_a_grid_has_one_clock_and_a_run_can_have_it_alone(visit):
    page = visit("grid.html")
    tiles = boxes(page)
    assert len(tiles) == 5
    assert len({x for x, *_ in tiles}) == 3
    assert len({y for _, y, *_ in tiles}) == 2
    assert all("ego drove into 1" in page.locator(".pane").nth(i).inner_text() for i in (0, 2, 4))
    blank = page.evaluate("document.createElement('canvas').toDataURL()")
    maps = "[...document.querySelectorAll('.map')].map((map) => map.toDataURL())"
    before = page.evaluate(maps)
    page.click("#forward")
    page.frames()
    after = page.evaluate(maps)
    assert all(one not in (two, blank) for one, two in zip(after, before, strict=True))
    page.click(".pane:nth-child(3) .enlarge")
    page.frames()
    ((_, _, width, height),) = boxes(page)
    assert width > 2.5 * tiles[0][2]
    assert height > 1.9 * tiles[0][3]
    page.until("location.hash.includes('run=3')")
    assert len(boxes(visit("grid.html", hash="#t=0&run=3"))) == 1
    page.keyboard.press("3")
    page.frames()
    assert boxes(page) == tiles
    page.keyboard.press("2")
    page.keyboard.press("0")
    page.frames()
    assert boxes(page) == tiles


def test_a_map_without_lanes_says_so(browser, visit, tmp_path):
    scene = planned_rollout().scene
    bare = rebuilt(scene, map_layers={"drivable_area": scene.map_layers()["drivable_area"]})
    write_page(log_rollout(bare), tmp_path / "bare.html")
    page = Page(browser, tmp_path / "bare.html")
    assert page.inner_text(".pane-note") == "This map has no lanes."
    page.context.close()
    assert visit("one.html").locator(".pane-note").count() == 0


def test_a_slider_chooses_the_run_that_is_seen_and_told(browser, tmp_path):
    run = planned_rollout()
    late = (RolloutEvent(60, "ego", None, "goal"),)
    runs = [replace(run, events=late), behind_a_car()]
    write_page(run, tmp_path / "s.html", compare=runs, titles=tuple("012"), slider=True)
    page = Page(browser, tmp_path / "s.html", "#t=3.5")
    assert page.locator(".map:visible").count() == 1
    assert "ego drove into 1" in page.inner_text("#events")
    page.focus("#choice input")
    page.keyboard.press("ArrowRight")
    page.frames()
    assert page.state("alone") == 1
    assert page.inner_text("#choice output") == "1"
    assert page.inner_text("#events").count("ego reached its goal") == 1
    assert "drove" not in page.inner_text("#events")
    assert page.time() == pytest.approx(3.5)
    page.until("location.hash.includes('run=2')")
    page.locator(".map:visible").focus()
    page.keyboard.press("0")
    page.keyboard.press("3")
    assert page.state("alone") == 2
    assert page.input_value("#choice input") == "2"
    # what became of each stop is below the track
    assert page.evaluate("[...document.querySelectorAll('.dots i')].map((i) => i.className)") == [
        "bad", "good", "blocked",
    ]  # fmt: skip
    assert page.inner_text("#captions").count("driven by") == 1
    assert page.faults == []


def test_a_run_that_has_ended_says_so(browser, tmp_path):
    run = planned_rollout()
    tracks = {name: values[:, :41] for name, values in run.tracks().items()}
    ended = replace(run, **tracks, info={}, plans=(), events=())
    write_page(run, tmp_path / "two.html", compare=[ended])
    page = Page(browser, tmp_path / "two.html", "#t=3.9")
    assert "ended" not in page.inner_text("#captions")
    page.evaluate("replay.seek(replay.start + 6)")
    page.frames()
    assert page.inner_text("#captions").count("ended at 4.0 s") == 1
    page.context.close()


def test_a_tall_map_has_the_ego_heading_up_and_an_address_says_otherwise(visit):
    tall = {"viewport": {"width": 390, "height": 844}}
    assert visit("two.html", viewport={"width": 900, "height": 1000}).state("headingUp") is True
    assert visit("one.html", hash="#t=0&up=north", **tall).state("headingUp") is False
    assert visit("one.html").state("headingUp") is False
