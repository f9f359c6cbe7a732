"""Custom models and planners by name, with options after a question mark."""

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env.errors import ConfigError
from ccdiff_env.system.named_objects import named_instance, named_object
from ccdiff_env_cli import main

HERE = __name__


class Coasting:
    """Traffic of constant acceleration."""

    def __init__(self, acceleration: float = 0.0, label: str | None = None) -> None:
        self.acceleration, self.label = acceleration, label

    def __call__(self, batch):
        plan = np.zeros((len(batch.kind), 10, 2), np.float32)
        plan[..., 0] = self.acceleration
        return plan


class Needy:
    """Wants to be told something."""

    def __init__(self, weights: str) -> None:
        self.weights = weights


def anything(**options):
    return options


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2.5", 2.5), ("3", 3), ("true", True), ("null", None), ('"7"', "7"),
        ("runs/a.pt", "runs/a.pt"), ("[1]", "[1]"), ("", ""), ("a=b", "a=b"),
    ],
)  # fmt: skip
def test_values_are_json_scalars_else_text(text, value):
    assert named_object(f"{HERE}:anything?x={text}", "thing")() == {"x": value}


def test_options_are_arguments_and_names_keep_them():
    text = f"{HERE}:Coasting?acceleration=-2&label=a"
    made = named_instance(text, "traffic model")
    assert isinstance(made, Coasting)
    assert (made.acceleration, made.label) == (-2, "a")
    assert named_instance(f"{HERE}:Coasting", "traffic model").acceleration == 0.0
    one, two = (
        ccdiff_env.WorldConfig().with_options(traffic=f"{HERE}:Coasting{options}")
        for options in ("?acceleration=-2", "?acceleration=-3")
    )
    # who reads the configuration sees the options
    assert f"{HERE}:Coasting?acceleration=-2" in one.to_json()
    assert one.to_json() != two.to_json()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{HERE}:Coasting?z=1", "no option 'z', it takes acceleration, label"),
        (f"{HERE}:Coasting?acceleration", "'acceleration', expected option=value"),
        (f"{HERE}:Coasting?label=a&label=b", "each option once"),
        (f"{HERE}:Needy", "missing a required argument: 'weights'; it takes weights"),
        (f"{HERE}:HERE?x=1", "a str takes no options"),
        (f"{HERE}:Nobody?x=1", "no 'Nobody' in module"),
        ("nowhere_at_all:X?x=1", "no module 'nowhere_at_all'"),
        (":X", "no 'X' in module ''"),
    ],
)
def test_wrong_names_are_said_with_those_there_are(text, message):
    with pytest.raises(ConfigError, match=message) as caught:
        named_instance(text, "traffic model")
    assert text in str(caught.value)


def test_the_command_line_takes_options(tmp_path, monkeypatch, capsys):
    (tmp_path / "my_planner_file.py").write_text(
        "import numpy as np\n"
        "def act(obs, throttle=1.0):\n"
        "    return np.tile(np.array([throttle, 0.0], np.float32), (len(obs), 1))\n"
    )
    monkeypatch.chdir(tmp_path)
    command = ["bench", "planners", "--limit", "1", "--quiet", "--traffic", "replay", "--planners"]
    found = "my_planner_file:act?throttle=-1"
    assert main([*command, found, "--out", str(tmp_path / "run")]) == 0
    assert f"\n{found} " in capsys.readouterr().out
    assert main([*command, "my_planner_file:act?thrttle=1", "--out", str(tmp_path / "no")]) == 2
    assert "no option 'thrttle', it takes obs, throttle" in capsys.readouterr().err
