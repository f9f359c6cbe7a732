"""The replay page in a real Chromium: clicked, dragged, typed at and looked at."""

from __future__ import annotations

import time

import pytest
from view_rollouts import planned_rollout

from ccdiff_env.view import address, log_rollout, write_page

pytestmark = pytest.mark.timeout(120)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Pages of a rollout with plans, and of it beside its log."""
    folder = tmp_path_factory.mktemp("pages")
    rollout = planned_rollout()
    write_page(rollout, folder / "one.html")
    log = log_rollout(rollout.scene, like=rollout)
    write_page(rollout, folder / "two.html", compare=log, titles=("run", "log"))
    return folder


class Page:
    """A page of the browser that notes what must not happen."""

    def __init__(self, browser, file, hash="", **options):
        self.context = browser.new_context(**{"viewport": {"width": 1280, "height": 800}} | options)
        self.page = self.context.new_page()
        self.faults, self.requests = [], []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on(
            "console", lambda m: m.type in ("error", "warning") and self.faults.append(m.text)
        )
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(file.as_uri() + hash)
        self.until("document.body.dataset.ready === 'yes'")
        self.frames()

    def frames(self, count=3):
        """Wait until some frames are drawn."""
        self.page.evaluate(
            """n => new Promise((done) => {
              const next = () => (n-- > 0 ? requestAnimationFrame(next) : done());
              next();
            })""",
            count,
        )

    def until(self, expression, seconds=20.0):
        """Wait until an expression holds. The page's own rules keep it from evaluating text."""
        end = time.monotonic() + seconds
        while not self.page.evaluate(expression):
            assert time.monotonic() < end, expression
            time.sleep(0.02)

    def __getattr__(self, name):
        return getattr(self.page, name)

    def time(self):
        return float(self.page.inner_text("#time"))

    def state(self, expression):
        self.frames()
        return self.page.evaluate(f"replay.{expression}")

    def picture(self):
        """Pixels of the first map as text; equal pictures give equal text."""
        self.frames()
        return self.page.evaluate("document.querySelector('.map').toDataURL()")

    def screen(self, agent_id, pane=0):
        """Where an agent is on the screen."""
        return self.page.evaluate(
            """([id, pane]) => {
              const { run, canvas, width, height } = replay.panes[pane];
              const pose = run.pose(run.indexOf.get(id), run.stepAt(replay.time));
              const [x, y] = replay.camera.toScreen(pose.x, pose.y, width, height);
              const box = canvas.getBoundingClientRect();
              return [box.left + x, box.top + y];
            }""",
            [agent_id, pane],
        )


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
        assert [url for url in page.requests if not url.startswith("file://")] == []
        assert len(page.requests) == 1
        page.context.close()


def test_play_runs_to_the_end_at_its_pace_and_begins_again(visit):
    page = visit("one.html")
    assert page.time() == 0.0
    page.select_option("#rate", "8")
    page.click("#play")
    page.until("!replay.playing")
    assert page.time() == pytest.approx(8.0)
    page.select_option("#rate", "0.25")
    page.click("#play")
    page.until("replay.time > 0.1 && replay.time < 6")
    page.click("#play")
    assert page.state("playing") is False
    assert 0.1 <= page.time() < 6.0


def test_time_passes_at_the_rate_that_is_chosen(visit):
    page = visit("one.html")
    passed = page.evaluate(
        """async () => {
          replay.rate = 2;
          replay.before = 1000;
          replay.playing = true;
          replay.frame(1050);
          const time = replay.time;
          replay.playing = false;
          return time - replay.start;
        }"""
    )
    assert passed == pytest.approx(0.1)


def test_an_address_opens_a_moment_and_an_agent(visit):
    second = planned_rollout().agent_ids[1]
    page = visit("one.html", hash="#" + address("", time_s=4.2, follow=second).partition("#")[2])
    assert page.time() == pytest.approx(4.2)
    assert page.state("follow") == second
    page.evaluate("location.hash = '#t=99&follow=nobody&show=graph,nothing'")
    page.until("replay.time === replay.end")
    assert page.state("follow") == second
    assert page.state("layers.graph") is True


def test_steps_and_the_time_line_move_the_cursor(visit):
    page = visit("one.html")
    page.click("#forward")
    page.click("#forward")
    page.click("#back")
    page.frames()
    assert page.time() == 0.1
    box = page.locator("#timeline").bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 10, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 2, middle, steps=4)
    page.mouse.up()
    page.frames()
    assert page.time() == pytest.approx(4.0, abs=0.1)
    before = page.picture()
    page.click("#forward")
    assert page.picture() != before


def test_the_page_shows_the_poses_of_the_rollout(visit):
    page = visit("one.html")
    rollout = planned_rollout()
    for agent, step in ((0, 0), (0, 37), (2, 80)):
        pose = page.evaluate("([a, t]) => replay.runs[0].pose(a, t)", [agent, step])
        assert pose["x"] == pytest.approx(rollout.position[agent, step, 0], abs=0.02)
        assert pose["y"] == pytest.approx(rollout.position[agent, step, 1], abs=0.02)
        assert pose["vx"] == pytest.approx(rollout.velocity[agent, step, 0], abs=0.02)
    plan = page.evaluate(
        "(({ step, agents, numSamples }) => [step, agents, numSamples])(replay.runs[0].planAt(12))"
    )
    assert plan == [10, [1, 2], 4]


@pytest.mark.parametrize("layer", ["trails", "plans", "graph", "labels", "lanes"])
def test_each_layer_has_a_button_that_changes_the_picture(visit, layer):
    page = visit("one.html")
    page.evaluate("replay.seek(3.25)")
    before, was = page.picture(), page.state(f"layers.{layer}")
    page.click(f"#layer-{layer}")
    assert page.state(f"layers.{layer}") is (not was)
    assert page.get_attribute(f"#layer-{layer}", "aria-pressed") == str(not was).lower()
    assert page.picture() != before
    page.click(f"#layer-{layer}")
    assert page.picture() == before


def test_keys_do_what_the_help_says(visit):
    page = visit("one.html")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    page.frames()
    assert page.time() == 1.1
    page.keyboard.press("End")
    page.frames()
    assert page.time() == 8.0
    page.keyboard.press("Home")
    page.keyboard.press("]")
    assert page.state("rate") == 2
    page.keyboard.press("g")
    assert page.state("layers.graph") is True
    page.keyboard.press(".")
    page.frames()
    assert page.time() == pytest.approx(3.0)
    page.keyboard.press("Tab")
    assert page.state("follow") == planned_rollout().agent_ids[1]
    page.keyboard.press("e")
    assert page.state("follow") == "ego"
    page.keyboard.press("h")
    assert page.state("headingUp") is True
    page.keyboard.press("f")
    assert page.state("follow") is None
    page.keyboard.press("Space")
    assert page.state("playing") is True
    page.keyboard.press("Space")
    theme = page.state("theme")
    page.keyboard.press("d")
    assert page.state("theme") != theme
    page.keyboard.press("?")
    assert page.is_visible("#help")
    page.keyboard.press("Escape")
    assert not page.is_visible("#help")
    page.keyboard.press("s")
    assert not page.is_visible("#side")


def test_following_keeps_an_agent_in_the_middle_and_dragging_lets_go(visit):
    page = visit("one.html")
    second = planned_rollout().agent_ids[1]
    page.select_option("#follow", second)
    page.evaluate("replay.seek(5)")
    page.frames()
    box = page.locator(".map").bounding_box()
    x, y = page.screen(second)
    assert x == pytest.approx(box["x"] + box["width"] / 2, abs=1)
    assert y == pytest.approx(box["y"] + box["height"] / 2, abs=1)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 80, y + 40, steps=4)
    page.mouse.up()
    page.frames()
    assert page.state("follow") is None
    moved = page.screen(second)
    assert moved[0] == pytest.approx(x + 80, abs=6)
    assert moved[1] == pytest.approx(y + 40, abs=6)


def test_the_wheel_zooms_and_the_point_under_it_stays(visit):
    page = visit("one.html")
    page.evaluate("replay.follow = null")
    x, y = page.screen("ego")
    page.mouse.move(x, y)
    scale = page.state("camera.scale")
    page.mouse.wheel(0, -300)
    page.until(f"replay.camera.scale > {scale}")
    assert page.screen("ego") == pytest.approx([x, y], abs=1)


def test_hovering_shows_facts_and_a_click_chooses_the_agent(visit):
    page = visit("one.html")
    second = planned_rollout().agent_ids[1]
    page.evaluate("id => { replay.followAgent('ego'); replay.seek(2); }", second)
    page.frames()
    x, y = page.screen(second)
    page.mouse.move(x, y)
    page.frames()
    assert page.is_visible("#tip")
    assert "CCDiff" in page.inner_text("#tip")
    assert "m/s" in page.inner_text("#tip")
    page.mouse.click(x, y)
    assert page.state("focus") == second
    assert second in page.inner_text("#facts")


def test_collisions_stand_on_the_time_line_and_in_its_tooltip(visit):
    page = visit("one.html")
    box = page.locator("#timeline").bounding_box()
    x = box["x"] + 10 + (box["width"] - 20) * 3.0 / 8.0
    page.mouse.move(x, box["y"] + 20)
    assert "collision front with" in page.get_attribute("#timeline", "title")
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


def test_figures_at_the_cursor_are_those_of_the_rollout(visit):
    page = visit("one.html")
    rollout = planned_rollout()
    page.evaluate("replay.seek(2)")
    page.frames()
    rows = page.locator(".figure").all_inner_texts()
    shown = {row.split("\n")[0].split(" m")[0]: row.split("\n")[-1] for row in rows}
    expected = rollout.figures["route_distance"][19]
    assert float(shown["route distance"]) == pytest.approx(expected, abs=0.01)


def test_the_matrix_holds_the_times_to_contact_of_the_core(visit):
    from ccdiff_env import causal

    page = visit("one.html")
    run = planned_rollout()
    step = 20
    seconds = causal.ttc(
        run.position[:, step],
        run.heading[:, step],
        (run.velocity[:, step] ** 2).sum(-1) ** 0.5,
        run.scene.sizes[:, :2],
        run.valid[:, step],
        normalised=False,
    )
    pairs = page.evaluate("replay.runs[0].pairs(20)")
    near = {(a, b) for a, b in zip(*(seconds <= 10.0).nonzero(), strict=True) if a < b}
    assert {(a, b) for a, b, _ in pairs} == near
    for a, b, ttc in pairs:
        assert ttc == pytest.approx(seconds[a, b], abs=0.03)


def test_two_runs_keep_step_and_share_the_view(visit):
    page = visit("two.html")
    assert page.locator(".pane").count() == 2
    assert page.locator(".pane-caption b").all_inner_texts() == ["run", "log"]
    page.keyboard.press("End")
    page.frames()
    steps = page.evaluate("replay.panes.map(p => p.run.stepAt(replay.time))")
    assert steps == [80, 80]
    before = page.picture()
    page.click("#layer-ghost")
    assert page.picture() != before
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
    assert min(box["width"], box["height"]) >= 36
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
