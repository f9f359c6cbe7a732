"""The playground in a real Chromium: its worlds are those of the package."""

import functools
import re
import shutil

import numpy as np
import pytest
from PIL import Image

from ccdiff_env import cli
from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.view import play
from ccdiff_env.view.captions import driver_of, guided_agents, still
from ccdiff_env.view.link import play_drive, play_keys, read_drive, top_speed_mps, world_config
from ccdiff_env.view.outcome import outcome
from ccdiff_env.view.play import SCENES, playground_html
from tools.playground import compiled, deciding, target_is_installed

pytestmark = pytest.mark.timeout(600)
NAMES = ("cut-in-04", "pedestrians-00", "left-turn-03", "pedestrians-02")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    if shutil.which("cargo") is None or not target_is_installed():
        pytest.skip("no compiler for WebAssembly: rustup target add wasm32-unknown-unknown")
    folder = tmp_path_factory.mktemp("playground")
    scenes = [embedded_scenes()[name] for name in NAMES]
    (folder / "drive.html").write_text(playground_html(compiled(), scenes), encoding="utf-8")
    return folder


@pytest.fixture
def playground(visit):
    """Open the playground."""
    return functools.partial(visit, "drive.html")


@pytest.mark.parametrize("name", SCENES)
def test_criticality_decides_for_who_only_steers(name):
    (found,) = deciding([embedded_scenes()[name]])
    assert found[1].text


@pytest.mark.parametrize("keys", [[], [0] * 150], ids=["steers along the way", "touches no key"])
def test_the_first_drive_meets_an_attacker_who_is_to_blame(keys):
    scene = embedded_scenes()[SCENES[0]]
    rolled = play_keys(scene, keys, world_config("ccdiff", 1.0), goes_on=True)
    assert rolled.collisions("ego")[0].partner_id in guided_agents(rolled)
    assert outcome(rolled).fault == "not at fault"
    keys = keys[: rolled.position.shape[1] - 1]  # then along the way, as the page says
    assert outcome(play_keys(scene, keys, world_config("ccdiff"), goes_on=True)).tone == "good"


def test_a_car_without_pedals_has_the_speed_of_its_log_at_each_place():
    scene = embedded_scenes()["double-left-01"]
    rolled = play_keys(scene, (), world_config("replay"), goes_on=True)
    ego, log = scene.agent_ids.index("ego"), scene.tracks()
    place, way = rolled.position[ego, 20:-1], log["position"][ego]
    nearest = np.linalg.norm(place[:, None] - way[None], axis=-1)
    assert nearest.min(axis=1).max() < 1.5
    logged = np.linalg.norm(log["velocity"][ego, nearest.argmin(axis=1)], axis=-1).clip(2.0)
    assert np.abs(np.linalg.norm(rolled.velocity[ego, 20:-1], axis=-1) - logged).max() < 1.5


def test_guided_vehicles_are_orange_and_in_the_legend_as_in_a_replay(playground):
    page = playground(hash="#scene=cut-in-04&traffic=ccdiff&criticality=2&drive=b3f2a4j2a30")
    page.until("(drive.steps > 0 && !drive.going && !drive.asked) || drive.outcome", 60)
    page.frames()
    drivers = page.evaluate("drive.runs[0].agents.map((agent) => agent.driver)")
    rollout = play_drive(page.evaluate("drive.link"))
    there = [driver_of(rollout, i) for i in range(len(drivers))]
    kinds = rollout.scene.agent_types
    assert [d for d, k in zip(drivers, kinds, strict=True) if k == "vehicle"] == [
        d for d, k in zip(there, kinds, strict=True) if k == "vehicle"
    ]
    assert "adversary" in drivers
    assert "guided" in page.inner_text("#legend")


def test_nobody_is_faster_than_the_cap_and_the_end_is_shown_again_slowly(playground):
    page = playground(
        hash="#scene=cut-in-04&traffic=replay&drive=b150", reduced_motion="no-preference"
    )
    page.until("drive.outcome", 60)
    top = top_speed_mps(embedded_scenes()["cut-in-04"])
    fastest = page.evaluate("Math.max(...drive.runs[0].a.vx.slice(0, drive.steps).map(Math.abs))")
    assert fastest < top + 0.5
    page.until("drive.time < drive.ended - 0.6")
    assert page.evaluate("drive.time >= drive.ended - 2.01")


def test_keys_drive_and_time_waits_for_the_first_one(playground):
    page = playground(hash="#scene=cut-in-04&traffic=idm")
    page.frames(10)
    assert page.evaluate("drive.steps") == 0
    page.keyboard.down("w")
    page.until("drive.steps >= 3")
    page.keyboard.down("ArrowLeft")
    page.until("drive.keys.at(-1) === 5 || drive.outcome")
    page.keyboard.up("w")
    page.keyboard.up("ArrowLeft")
    page.keyboard.press("r")
    page.until("drive.steps === 0")
    assert page.evaluate("[drive.steps, drive.going, drive.held.size]") == [0, False, 0]
    page.keyboard.press("n")
    page.until("drive.runs[0].title === 'pedestrians-00' && location.hash.includes('pedestrians')")
    assert page.url.endswith("#scene=pedestrians-00&traffic=idm")
    page.keyboard.press("?")
    assert page.is_visible("#help")


def test_a_car_that_nobody_drives_rolls_off(playground):
    page = playground(hash="#scene=cut-in-04&traffic=idm", reduced_motion="no-preference")
    page.until("drive.steps >= 3", 30)
    assert page.evaluate("drive.keys.every((held) => held === 0)")


def test_a_drive_of_a_scene_that_the_page_has_not_is_played_in_no_other_one(playground):
    page = playground(hash="#scene=queue-00&traffic=idm&drive=b150")
    said = "no scene queue-00 on this page: give the link to ccdiff-env view"
    assert page.inner_text("#outcome") == said
    page.frames(10)
    assert page.evaluate("[drive.steps, drive.going, drive.script]") == [0, False, None]


def test_the_end_shows_why_and_what_the_same_keys_do_at_criticality_0(playground):
    page = playground(hash="#scene=cut-in-04&traffic=ccdiff&criticality=1&drive=a150")
    page.until("drive.calm && drive.outcome && drive.result", 90)
    assert re.search(r"Trained ego: (?!still driving)", page.inner_text("#card"))
    link = page.evaluate("drive.link")
    drive, rollout = read_drive(link), play_drive(link)
    calm = outcome(
        play_keys(rollout.scene, drive.keys, world_config(drive.traffic, 0.0), goes_on=True)
    )
    said = page.inner_text("#calm")
    assert said.endswith(calm.text.removeprefix("ego ").replace("its", "your"))
    assert said.startswith("At criticality 0, the same keys")
    with page.expect_download() as found:  # the drive's own picture
        page.click("#picture")
    assert found.value.suggested_filename == "cut-in-04.png"
    with Image.open(found.value.path()) as image:
        assert image.size == (1280, int(page.locator(".map").bounding_box()["height"]) + 60)
    # the plan of whom it met, as the world has it
    partner = rollout.agent_ids.index(rollout.collisions("ego")[0].partner_id)
    plans = [p for p in rollout.plans if partner in p.agents]
    shown = page.evaluate("drive.runs[0].plans.map((p) => [p.agents, [...p.x], p.guided, p.edges])")
    assert plans
    for plan, (agents, x, guided, edges) in zip(plans, shown, strict=True):
        row = list(plan.agents).index(partner)
        assert (agents, guided) == ([partner], [plan.guided[row]])
        assert np.array_equal(np.float32(x[1:]), plan.samples[plan.selected_sample[row], row, :, 0])
        into = plan.graph[list(plan.agents).index(0), row] if 0 in plan.agents else False
        assert edges == [[partner, 0]] * bool(into)


def test_goals_stay(playground):
    page = playground(hash="#scene=pedestrians-00&traffic=replay&drive=a150")
    page.until("drive.outcome", 60)
    assert page.evaluate("drive.outcome.tone") == "good"
    seconds = page.evaluate("(drive.steps * 0.1).toFixed(1)")
    page.keyboard.press("r")
    page.until("drive.steps === 0 && !drive.outcome")
    page.frames()
    assert f"1 goal · your best here {seconds} s" in page.inner_text("#figures")
    kept = page.evaluate("JSON.parse(localStorage.getItem('ccdiff-env goals'))")
    assert [*kept] == ["scene=pedestrians-00&traffic=replay"]


def test_an_ego_at_its_goal_stays_to_be_seen(playground):
    page = playground(hash="#scene=pedestrians-00&traffic=replay&drive=c10a30b110")
    page.until("drive.outcome", 60)
    assert page.inner_text("#verdict").startswith("ego reached its goal")
    assert page.evaluate("drive.runs[0].pose(0, drive.steps) !== null")
    page.keyboard.press("r")
    page.until("drive.steps === 0")
    assert page.evaluate("drive.runs[0].arrived(0, 149)") is False


def test_touch_drives(playground):
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    page = playground(hash="#scene=cut-in-04", **phone)
    assert page.is_visible("[data-key=gas]")
    box = page.locator("[data-key=gas]").bounding_box()
    assert min(box["width"], box["height"]) >= 44
    page.dispatch_event("[data-key=gas]", "pointerdown")
    page.until("drive.steps >= 2")
    assert page.evaluate("drive.mask") == 1
    page.dispatch_event("[data-key=gas]", "pointerup")
    assert page.evaluate("drive.held.size") == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_keeps_people_from_using_it(playground, axe, scheme):
    page = playground(color_scheme=scheme, bypass_csp=True)
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    assert axe(page) == []


def test_what_the_world_refuses_is_said(playground):
    page = playground()
    said = page.evaluate(
        """() => drive.engine.ask("reset", '{"traffic": "nobody"}').catch((e) => e.message)"""
    )
    assert "nobody" in said
    assert page.evaluate("drive.engine.ask('load', new Uint8Array(3)).catch((e) => e.message)")


@pytest.mark.parametrize(
    ("hash", "least"),
    [
        ("scene=cut-in-04&traffic=ccdiff&criticality=0&drive=c8b5a40", 5),
        ("scene=cut-in-04&traffic=ccdiff&criticality=2&drive=b3f2a4j2a30", 5),
        ("scene=pedestrians-00&traffic=ccdiff&criticality=1&drive=b10a20", 5),
        ("scene=pedestrians-00&traffic=idm&drive=b10e3i3a20c12", 10),
        ("scene=cut-in-04&traffic=replay&drive=b6c4d2a9", 10),
        ("scene=cut-in-04&traffic=tokens&criticality=1.5&drive=b2a8j3a30", 5),
        ("scene=cut-in-04&traffic=swift&criticality=1.5&drive=b2a8j3a30", 5),
    ],
)
def test_a_link_replays_in_python_with_the_bits_of_the_page(playground, hash, least):
    page = playground(hash=f"#{hash}")
    page.until("(drive.steps > 0 && !drive.going && !drive.asked) || drive.outcome", 60)
    seen = page.evaluate(
        """() => { const run = drive.runs[0];
          return [drive.steps, drive.link, run.numSteps, ["x", "y", "heading", "vx", "vy", "valid"]
            .map((name) => [...new Uint32Array(new Float32Array(run.a[name]).buffer)]),
            drive.settings.columns.map((name) => [name, drive.info[name]])]; }"""
    )
    steps, link, width, bits, columns = seen
    rollout = play_drive(link)
    figures = {name: value for name, value in columns if name in rollout.info}
    assert len(figures) > 10
    expected = [rollout.info[name][-1] for name in figures]
    assert np.array_equal(np.float32([*figures.values()]), np.float32(expected), equal_nan=True)
    assert rollout.num_steps == steps + 1 > least
    x, y, heading, vx, vy, valid = (
        np.array(b, np.uint32).view(np.float32).reshape(-1, width)[:, : steps + 1] for b in bits
    )
    there = rollout.valid
    assert np.array_equal(valid > 0, there)
    for page_side, python_side in (
        (x, rollout.position[..., 0]),
        (y, rollout.position[..., 1]),
        (heading, rollout.heading),
        (vx, rollout.velocity[..., 0]),
        (vy, rollout.velocity[..., 1]),
    ):
        assert np.array_equal(page_side[there], python_side[there])


@pytest.mark.parametrize(
    "hash",
    [
        *(
            f"scene=cut-in-04&traffic={traffic}&drive={drive}"
            for traffic in ("ccdiff&criticality=2", "replay")
            for drive in ("b150", "c150", "e40a110", "b20a130")
        ),
        "scene=left-turn-03&traffic=ccdiff&criticality=1&drive=a150",
        "scene=pedestrians-02&traffic=ccdiff&criticality=1&drive=b60",
        "scene=left-turn-03&traffic=idm&drive=b8c142",
    ],
)
def test_a_verdict_has_the_words_of_replays(playground, hash):
    page = playground(hash=f"#{hash}")
    page.until("drive.outcome", 60)
    found = outcome(play_drive(page.evaluate("drive.link")))
    said = {name: getattr(found, name) for name in ("tone", "text", "fault")}
    assert page.evaluate("drive.outcome") == said
    for place in ("#verdict", "#outcome"):
        assert page.inner_text(f"{place} .verdict") == found.text
        assert page.locator(f"{place} .fault").all_inner_texts() == [found.fault] * bool(
            found.fault
        )


def test_a_vehicle_that_waits_in_the_log_is_solid_once_it_moves(playground):
    page = playground(hash="#scene=left-turn-03&traffic=ccdiff&criticality=1&drive=a150")
    page.until("drive.outcome", 60)
    solid = page.evaluate("drive.runs[0].agents.map((agent) => !agent.still)")
    rollout = play_drive(page.evaluate("drive.link"))
    assert not (~np.array(solid) & ~still(rollout)).any()
    assert page.evaluate("drive.log.agents[2].still && !drive.runs[0].agents[2].still")


def test_a_hostile_link_opens_the_page_and_drives_no_longer_than_any(playground):
    for name in ("toString", "constructor", "__proto__"):
        page = playground(hash=f"#scene=cut-in-04&scene=pedestrians-00&traffic={name}")
        assert page.evaluate("drive.key.split('&').slice(0, 2)") == [
            "scene=cut-in-04", "traffic=ccdiff",
        ]  # fmt: skip
    page = playground(hash=f"#scene=cut-in-04&traffic=replay&drive={'c999' * 50_000}")
    assert page.evaluate("drive.script.length") == 150


@pytest.mark.parametrize(
    ("link", "said"),
    [
        ("x#scene=cut-in-04&drive=b1", "no traffic"),
        ("x#scene=cut-in-04&traffic=me&drive=b1", "'me'"),
        ("x#scene=cut-in-04&traffic=idm&drive=z1", "'z1'"),
        ("x#scene=cut-in-04&traffic=idm&drive=b999", "150"),
        ("x#scene=cut-in-04&traffic=ccdiff&criticality=nan&drive=b1", "0 to 2"),
    ],
)
def test_a_broken_link_is_refused_by_what_is_wrong(link, said):
    with pytest.raises(ConfigError, match=said):
        read_drive(link)


def test_of_a_key_that_a_link_has_twice_the_first_counts():
    drive = read_drive("#scene=cut-in-04&scene=b&traffic=idm&traffic=me&drive=b1&drive=z")
    assert (drive.scene, drive.traffic, drive.keys) == ("cut-in-04", "idm", (1,))
    with pytest.raises(ConfigError, match="traffic is ''"):
        read_drive("#scene=cut-in-04&traffic=&traffic=idm&drive=b1")


def test_links_of_the_scene_with_lights_are_played_again():
    rollout = play_drive(f"x#scene={play.LIT}&traffic=replay&drive=b5")
    assert rollout.scene.map_layers()["lights"]


def test_the_verb_writes_a_page_of_scenes_of_ones_own(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(play, "MODULE", tmp_path / "playground.wasm")
    out = tmp_path / "page.html"
    assert cli.main(["play", "cut-in-04", "--out", str(out)]) == 2
    assert "make playground" in capsys.readouterr().err
    assert not out.exists()
    play.MODULE.write_bytes(b"module")
    assert cli.main(["play", "cut-in-04", "--out", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    assert re.findall(r'class="run" data-scene="([^"]*)"', text) == ["cut-in-04"]
    assert 'src="' not in text
