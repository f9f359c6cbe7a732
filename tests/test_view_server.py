"""Pages of a server on this machine: scenes played again, and runs while they go on."""

from __future__ import annotations

import http.client
import json
import os
import shutil
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest
from view_rollouts import planned_rollout

from ccdiff_env import cli, embedded_scenes
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.models import shipped_weights
from ccdiff_env.view.live import LiveRun, read_curves
from ccdiff_env.view.play import Playground, moved_scene
from ccdiff_env.view.server import LocalServer

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def serve():
    """Start servers, and stop them at the end."""
    servers = []

    def go(answers):
        servers.append(LocalServer(answers))
        servers[-1].start()
        return servers[-1]

    yield go
    for server in servers:
        server.stop()


def get(server, path, **headers):
    port = int(server.address.rsplit(":", 1)[1].strip("/"))
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    text = response.read().decode()
    connection.close()
    return response.status, text


def test_only_pages_of_this_machine_are_answered(serve):
    server = serve({"/": lambda words: "hello"})
    assert server.address.startswith("http://127.0.0.1:")
    assert get(server, "/") == (200, "hello")
    assert get(server, "/", Host="evil.example")[0] == 403
    assert get(server, "/", **{"Sec-Fetch-Site": "cross-site"})[0] == 403
    assert get(server, "/../etc/passwd")[0] == 404
    assert get(server, f"/?{'x' * 3000}")[0] == 404


def test_what_is_wrong_is_said_on_the_page(serve):
    server = serve(Playground(embedded_scenes("val"), "left-turn-04").answers)
    for words, message in (
        ({"scene": "<b>"}, "no scene &#x27;&lt;b&gt;&#x27;"),
        ({"criticality": "nan"}, "expected 0 to 2"),
        ({"seed": "-1"}, "expected 0 to"),
        ({"driver": "external"}, "&#x27;external&#x27;; there are"),
        ({"moves": "[1]"}, "metres by agent id"),
        ({"moves": '{"1": [1e9, 0]}'}, "at most 100 m"),
        ({"moves": '{"nobody": [1, 0]}'}, "no agent &#x27;nobody&#x27;"),
    ):
        status, text = get(server, f"/replay?{urlencode(words)}")
        assert (status, message in text) == (400, True), text


def test_an_agent_that_is_moved_is_elsewhere_and_nothing_else_is():
    scene = embedded_scenes()["left-turn-04"]
    agent = scene.agent_ids[4]
    moved = moved_scene(scene, {agent: (3.0, -2.0)})
    before, after = scene.tracks(), moved.tracks()
    there = before["valid"][4]
    change = after["position"] - before["position"]
    np.testing.assert_allclose(change[4, there], [[3.0, -2.0]] * there.sum(), atol=1e-4)
    change[4] = 0.0
    assert not change.any()
    for name in ("heading", "velocity", "valid"):
        np.testing.assert_array_equal(before[name], after[name])
    assert moved_scene(scene, {}) is scene
    with pytest.raises(UnknownNameError):
        moved_scene(scene, {"nobody": (0.0, 0.0)})


def test_a_page_plays_again_with_what_is_chosen_and_dragged(serve, browser):
    server = serve(Playground(embedded_scenes("val"), "left-turn-04").answers)
    page = browser.new_page(viewport={"width": 1200, "height": 800}, reduced_motion="reduce")
    faults = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(server.address)

    def replay(word):
        """The frame, once it shows a replay whose address has a word."""
        for _ in range(300):
            frame = page.frames[-1]
            if word in frame.url and frame.locator("body[data-ready=yes]").count():
                return frame
            page.wait_for_timeout(200)
        raise AssertionError(page.frames[-1].url)

    page.select_option("[name=traffic]", "idm")
    frame = replay("traffic=idm")
    assert "traffic: IDM" in frame.inner_text("header")
    assert page.is_disabled("[name=criticality]")
    where = """() => {
      const { run, canvas, width, height } = replay.panes[0];
      const pose = run.pose(4, run.stepAt(replay.time)), box = canvas.getBoundingClientRect();
      const [x, y] = replay.camera.toScreen(pose.x, pose.y, width, height);
      return [pose.x, pose.y, box.left + x, box.top + y, replay.camera.scale];
    }"""
    frame.evaluate("replay.seek(replay.start)")
    x, y, px, py, scale = frame.evaluate(where)
    frame.click("#edit")
    outer = page.locator("iframe").bounding_box()
    page.mouse.move(outer["x"] + px, outer["y"] + py)
    page.mouse.down()
    page.mouse.move(outer["x"] + px + 4 * scale, outer["y"] + py, steps=5)
    page.mouse.up()
    frame = replay("moves=")
    frame.evaluate("replay.seek(replay.start)")
    again = frame.evaluate(where)
    assert again[0] - x == pytest.approx(4.0, abs=0.3)
    assert again[1] - y == pytest.approx(0.0, abs=0.3)
    assert page.is_visible("#undo")
    assert faults == []
    page.close()


def test_curves_are_read_while_they_are_written(tmp_path):
    text = "step,loss,seconds\n1,4.0,1\n2,2.0,2\n3,nan,3\n4,1.5,4\n5,1."
    (tmp_path / "loss.csv").write_text(text, encoding="utf-8")
    (tmp_path / "log").mkdir()
    phases = ["", *["IDM"] * 400, *["CCDiff"] * 599]
    rows = "\n".join(f"{i},{i % 2},{2 * i},{phase}" for i, phase in enumerate(phases))
    head = "time/total_timesteps,rollout/success_rate,time/fps,phase\n"
    (tmp_path / "log" / "progress.csv").write_text(head + rows, encoding="utf-8")
    (tmp_path / "other.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    success, loss = read_curves(tmp_path)
    assert (loss["name"], loss["x"], loss["y"]) == ("loss: loss", [1, 2, 4], [4.0, 2.0, 1.5])
    assert success["name"] == "progress: rollout/success_rate"
    assert len(success["x"]) == 334
    assert np.mean(success["y"]) == pytest.approx(0.5, abs=0.01)
    assert (success["marks"], loss["marks"]) == ([(401.0, "CCDiff")], [])


def test_the_newest_replay_is_that_of_the_newest_file(tmp_path, serve, browser):
    run = LiveRun(tmp_path)
    assert run.state({})["replay"] is None
    planned_rollout().save(tmp_path / "one.npz")
    assert run.state({})["replay"].startswith("one.npz@")
    shutil.copy(shipped_weights(), tmp_path / "weights.safetensors")
    assert run.state({})["replay"].startswith("weights.safetensors@")
    (tmp_path / "loss.csv").write_text("step,loss\n1,4.0\n2,2.0\n", encoding="utf-8")
    server = serve(run.answers)
    status, text = get(server, "/state")
    assert status == 200
    assert json.loads(text)["curves"][0]["y"] == [4.0, 2.0]
    page = browser.new_page(reduced_motion="reduce")
    faults = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(server.address)
    frame = page.frame_locator("iframe")
    frame.locator("body[data-ready=yes]").wait_for()
    assert "weights.safetensors" in frame.locator("h1").inner_text()
    assert "loss: loss" in page.inner_text("#curves h2")
    assert faults == []
    page.close()


@pytest.mark.parametrize("verb", [["play", "left-turn-04"], ["live", "."]])
def test_the_verbs_serve_until_they_are_interrupted(verb, tmp_path):
    command = [sys.executable, "-m", "ccdiff_env.cli", *verb]
    environ = {**os.environ, "PYTHONPATH": str(Path(cli.__file__).parents[1])}
    # a shell that runs the tests in the background has them ignore SIGINT
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    started = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=tmp_path, env=environ
    )
    signal.signal(signal.SIGINT, before)
    with started as process:
        address = process.stdout.readline().split()[0]
        with urllib.request.urlopen(address, timeout=60) as response:
            assert b"<iframe" in response.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


def test_the_verbs_say_what_is_wrong(tmp_path, capsys):
    assert cli.main(["play", "nowhere"]) == 2
    assert "ccdiff-env scenes lists them" in capsys.readouterr().err
    assert cli.main(["live", str(tmp_path / "none")]) == 2
    assert "no folder of a run" in capsys.readouterr().err


def test_a_port_that_is_taken_is_said(serve):
    server = serve({})
    with pytest.raises(ConfigError, match="cannot be used"):
        LocalServer({}, int(server.address.rsplit(":", 1)[1].strip("/")))
    with pytest.raises(ConfigError, match="cannot be used"):
        LocalServer({}, 99_999)
