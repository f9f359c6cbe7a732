"""Benchmarks: figures of episodes, tables, planners, scores."""

import json

import numpy as np
import pytest
import shapely
from array_scenes import agent, array_scene, outline, wide_road

import ccdiff_env
from ccdiff_env import _native, cli
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.planners import Traffic, drive
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.run import episodes_table
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.bench.traffic import control_set, evaluate, traffic_jobs
from ccdiff_env.bench.traffic_report import Condition, conditions, figures_table, summarise, tables
from ccdiff_env.errors import UnknownNameError
from ccdiff_env.metrics import scores
from ccdiff_env.models import weight_files
from ccdiff_env.record.episode import begin
from ccdiff_env.record.episode import play as playing
from ccdiff_env.scenes import SceneSet
from ccdiff_env.system.table import document

VAL = "embedded/val"

SHIPPED = sorted({file.stem.split("_")[0] for file in weight_files()} & {*METHODS})


def measured(method, num_controlled, scenes=1, replan_steps=5, **given):
    return evaluate(
        source=VAL, names=scenes_of(VAL).names[:scenes], method=method,
        num_controlled=num_controlled, replan_steps=replan_steps, seed=0, **given,
    )  # fmt: skip


def test_the_floor_replays_the_log():
    rows = measured("replay", 0, 3)
    for row in rows:
        assert row["fde"] == row["ade"] == 0.0
        assert not row["scr_new"]
        assert row["num_controlled"] == 0
        assert row["fde_controlled"] is None
    json.dumps(rows, allow_nan=False)


@pytest.mark.parametrize("method", SHIPPED)
def test_no_network_moves_a_scene_in_which_it_drives_nobody(method):
    (row,) = measured(method, 0)
    assert row["fde"] == row["ade"] == 0.0


def test_only_the_control_set_leaves_the_log():
    one, everyone = (measured("constant_velocity", k, 2) for k in (1, None))
    for row, full in zip(one, everyone, strict=True):
        assert row["num_controlled"] == 1
        assert full["num_controlled"] == full["num_agents"]
        # the mean over all counts those who replay with zero
        assert row["fde"] == pytest.approx(row["fde_controlled"] / row["num_agents"], rel=1e-6)
        assert full["fde"] == pytest.approx(full["fde_controlled"])


def test_the_others_may_be_driven_by_idm():
    floor, everyone = measured("idm", 0, 3, others="idm"), measured("idm", None, 3)
    assert [row["fde"] for row in floor] == pytest.approx([row["fde"] for row in everyone])
    for row, logged in zip(
        measured("constant_velocity", 1, 3, others="idm"),
        measured("constant_velocity", 1, 3),
        strict=True,
    ):
        assert row["fde_controlled"] == logged["fde_controlled"]
        assert row["fde"] > logged["fde"]
    words = {job.arguments.get("others") for job in traffic_jobs(VAL, ["ccdiff"], others="idm")}
    assert words == {"idm"}


def test_control_sets_grow_by_one_vehicle_at_a_time():
    scene = ccdiff_env.embedded_scenes("val")[0]
    for ranking in ("cliques", "distance_cliques", "first", "random"):
        sets = [control_set(scene, ranking, k) for k in (1, 2, 3, None)]
        assert [len(s) for s in sets[:3]] == [1, 2, 3]
        assert sets[0] == sets[1][:1] == sets[3][:1]
        assert len(set(sets[3])) == len(sets[3])


def test_control_sets_hold_moving_vehicles_only():
    for scene in ccdiff_env.embedded_scenes("val"):
        tracks = scene.tracks()
        speed = np.hypot(*tracks["velocity"][:, 31].T)
        everyone = control_set(scene, "first", None)
        moving = {i for i in everyone if speed[i] > 0.5}
        for ranking in ("cliques", "distance_cliques", "first", "random"):
            assert set(control_set(scene, ranking, 100)) == moving
            assert set(control_set(scene, ranking, None)) == set(everyone)


def _row(scene, collided, off_road, fde, histogram):
    return {
        "scene": scene, "scr": collided, "scr_new": collided, "scr_controlled": False,
        "collision_rate": 0.5 * collided, "orr": off_road, "fde": fde, "fde_controlled": None,
        "sor": False, "comfort": histogram, "comfort_end_bins": histogram,
        "comfort_reference_impl": histogram,
    }  # fmt: skip


def test_tables_hold_means_intervals_and_scores(tmp_path):
    centre = np.zeros((3, 20))
    centre[:, 10] = 1.0
    moved = np.roll(centre, 1, axis=1)
    log = [_row(str(i), False, 0.0, 0.0, centre.tolist()) for i in range(12)]
    rows = [_row(str(i), i < 3, i % 2, float(i), moved.tolist()) for i in range(12)]
    played = {
        Condition("replay", "0", 0.5): log,
        Condition("idm", "1", 0.5): rows,
        Condition("idm", "Full", 0.5): [{**r, "fde": 9.0} for r in rows],
    }
    found = summarise(played)
    figures = found[Condition("idm", "1", 0.5)]
    assert figures["scr"][0] == 0.25
    assert figures["orr"][0] == pytest.approx(0.5)
    assert figures["fde"][0] == 5.5
    # one bin: 0.2, 0.2 m/s² and 0.1 m/s³
    assert figures["cfd"][0] == pytest.approx(100 * 0.5 / 3)
    assert figures["scr"][1] < 0.25 < figures["scr"][2]
    assert np.isnan(figures["fde_controlled"][0])
    text = document(*tables(played, found))
    assert "| Floor: log replay | 0 | 0.5 | | | 0.00 [0.00, 0.00] |" in text
    cs, rs = scores(scr=[0.25, 0.25], orr=[0.5, 0.5], fde=[5.5, 9.0], cfd=[1.0, 1.0])
    for k, c, r in zip(("1", "Full"), cs, rs, strict=True):
        assert f"| IDM | {k} | 0.5 | {c:.2f} | {r:.2f} | 0.25 [" in text
    figures_table(played, found).write_csv(tmp_path / "figures.csv")
    assert len((tmp_path / "figures.csv").read_text(encoding="utf-8").splitlines()) == 4


def test_comfort_distances_draw_the_log_with_the_scenes():
    """A method that is the log, one bin farther in every scene, is as far from it in any draw."""
    ramps = np.zeros((12, 3, 20))
    for i, ramp in enumerate(ramps):
        ramp[:, 2 + i], ramp[:, 3] = 0.5, ramp[:, 3] + 0.5
    log, moved = (
        [
            _row(str(i), False, 0.0, 0.0, np.roll(ramp, by, axis=1).tolist())
            for i, ramp in enumerate(ramps)
        ]
        for by in (0, 1)
    )
    played = {Condition("replay", "0", 0.5): log, Condition("idm", "1", 0.5): moved}
    floor, found = (figures["cfd"] for figures in summarise(played).values())
    assert floor == (0.0, 0.0, 0.0)
    assert found == pytest.approx([100 * 0.5 / 3] * 3)
    # rows of several seeds count as one scene, wherever they stand
    more = [*moved, *({**row, "seed": 1} for row in reversed(moved))]
    assert summarise({**played, Condition("idm", "1", 0.5): more})[Condition("idm", "1", 0.5)][
        "cfd"
    ] == pytest.approx(found)


def test_a_random_ranking_is_drawn_for_every_scene_and_seed():
    scenes = list(ccdiff_env.embedded_scenes("city"))[:60]
    orders: dict[int, set[tuple[int, ...]]] = {}
    for scene in scenes:
        everyone = control_set(scene, "first", None)
        drawn, again, other = (control_set(scene, "random", None, seed) for seed in (0, 0, 1))
        assert drawn == again
        places = tuple(map(sorted(everyone).index, drawn))
        orders.setdefault(len(drawn), set()).add(places)
        assert sorted(other) == sorted(everyone)
    several = [len(found) for count, found in orders.items() if count > 4]
    assert max(several) > 3
    rows = evaluate(
        source="embedded/val", names=scenes_of("embedded/val").names[:2],
        method="ccdiff_random", num_controlled=1, replan_steps=5, seed=4,
    )  # fmt: skip
    assert [row["seed"] for row in rows] == [4, 4, 5, 5, 6, 6]


def test_conditions_stand_by_number_and_intervals_are_never_nan():
    rows = [{"method": "ccdiff", "k": k, "replan_steps": 5} for k in (None, 10, 2, 1)]
    assert [c.k for c in conditions(rows)] == ["1", "2", "10", "Full"]
    histogram = np.full((3, 20), 0.05).tolist()
    rows = [_row(str(i), True, 0.0, 1.0, histogram) for i in range(11)]
    rows = [*({**row, "fde_controlled": 2.0} for row in rows[1:]), rows[0]]
    (figures,) = summarise({Condition("replay", "0", 0.5): rows}).values()
    assert figures["fde_controlled"] == (2.0, 2.0, 2.0)


def test_a_row_of_an_episode_has_its_keys_and_figures_and_no_tape(tmp_path):
    rows = [
        {"planner": "idm", "scene": "a", "score": 0.5, "actions": "QUJD", "action": {"a": 1}},
        {"planner": "idm", "scene": "b", "hit": True, "kinds": ["front"]},
    ]
    episodes_table(rows).write_csv(tmp_path / "episodes.csv")
    assert (tmp_path / "episodes.csv").read_text().splitlines() == [
        "planner,scene,score,hit",
        "idm,a,0.5,",
        "idm,b,,1.0",
    ]


@pytest.mark.parametrize(
    ("first_m", "last_m", "on_road"),
    [(2.0, 2.9, 1.0), (2.0, 3.29, 1.0), (2.0, 3.31, 0.0), (2.0, 5.0, 0.0), (3.2, 3.4, 1.0)],
)
def test_a_corner_may_leave_the_road_by_less_than_0_3_m(first_m, last_m, on_road):
    """A box 2 m wide drifts, heading along a road that ends 4 m to its left. Who begins off the
    road has not left it."""
    y = np.interp(np.arange(150), [30, 125], [first_m, last_m])
    ego = agent("ego", np.linspace(0.0, 100.0, 150), y, size=(4.0, 2.0, 1.5))
    scene = array_scene(ego, layers=wide_road(4.0))
    ((row,), _) = drive(SceneSet([scene]), "replay", Traffic("", "replay"))
    assert row["on_road"] == on_road


def steers(obs):
    return np.tile([0.2, 0.25], (len(obs), 1))


def test_the_way_off_the_road_is_that_of_shapely():
    """Egos that steer off the roads of the city: union of its polygons, distance of corners."""
    scenes = ccdiff_env.embedded_scenes("val")[:6]
    worlds = begin(scenes, PROTOCOL.world(None, "", 0.1).with_options(driver="external"), 0)
    seen, gates = [], np.zeros(6)
    for step in playing(worlds, lambda obs, _: steers(obs)):
        for i in np.flatnonzero(step.running):
            scene, states = scenes[int(i)], worlds.native.states(i)
            ego = worlds.native.slot_agents(i)[0]
            if not states["active"][ego]:  # at its goal, on the road
                continue
            areas = scene.map_layers()["drivable_area"]
            # whose rings have spikes without an area
            polygons = [shapely.Polygon(a["exterior"], a["holes"]).buffer(0) for a in areas]
            road = shapely.unary_union(polygons)
            pose = *states["position"][ego].astype(float), float(states["heading"][ego])
            box = outline(*pose, scene.sizes[ego].astype(float))
            expected = max(road.distance(shapely.Point(c)) for c in box.exterior.coords)
            (found,) = worlds.native.off_road_m(i)
            assert found == pytest.approx(expected, abs=2e-3)
            gates[i] = max(gates[i], expected)
            seen.append(expected)
    assert 0.2 < np.mean(np.array(seen) > 0.0) < 0.95
    rows, _ = drive(scenes, steers, Traffic("", "replay"))
    assert [row["on_road"] for row in rows] == [float(off < 0.3) for off in gates]


def test_the_command_writes_tables_and_refuses_another_runs_folder(tmp_path, capsys):
    command = ["bench", "traffic", "--out", str(tmp_path), "--quiet", "--k", "1,Full"]
    assert cli.main([*command, "--methods", "idm"]) == 0
    assert "Floor" in capsys.readouterr().out
    for name in ("table.md", "table.tex", "episodes.csv", "figures.csv", "run.json"):
        assert (tmp_path / name).stat().st_size > 0
    assert cli.main([*command, "--methods", "idm", "--seed", "1"]) == 2
    assert "other settings: seed" in capsys.readouterr().err
    for t in ("abc", "0.55", "inf", "nan", "0.5,0"):
        assert cli.main([*command, "--methods", "idm", "--t", t]) == 2
        assert f"--t is '{t}', expected multiples of 0.1 s" in capsys.readouterr().err


def test_all_methods_have_drivers_that_exist():
    assert {m.driver for m in METHODS.values()} <= {name for name, *_ in _native.drivers()}


def test_rankings_that_ask_the_network_find_their_own_control_set():
    rows = measured("ccdiff_greedy", 1, 2)
    assert [row["num_controlled"] for row in rows] == [1, 1]


def test_what_cannot_differ_is_not_played_twice():
    one = "embedded/val?limit=1"
    jobs = traffic_jobs(
        one, ["idm", "ccdiff", "ccdiff_random", "ccdiff_no_enc"],
        num_controlled=(2, 5, None), replan_steps=(5, 10), replan_controlled=(5,),
    )  # fmt: skip
    by_method: dict[str, set[tuple[int | None, int]]] = {}
    for job in (job.arguments for job in jobs):
        at = job["num_controlled"], job["replan_steps"]
        by_method.setdefault(job["method"], set()).add(at)
    assert by_method == {
        "replay": {(0, 5)},
        "idm": {(2, 5), (5, 5), (None, 5)},
        "ccdiff": {(2, 5), (5, 5), (5, 10), (None, 5)},
        "ccdiff_random": {(2, 5), (5, 5), (5, 10)},
        "ccdiff_no_enc": {(2, 5), (5, 5), (5, 10), (None, 5)},
    }
    with pytest.raises(UnknownNameError, match="no method 'nobody'"):
        traffic_jobs(one, ["nobody"])
    alone = traffic_jobs(one, ["ccdiff_random"], num_controlled=(None,))
    assert [job.arguments["method"] for job in alone] == ["replay", "ccdiff_random"]


def test_the_order_of_vehicles_does_not_matter_where_all_are_controlled():
    named = ("ccdiff", "ccdiff_random", "ccdiff_greedy")
    played = [measured(method, None, replan_steps=10) for method in named]
    rows = [[row for row in of if row["seed"] == played[0][0]["seed"]] for of in played]
    assert rows[1:] == [rows[0]] * 2
