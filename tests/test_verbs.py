"""The command line: words that are wrong, folders that a typo leaves alone, small verbs."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest

from ccdiff_env import cli


@pytest.mark.parametrize(
    ("words", "help_line", "said"),
    [
        ("viw left-turn-00", "ccdiff-env --help", "did you mean view?"),
        ("bench planers", "ccdiff-env bench --help", "did you mean planners?"),
        (
            "bench planners --out x --planers idm",
            "ccdiff-env bench planners --help",
            "mean --planners?",
        ),
        ("view left-turn-00 --trafic=idm", "ccdiff-env view --help", "did you mean --traffic?"),
    ],
)
def test_wrong_words_are_answered_by_their_verb(words, help_line, said, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(words.split())
    assert ended.value.code == 2
    err = capsys.readouterr().err
    assert help_line in err
    assert said in err


RUN = ["--planners", "replay", "--traffic", "replay", "--limit", "1", "--seeds", "0", "--quiet"]


def test_a_typo_leaves_no_folder_and_a_run_is_begun_anew_or_gone_on_with(tmp_path, capsys):
    out = tmp_path / "run"
    command = ["bench", "planners", "--out", str(out), *RUN]
    for wrong in (["--planners", "replayy"], ["--traffic", "idmm"], ["--resume"]):
        assert cli.main([*command, *wrong]) == 2
        assert not out.exists()
    assert "there is no run in" in capsys.readouterr().err
    assert cli.main(command) == 0
    assert "no interval" in (out / "table.md").read_text()
    # planners may be added, and a run gone on with
    assert cli.main([*command, "--planners", "replay,constant_velocity", "--resume"]) == 0
    (out / "old.txt").write_text("old")
    assert cli.main([*command, "--seeds", "1"]) == 2
    assert cli.main([*command, "--seeds", "1", "--overwrite"]) == 0
    assert not (out / "old.txt").exists()
    assert json.loads((out / "run.json").read_text())["seeds"] == [1]
    other = tmp_path / "letters"
    other.mkdir()
    (other / "letter.txt").write_text("dear")
    command[3] = str(other)
    assert cli.main([*command, "--overwrite"]) == 2
    assert (other / "letter.txt").exists()


def test_the_doctor_says_what_there_is_and_drives_a_world(capsys):
    assert cli.main(["doctor"]) == 0
    said = capsys.readouterr().out
    for word in ("ccdiff-env", "Python", "processor", "torch", "cache", "41 scenes", "steps a sec"):
        assert word in said
    assert cli.main(["doctor", "--scenes", "nuscenes:/nowhere"]) == 1
    assert "FAILS" in capsys.readouterr().out


def test_an_ego_is_trained_by_a_verb_that_refuses_what_means_nothing(tmp_path, capsys):
    pytest.importorskip("torch")
    import ccdiff_env

    out = tmp_path / "ego"
    for words, said in (
        (["--traffic", "imd"], "--traffic is 'imd'"),
        (["--traffic", "bank"], "go together"),
        (["--resume"], "there is no checkpoint in"),
        (["--forks", "2", "--traffic", "idm"], "share of episodes, 0 to 1"),
        (["--forks", "0.5"], "--forks"),
        (["--start", "nobody"], "nobody"),
        (["--base", "nobody"], "one of idm, pdm"),
    ):
        assert cli.main(["train-ego", "--out", str(out), *words]) == 2
        assert said in capsys.readouterr().err
        assert not out.exists()
    words = ["--base", "pdm", "--anchor", "zero", "--out", str(out), "--threads", "1"]
    assert cli.main(["train-ego", "--smoke", *words]) == 0
    policy = ccdiff_env.planners.load(out / "ego.safetensors")
    assert policy.config.action.dynamics.base == "pdm"
    assert "ego.safetensors" in capsys.readouterr().out


def test_vehicles_starts_and_differences_are_drawn_but_the_ego_of_a_bank_stays(tmp_path):
    pytest.importorskip("torch")
    import ccdiff_env
    from ccdiff_env.envs import train_ego
    from ccdiff_env.envs.ppo import Worlds

    ccdiff_env.record_bank(ccdiff_env.embedded_scenes("val")[:2], tmp_path, ego="replay")
    words = ["--worlds", "48", "--traffic", "replay", "styles", "bank", "--bank", str(tmp_path)]
    parser, found = argparse.ArgumentParser(), {}
    train_ego.add_arguments(parser)
    config = ccdiff_env.WorldConfig().with_options(start_spread_steps=50)
    for drawn in ("--any-ego", "--differences 0.1"):
        worlds = Worlds(parser.parse_args([*words, *drawn.split()]), config, seed=0)
        for name, env in zip(("replay", "styles", "bank"), worlds.envs, strict=True):
            native = env.worlds.native
            status = [native.status(i) for i in range(16)]
            found[drawn, name] = [
                env.worlds.scenes[one.scene_idx].agent_ids[one.ego_idx] for one in status
            ]
            found[name] = {driver for i in range(16) for driver in native.drivers(i)}
            differ = [native.drawn(i)[0] for i in range(16)]
            for gain in ("acceleration_gain", "yaw_gain", "size"):
                off = [abs(one[gain] - 1.0) for one in differ]
                assert (0.05 < max(off) <= 0.1) if drawn != "--any-ego" else not any(off)
            assert {one["delay_steps"] for one in differ} <= {0, 1, 2}
    others = {key for key, ids in found.items() if isinstance(key, tuple) and set(ids) != {"ego"}}
    assert others == {("--any-ego", "replay"), ("--any-ego", "styles")}
    assert found["styles"] >= {"calm", "idm", "hasty"}
    assert "idm" not in found["replay"] | found["bank"]


def test_training_begins_with_a_policy_and_stays_near_an_anchor():
    torch = pytest.importorskip("torch")
    import ccdiff_env
    from ccdiff_env.envs.ego_network import Agent
    from ccdiff_env.envs.ppo import update

    ego = ccdiff_env.planners.load("ego")
    env = ccdiff_env.make_vec(64, traffic="idm", **ego.env_options)
    obs, _ = env.reset(seed=0)
    moved = {}
    for kl in (0.0, 1e4):
        torch.manual_seed(0)
        agent = Agent(env.worlds.layout, (0.2, 0.1))
        agent.take(ego)
        agent.see(torch.from_numpy(obs))
        x = agent.normalised(torch.from_numpy(obs))
        with torch.no_grad():
            mean = agent(x)[0]
        assert np.allclose(mean.clamp(-1.0, 1.0).numpy(), ego.act(obs), atol=1e-4)
        actions = mean + 0.1 * torch.randn_like(mean)
        data = {"x": x, "actions": actions, "log_prob": agent.log_prob(mean, actions).detach()}
        data |= {"advantage": torch.randn(64), "returns": torch.zeros(64), "anchor": mean}
        optimiser = torch.optim.Adam(agent.policy.parameters(), lr=1e-3)
        for _ in range(10):
            update(agent, optimiser, dict(data), kl)
        moved[kl] = float((agent(x)[0] - mean).abs().mean().detach())
    assert moved[1e4] < 0.5 * moved[0.0]
