"""What wrappers and learners of others ask: attributes, spaces, options of resets."""

import copy

import gymnasium
import numpy as np
import pytest
from array_scenes import begun, played
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecNormalize

import ccdiff_env
from ccdiff_env import AdversarySelectionVectorEnv, AgentVectorEnv, EgoEnv
from ccdiff_env.envs.sb3 import AgentSB3VecEnv, SB3VecEnv, SelectionSB3VecEnv
from ccdiff_env.errors import ConfigError, ResetNeededError, UnknownNameError
from ccdiff_env.planners.built_in import ego_driver

NUM_SCENES = 2


def test_a_learner_chooses_when_worlds_begin_anew(scenes):
    options = {"scenes": scenes, "horizon_steps": 3, "traffic": "idm"}
    worlds = ccdiff_env.make_vec(2, **options)
    played = []
    for env in (worlds, ccdiff_env.make_vec(2, autoreset_mode="same_step", **options)):
        learner = SB3VecEnv(env)
        learner.seed(7)
        out = [learner.reset()]
        for _ in range(5):
            obs, rewards, dones, _ = learner.step(np.zeros((2, 2), np.float32))
            out += [obs, rewards, dones]
        played.append(out)
    assert played[0][9].all()  # the third step ends the episodes
    assert all(np.array_equal(a, b) for a, b in zip(*played, strict=True))
    assert worlds.autoreset_mode is AutoresetMode.SAME_STEP
    assert worlds.config.autoreset == "same_step"
    begun = ccdiff_env.make_vec(2, **options)
    begun.reset(seed=0)
    for env in (begun, gymnasium.vector.VectorWrapper(ccdiff_env.make_vec(2, **options))):
        with pytest.raises(ConfigError, match="expected SAME_STEP: make_vec"):
            SB3VecEnv(env)
    with pytest.raises(ConfigError, match="have begun"):
        begun.set_autoreset_mode("disabled")


def test_an_unknown_keyword_is_a_type_error_too():
    ids = lambda **o: gymnasium.make("ccdiff_env/Ego-v0", **o)  # noqa: E731
    for make in (ccdiff_env.EgoEnv, ids, ccdiff_env.WorldConfig):
        with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
            make(frameskip=4)
        with pytest.raises(ConfigError, match="unknown option 'trafic'; did you mean 'traffic'"):
            make(trafic="idm")


def is_numeric(value):
    if isinstance(value, dict):
        return all(map(is_numeric, value.values()))
    return np.asarray(value).dtype.kind in "biuf"


def test_without_information_there_are_numbers_alone(scenes):
    options = {"scenes": scenes, "info": "none"}
    vector = ccdiff_env.make_vec(2, **options)
    infos = vector.reset(seed=0, options={"scene": [1, 0]})[1]
    assert infos["scene_idx"].tolist() == [1, 0]
    single = ccdiff_env.EgoEnv(**options)
    told = [infos, single.reset(seed=0)[1], single.step(single.action_space.sample())[4]]
    told.append(ccdiff_env.parallel_env(agents=2, **options).reset(seed=0)[1])
    told.append(AgentVectorEnv(2, agents=2, **options).reset(seed=0)[1])
    assert all(map(is_numeric, told))


def test_a_recorder_made_after_a_reset_has_started(scenes):
    env = begun(scenes=scenes, traffic="idm", driver="idm")
    recorder = ccdiff_env.Recorder(env)
    with pytest.raises(ResetNeededError, match="no step is recorded"):
        recorder.rollout()
    env.step(env.action_space.sample())
    recorder.step()
    assert recorder.rollout().num_steps == 2
    env = ccdiff_env.AdversarySelectionEnv(scenes=scenes)
    env.reset(seed=0)
    recorder = ccdiff_env.Recorder(env)
    env.step(0)
    assert recorder.rollout().num_steps == env.unwrapped.worlds.config.ccdiff.replan_steps + 1


RASTER = {"observation": "dict", "bev": {"size_px": 36}}


def own(env):
    """All spaces of an environment and of its worlds, as they are."""
    names = ("observation_space", "action_space", "single_observation_space", "single_action_space")
    found = {name: getattr(env, name) for name in names if hasattr(env, name)}
    return found | {"worlds": env.worlds.action_space}


def spoil(space):
    """Change a space in place, as wrappers do."""
    if isinstance(space, spaces.Dict):
        for name in list(space.spaces):
            space.spaces[name] = spaces.Discrete(2)
    elif isinstance(space, spaces.Box):
        space.low[:], space.high[:] = -3.0, 3.0
    elif isinstance(space, spaces.MultiBinary):
        space.n, space._shape = 1, (1,)


def test_worlds_go_on_whatever_is_done_to_a_space_that_was_handed_out(scenes):
    rows = AgentVectorEnv(2, scenes=scenes, agents=2)
    selection = AdversarySelectionVectorEnv(2, scenes=scenes, horizon_steps=10)
    for env, vec in (
        (ccdiff_env.make_vec(2, scenes=scenes), SB3VecEnv),
        (ccdiff_env.make_vec(2, scenes=scenes, **RASTER), SB3VecEnv),
        (rows, AgentSB3VecEnv),
        (selection, SelectionSB3VecEnv),
    ):
        before = copy.deepcopy(own(env))
        made = vec(env)
        actions = np.stack([made.action_space.sample() for _ in range(made.num_envs)])
        spoil(made.observation_space)
        spoil(made.action_space)
        assert own(env) == before
        for space in own(env).values():
            spoil(space)
        made.reset()
        made.step(actions)
    env = EgoEnv(scenes=scenes)
    spoil(env.action_space)
    env.reset(seed=0)
    assert env.step(np.zeros(2, np.float32))[0].shape == env.observation_space.shape
    assert env.expert_action().shape == (2,)


def test_a_policy_of_changed_observations_is_refused(scenes):
    """stable-baselines3 changes the raster's space of an environment of one world in place."""
    env = DummyVecEnv([lambda: EgoEnv(scenes=scenes, **RASTER)])
    norm = VecNormalize(env, norm_obs_keys=["bev"], norm_reward=False)
    model = PPO("MultiInputPolicy", norm, n_steps=4, batch_size=4, n_epochs=1, seed=0)
    worlds = EgoEnv(scenes=scenes, **RASTER).worlds
    worlds.native.reset([0], [0], None, worlds.arrays())
    with pytest.raises(ConfigError, match="another space"):
        ego_driver(model)[1].begin(worlds)
    plain = PPO("MultiInputPolicy", SB3VecEnv(ccdiff_env.make_vec(1, scenes=scenes, **RASTER)))
    ego_driver(plain)[1].begin(worlds)


TOLD = ("scene", "ego", "start_step")


def driver_of(worlds, world_idx, agent):
    ids = worlds.scenes[worlds.native.status(world_idx).scene_idx].agent_ids
    return worlds.native.drivers(world_idx)[list(ids).index(agent)]


def drawn(scenes, scene):
    """An ego that a scene has, besides the logged one."""
    env = EgoEnv(scenes=scenes, ego="any")
    for seed in range(9):
        ego = env.reset(seed=seed, options={"scene": scene})[1]["ego"]
        if ego != "ego":
            return ego
    raise AssertionError(scene)


def cases(scenes):
    one, two = scenes.names[:2]
    other = drawn(scenes, one)
    return [
        ({"scene": one}, {}),
        ([{"scene": one}, {"scene": two}], {}),
        ([{}, {"scene": two}], {}),
        ([{"scene": one, "ego": other, "start": 50}, {"scene": two}], {"ego": "any"}),
        ({"style": {"comfort": 4.0}}, {"style": {"comfort": (0.0, 4.0)}}),
        (
            [{"style": {"comfort": 4.0}}, {"style": {"comfort": 1.0}}],
            {"style": {"comfort": (0.0, 4.0)}},
        ),
        ({"scene": one, "drivers": {other: "replay"}}, {"traffic": "idm"}),
        ([{"scene": one, "drivers": {other: "replay"}}, {"scene": one}], {"traffic": "idm"}),
    ]


def test_stable_baselines3_tells_worlds_what_it_tells_environments(scenes):
    for options, made in cases(scenes):
        native = SB3VecEnv(ccdiff_env.make_vec(2, scenes=scenes, **made))
        envs = [EgoEnv(scenes=scenes, **made) for _ in range(2)]
        single = DummyVecEnv([lambda env=env: env for env in envs])
        found = []
        for vec in (native, single):
            vec.seed(3)
            vec.set_options(options)
            found.append(vec.reset())
        assert np.array_equal(*found), options
        for i, env in enumerate(envs):
            told = [vec.reset_infos[i] for vec in (native, single)]
            assert [one.get(name) for one in told for name in TOLD] == [
                told[0].get(name) for _ in told for name in TOLD
            ]
            drivers = [native.env.worlds.native.drivers(i), env.worlds.native.drivers(0)]
            assert drivers[0] == drivers[1], options
        actions = np.zeros((2, 2), np.float32)
        for _ in range(5):
            rows = [vec.step(actions) for vec in (native, single)]
            assert all(
                np.array_equal(a, b) for a, b in zip(*(row[:3] for row in rows), strict=True)
            )
        # told once
        assert [vec._options for vec in (native, single)] == [[{}, {}]] * 2


def test_what_no_world_takes_is_refused_by_every_door(scenes):
    game = ccdiff_env.parallel_env(scenes=scenes, agents=2)
    rows = AgentVectorEnv(2, scenes=scenes, agents=2)
    selection = AdversarySelectionVectorEnv(2, scenes=scenes)
    doors = [EgoEnv(scenes=scenes), ccdiff_env.make_vec(2, scenes=scenes), game, rows, selection]
    doors += [ccdiff_env.AdversarySelectionEnv(scenes=scenes)]
    for env in doors:
        with pytest.raises(ConfigError, match="did you mean 'scene'"):
            env.reset(seed=0, options={"scen": scenes.names[0]})
        with pytest.raises(ConfigError, match="expected a dictionary"):
            env.reset(seed=0, options=["scene"])
    for vec in (
        SB3VecEnv(ccdiff_env.make_vec(2, scenes=scenes)),
        AgentSB3VecEnv(rows),
        SelectionSB3VecEnv(selection),
    ):
        vec.set_options({"scen": scenes.names[0]})
        with pytest.raises(ConfigError, match="did you mean 'scene'"):
            vec.reset()
        vec.set_options({"reset_mask": np.ones(2, np.bool_)})
        with pytest.raises(ConfigError, match="reset_mask"):
            vec.reset()
        vec.set_options([{"scene": 0}] * (vec.num_envs + 1))
        with pytest.raises(ConfigError, match=f"{vec.num_envs + 1} options"):
            vec.reset()
    game.reset(seed=0, options={"options": 1})  # PettingZoo's own tests


def test_rows_of_a_world_are_told_the_same(scenes):
    one, two = scenes.names[:2]
    env = AgentVectorEnv(2, scenes=scenes, agents=2, traffic="idm")
    vec = AgentSB3VecEnv(env)
    vec.set_options([{"scene": one}, {}, {"scene": two}, {"scene": two}])
    vec.reset()
    assert [info["scene"] for info in vec.reset_infos] == [one, one, two, two]
    vec.set_options([{"scene": one}, {"scene": two}, {}, {}])
    with pytest.raises(ConfigError, match="rows of one world"):
        vec.reset()
    ids = scenes[0].agent_ids
    kept = {env.worlds.native.slot_agents(0)[c] for c in range(2)}
    other = next(i for i in range(len(ids)) if env.worlds.native.drivers(0)[i] == "idm")
    assert other not in kept
    env.reset(seed=0, options={"scene": [one, two], "drivers": {ids[other]: "replay"}})
    assert driver_of(env.worlds, 0, ids[other]) == "replay"
    env.reset(seed=0, options={"scene": one, "drivers": [{}, {ids[other]: "replay"}]})
    assert [driver_of(env.worlds, e, ids[other]) for e in range(2)] == ["idm", "replay"]


def test_drivers_are_told_to_all_worlds_or_to_each(scenes):
    one, two = scenes.names[:2]
    ids = [set(scene.agent_ids) for scene in scenes[:2]]
    only = next(i for i in scenes[0].agent_ids if i in ids[0] - ids[1])
    env = ccdiff_env.make_vec(2, scenes=scenes, traffic="idm")
    env.reset(seed=0, options={"scene": [one, two], "drivers": {only: "replay"}})
    assert driver_of(env.worlds, 0, only) == "replay"
    env.reset(seed=0, options={"scene": [one, two], "drivers": [{only: "replay"}, None]})
    assert driver_of(env.worlds, 0, only) == "replay"
    with pytest.raises(UnknownNameError, match=f"{two}.*world 1.*{only}"):
        env.reset(seed=0, options={"scene": [one, two], "drivers": [{}, {only: "replay"}]})
    with pytest.raises(ConfigError, match="drivers has 3 entries"):
        env.reset(seed=0, options={"drivers": [{}, {}, {}]})
    rows = AgentVectorEnv(2, scenes=scenes, agents=2, traffic="idm")
    walks = scenes[0].agent_ids[scenes[0].agent_types.index("pedestrian")]
    for door in (env, rows, AdversarySelectionVectorEnv(2, scenes=scenes)):
        for agent in ("nobody", walks):
            with pytest.raises(UnknownNameError, match=f"no scene has a vehicle '{agent}'"):
                door.reset(seed=0, options={"drivers": {agent: "idm"}})


def test_processes_of_stable_baselines3_give_the_bits_of_one_process(scenes):
    def make():
        return EgoEnv(scenes=scenes[:2], traffic="ccdiff", criticality=1.0, horizon_steps=12)

    seen = []
    for form in (DummyVecEnv, SubprocVecEnv):
        env = form([make] * 2)
        env.seed(3)
        steps = [env.reset()]
        for t in range(15):  # over the end of an episode
            steps += env.step(np.full((2, 2), 0.1 * (t % 3), np.float32))[:3]
        env.close()
        seen.append(steps)
    for one, other in zip(*seen, strict=True):
        assert np.array_equal(one, other)


def test_a_collision_terminates_and_the_horizon_truncates():
    crash = EgoEnv(scenes="val", traffic="idm", on_off_road="ignore", horizon_steps=150)
    endings = set()
    for seed in range(12):
        *_, (_, _, info) = played(crash, np.array([1.0, 0.0], np.float32), seed=seed)
        caused = bool(info["collision"] or info["goal_reached"])
        assert (info["terminated"], info["truncated"]) == (caused, bool(info["time_limit"]))
        assert caused != info["truncated"]
        endings.add(caused)
    assert True in endings


@pytest.mark.parametrize(
    ("learner", "options"), [(SAC, {"dynamics": "bicycle"}), (DQN, {"discrete": True})]
)
def test_learners_with_a_memory_learn_on_it(learner, options, scenes):
    env = EgoEnv(scenes=scenes, traffic="idm", horizon_steps=20, **options)
    settings = {"learning_starts": 50, "batch_size": 32, "policy_kwargs": {"net_arch": [16]}}
    model = learner("MlpPolicy", env, seed=0, **settings).learn(200)
    assert len(model.ep_info_buffer) > 0


EPISODE = ("scene", "scene_token", "scene_idx", "seed", "episode_idx", "start_step", "criticality")


def test_an_ended_episode_says_which_one_it_was(scenes):
    """Its last information repeats that of its reset, whoever plays it; a restored one's, too."""
    options = {"scenes": scenes, "traffic": "swift", "criticality": (0.0, 2.0), "horizon_steps": 4}
    still, same = np.zeros(2, np.float32), AutoresetMode.SAME_STEP

    def told(info, i=None):
        return {name: info[name] if i is None else info[name][i] for name in EPISODE}

    env = EgoEnv(start_spread_steps=20, **options)
    for seed in range(3):
        begun = env.reset(seed=seed)[1]
        info = env.step(still)[4]
        assert "scene" not in info
        saved = env.snapshot()
        env.reset(seed=9)
        env.restore(saved)
        while "metrics" not in info:
            info = env.step(still)[4]
        assert told(info) == told(begun)
    for mode in AutoresetMode:
        worlds = ccdiff_env.make_vec(3, autoreset_mode=mode, **options)
        begun = worlds.reset(seed=2)[1]
        while not (done := np.logical_or(*(out := worlds.step(np.zeros((3, 2))))[2:4])).any():
            pass
        ended = out[4].get("final_info", out[4])
        for i in np.flatnonzero(done):
            assert told(ended, i) == told(begun, i)
            assert out[4]["episode_idx"][i] == int(mode is same)
    rows = AgentVectorEnv(2, agents=2, **options)
    for vec in (SB3VecEnv(ccdiff_env.make_vec(2, **options)), AgentSB3VecEnv(rows)):
        vec.seed(5)
        vec.reset()
        before, seen = list(vec.reset_infos), 0
        while seen == 0:
            _, _, dones, infos = vec.step(np.zeros((vec.num_envs, 2), np.float32))
            for i in np.flatnonzero(dones):
                assert told(infos[i]) == told(before[i])
                seen += 1
        assert vec.reset_infos != before


def test_options_that_stay_are_refused_and_criticality_holds_from_the_next_reset(scenes):
    options = {"scenes": scenes, "traffic": "swift", "horizon_steps": 3}
    doors = [EgoEnv(**options), ccdiff_env.make_vec(2, **options)]
    doors += [ccdiff_env.parallel_env(agents=2, **options), AgentVectorEnv(2, agents=2, **options)]
    for env in doors:
        env.criticality = lambda progress: 2.0 * progress
        env.set_progress(0.5)
        assert set(np.ravel(values_of(env.reset(seed=0)[1], "criticality"))) == {1.0}
        env.criticality = 0.5
        assert env.criticality == 0.5
        assert set(np.ravel(values_of(env.reset(seed=0)[1], "criticality"))) == {0.5}
        with pytest.raises(ConfigError, match="expected a number of at least 0"):
            env.criticality = "high"
    doors += [
        AdversarySelectionVectorEnv(2, scenes=scenes),
        ccdiff_env.AdversarySelectionEnv(scenes=scenes),
    ]
    for env in doors:
        for name in ("traffic", "reward", "dynamics", "scenes", "horizon_steps"):
            with pytest.raises(ConfigError, match=f"{name} is an option.*criticality can"):
                setattr(env, name, 1)
        env.curiosity = 1.0  # what is no option is the user's
    with pytest.raises(ConfigError, match="criticality is an option"):
        doors[-1].criticality = 1.0
    with pytest.raises(ConfigError, match="expected one that can be guided"):
        EgoEnv(scenes=scenes, traffic="idm").criticality = 1.0
    worlds = ccdiff_env.make_vec(2, autoreset_mode="same_step", **options)
    vec = SB3VecEnv(gymnasium.vector.VectorWrapper(worlds))
    vec.set_attr("criticality", 1.5)
    vec.reset()
    assert [info["criticality"] for info in vec.reset_infos] == [1.5, 1.5]
    assert vec.get_attr("criticality") == [1.5, 1.5]
    with pytest.raises(ConfigError, match="traffic is an option"):
        vec.set_attr("traffic", "idm")


def values_of(info, name):
    """A value of one world's information, of all worlds', or of all agents'."""
    return info[name] if name in info else [of[name] for of in info.values()]


def test_misspelt_arguments_are_guessed_and_the_wrong_wrapper_is_named(scenes):
    for name, words in {
        "criticallity": "did you mean 'criticality'",
        "scene": "did you mean 'scenes'",
        "dynamic": "did you mean 'dynamics'",
        "zzz": "criticality.*info.*scenes",
    }.items():
        for make in (EgoEnv, ccdiff_env.make_vec, ccdiff_env.parallel_env):
            with pytest.raises(ConfigError, match=words):
                make(**{name: 1})
    with pytest.raises(ConfigError, match="render_mode is 'video', expected None or one of"):
        EgoEnv(render_mode="video")
    with pytest.raises(ConfigError, match=r"no source 'city_train' .did you mean 'train'"):
        EgoEnv(scenes="city_train")
    with pytest.raises(ConfigError, match=r"names=..double-left-0"):
        EgoEnv(scenes="double-left-0")
    with pytest.raises(ConfigError, match=r"names=\[\.\.\.\]\) gives"):
        EgoEnv(scenes=["double-left-00"])
    with pytest.raises(UnknownNameError, match="did you mean 'double-left-0"):
        EgoEnv().reset(options={"scene": "double-left-0"})
    for wrong in (gymnasium.make("ccdiff_env/Ego-v0"), EgoEnv(scenes=scenes)):
        with pytest.raises(ConfigError, match=r"takes the worlds of make_vec.*to the algorithm"):
            SB3VecEnv(wrong)
    for made, wrong in (
        (SB3VecEnv, AgentVectorEnv(2, scenes=scenes, agents=2)),
        (AgentSB3VecEnv, ccdiff_env.make_vec(2, scenes=scenes)),
    ):
        with pytest.raises(ConfigError, match="AgentVectorEnv needs AgentSB3VecEnv"):
            made(wrong)


def test_observations_are_chosen_by_a_dictionary_as_rewards_are(scenes):
    columns = {"num_neighbors": 3, "ego_columns": ("speed",)}
    config = ccdiff_env.WorldConfig().with_options(observation=columns)
    for form in ("flat", "dict"):
        short = EgoEnv(scenes=scenes, observation={"form": form, **columns})
        assert (
            short.observation_space
            == EgoEnv(scenes=scenes, config=config, observation=form).observation_space
        )
    with pytest.raises(ConfigError, match=r"observation.num_neighbours"):
        EgoEnv(observation={"num_neighbours": 3})
    with pytest.raises(ConfigError, match="unknown observation form 'flatt'"):
        EgoEnv(observation={"form": "flatt"})


@pytest.mark.parametrize(("dt_steps", "fps"), [(1, 10.0), (4, 2.5)])
def test_videos_last_as_long_as_the_drive(dt_steps, fps, scenes):
    options = {"scenes": scenes, "decision_steps": dt_steps}
    worlds = ccdiff_env.make_vec(2, **options)
    envs = [EgoEnv(**options), worlds, SB3VecEnv(worlds)]
    envs += [ccdiff_env.parallel_env(agents=2, **options), AgentVectorEnv(1, agents=2, **options)]
    assert [env.metadata["render_fps"] for env in envs] == [fps] * len(envs)
    plans = AdversarySelectionVectorEnv(1, scenes=scenes)
    assert plans.metadata["render_fps"] == 1.0 / (0.1 * plans.decision_steps)


def _seeded(env, seed):
    if isinstance(env, SB3VecEnv):
        env.seed(seed)
        return env.reset()
    return env.reset(seed=seed)[0]


@pytest.mark.parametrize(
    "made",
    [
        lambda: ccdiff_env.AdversarySelectionEnv(ego="idm"),
        lambda: SB3VecEnv(ccdiff_env.make_vec(2)),
        lambda: AgentSB3VecEnv(AgentVectorEnv(2, agents=2)),
    ],
)
def test_any_integer_is_a_seed_and_no_other_number(made):
    env = made()
    first = _seeded(env, 7)
    for kind in (np.uint8, np.int64, np.uint64):
        assert np.array_equal(_seeded(env, kind(7)), first)
    assert np.array_equal(_seeded(env, np.int64(2**40 + 1)), _seeded(env, 2**40 + 1))
    for seed in (-1, 2**70):
        _seeded(env, seed)
    for wrong in (7.0, "7", np.float32(7), np.array([1.5]), float("nan")):
        with pytest.raises(ConfigError, match="seed is"):
            _seeded(env, wrong)
