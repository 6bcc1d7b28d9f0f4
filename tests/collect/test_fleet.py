"""Recorded flights: alone or in company the same bits, replayed to the bit, labelled clean."""

from dataclasses import fields, replace

import numpy as np
import pytest

from cognitivedrone.collect import fleet as fleet_module
from cognitivedrone.collect.fleet import Fleet, attempt_rng, relabel
from cognitivedrone.collect.recipe import RECIPES, disturb, draw_beginning, draw_disturbances
from cognitivedrone.collect.replay import replay
from cognitivedrone.data.episode import decode_image
from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import DataError, PolicyError
from cognitivedrone.labels import load_pack
from cognitivedrone.policies.baselines import Hover
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.tasks import BASE_FAMILIES, load_suite
from cognitivedrone.world import places

SUITE = load_suite("open-v1:train", size=40)
ROBUST = replace(RECIPES["robust"], kicks_per_s=0.6, wrongs_per_s=0.6, speed_m_s=(2.0, 2.5))


def fly(recipe, indices, worlds):
    fleet = Fleet(SUITE, recipe, seed=5, worlds=worlds)
    try:
        return sorted((flown.episode for flown in fleet.fly(indices)), key=lambda episode: episode.index)
    finally:
        fleet.close()


@pytest.fixture(scope="module")
def clean():
    return fly(RECIPES["paper"], range(10), 8)


@pytest.fixture(scope="module")
def disturbed():
    return fly(ROBUST, range(8), 5)


def assert_same(a, b):
    for each in fields(a):
        ours, theirs = getattr(a, each.name), getattr(b, each.name)
        same = np.array_equal(ours, theirs) if isinstance(ours, np.ndarray) else ours == theirs
        assert same, each.name


def test_every_task_is_passed_once_in_order_and_all_families_alike(clean):
    assert [episode.index for episode in clean] == list(range(10))
    families = [episode.task.family for episode in clean]
    assert {families.count(family) for family in BASE_FAMILIES} == {1}


def test_a_disturbed_episode_does_not_depend_on_its_company(disturbed):
    (alone,) = fly(ROBUST, [3], 1)
    assert_same(alone, disturbed[3])


def test_the_camera_that_looks_down_records_what_the_simulator_draws_at_every_step():
    recipe = replace(RECIPES["paper"], look="varied", down_camera=True)
    (episode,) = fly(recipe, [7], 1)
    rng = attempt_rng(SUITE.digest, 7, 5, 0)
    with Worlds(1, load_pack(None), TrackConfig(appearance="varied"), airframe=AIRFRAMES["racer"]) as worlds:
        start = draw_beginning(rng, recipe, worlds.runners[0].world.hull_radius)
        rng.uniform(*recipe.speed_m_s)
        worlds.runners[0].begin(SUITE.tracks[7], rng, start)
        for image, down, sent in zip(episode.images, episode.down, episode.sent, strict=True):
            assert np.array_equal(decode_image(image), worlds.simulator.frames()[0])
            assert np.array_equal(decode_image(down), worlds.simulator.frames(down=True)[0])
            worlds.command(sent[None])
            worlds.advance()


def test_the_camera_that_looks_down_changes_nothing_else_of_a_flight(disturbed):
    (episode,) = fly(replace(ROBUST, down_camera=True), [3], 1)
    assert len(episode.down) == len(episode)
    assert_same(replace(episode, down=()), disturbed[3])


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("wanted", [False, True])
def test_only_a_learner_that_wants_the_camera_that_looks_down_sees_it(recorded, wanted):
    seen = []

    class Looking(Hover):
        needs_down_camera = wanted

        def act(self, observation):
            seen.append(observation.down)
            return super().act(observation)

    recipe = replace(RECIPES["debug"], kicks_per_s=0.0, time_limit_s=0.5, encoding="png", down_camera=recorded)
    (episode,) = relabel(Looking, SUITE, recipe, 0, [2], worlds=1)
    assert len(episode.down) == (len(episode) if recorded else 0)
    assert all((down is not None) == wanted for down in seen)
    if recorded and wanted:
        assert np.array_equal(decode_image(episode.down[0]), seen[0])


def test_half_of_the_robust_flights_are_in_places_that_models_are_trained_in(disturbed):
    there = [episode.conditions.place for episode in disturbed]
    assert 0 < sum(map(bool, there)) < len(there)
    assert {*there} <= {"", *places.names("training")}
    for episode in disturbed:
        assert episode.conditions.look == ("photo" if episode.conditions.place else "varied")
        colors = np.unique(decode_image(episode.images[0]).reshape(-1, 3), axis=0)
        assert len(colors) > 1000 or not episode.conditions.place


def test_recipes_without_places_are_told_of_as_before(clean):
    assert "places" not in RECIPES["paper"].facts()
    assert RECIPES["robust"].facts()["places"] == 0.5
    assert all("place" not in episode.conditions.facts() for episode in clean)


def test_replays_are_the_same_bits(clean, disturbed):
    for episode in (*clean[:4], *disturbed[:4]):
        report = replay(episode)
        assert report.same_bits
        assert (report.end_error_m, report.path_error_m, report.steps) == (0.0, 0.0, len(episode))


def test_a_replay_tells_of_altered_actions(clean):
    sent = clean[0].sent.copy()
    sent[-10:, 0] += 0.5
    report = replay(replace(clean[0], sent=sent))
    assert not report.same_bits
    assert report.end_error_m > 0.001


def test_a_replay_of_an_unknown_airframe_says_so(clean):
    episode = clean[0]
    with pytest.raises(DataError, match=r"racr.*did you mean 'racer'"):
        replay(replace(episode, conditions=replace(episode.conditions, airframe="racr")))


def test_clean_flights_send_the_label_and_disturbed_ones_keep_it(clean, disturbed):
    for episode in clean:
        assert np.array_equal(episode.action, episode.sent)
    pushed = np.concatenate([np.any(episode.action != episode.sent, axis=1) for episode in disturbed])
    assert 0.1 < pushed.mean() < 0.9
    labels = np.concatenate([episode.action for episode in disturbed])
    assert np.linalg.norm(labels[:, :3], axis=1).max() < 2.6  # never a kick


def test_records_are_whole(clean):
    for episode in clean[:3]:
        count = len(episode)
        assert count == len(episode.action) == len(episode.position) == len(episode.quaternion)
        assert episode.state.shape == (count, 5)
        assert episode.position[0] == pytest.approx(episode.conditions.start_position)
        assert decode_image(episode.images[0]).shape == (256, 256, 3)
        assert np.abs(np.diff(episode.position, axis=0)).max() < 0.3
        assert episode.velocity[0] == pytest.approx(np.zeros(3), abs=1e-9)
    speeds = [np.linalg.norm(episode.velocity, axis=1).max() for episode in clean]
    assert max(speeds) - min(speeds) > 0.5


def test_relabelling_records_the_learner_and_what_the_expert_would_do():
    recipe = replace(RECIPES["debug"], kicks_per_s=0.0, time_limit_s=1.0)
    episodes = list(relabel(Hover, SUITE, recipe, 0, [2, 0, 1], worlds=2))
    assert sorted(episode.index for episode in episodes) == [0, 1, 2]
    for episode in episodes:
        assert len(episode) == 10
        assert not episode.sent.any()
        assert np.linalg.norm(episode.action[-1, :3]) > 0.5
        assert replay(episode).same_bits


def test_a_task_that_cannot_be_flown_is_an_error(monkeypatch):
    monkeypatch.setattr(fleet_module, "MAX_ATTEMPTS", 2)
    recipe = replace(RECIPES["debug"], time_limit_s=0.2)
    with pytest.raises(DataError, match=r"train/0-4.*no flight out of 2"):
        fly(recipe, [4], 1)


def test_disturbances_come_at_their_rates():
    recipe = RECIPES["robust"]
    rng = np.random.default_rng(0)
    drawn = [draw_disturbances(rng, recipe) for _ in range(300)]
    per_flight = np.mean([len(each) for each in drawn])
    assert per_flight == pytest.approx(30 * (recipe.kicks_per_s + recipe.wrongs_per_s), rel=0.15)
    assert draw_disturbances(rng, RECIPES["paper"]) == ()
    one = drawn[0][0]
    own = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
    assert disturb(own, one.first, (one,)) == pytest.approx(one.action)
    assert disturb(own, one.last + 1, (one,)) is own


def test_starts_are_published_or_off_track_and_windy_by_recipe():
    rng = np.random.default_rng(0)
    published = [draw_beginning(rng, RECIPES["paper"], 0.13) for _ in range(200)]
    assert all(abs(s.position[0] + 1) <= 1 and abs(s.position[1]) <= 1 and s.yaw == 0 for s in published)
    assert {s.wind for s in published} == {(0.0, 0.0, 0.0)}
    robust = [draw_beginning(rng, RECIPES["robust"], 0.13) for _ in range(400)]
    share = np.mean([s.yaw != 0 for s in robust])
    assert share == pytest.approx(RECIPES["robust"].off_track_share, abs=0.08)
    winds = np.linalg.norm([s.wind for s in robust], axis=1)
    assert winds.max() <= RECIPES["robust"].wind_m_s + 1e-9
    assert winds.mean() == pytest.approx(RECIPES["robust"].wind_m_s / 2, rel=0.15)


class Once:
    """A policy that flies forward three steps at a time, and counts how often it is asked."""

    asked = 0

    def reset(self, context):
        self.steps = 0

    def act(self, observation):
        Once.asked += 1
        return np.tile(np.array([0.5, 0.1, 0.0, 0.0], np.float32), (3, 1))


class NotANumber(Once):
    def act(self, observation):
        return np.full((1, 4), np.nan, np.float32)


class Failing(Once):
    def act(self, observation):
        raise ZeroDivisionError("a bug")


SHORT = replace(RECIPES["debug"], kicks_per_s=0.0, time_limit_s=2.0)


def test_a_mixed_flight_sends_the_experts_commands_at_its_share_of_steps():
    (alone,) = relabel(Once, SUITE, SHORT, 0, [4], worlds=1)
    assert (alone.sent == np.array([0.5, 0.1, 0.0, 0.0], np.float32)).all()
    Once.asked = 0
    mixed = list(relabel(Once, SUITE, SHORT, 0, range(12), worlds=3, beta=0.3))
    steps = sum(map(len, mixed))
    assert Once.asked == sum(-(-len(episode) // 3) for episode in mixed)
    expert = sum(int((episode.sent == episode.action).all(axis=1).sum()) for episode in mixed)
    assert 0.2 < expert / steps < 0.4
    for episode in mixed:
        sent = episode.sent
        own = (sent == np.array([0.5, 0.1, 0.0, 0.0], np.float32)).all(axis=1)
        assert (own | (sent == episode.action).all(axis=1)).all()
        assert replay(episode).same_bits
    (again,) = relabel(Once, SUITE, SHORT, 0, [7], worlds=1, beta=0.3)
    assert_same(again, mixed[7])


def test_all_of_the_experts_share_is_the_experts_flight(clean):
    flown = list(relabel(Hover, SUITE, RECIPES["paper"], 5, range(3), worlds=1, beta=1.0))
    for ours, theirs in zip(flown, clean, strict=False):
        assert_same(ours, theirs)


def test_a_policy_without_a_finite_command_or_with_a_bug_is_reported(monkeypatch):
    monkeypatch.setattr(fleet_module, "MAX_ATTEMPTS", 2)
    with pytest.raises(DataError, match=r"in 2 flights the policy gave no finite command"):
        list(relabel(NotANumber, SUITE, SHORT, 0, [0], worlds=1))
    with pytest.raises(PolicyError, match=r"Failing failed in episode 0 at step 0 \(ZeroDivisionError: a bug\)"):
        list(relabel(Failing, SUITE, SHORT, 0, [0], worlds=1))
