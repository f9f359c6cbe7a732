"""Replay pages, images and videos of rollouts, and the verb that writes them."""

import base64
import json
import re
import webbrowser
import zlib
from dataclasses import replace

import numpy as np
import pytest
from array_scenes import rebuilt
from view_rollouts import NUM_STEPS, planned_rollout

from ccdiff_env import Scene, cli, embedded_scenes
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.metrics import causal
from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.view import find_rollout, log_rollout, page_html, write_page
from ccdiff_env.view.captions import planner_title
from ccdiff_env.view.link import play_drive
from ccdiff_env.view.pack import contacts
from ccdiff_env.view.video import Video


def unpacked(text: str) -> tuple[dict, dict[str, np.ndarray]]:
    """Header and values of a data element, read by the rules that pack.py writes down."""
    header = json.loads(zlib.decompress(base64.b64decode(text)))
    return header, {name: values_of(array) for name, array in header["arrays"].items()}


def values_of(array: dict) -> np.ndarray:
    return array["step"] * np.cumsum(np.reshape(array["deltas"], (-1, array["row"])), axis=-1)


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


def test_a_page_holds_plans_chosen_sample_first_and_edges_by_cause():
    run = planned_rollout()
    header, _ = unpacked(elements(page_html(run))[0])
    plan = header["plans"][2]
    assert (plan["made_at"], plan["agents"], plan["guided"]) == (20, [1, 2], [0, 1])
    assert plan["edges"] == [[2, 1]]  # entry (0, 1) of the graph: the second influences the first
    for row, (agent, chosen) in enumerate([(1, 1), (2, 3)]):
        points = run.plans[2].samples[chosen, row, [3, 7, 11, 15, 19], 0]
        expected = [run.position[agent, 20, 0], *points]
        np.testing.assert_allclose(values_of(plan["x"])[row], expected, atol=0.03)


def test_pairs_are_those_that_the_core_says_will_meet():
    run = planned_rollout()
    for step, pairs in enumerate(contacts(run)):
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
        assert all(abs(expected[a, b] - seconds) < 0.0051 for a, b, seconds in pairs)
        kinds = np.array(run.scene.agent_types)
        alike = kinds[:, None] == kinds[None, :]
        near = (expected <= 10.0) & ~(alike & np.isin(kinds, ("static", "pedestrian")))
        assert len(pairs) == np.count_nonzero(np.triu(near, 1))


def shown_events(run: Rollout) -> list[dict]:
    return unpacked(elements(page_html(run))[0])[0]["run"]["events"]


@pytest.mark.parametrize(
    ("events", "expected"),
    [
        # both sides of a collision are one event
        ([(9, 4, 2, "rear"), (9, 2, 4, "front")], [("collision", "guided", 2, 4)]),
        ([(9, 1, 5, "rear")], [("collision", "others", 1, 5)]),
        # boxes of two agents that follow the log are not exact
        ([(5, 3, 4, "side")], []),
        ([(6, 1, 4, "side")], [("collision", "others", 1, 4)]),
    ],
)
def test_collisions_are_told_once_in_the_lane_of_who_is_driven(events, expected):
    run = planned_rollout()
    ids = run.agent_ids
    events = tuple(RolloutEvent(s, ids[a], ids[b], f"collision_{of}") for s, a, b, of in events)
    shown = shown_events(replace(run, events=events))
    told = [(e["kind"], e["lane"], *sorted((e["agent"], e["partner"]))) for e in shown]
    assert told == expected


def test_what_breaks_the_rules_of_the_road_is_flagged_of_the_ego_and_guided_vehicles():
    run = planned_rollout()
    events = tuple(RolloutEvent(20, run.agent_ids[i], None, "off_road") for i in (1, 2, 0))
    wrong = {"wrong_way": np.isin(np.arange(NUM_STEPS - 1), [29, 30, 40]).astype(np.float32)}
    shown = shown_events(replace(run, events=events, info=run.info | wrong))
    told = [(e["kind"], e["agent"], e["step"]) for e in shown]
    assert told[:2] == [("off_road", 0, 20), ("off_road", 2, 20)]
    assert told[2:] == [("wrong_way", 0, 30), ("wrong_way", 0, 41)]
    # a drive of which nobody is called ego
    tracks = run.scene.tracks()
    ids = ["car", *run.scene.agent_ids[1:]]
    nobody = Scene.from_arrays(
        "x", agent_ids=ids, agent_types=run.scene.agent_types, sizes=run.scene.sizes,
        **{name: tracks[name] for name in ("position", "heading", "velocity", "valid")},
    )  # fmt: skip
    other = {"scene": nobody, "agent_ids": type(run.agent_ids)(ids), "events": ()}
    assert not shown_events(replace(run, **other, info=run.info | wrong))


def test_names_cannot_break_out_of_the_page():
    run = planned_rollout()
    evil = "</script><script>alert(1)</script>{{runs}}"
    text = page_html(replace(run, scene=rebuilt(run.scene, evil, location="<b>")))
    assert "alert(1)</script>" not in text
    assert text.count("<script") == text.count("</script>") == 3
    assert len(elements(text)) == 1


def test_several_runs_keep_their_titles_and_a_title_too_few_is_an_error():
    run = planned_rollout()
    found = elements(page_html(run, compare=[run, run]))
    assert [unpacked(e)[0]["run"]["title"] for e in found] == ["A", "B", "C"]
    with pytest.raises(ConfigError, match="titles: 2 for 3 runs"):
        page_html(run, compare=[run, run], titles=("one", "two"))


@pytest.mark.parametrize(
    ("options", "titles"),
    [
        ("--traffic ccdiff --criticality 0 1", ["criticality 0", "criticality 1"]),
        ("--traffic ctg ccdiff --compare log", ["CTG", "CCDiff", "log"]),
        ("--traffic idm --driver idm noop", ["driven by IDM", "driven by no action"]),
    ],
)
def test_runs_are_shown_beside_each_other_by_what_differs(options, titles, tmp_path):
    words = ["view", "left-turn-00", *options.split()]
    assert cli.main([*words, "-o", str(tmp_path / "page.html")]) == 0
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert [unpacked(e)[0]["run"]["title"] for e in elements(text)] == titles


@pytest.mark.parametrize(
    ("name", "title"),
    [("a/ego.zip", "ego.zip"), ("a/mine.zip", "mine"), ("ego", "trained ego")],
)
def test_a_file_that_is_named_as_a_planner_of_the_package_keeps_its_suffix(name, title):
    assert planner_title(name) == title


def test_pages_need_nothing_from_outside():
    text = page_html(planned_rollout())
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)""", text)
    assert "http" not in text.replace("http-equiv", "")
    assert "default-src 'none'" in text


def test_every_embedded_scene_gives_a_small_page(tmp_path):
    for scene in embedded_scenes():
        assert write_page(log_rollout(scene), tmp_path / "page.html") < 400_000
    assert (tmp_path / "page.html").stat().st_size > 10_000


def test_a_name_is_a_file_a_scene_or_an_error(tmp_path):
    assert find_rollout("left-turn-00").scene.name == "left-turn-00"
    planned_rollout().save(tmp_path / "run.npz")
    assert find_rollout(str(tmp_path / "run.npz")).num_steps == NUM_STEPS
    with pytest.raises(UnknownNameError, match="in embedded: no scene 'scene-9999'"):
        find_rollout("scene-9999")
    (tmp_path / "mine.zip").touch()
    with pytest.raises(
        ConfigError, match=r"mine\.zip is a policy, not.*--driver .*mine\.zip drives"
    ):
        find_rollout(str(tmp_path / "mine.zip"))
    with pytest.raises(ConfigError, match="rollout is 3, expected a Rollout"):
        write_page(3, tmp_path / "page.html")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="--compare"):
        find_rollout("log")


def test_the_suffix_says_what_is_written(tmp_path, capsys):
    from PIL import Image

    planned_rollout().save(tmp_path / "run.npz")
    planned_rollout().save(tmp_path / "again.npz")
    for name, options, head in (
        ("page.html", [], b"<!DO"),
        ("two.html", ["--compare", "log"], b"<!DO"),
        ("grid.html", [str(tmp_path / "again.npz"), str(tmp_path / "run.npz")], b"<!DO"),
        ("moment.svg", [], b"<svg"),
        ("step.png", ["--step", "30"], b"\x89PNG"),
        ("video.gif", ["--size", "160"], b"GIF8"),
    ):
        out = tmp_path / name
        assert cli.main(["view", str(tmp_path / "run.npz"), *options, "-o", str(out)]) == 0
        assert capsys.readouterr().out.strip() == str(out)
        assert out.read_bytes()[:4] == head
    for name, expected in (("two", ["run", "log"]), ("grid", ["run", "again", "run"])):
        found = elements((tmp_path / f"{name}.html").read_text(encoding="utf-8"))
        assert [unpacked(e)[0]["run"]["title"] for e in found] == expected
    assert cli.main(["view", str(tmp_path), str(tmp_path / "run.npz")]) == 2
    # the moment is that of the contact, which has a ring
    assert 'stroke="#d61f2c"' in (tmp_path / "moment.svg").read_text()
    with Image.open(tmp_path / "step.png") as image:
        assert image.size == (720, 720)
    with Image.open(tmp_path / "video.gif") as video:
        # the pace of the world, ten images a second; the last stays to be read
        assert video.n_frames == NUM_STEPS
        assert video.info["duration"] == 100
        video.seek(NUM_STEPS - 1)
        assert video.info["duration"] == pytest.approx(1600, abs=100)


def test_videos_of_two_runs_stand_side_by_side(tmp_path):
    from PIL import Image

    run = planned_rollout()
    run.save(tmp_path / "run.npz")
    out = tmp_path / "two.png"
    options = ["--step", "30", "--size", "100", "--compare", "log", "-o", str(out)]
    assert cli.main(["view", str(tmp_path / "run.npz"), *options]) == 0
    with Image.open(out) as image:
        assert image.size == (206, 100)
        both = np.asarray(image)
    for part, shown, title in (
        (both[:, :100], run, "run"),
        (both[:, 106:], log_rollout(run.scene, like=run), "log"),
    ):
        np.testing.assert_array_equal(part, Video(shown, size=(100, 100), title=title).frame(30))


def test_the_verb_plays_a_scene_and_keeps_the_episode(tmp_path, capsys):
    out, kept = tmp_path / "page.html", tmp_path / "run.npz"
    options = ["--traffic", "idm", "--seed", "3", "--compare", "log", "--save", str(kept)]
    assert cli.main(["view", "left-turn-00", "-o", str(out), *options]) == 0
    run = Rollout.load(kept)
    # beside the log only the traffic differs: the ego follows the log, too
    assert (run.meta["seed"], run.meta["traffic"], run.meta["planner"]) == (3, "idm", "replay")
    first, second = (unpacked(e)[0]["run"] for e in elements(out.read_text(encoding="utf-8")))
    assert (first["title"], second["title"]) == ("IDM", "log")
    assert first["startStep"] == second["startStep"] == run.start_step
    assert cli.main(["view", str(kept), "--traffic", "idm"]) == 2
    assert "an episode already" in capsys.readouterr().err
    # a drive of the playground is kept like any, and its page says what would have saved the ego
    link = "x#scene=cut-in-04&traffic=ccdiff&criticality=1&drive=b10"
    assert cli.main(["view", link, "-o", str(out), "--save", str(kept)]) == 0
    assert Rollout.load(kept).position.tobytes() == play_drive(link).position.tobytes()
    assert "avoidable" in unpacked(*elements(out.read_text()))[0]["run"]["outcome"]["rescue"]


def test_the_verb_writes_an_mp4_that_plays_at_the_pace_of_the_world(tmp_path):
    imageio = pytest.importorskip("imageio.v2")
    pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "video.mp4"
    options = ["--size", "160", "--follow", planned_rollout().agent_ids[1]]
    assert cli.main(["view", "left-turn-00", "-o", str(out), *options]) == 0
    video = imageio.get_reader(out).get_meta_data()
    seconds = (embedded_scenes()["left-turn-00"].num_steps - 1) * 0.1 + 1.6
    assert video["fps"] == 10
    assert video["duration"] == pytest.approx(seconds, abs=0.2)
    assert video["size"] == (160, 160)


def test_the_verb_writes_an_index_of_a_folder(tmp_path, capsys):
    (tmp_path / "runs" / "deep").mkdir(parents=True)
    planned_rollout().save(tmp_path / "runs" / "a.npz")
    planned_rollout().save(tmp_path / "runs" / "deep" / "b.npz")
    out = tmp_path / "pages"
    assert cli.main(["view", str(tmp_path / "runs"), "-o", str(out)]) == 0
    text = (out / "index.html").read_text(encoding="utf-8")
    links = re.findall(r'href="([^":]+)"', text)
    # two seconds before the collision
    assert links == ["a.html#t=1.0&amp;play=1", "deep-b.html#t=1.0&amp;play=1"]
    assert all((out / link.partition("#")[0]).is_file() for link in links)
    assert "2 replays: the ego drives into somebody in 2; others collide in 0" in text
    assert text.count('alt="a: ego drove into 1') == 1
    assert 'href="index.html"' in (out / "a.html").read_text(encoding="utf-8")
    assert "<title>deep-b</title>" in (out / "deep-b.html").read_text(encoding="utf-8")
    assert capsys.readouterr().out.strip() == str(out / "index.html")


@pytest.mark.parametrize(
    ("words", "out", "message"),
    [
        ("left-turn-00 --step 100000", "a.png", "expected 0 to"),
        ("left-turn-00 --step 0 --follow nobody", "a.png", "a name on its page: ego, 1, 2"),
        ("left-turn-00 --step 0", "a.gif", "--step is of an image"),
        ("left-turn-00 --open", "a.png", "--open shows pages"),
        ("left-turn-00", "a.xyz", "expected a file that ends in"),
        ("left-turn-00 --slider --traffic ccdiff", "a.gif", "--slider is for a page"),
        ("nothing", "a", "no file 'nothing'"),
        ("{empty}", "a", "no rollouts"),
        ("{empty} --seed 3", "a", "--seed does not go with a folder"),
        ("left-turn-00 --criticality 1", "a", "--criticality plays a scene: give --traffic"),
        ("left-turn-00 --driver idm", "a", "--driver plays a scene: give --traffic"),
        ("left-turn-00 --span 40", "a", "--span goes with an image"),
        ("left-turn-00 --traffic idm --criticality 1", "a", "guides networks"),
        ("left-turn-00 --traffic ccdiff --criticality 5", "a", "expected 0 to 2"),
        ("left-turn-00 --traffic idm --driver external", "a", "'external'; there are"),
        ("left-turn-00 left-turn-01 --traffic idm", "a", "--traffic plays one scene"),
    ],
)
def test_the_verb_says_what_is_wrong(words, out, message, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    options = words.format(empty=tmp_path / "empty").split()
    assert cli.main(["view", *options, "-o", str(tmp_path / out)]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / out).exists()


def test_where_no_browser_is_found_the_page_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    out = tmp_path / "page.html"
    assert cli.main(["view", "left-turn-00", "--open", "-o", str(out)]) == 0
    said = capsys.readouterr()
    assert (said.out, said.err) == (f"{out}\n", f"no browser was found: open {out.as_uri()}\n")


def test_the_scenes_are_listed(capsys):
    assert cli.main(["scenes", "--scenes", "embedded/val"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert cli.main(["scenes", "embedded/val"]) == 0
    assert capsys.readouterr().out.splitlines() == lines
    assert cli.main(["scenes", "embedded/val", "--scenes", "embedded/train"]) == 2
    assert "give one" in capsys.readouterr().err
    scenes = embedded_scenes("val")
    assert lines[0].split() == ["scene", "location", "seconds", "agents", "vehicles"]
    assert [line.split()[0] for line in lines[2:]] == list(scenes.names)
    vehicles = scenes[0].agent_types.count("vehicle")
    assert lines[2].split()[-2:] == [str(scenes[0].num_agents), str(vehicles)]
