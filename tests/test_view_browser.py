"""The replay page in a real Chromium: clicked, dragged, typed at and looked at."""

import numpy as np
import pytest
from view_rollouts import planned_rollout

from ccdiff_env import embedded_scenes
from ccdiff_env.view import address, write_page
from ccdiff_env.view.sources import play_scene

pytestmark = pytest.mark.timeout(120)


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


def test_a_page_plays_from_two_seconds_before_the_collision(visit):
    page = visit("one.html", hash="", reduced_motion="no-preference")
    assert 1.0 <= page.time() < 3.0
    assert page.state("playing") is True
    page.until("replay.time > replay.start + 1.1")


def test_the_address_follows_what_is_shown_and_opens_it_again(visit):
    page = visit("one.html")
    page.click("#layer-graph")
    page.click("#layer-trails")
    page.keyboard.press("f")
    page.evaluate("replay.seek(3.3)")
    page.until("location.hash.includes('t=3.3')")
    again = visit("one.html", hash=page.evaluate("location.hash"))
    assert again.time() == pytest.approx(3.3)
    assert again.state("layers.graph") is True
    assert again.state("layers.trails") is False

    second = planned_rollout().agent_ids[1]
    page = visit("one.html", hash="#" + address("", time_s=4.2, follow=second).partition("#")[2])
    assert page.time() == pytest.approx(4.2)
    assert page.state("follow") == second
    page.evaluate("location.hash = '#t=99&follow=nobody&show=graph,nothing'")
    page.until("replay.time === replay.end")
    assert page.state("follow") == second
    assert page.state("layers.graph") is True
    page.evaluate("location.hash = '#follow=2'")
    page.until(f"replay.follow === {planned_rollout().agent_ids[2]!r}")


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
    before = page.image()
    page.click("#forward")
    assert page.image() != before


@pytest.mark.parametrize("layer", ["trails", "plans", "graph", "labels", "lanes"])
def test_each_layer_has_a_button_that_changes_the_image(visit, layer):
    page = visit("one.html")
    page.evaluate("replay.seek(3.25)")
    before, was = page.image(), page.state(f"layers.{layer}")
    page.click(f"#layer-{layer}")
    assert page.state(f"layers.{layer}") is (not was)
    assert page.get_attribute(f"#layer-{layer}", "aria-pressed") == str(not was).lower()
    assert page.image() != before
    page.click(f"#layer-{layer}")
    assert page.image() == before


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
    page.keyboard.press("g")
    assert page.state("layers.graph") is True
    page.select_option("#follow", planned_rollout().agent_ids[1])
    page.evaluate("document.activeElement.blur()")
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
    page.frames()
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


def test_a_click_chooses_the_agent_and_shows_its_captions(visit):
    page = visit("one.html")
    second = planned_rollout().agent_ids[1]
    page.evaluate("replay.seek(2)")
    page.frames()
    page.mouse.click(*page.screen(second))
    assert page.state("focus") == second
    captions = page.inner_text("#captions")
    assert captions.startswith("1 · car")
    assert "CCDiff" in captions
    assert "m/s" in captions


def test_stop_lines_have_the_colour_of_their_light(visit, files):
    run = play_scene(embedded_scenes("city-lights")["tee-crossing-005"], driver="pdm")
    write_page(run, files / "lit.html")
    page = visit("lit.html")
    found = page.lights("replay", "replay.seek(replay.start + {})", run.scene, run.start_step)
    states, drawn = zip(*found, strict=True)
    assert set(states) == {"green", "yellow", "red"}
    assert np.mean(drawn) > 0.9  # others are below road users


def test_the_scale_bar_covers_no_name(visit):
    page = visit("one.html", viewport={"width": 390, "height": 844})
    said = page.texts("replay.panes[0].draw(replay)")
    assert said[0].endswith(" m")
    assert "ego" in said[1:]
