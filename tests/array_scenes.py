"""Scenes of a few agents on a wide straight road, from arrays."""

import numpy as np
import shapely
from shapely import affinity

from ccdiff_env import EgoEnv, Scene

DT_S = 0.1
STEPS = 160
TIMES_S = np.arange(STEPS) * DT_S
#: Options of worlds that only their time ends.
GOES_ON = {"on_collision": "ignore", "on_off_road": "ignore", "terminate_at_goal": False}


def agent(ident, x, y=0.0, **more):
    """An agent at x, y (m), numbers or one per step; also `heading`, `valid`, `size` and so on."""
    return {"id": ident, "x": x, "y": y, **more}


def wide_road(half_m=100.0, lanes=()):
    """Layers of a map: a drivable area along x, and lanes at these y (m)."""
    ring = np.array([[-300, -half_m], [600, -half_m], [600, half_m], [-300, half_m]], np.float32)
    names = ("ped_crossings", "walkways", "stop_lines", "carpark_areas", "road_dividers")
    empty = {name: [] for name in (*names, "lane_dividers")}
    x = np.arange(-300, 601, dtype=np.float32)
    lines = {f"lane {y}": np.stack([x, 0 * x + np.float32(y)], 1) for y in lanes}
    made = [{"id": name, "kind": "lane", "centreline": line} for name, line in lines.items()]
    return {"drivable_area": [{"exterior": ring, "holes": []}], "lanes": made, **empty}


def array_scene(*agents, name="own", dt_s=DT_S, layers=None):
    """A scene of such agents, gaps and all; velocities are differences of the positions."""
    steps = max(np.size(a["x"]) for a in agents)

    def rows(key, default):
        return np.stack([np.broadcast_to(np.asarray(a.get(key, default)), steps) for a in agents])

    x, y = rows("x", 0.0).astype(float), rows("y", 0.0).astype(float)
    position, valid = np.stack([x, y], -1), rows("valid", True).astype(bool)
    velocity = np.gradient(position, dt_s, axis=1) if steps > 1 else np.zeros_like(position)
    for row in np.flatnonzero([a.get("appears", False) for a in agents]):  # not from where it was
        velocity[row, valid[row]] = np.gradient(position[row, valid[row]], dt_s, axis=0)
    return Scene.from_arrays(
        name,
        agent_ids=[a["id"] for a in agents],
        agent_types=[a.get("kind", "vehicle") for a in agents],
        sizes=np.array([a.get("size", (4.5, 2.0, 1.6)) for a in agents], np.float32),
        position=position.astype(np.float32),
        heading=rows("heading", 0.0).astype(np.float32),
        velocity=velocity.astype(np.float32),
        valid=valid,
        dt=dt_s,
        map_layers=wide_road() if layers is None else layers,
        mend=False,
    )


def rebuilt(scene, name=None, **changes):
    """The scene made again from its arrays, with changes."""
    own = ("agent_ids", "agent_types", "agent_categories", "sizes", "dt")
    more = ("token", "location", "source", "origin")
    fields = {field: getattr(scene, field) for field in (*own, *more)}
    fields |= {**scene.tracks(), "map_layers": scene.map_layers(), **changes}
    return Scene.from_arrays(name or scene.name, **fields)


def outline(x, y, heading, size):
    """The box of an agent, as shapely has it."""
    flat = shapely.box(-size[0] / 2, -size[1] / 2, size[0] / 2, size[1] / 2)
    turned = affinity.rotate(flat, heading, (0, 0), use_radians=True)
    return affinity.translate(turned, x, y)


def log_env(*agents, dt_s=DT_S, layers=None, **options):
    """An environment of a scene of such agents, whose ego follows its log to the end."""
    options = {"driver": "replay", "terminate_at_goal": False, "dt_s": dt_s, **options}
    return EgoEnv(scenes=[array_scene(*agents, dt_s=dt_s, layers=layers)], **options)


def begun(**options):
    """An environment of one ego, at the beginning of the episode of seed 0."""
    env = EgoEnv(**options)
    env.reset(seed=0)
    return env


def played(env, action=None, seed=0, **reset):
    """Play an episode; yield step of the log, states and info after each step."""
    env.reset(seed=seed, **reset)
    native, done = env.worlds.native, False
    while not done:
        act = np.zeros(env.action_space.shape, np.float32) if action is None else action
        _, reward, terminated, truncated, info = env.step(act)
        done = terminated or truncated
        ends = {"reward": reward, "terminated": terminated, "truncated": truncated}
        yield native.status(0).step_idx, native.states(0), {**info, **ends}


def driven(scene, path, **options):
    """Infos of an episode whose ego goes along a path [T, 3] of the scene, step by step."""
    env = begun(scenes=[scene], **{"dynamics": "delta_pose", "on_collision": "ignore", **options})
    native, infos = env.worlds.native, []
    low, high = (np.array(bound) for bound in list(zip(*native.action_bounds, strict=True))[1:])
    done = False
    while not done:
        k, states = native.status(0).step_idx, native.states(0)
        (x, y), h = states["position"][0], states["heading"][0]
        dx, dy = path[k + 1, 0] - x, path[k + 1, 1] - y
        cos, sin = np.cos(h), np.sin(h)
        local = np.array([dx * cos + dy * sin, dy * cos - dx * sin, path[k + 1, 2] - h])
        act = np.where(local >= 0, local / high, -local / low).astype(np.float32)
        _, reward, terminated, truncated, info = env.step(act)
        done = terminated or truncated
        infos.append({**info, "reward": reward, "at": native.states(0)["position"][0].copy()})
        infos[-1]["active"] = native.states(0)["active"][0]
    return env, infos


def line(x, y=0.0, heading=0.0):
    return np.stack(np.broadcast_arrays(x, y, heading), -1).astype(float)
