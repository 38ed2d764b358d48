"""`gymnasium.vector`: its checks, its auto-reset within the step, its seeds, and its wrappers."""

import pathlib

import numpy as np
import pytest

vector_world = pytest.importorskip("jaxnav.adapters.gymnasium", exc_type=ImportError)

import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from jaxnav import Params, World, WorldConfig, maps

COUNT = 4
OFFICE = pathlib.Path(__file__).parents[2] / "examples" / "office.yaml"
STAND = {"twist": np.tile(np.float32([-1.0, 0.0]), (COUNT, 1)), "request": np.zeros(COUNT, np.int64)}


@pytest.fixture(scope="module")
def envs(world, params):
    return vector_world.VectorWorld(COUNT, world, params)


class First(gymnasium.Env):
    """The first environment of a vector: what the checker of single environments can look at."""

    def __init__(self, envs):
        self.envs = envs
        self.observation_space, self.action_space = envs.single_observation_space, envs.single_action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observations, infos = self.envs.reset(seed=seed, options=options)
        return {name: part[0] for name, part in observations.items()}, infos

    def step(self, action):
        actions = {name: np.stack([part] * COUNT) for name, part in action.items()}
        observations, rewards, terminated, truncated, infos = self.envs.step(actions)
        first = {name: part[0] for name, part in observations.items()}
        return first, float(rewards[0]), bool(terminated[0]), bool(truncated[0]), infos


def test_an_environment_of_it_passes_the_check_of_gymnasium(envs):
    check_env(First(envs), skip_render_check=True)


def test_gymnasium_makes_it_by_name(world):
    spec = gymnasium.envs.registration.EnvSpec(
        "jaxnav-v0", vector_entry_point="jaxnav.adapters.gymnasium:VectorWorld", kwargs={"world": world}
    )
    made = gymnasium.make_vec(spec, num_envs=3, vectorization_mode="vector_entry_point")
    assert made.num_envs == 3
    assert made.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert made.action_space.sample()["request"].shape == (3,)
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        made.unwrapped.step(made.action_space.sample())


def test_the_last_observation_of_an_ended_episode_is_kept(envs, follows, is_first):
    observations, infos = envs.reset(seed=1)
    assert infos == {}
    assert is_first(observations["pose"])
    for step in range(11):
        before = observations
        observations, rewards, terminated, truncated, infos = envs.step(STAND)
        assert observations in envs.observation_space
        assert rewards.shape == terminated.shape == truncated.shape == (COUNT,)
        assert not terminated.any()
        assert truncated.tolist() == [step in (4, 9)] * COUNT
        if not truncated.any():
            assert infos == {}
            assert follows(before["pose"], observations["pose"])
            continue
        assert is_first(observations["pose"])
        assert infos["_final_obs"].all() and infos["_final_info"].all()
        assert not (infos["final_info"]["arrived"] | infos["final_info"]["collided"]).any()
        for i in range(COUNT):
            assert infos["final_obs"][i] in envs.single_observation_space
            assert follows(before["pose"][i], infos["final_obs"][i]["pose"])


def test_only_the_ended_episodes_are_replaced(envs, follows, is_first):
    """Robots that drive ahead arrive, each in its own time, or run out of it."""
    observations, _ = envs.reset(seed=2)
    ahead = {"twist": np.tile(np.float32([1.0, 0.0]), (COUNT, 1)), "request": np.zeros(COUNT, np.int64)}
    mixed = arrived = 0
    for _ in range(30):
        before = observations
        observations, _, terminated, truncated, infos = envs.step(ahead)
        ended = terminated | truncated
        assert not (terminated & truncated).any()
        mixed += ended.any() and not ended.all()
        for i in range(COUNT):
            assert is_first(observations["pose"][i]) == ended[i]
            last = infos["final_obs"][i] if ended[i] else {name: part[i] for name, part in observations.items()}
            assert follows(before["pose"][i], last["pose"])
        if ended.any():
            final = infos["final_info"]
            np.testing.assert_array_equal(infos["_final_obs"], ended)
            np.testing.assert_array_equal(final["arrived"] | final["collided"], terminated)
            arrived += final["arrived"].sum()
    assert mixed >= 5 and arrived >= 5


def test_the_same_seed_gives_the_same_episodes(envs):
    def episodes(seed):
        seen = [envs.reset(seed=seed)[0]] + [envs.step(STAND)[0] for _ in range(6)]
        return np.stack([observations["scan"] for observations in seen])

    one = episodes(5)
    np.testing.assert_array_equal(episodes(5), one)
    assert not np.array_equal(episodes(6)[0], one[0])
    # Neither of its episodes begins like another one, side by side, after an end, or after a reset without a seed.
    begins = [*one[0], *one[5], *envs.reset()[0]["scan"], *envs.reset()[0]["scan"]]
    assert len(np.unique(np.stack(begins), axis=0)) == 4 * COUNT


def test_what_it_returns_is_the_callers(envs):
    observations, _ = envs.reset(seed=0)
    kept = observations["scan"].copy()
    envs.step(STAND)
    np.testing.assert_array_equal(observations["scan"], kept)
    observations["scan"][:] = 0.0


def test_the_wrappers_of_gymnasium_read_its_infos(envs):
    counted = DictInfoToList(RecordEpisodeStatistics(envs))
    _, infos = counted.reset(seed=0)
    assert infos == [{}] * COUNT
    total = np.zeros(COUNT)
    for _ in range(5):
        _, rewards, _, _, infos = counted.step(STAND)
        total += rewards
    assert [info["episode"]["l"] for info in infos] == [5] * COUNT
    np.testing.assert_allclose([info["episode"]["r"] for info in infos], total, rtol=1e-5)
    assert [info["final_info"]["arrived"] for info in infos] == [False] * COUNT


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs is 0: give a whole number of at least 1"),
        ({"num_envs": "3"}, "num_envs is '3': give a whole number of at least 1"),
        ({"params": Params(robot_radius=-1.0)}, "world.params.robot_radius is -1.0"),
    ],
)
def test_what_cannot_be_is_said(arguments, message):
    with pytest.raises(ValueError, match=message):
        vector_world.VectorWorld(**arguments)


def test_people_and_delays_are_those_of_the_world():
    """Of a suite or of a building; nothing is compiled before the first reset."""
    late = World(WorldConfig(scenes=("doorway",), scan_delay=2))
    assert vector_world.VectorWorld(2, late).params.preferred_speed == 1.2
    assert vector_world.VectorWorld(2, late, Params(scan_latency=2)).params.scan_latency == 2
    office = maps.load(OFFICE, meetings=256, strolls=64, cell=4.0)
    envs = vector_world.VectorWorld(2, World(WorldConfig(scenes=(office.name,), beams=16), [office]))
    assert envs.single_observation_space["scan"].shape == (16,)
