"""A planner in another language: a program that reads and writes lines of JSON.

    python examples/planner_over_a_pipe.py --smoke

Every line that it reads is one decision for all worlds, and it answers each by one line, with the
number of the decision and the actions in [-1, 1], or trajectories ``[[[x, y, heading], ...], ...]``
in their place:

    {"number": 7, "dt_s": 0.1, "worlds": [{"ego": 0, "step": 3, "route": [[x, y], ...],
     "position": [[x, y], ...], "heading": [...], "speed": [...],
     "size": [[length, width, height], ...], "active": [...]}]}

    {"number": 7, "actions": [[acceleration, yaw rate], ...]}

Arrays are over agents, in the scene's frame: metres, radians, m/s (docs/planners.md). A world whose
episode has ended is ``null``. An answer with another number, or none within ``limit_s`` seconds,
ends the run. In this folder the whole benchmark takes a program by

    ccdiff-env bench planners --planners "planner_over_a_pipe:Piped?command=./my_planner"

The program below stands in for yours: it keeps its lane and two seconds to whoever is ahead.
"""

from __future__ import annotations

import argparse
import cmath
import json
import queue
import shlex
import subprocess
import sys
import threading
from typing import Any

import numpy as np

from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from


class Piped:
    """Asks a program, which is started with the worlds and ends with its input."""

    def __init__(
        self,
        worlds: Any,
        command: str = f"{sys.executable} {__file__} --program",
        limit_s: float = 60.0,
    ) -> None:
        self.worlds, self.command, self.limit_s, self.number = worlds, command, limit_s, 0
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.program = subprocess.Popen(shlex.split(command), **pipes)
        self.lines: queue.Queue[str] = queue.Queue(2)  # one that writes too much waits
        # a pipe has no time limit; the thread does not keep the program's input open
        told = self.program.stdout, self.lines
        threading.Thread(target=read, args=told, daemon=True).start()

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        worlds = [self.world(i) for i in range(self.worlds.num_worlds)]
        self.number += 1
        asked = {"number": self.number, "dt_s": self.worlds.config.dt_s, "worlds": worlds}
        print(json.dumps(asked), file=self.program.stdin, flush=True)
        try:
            line = self.lines.get(timeout=self.limit_s)
        except queue.Empty:
            self.program.kill()
            raise TimeoutError(f"no answer of {self.command} in {self.limit_s:g} s") from None
        if not line:
            raise RuntimeError(f"{self.command} has ended with {self.program.wait()}")
        answer = json.loads(line)
        if not isinstance(answer, dict) or answer.get("number") != self.number:
            raise ValueError(f"{self.command} answers {line:.80}, not number {self.number}")
        return np.array(answer["actions"], np.float32)

    def world(self, i: int) -> dict[str, Any] | None:
        """What a program is told of a world."""
        native = self.worlds.native
        if not native.slot_alive(i)[0]:
            return None
        status, states = native.status(i), native.states(i)
        route = native.route(i, 0)
        return {
            "ego": native.slot_agents(i)[0],
            "step": status.elapsed_steps,
            "route": [] if route is None else route[0].tolist(),
            "size": self.worlds.scenes[status.scene_idx].sizes.tolist(),
            **{n: states[n].tolist() for n in ("position", "heading", "speed", "active")},
        }


def read(file: Any, lines: queue.Queue[str]) -> None:
    """Read lines to their end, which is an empty one."""
    for line in file:
        lines.put(line)
    lines.put("")


def program() -> None:
    """What another language would do."""
    for line in sys.stdin:
        asked = json.loads(line)
        found = [(0.0, 0.0) if world is None else act(world) for world in asked["worlds"]]
        print(json.dumps({"number": asked["number"], "actions": found}), flush=True)


def act(world: dict[str, Any]) -> tuple[float, float]:
    """The action of one world: an acceleration and a yaw rate."""
    ego, speed = world["ego"], world["speed"][world["ego"]]
    at, turned = complex(*world["position"][ego]), cmath.exp(-1j * world["heading"][ego])
    # places ahead of the ego (real) and to its left (imaginary)
    route = [(complex(*point) - at) * turned for point in world["route"]]
    others = [(complex(*point) - at) * turned for point in world["position"]]
    reach = max(6.0, speed)
    aim = next((point for point in route if point.real > reach), complex(reach))
    gap = 1e3
    for i, there in enumerate(others):
        if world["active"][i] and i != ego and there.real > 0.0 and abs(there.imag) < 2.0:
            gap = min(gap, there.real - (world["size"][i][0] + world["size"][ego][0]) / 2)
    wanted = min(10.0, max(gap - 2.0, 0.0) / 2.0)
    acceleration = max(min(wanted - speed, 2.0), -8.0)
    turn = 2.0 * aim.imag / abs(aim) ** 2 * speed
    return acceleration / (4.0 if acceleration > 0.0 else 8.0), max(min(turn, 1.0), -1.0)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "test")
    parser.add_argument("--traffic", default="idm", help="as bench planners takes it")
    parser.add_argument("--program", action="store_true", help="run as the program")
    parser.add_argument("--smoke", action="store_true", help="a short test run")
    return parser.parse_args()


def main() -> None:
    args = arguments()
    if args.program:
        program()
        return
    scenes = scenes_from(args)
    rows, _ = drive(scenes[:2] if args.smoke else scenes, Piped, TRAFFIC[args.traffic])
    for row in rows:
        print(f"{row['scene']:24s} score {row['score']:.2f}")


if __name__ == "__main__":
    main()
