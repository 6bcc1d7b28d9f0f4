"""The environments pass Gymnasium's checks, agree with each other and repeat to the bit."""

import re
import sys
import warnings

import av
import gymnasium
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.options import observation_space
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv
from cognitivedrone.errors import LabelError, PolicyError, SimulationError, TaskError, UsageError
from cognitivedrone.tasks import train_task
from cognitivedrone.training.perception.ground_truth import project
from cognitivedrone.world.geometry import panel_centers


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", render_mode="rgb_array")
    yield made
    made.close()


@pytest.fixture(scope="module")
def vector():
    made = gymnasium.make_vec("CognitiveDrone-v1", num_envs=3, suite="open-v1:smoke")
    yield made
    made.close()


@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
def test_gymnasiums_own_checker_is_content(render_mode):
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", render_mode=render_mode)
    with warnings.catch_warnings():
        # Actions are velocities in m/s; RescaleAction makes them -1 to 1 for who wants that.
        warnings.filterwarnings("ignore", message=".*normalized space")
        check_env(made.unwrapped)
    made.close()


def test_the_view_from_behind_follows_the_stages_of_a_track():
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", render_mode="rgb_array", camera="chase")
    made.reset(options={"episode": 0, "seed": 0})
    first = made.render()
    made.step(np.array([3.0, 0.0, 0.0, 0.0], np.float32))
    second = made.render()
    made.reset(options={"episode": 1, "seed": 0})
    other = made.render()
    made.close()
    assert isinstance(first, np.ndarray)
    assert isinstance(second, np.ndarray)
    assert isinstance(other, np.ndarray)
    assert first.shape == second.shape == (360, 640, 3)
    assert (first != second).any()
    assert (first != other).mean() > 0.2


def test_a_window_is_gymnasiums_and_without_its_library_one_sentence_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.warns(UserWarning, match="HumanRendering"):
        made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", render_mode="human")
    with pytest.raises(DependencyNotInstalled, match="pygame is not installed, run `pip install"):
        made.reset()
    made.unwrapped.close()
    with pytest.raises(SimulationError, match=r"gymnasium.make\(..., render_mode=.human.\) opens a window"):
        CognitiveDroneEnv("open-v1:smoke", render_mode="human")
    with pytest.raises(SimulationError, match="unknown camera 'chas'; did you mean 'chase'"):
        CognitiveDroneEnv("open-v1:smoke", camera="chas")  # type: ignore[arg-type]


def test_without_a_render_mode_nothing_is_rendered(env, vector):
    env.reset(seed=0)
    assert env.render().shape == (256, 256, 3)
    bare = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke").unwrapped
    bare.reset(seed=0)
    assert bare.render() is None
    bare.close()
    vector.reset(seed=0)
    assert vector.render() is None
    drawn = gymnasium.make_vec("CognitiveDrone-v1", num_envs=2, suite="open-v1:smoke", render_mode="rgb_array")
    seen, _ = drawn.reset(seed=0)
    assert np.array_equal(np.asarray(drawn.render()), seen["image"])
    drawn.close()


def test_a_film_is_recorded(tmp_path):
    pytest.importorskip("moviepy", reason="Gymnasium's RecordVideo needs moviepy")
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", time_limit_s=0.5, render_mode="rgb_array")
    recorded = RecordVideo(made, str(tmp_path / "films"), episode_trigger=lambda _: True)
    recorded.reset(seed=0)
    for _ in range(5):
        recorded.step(np.array([1, 0, 0, 0], np.float32))
    recorded.close()
    (film,) = (tmp_path / "films").glob("*.mp4")
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert [frame.shape for frame in frames] == [(256, 256, 3)] * 6
    assert np.ptp(frames[0]) > 50
    assert not np.array_equal(frames[0], frames[-1])


def test_training_goes_on_without_end():
    made = gymnasium.make_vec("CognitiveDrone-v1", num_envs=2, suite="open-v1:train", time_limit_s=0.1)

    def drawn(seed):
        ids = [task.id for task in made.reset(seed=seed)[1]["task"]]
        for _ in range(40):
            ids += [task.id for task in made.step(np.zeros((2, 4), np.float32))[4]["task"]]
        return ids

    ids = drawn(7)
    assert len(set(ids)) == 2 * 21, "a new task for every episode"
    assert min(int(name.rpartition("-")[2]) for name in ids) > 300
    assert drawn(7) == ids
    assert not set(drawn(9)) & set(ids)
    alone = gymnasium.make("CognitiveDrone-v1", suite="open-v1:train")
    assert [alone.reset(seed=seed)[1]["task"].id for seed in (7, 8)] == ids[:2]
    assert alone.reset(options={"episode": 123_456_789})[1]["task"] == train_task(123_456_789)
    alone.close()
    made.close()


def test_hovering_is_cut_off_by_the_clock():
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", time_limit_s=0.5)
    made.reset(seed=0)
    endings = [made.step(np.zeros(4, np.float32))[2:4] for _ in range(5)]
    made.close()
    assert endings == [(False, False)] * 4 + [(False, True)]


def test_looks_differ_by_seed_only_where_they_are_varied():
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", appearance="varied")
    first = made.reset(seed=1, options={"episode": 0})[0]["image"].copy()
    second = made.reset(seed=2, options={"episode": 0})[0]["image"].copy()
    made.close()
    assert np.abs(first.astype(int) - second).mean() > 5


def test_bad_input_is_refused(env, vector):
    env.reset(seed=0)
    with pytest.raises(PolicyError, match="not finite"):
        env.step(np.array([0, np.nan, 0, 0], np.float32))
    vector.reset(seed=0)
    actions = np.zeros((3, 4), np.float32)
    actions[2, 1] = np.inf
    with pytest.raises(PolicyError, match="world 2"):
        vector.step(actions)
    with pytest.raises(TaskError, match="episodes 0 to 29, not 30"):
        env.reset(options={"episode": 30})
    with pytest.raises(TaskError, match="not 'first'"):
        env.reset(options={"episode": "first"})
    with pytest.raises(TaskError, match="seed of an episode is -1"):
        vector.reset(options={"seed": -1})
    with pytest.raises(TaskError):
        gymnasium.make("CognitiveDrone-v1", suite="open-v1:tset")


@pytest.mark.parametrize(
    ("wrong", "error", "says"),
    [
        ({"airframe": "dji"}, SimulationError, "unknown airframe 'dji'; known: iris, racer"),
        ({"airframe": "race"}, SimulationError, "did you mean 'racer'?"),
        ({"appearance": "plane"}, SimulationError, "unknown appearance 'plane'; did you mean 'plain'?"),
        ({"labels": "open-v9"}, LabelError, "no label pack 'open-v9'"),
        ({"wind": -1.0}, UsageError, "--wind is -1.0; it must be from 0 to 50 m/s"),
        ({"time_limit_s": 0.0}, SimulationError, "time_limit_s is 0.0; it is a time in seconds, more than 0"),
        ({"suite": "open-v1:trian"}, TaskError, "did you mean 'open-v1:train'"),
    ],
)
def test_conditions_that_cannot_be_are_sentences(wrong, error, says):
    with pytest.raises(error, match=re.escape(says)):
        CognitiveDroneEnv(**wrong)


def test_actions_of_another_shape_are_refused(env, vector):
    env.reset(seed=0)
    with pytest.raises(PolicyError, match=r"shape \(3,\); the action space has \(4,\)"):
        env.unwrapped.step(np.zeros(3, np.float32))
    vector.reset(seed=0)
    with pytest.raises(PolicyError, match=r"shape \(4,\); the action space has \(3, 4\)"):
        vector.step(np.zeros(4, np.float32))
    with pytest.raises(SimulationError, match="num_envs is 0"):
        CognitiveDroneVectorEnv(0)


def test_the_bounds_of_the_space_are_where_a_flight_diverges():
    space = observation_space()
    for key, limit in (("velocity", 100 * 2**0.5), ("height", 1e4), ("yaw_rate", 300.0)):
        assert np.allclose([space[key].low, space[key].high], np.array([[-limit], [limit]]))


def test_with_a_camera_that_looks_down_observations_have_its_view_too():
    alone = CognitiveDroneEnv("open-v1:smoke", down_camera=True)
    many = CognitiveDroneVectorEnv(2, "open-v1:smoke", down_camera=True)
    plain = CognitiveDroneEnv("open-v1:smoke")
    seen, shown, other = (env.reset(seed=3, options={"episode": 0})[0] for env in (alone, many, plain))
    assert alone.observation_space.contains(seen)
    assert many.observation_space.contains(shown)
    assert "down" not in other
    assert (seen["image"] == other["image"]).all()
    assert seen["down"].shape == (256, 256, 3)
    assert (seen["down"] != seen["image"]).any()
    for env in (alone, many, plain):
        env.close()


def test_depth_is_how_far_ahead_of_the_camera_the_panels_are():
    alone = CognitiveDroneEnv("open-v1:smoke", depth=True, down_camera=True)
    many = CognitiveDroneVectorEnv(2, "open-v1:smoke", depth=True)
    seen, shown = (env.reset(seed=3, options={"episode": 0, "seed": 0})[0] for env in (alone, many))
    assert alone.observation_space.contains(seen)
    assert many.observation_space.contains(shown)
    assert (seen["depth"] == shown["depth"][0]).all()
    state, stage = alone.track_runner.world.state(), alone.track_runner.stage
    panels = project(panel_centers(stage)[None], state.position[None], state.quaternion[None])[0]
    for u, v, distance in panels:
        assert seen["depth"][int(v), int(u)] == pytest.approx(distance, rel=0.01)
    alone.close()
    many.close()
