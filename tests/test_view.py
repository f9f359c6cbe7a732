"""Replay pages, pictures and films of rollouts, and the verb that writes them."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from view_rollouts import NUM_STEPS, planned_rollout

from ccdiff_env import Scene, causal, cli, embedded_scenes, load_nuscenes
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.rollout import Rollout, RolloutEvent
from ccdiff_env.view import find_rollout, log_rollout, page_html, play_scene, write_page
from ccdiff_env.view.contacts import contacts
from ccdiff_env.view.film import Film


def unpacked(text: str) -> tuple[dict, dict[str, np.ndarray]]:
    """Header and values of a data element, read by the rules that pack.py writes down."""
    raw = zlib.decompress(base64.b64decode(text))
    length = int.from_bytes(raw[:4], "little")
    header = json.loads(raw[4 : 4 + length])
    at, arrays = -(-(4 + length) // 4) * 4, {}
    for entry in header["arrays"]:
        dtype = np.dtype(f"<{entry['type']}")
        count = int(np.prod(entry["shape"]))
        values = np.frombuffer(raw, dtype, count, at).reshape(entry["shape"])
        at += -(-values.nbytes // 4) * 4
        if entry.get("delta"):
            values = np.cumsum(values, axis=-1, dtype=dtype)
        if "step" in entry:
            values = entry["base"] + entry["step"] * values.astype(float)
        arrays[entry["name"]] = values
    assert at == len(raw)
    return header, arrays


def elements(text: str) -> list[str]:
    return re.findall(r'<script class="run" type="text/plain">([^<]*)</script>', text)


def test_a_page_holds_the_states_to_a_centimetre():
    run = planned_rollout()
    header, arrays = unpacked(elements(page_html(run))[0])
    there = run.valid
    for name, values in (
        ("x", run.position[..., 0]),
        ("y", run.position[..., 1]),
        ("vx", run.velocity[..., 0]),
        ("vy", run.velocity[..., 1]),
    ):
        np.testing.assert_allclose(arrays[name][there], values[there], atol=0.006)
    turn = arrays["heading"] - run.heading
    assert np.abs(np.angle(np.exp(1j * turn)))[there].max() < 1e-3
    np.testing.assert_array_equal(arrays["valid"].astype(bool), there)
    assert [agent["id"] for agent in header["run"]["agents"]] == list(run.agent_ids)
    assert [agent["driver"] for agent in header["run"]["agents"]][:4] == [
        "ego", "ccdiff", "adversary", "replay",
    ]  # fmt: skip


def test_a_page_holds_plans_with_the_chosen_sample_first_and_edges_from_cause_to_effect():
    run = planned_rollout()
    header, arrays = unpacked(elements(page_html(run))[0])
    plan = header["plans"][2]
    assert (plan["step"], plan["agents"], plan["guided"]) == (20, [1, 2], [0, 1])
    assert plan["edges"] == [[2, 1]]  # entry (0, 1) of the graph: the second influences the first
    for row, (agent, chosen) in enumerate([(1, 1), (2, 3)]):
        points = run.plans[2].samples[chosen, row, [3, 7, 11, 15, 19], 0]
        expected = [run.position[agent, 20, 0], *points]
        np.testing.assert_allclose(arrays["plan2x"][0, row], expected, atol=0.03)


def test_figures_that_never_change_are_left_out():
    header, _ = unpacked(elements(page_html(planned_rollout()))[0])
    assert header["figures"] == [{"name": "route_distance", "unit": "m"}]


def test_pairs_are_those_that_the_core_says_will_meet():
    run = planned_rollout()
    for step, (a, b, seconds) in enumerate(contacts(run)):
        if step % 16:
            continue
        expected = causal.ttc(
            run.position[:, step],
            run.heading[:, step],
            np.linalg.norm(run.velocity[:, step], axis=-1),
            run.scene.sizes[:, :2],
            run.valid[:, step],
            normalised=False,
        )
        np.testing.assert_array_equal(expected[a, b], seconds)
        kinds = np.array(run.scene.agent_types)
        alike = kinds[:, None] == kinds[None, :]
        near = (expected <= 10.0) & ~(alike & np.isin(kinds, ("static", "pedestrian")))
        assert len(a) == np.count_nonzero(np.triu(near, 1))


def test_two_agents_that_follow_the_log_overlap_but_do_not_collide():
    run = planned_rollout()
    ids = run.agent_ids
    events = (
        RolloutEvent(5, ids[3], ids[4], "collision_side"),
        RolloutEvent(6, ids[1], ids[4], "collision_side"),
        RolloutEvent(7, ids[1], None, "off_road"),
    )
    shown = unpacked(elements(page_html(replace(run, events=events)))[0])[0]["run"]["events"]
    assert [event["collision"] for event in shown] == [False, True, False]


def test_names_cannot_break_out_of_the_page():
    run = planned_rollout()
    evil = "</script><script>alert(1)</script>{{runs}}"
    scene = run.scene
    named = Scene.from_arrays(
        evil,
        agent_ids=scene.agent_ids,
        agent_types=scene.agent_types,
        sizes=scene.sizes,
        location="<b>",
        **scene.tracks(),
    )
    text = page_html(replace(run, scene=named))
    assert "alert(1)</script>" not in text
    assert text.count("<script") == text.count("</script>") == 3
    assert len(elements(text)) == 1


def test_pages_need_nothing_from_outside():
    text = page_html(planned_rollout())
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)""", text)
    assert "http" not in text.replace("http-equiv", "")
    assert "default-src 'none'" in text


def test_a_run_beside_the_log_gives_two_elements_of_the_same_time():
    run = replace(planned_rollout(), start_step=20)
    log = log_rollout(run.scene, like=run)
    assert (log.start_step, log.num_steps) == (20, NUM_STEPS)
    first, second = (unpacked(e)[0]["run"] for e in elements(page_html(run, compare=log)))
    assert (first["startStep"], first["numSteps"]) == (second["startStep"], second["numSteps"])


def test_every_embedded_scene_gives_a_small_page(tmp_path):
    for scene in embedded_scenes():
        assert write_page(log_rollout(scene), tmp_path / "page.html") < 400_000
    assert (tmp_path / "page.html").stat().st_size > 10_000


@pytest.mark.nuscenes
def test_every_mini_scene_with_plans_of_ten_seconds_is_under_a_megabyte(data_root, tmp_path):
    scenes = load_nuscenes(data_root / "nuscenes", "v1.0-mini")
    sample = planned_rollout().plans[0]
    rng = np.random.default_rng(0)
    for scene in scenes:
        log = log_rollout(scene)
        ids = tuple(log.agent_ids[:20])
        plans = tuple(
            replace(
                sample,
                step=step,
                agent_ids=ids,
                samples=rng.normal(size=(10, len(ids), 52, 2)).cumsum(2).astype(np.float32),
                graph=np.eye(len(ids), dtype=bool),
                ttc_s=np.ones((len(ids),) * 2, np.float32),
                chosen=np.zeros(len(ids), np.int64),
                executed=np.ones(len(ids), bool),
                guided=np.zeros(len(ids), bool),
                realism_cost=np.zeros(len(ids), np.float32),
            )
            for step in range(0, 100, 5)
        )
        assert write_page(replace(log, plans=plans), tmp_path / "page.html") < 1_000_000


def test_a_name_is_a_file_a_scene_or_an_error(tmp_path):
    assert find_rollout("left-turn-00").scene.name == "left-turn-00"
    planned_rollout().save(tmp_path / "run.npz")
    assert find_rollout(str(tmp_path / "run.npz")).num_steps == NUM_STEPS
    with pytest.raises(UnknownNameError, match="no embedded scene"):
        find_rollout("scene-9999")
    with pytest.raises(ConfigError, match="--compare"):
        find_rollout("log")


def test_the_verb_writes_a_page_a_comparison_a_picture_and_a_gif(tmp_path, capsys):
    from PIL import Image

    planned_rollout().save(tmp_path / "run.npz")
    run = str(tmp_path / "run.npz")
    for name, options in (
        ("page.html", []),
        ("two.html", ["--compare", "log"]),
        ("step.png", ["--png", "30", "--graph"]),
        ("film.gif", ["--gif", "--size", "160", "--speed", "4"]),
    ):
        out = tmp_path / name
        assert cli.main(["view", run, "-o", str(out), *options]) == 0
        assert capsys.readouterr().out.strip() == str(out)
        assert out.stat().st_size > 1000
    assert len(elements((tmp_path / "two.html").read_text(encoding="utf-8"))) == 2
    with Image.open(tmp_path / "step.png") as picture:
        assert picture.size == (720, 720)
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames == 41  # four times the pace at no more than 20 pictures a second
        assert film.info["duration"] == 50


def test_the_verb_plays_a_scene_and_keeps_the_episode(tmp_path, capsys):
    out, kept = tmp_path / "page.html", tmp_path / "run.npz"
    options = ["--traffic", "idm", "--seed", "3", "--compare", "log", "--save", str(kept)]
    assert cli.main(["view", "left-turn-00", "-o", str(out), *options]) == 0
    run = Rollout.load(kept)
    assert (run.meta["seed"], run.meta["traffic"], run.meta["planner"]) == (3, "idm", "idm")
    first, second = (unpacked(e)[0]["run"] for e in elements(out.read_text(encoding="utf-8")))
    assert (first["title"], second["title"]) == ("IDM", "log")
    assert first["startStep"] == second["startStep"] == run.start_step
    assert cli.main(["view", str(kept), "--traffic", "idm"]) == 2
    assert "an episode already" in capsys.readouterr().err


@pytest.mark.slow
def test_a_scene_played_with_ccdiff_traffic_shows_its_plans():
    run = play_scene(embedded_scenes()["left-turn-00"], ccdiff={"num_samples": 3})
    header, arrays = unpacked(elements(page_html(run))[0])
    assert len(header["plans"]) == len(run.plans) > 1
    assert header["plans"][0]["numSamples"] == 3
    assert np.isfinite(arrays["plan0x"]).all()
    assert "ccdiff" in {agent["driver"] for agent in header["run"]["agents"]}


def test_the_verb_writes_an_mp4_that_plays_at_the_pace_of_the_world(tmp_path):
    imageio = pytest.importorskip("imageio.v2")
    pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "film.mp4"
    options = ["--mp4", "--size", "160", "--follow", planned_rollout().agent_ids[1]]
    assert cli.main(["view", "left-turn-00", "-o", str(out), *options]) == 0
    film = imageio.get_reader(out).get_meta_data()
    seconds = (embedded_scenes()["left-turn-00"].num_steps - 1) * 0.1
    assert film["duration"] == pytest.approx(seconds, abs=0.2)
    assert film["size"] == (160, 160)


def test_the_verb_writes_an_index_of_a_folder(tmp_path, capsys):
    (tmp_path / "runs" / "deep").mkdir(parents=True)
    planned_rollout().save(tmp_path / "runs" / "a.npz")
    planned_rollout().save(tmp_path / "runs" / "deep" / "b.npz")
    out = tmp_path / "pages"
    assert cli.main(["view", str(tmp_path / "runs"), "-o", str(out)]) == 0
    text = (out / "index.html").read_text(encoding="utf-8")
    links = re.findall(r'href="([^":]+)"', text)
    assert links == ["a.html#t=1.0", "deep-b.html#t=1.0"]  # two seconds before the collision
    assert all((out / link.partition("#")[0]).is_file() for link in links)
    assert "2 replays, 2 with a collision" in text
    assert capsys.readouterr().out.strip() == str(out / "index.html")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["left-turn-00", "--gif", "--mp4"], "one of"),
        (["left-turn-00", "--png", "100000"], "expected 0 to"),
        (["left-turn-00", "--png", "0", "--follow", "nobody"], "no agent 'nobody'"),
        (["nothing"], "no file 'nothing'"),
        ([".", "--gif"], "a folder gives pages"),
    ],
)
def test_the_verb_says_what_is_wrong(options, message, tmp_path, capsys):
    assert cli.main(["view", *options, "-o", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err


def test_pictures_have_the_ego_in_the_middle_in_its_colour():
    film = Film(planned_rollout(), size=(200, 200), span_m=40.0)
    assert tuple(film.frame(0)[100, 100]) == (0, 87, 184)
    assert sum(1 for _ in film.frames(every=20)) == 5


def test_agents_that_are_absent_now_are_not_drawn(tmp_path):
    run = planned_rollout()
    valid = run.valid.copy()
    valid[1, 40:] = False
    gone = Rollout(**{f: getattr(run, f) for f in run.__dataclass_fields__} | {"valid": valid})
    _, arrays = unpacked(elements(page_html(gone))[0])
    assert arrays["valid"][1, 40:].max() == 0
    assert np.ptp(arrays["x"][1, 39:]) == 0.0
    film = Film(gone, follow=run.agent_ids[1], size=(200, 200), span_m=40.0)
    seen = [bool((film.frame(step) == (0, 158, 115)).all(-1)[100, 100]) for step in (39, 41)]
    assert seen == [True, False]
