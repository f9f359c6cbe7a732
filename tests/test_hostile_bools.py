"""Arrays of bool whose bytes are neither 0 nor 1: views of numpy have them, and they are true."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from ccdiff_env import EgoVectorEnv, Scene, _native

STUB = Path(_native.__file__).with_name("_native.pyi")
A, T = 3, 40
VALID = np.ones((T, A), bool)
VALID[:7, 1] = False
SOME = np.array([True, False, True])


def odd(mask):
    """The same flags; bytes of those that are set are 2, 3, 254, 255."""
    bytes_ = np.resize(np.array([2, 3, 254, 255], np.uint8), mask.shape)
    return np.where(mask, bytes_, 0).astype(np.uint8).view(bool)


def states(shape=(T, A)):
    rng = np.random.default_rng(0)
    return [rng.uniform(-9, 9, shape).astype(np.float32) for _ in range(4)]


SIZES = np.full(A, 4.0, np.float32), np.full(A, 2.0, np.float32)


def motion(valid):
    x, y, heading, _ = (np.ascontiguousarray(part.T) for part in states())
    return _native.Trajectories(0.1, x, y, heading, valid, np.stack(SIZES, 1))


def scene(valid):
    x, y, heading, speed = states((A, T))
    made = Scene.from_arrays(
        "bools",
        agent_ids=["ego", "a", "b"],
        agent_types=["vehicle"] * A,
        sizes=np.full((A, 3), 2.0, np.float32),
        position=np.stack([x, y], -1),
        heading=heading,
        velocity=np.stack([speed, speed], -1),
        valid=valid,
    )
    return made.to_bytes(), made.tracks()["valid"].view(np.uint8).tolist()


def ranked(valid):
    measure = np.abs(np.stack([part[:A] for part in states()])).astype(np.float32)
    return _native.causal_rank("first", 2, valid, measure, measure, None, None, 0, (3.0, 1, 2, 9))


def drawn(**flags):
    x, y, heading, _ = (part[0] for part in states())
    kinds = np.zeros(A, np.uint8)
    return _native.render_arrays(
        np.stack([x, y], 1), heading, np.stack(SIZES, 1), kinds, kinds,
        flags.get("collided", SOME), flags.get("parked", SOME), flags.get("arrived", SOME),
        scene=None, size=(64, 64), span_m=30.0, centre_m=(0.0, 0.0), up_rad=0.0,
        route_m=np.zeros((0, 2), np.float32), trails=[], samples=[], plans=[], arrows=[],
        collisions_m=np.zeros((0, 2), np.float32), names=[], caption="", scale_bar=False,
        legend=[], theme="light", svg=False,
    )  # fmt: skip


def stepped(active):
    env = EgoVectorEnv(A, traffic="idm")
    env.reset(seed=0)
    native = env.worlds.native
    native.step(np.full((A, 1, 2), 0.5, np.float32), env.worlds.arrays(), active)
    return [native.status(i).elapsed_steps for i in range(A)], [native.digest(i) for i in range(A)]


AREA = [([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]], [])]
#: Call with the flags of an argument, and those flags.
CASES = {
    "causal_ttc.valid": (lambda m: _native.causal_ttc(*states(), *SIZES, m, "oriented"), VALID),
    "causal_distance.valid": (lambda m: _native.causal_distance(*states()[:2], m), VALID),
    "causal_rank.valid": (ranked, SOME),
    "render_arrays.collided": (lambda m: drawn(collided=m), SOME),
    "render_arrays.parked": (lambda m: drawn(parked=m), SOME),
    "render_arrays.arrived": (lambda m: drawn(arrived=m), SOME),
    "Trajectories.__new__.valid": (
        lambda m: motion(m).comfort("body", 1),
        np.ascontiguousarray(VALID.T),
    ),
    "Trajectories.collisions.controlled": (
        lambda m: motion(VALID.T.copy()).collisions(m, None),
        SOME,
    ),
    "Trajectories.off_road.counted": (
        lambda m: motion(VALID.T.copy()).off_road(AREA, [], m, 5),
        SOME,
    ),
    "Trajectories.over_speed.counted": (
        lambda m: motion(VALID.T.copy()).over_speed(1.0, 0.1, m),
        SOME,
    ),
    "Scene.from_arrays.valid": (scene, np.ascontiguousarray(VALID.T)),
    "VecWorld.step.active": (stepped, SOME),
}


def arguments_of_bools():
    """``Class.function.argument`` of every array of bool that the extension takes."""
    tree = ast.parse(STUB.read_text(encoding="utf-8"))
    for node in tree.body:
        inside = node.body if isinstance(node, ast.ClassDef) else [node]
        for made in inside:
            if isinstance(made, ast.FunctionDef):
                where = f"{node.name}.{made.name}" if made is not node else made.name
                for argument in (*made.args.args, *made.args.kwonlyargs):
                    said = argument.annotation and ast.unparse(argument.annotation)
                    if said and "Bool" in said:
                        yield f"{where}.{argument.arg}"


def test_every_argument_of_bools_is_tried():
    assert set(arguments_of_bools()) == set(CASES)


@pytest.mark.parametrize("name", CASES)
def test_any_byte_but_zero_is_true(name):
    call, flags = CASES[name]
    np.testing.assert_equal(call(odd(flags)), call(flags))
