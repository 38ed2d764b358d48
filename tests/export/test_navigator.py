"""The Navigator beside the world: the same observations whatever it has to work out itself, and what stops it."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.exporting import navigated
from jaxnav.training.config import resolve
from jaxnav.training.run import Run

EMPTY = np.full(180, 5.0)


@pytest.fixture
def drive(robot):
    """A function (bundle, options) -> (a navigator with a goal 5 m ahead, a scan of a wall 5 m away, its modules)."""

    def start(name="lidar", **options):
        folder, policy, navigator, scans = robot(name)
        made = navigator.Navigator(str(folder), **options)
        made.reset((5.0, 0.0))
        return made, scans.Scan(EMPTY, -np.pi / 2, np.pi / 179), SimpleNamespace(policy=policy, scans=scans)

    return start


def longer(run, **params):
    """The same run in longer episodes, or with other changes of its people."""
    world = dataclasses.replace(run.config.world, params=run.params.replace(max_steps=40.0, **params))
    return Run(resolve(dataclasses.replace(run.config, world=world)))


@pytest.mark.parametrize("name", ["approach", "lidar"])
def test_it_observes_what_the_world_does(name, bundles, robot):
    """Of robots that drive anyhow and ask for anything, in every step: dialogues, ages, replies, history, places.

    One person who may speak first; and three who don't, and of whom one at a time is asked, since a sentence doesn't
    say whose it is.
    """
    crowd = name == "approach"
    run, folder = longer(bundles(name)[0], **({"p_pedestrian_first": 0.0} if crowd else {})), bundles(name)[2]
    _, policy, navigator, scans = robot(name)
    rng, given, seen = np.random.default_rng(0), [], []
    worlds = navigated.Worlds(run, seed=3, episodes=12)
    look = worlds.observe

    def observe():
        seen.append(look())
        return seen[-1]

    def act(observation):
        given.append(observation)
        waits = crowd and ((observation["asked"] != 0) & (observation["reply"] == 0)).any()
        request = rng.integers(1, 4) if observation["may_request"] and not waits and rng.random() < 0.5 else 0
        return policy.Decision(rng.uniform(0.0, 0.6), rng.uniform(-0.5, 0.5), request, None, None, None)

    worlds.observe = observe
    drives, play = [], worlds.play

    def noted(function):
        def drive(step, who):
            drives.append(np.flatnonzero(who))
            return function(step, who)

        return play(drive)

    worlds.play = noted
    # A policy that understands for certain: what is tested is where what was understood goes.
    meant = None if crowd else _meanings()
    navigated.by_navigators(
        worlds, lambda: _understanding(navigator.Navigator(str(folder), safety=False), meant),
        navigated.laser(scans, run), act,
    )  # fmt: skip
    rows = [(step, i) for step, who in enumerate(drives) for i in who]
    assert len(rows) == len(given) > 500
    answered = spoken = 0
    for (step, i), found in zip(rows, given, strict=True):
        world, words = seen[step]
        expected = {
            "pedestrians": world.pedestrians[i], "seen": world.seen[i], "pose": world.pose[i], "twist": world.twist[i],
            "may_request": world.may_request[i], "scan": world.scan[i],
        }  # fmt: skip
        for part in ("is_open", "pedestrian_first", "message_age", "reply", "request_age", "message"):
            expected[part] = getattr(world.dialogue, part)[i]
        expected["asked"] = world.dialogue.request[i]
        if not crowd:
            expected["words"] = words[i]
        for key, value in expected.items():
            np.testing.assert_allclose(found[key], value, atol=1e-4, err_msg=f"{key} in step {step} of world {i}")
        answered += world.dialogue.reply[i].any()
        spoken += world.dialogue.message[i].any()
    assert answered > 20 and (crowd or spoken > 20)


def _meanings():
    """{bytes of a vector: (message, reply)} of every phrase that comes with jaxnav."""
    from jaxnav.language.table import default_table

    table = default_table()
    vectors = table.vectors().astype(np.float32)
    return {v.tobytes(): (p.message, p.reply) for v, p in zip(vectors, table.phrases, strict=True)}


def _understanding(made, meant):
    if meant is not None:

        def understand(words):
            message, reply = meant[np.asarray(words, np.float32).tobytes()]
            return np.eye(4)[message][1:], np.eye(3)[reply]

        made.policy.understand = understand
    return made


def test_calls_at_any_rate_see_the_same_history(drive):
    """Ten calls a second or two and a half: every 0.4 s the policy is given the same."""
    seen = {}
    for rate in (0.1, 0.4):
        navigator, scan, modules = drive()
        given = seen[rate] = []

        def act(observation, given=given, modules=modules):
            given.append(observation)
            return modules.policy.Decision(0.5, 0.0, 0, None, None, None)

        navigator.policy.act = act
        for i in range(round(4.0 / rate) + 1):
            t = i * rate
            navigator.step(
                scan._replace(), [[3.0 - 0.8 * t, 0.2, -0.3, 0.0]], (0.5 * t, 0.1 * t, 0.2 * t), now=100.0 + t
            )
    often, seldom = seen[0.1][::4], seen[0.4]
    assert len(often) == len(seldom) == 11
    for one, other in zip(often, seldom, strict=True):
        for name in one:
            np.testing.assert_allclose(one[name], other[name], atol=1e-6, err_msg=name)
    # Between two beats the goal is that of now, and the past that of 0.4 s and 0.8 s ago; there is no voice.
    between = seen[0.1][22]
    t = 2.2
    for row, when in enumerate((t - 0.8, t - 0.4, t)):
        dx, dy, heading = 5.0 - 0.5 * when, -0.1 * when, 0.2 * when
        cos, sin = math.cos(heading), math.sin(heading)
        expected = [cos * dx + sin * dy, cos * dy - sin * dx, -heading]
        np.testing.assert_allclose(between["pose"][row], expected, atol=1e-3)
    assert [bool(one["voice"]) for one in seen[0.1][:9]] == [True, False, False, False, True, False, False, False, True]
    np.testing.assert_array_equal(seen[0.1][0]["pose"][:2], 0.0)


def test_heading_may_jump_by_a_whole_turn(drive):
    navigator, scan, modules = drive()
    seen = []
    navigator.policy.act = lambda observation: (
        seen.append(observation["pose"][2]) or modules.policy.Decision(0.0, 0.9, 0, None, None, None)
    )
    for i in range(12):
        heading = 3.0 + 0.1 * i
        navigator.step(scan._replace(), [], (0.0, 0.0, math.atan2(math.sin(heading), math.cos(heading))), now=0.1 * i)
    np.testing.assert_allclose([pose[2] for pose in seen], -0.1 * np.arange(12), atol=1e-6)


def test_words_have_answers(drive):
    """Asked, it says that it does; unsure, it asks to repeat; answered, it thanks; and small talk is left alone."""
    navigator, scan, _ = drive()
    sentences = navigator.contract["sentences"]
    somebody, pose = [[2.0, 0.3, -0.5, 0.0]], (0.0, 0.0, 0.0)
    vector = np.full(185, 0.1, np.float32)
    seen = []
    act = navigator.policy.act

    def quiet(observation):
        seen.append(observation)
        return act(observation)._replace(request=0)

    def understood(*heard, answer=(1, 0, 0)):
        navigator.policy.understand = lambda words: (np.array(heard), np.array(answer))

    navigator.policy.act = quiet
    understood(0.0, 0.1, 0.0)
    assert navigator.step(scan._replace(), somebody, pose, vector, now=0.0).utterance == ""
    assert not seen[-1]["pedestrian_first"][0] and seen[-1]["spoken"][0] and seen[-1]["may_request"]
    navigator.step(scan._replace(), somebody, pose, now=0.4)
    assert not seen[-1]["words"].any()
    understood(0.0, 0.0, 1.0)
    assert (
        navigator.step(scan._replace(), somebody, pose, vector, now=0.8).utterance
        in sentences["acknowledge"]["robot left"]
    )
    assert seen[-1]["pedestrian_first"][0] and not seen[-1]["may_request"] and seen[-1]["words"].any()
    understood(0.1, 0.5, 0.4)
    held = seen[-1]["words"].copy()
    assert navigator.step(scan._replace(), somebody, pose, 2 * vector, now=1.2).utterance in sentences["repeat"]
    np.testing.assert_array_equal(seen[-1]["words"], held)
    navigator.reset((5.0, 0.0))
    navigator.policy.act = lambda observation: act(observation)._replace(request=2 if observation["may_request"] else 0)
    asked = navigator.step(scan._replace(), somebody, pose, now=2.0)
    assert asked.request == 2 and asked.utterance in sentences["request"]["margin-right"]
    understood(0.0, 0.0, 0.0, answer=(0.3, 0.4, 0.3))
    assert navigator.step(scan._replace(), somebody, pose, vector, now=2.2).utterance == ""
    understood(0.0, 0.0, 0.0, answer=(0.1, 0.8, 0.1))
    assert navigator.step(scan._replace(), somebody, pose, vector, now=2.4).utterance in sentences["reply"]["agrees"]
    navigator.policy.act = quiet
    navigator.step(scan._replace(), somebody, pose, now=2.8)
    assert seen[-1]["reply"][0] == 1 and seen[-1]["asked"][0] == 2 and seen[-1]["request_age"][0] == 2


def test_a_voice_from_nowhere_belongs_to_who_appears(drive):
    navigator, scan, modules = drive("td3")
    scan = modules.scans.Scan(np.full(7, 5.0), -np.pi / 2, np.pi / 6)
    seen, act = [], navigator.policy.act
    navigator.policy.act = lambda observation: seen.append(observation) or act(observation)
    navigator.step(scan, [], (0.0, 0.0, 0.0), "robot right", now=0.0)
    assert not seen[-1]["seen"].any() and seen[-1]["message"][0] == 2 and seen[-1]["is_open"][0]
    navigator.step(scan, [[1.5, 0.0, -0.5, 0.0]], (0.0, 0.0, 0.0), now=0.4)
    assert seen[-1]["seen"][0] and seen[-1]["message"][0] == 2 and seen[-1]["message_age"][0] == 1


STOPS = {
    "no goal": ({"goal": None}, "no goal was set"),
    "stale": ({"stamp": 0.0, "now": 0.6}, "stale: 0.60 s old, at most 0.50"),
    "future": ({"stamp": 2.0, "now": 1.0}, "from the future"),
    "no time": ({"now": math.nan}, "now is no time: give s"),
    "no stamp": ({"stamp": "noon"}, "stamp is no time: give s"),
    "nan pose": ({"pose": (0.0, math.nan, 0.0)}, "pose is not x, y, heading"),
    "no pose": ({"pose": None}, "pose is not x, y, heading"),
    "far goal": ({"pose": (900.0, 0.0, 0.0)}, "the goal is 895 m away"),
    "nobody listed": ({"pedestrians": None}, "pedestrians is None"),
    "three columns": ({"pedestrians": [[1.0, 2.0, 3.0]]}, "pedestrians are not"),
    "words for people": ({"pedestrians": "two"}, "pedestrians are not"),
    "no scan": ({"scan": None}, "scan has no ranges"),
    "dead laser": ({"ranges": np.full(180, np.nan)}, "180 ranges that are none, of 180"),
    "half a laser": ({"ranges": np.where(np.arange(180) < 91, np.nan, 5.0)}, "91 ranges that are none"),
    "negative": ({"ranges": np.full(180, -1)}, "180 ranges that are none"),
    "millimetres": ({"ranges": np.full(180, 300)}, "ranges of 300 in the median: are they in metres?"),
    "no angle_max": ({"ranges": EMPTY, "angle_max": "x"}, "scan has no ranges, angle_min"),
    "texts": ({"ranges": ["1"] * 180}, "not a list of at least two numbers"),
    "narrow": ({"ranges": EMPTY[:90]}, "doesn't cover the front"),
    "miscounted": ({"ranges": EMPTY, "angle_max": 1.0}, "not as many as from angle_min to angle_max"),
    "degrees": ({"ranges": EMPTY, "angle_min": -90.0}, "no angle in rad"),
    "twice around": ({"ranges": np.tile(EMPTY, 5)}, "more than once around"),
    "a word": ({"message": "stop!"}, "give what Phrasebook().look_up(text) returns"),
    "short vector": ({"message": np.ones(184)}, "no vector of 185"),
    "nan vector": ({"message": np.full(185, np.nan)}, "no vector of 185"),
}


@pytest.mark.parametrize("case", STOPS)
def test_what_it_can_not_use_stops_it_and_has_a_reason(case, drive):
    navigator, scan, _ = drive()
    given, said = STOPS[case]
    given = {"scan": scan, "pedestrians": [], "pose": (0.0, 0.0, 0.0), "now": 1.0} | given
    if "goal" in given:
        with pytest.raises(ValueError, match="goal is None: give"):
            navigator.reset(given.pop("goal"))
    geometry = {"ranges": EMPTY, "angle_min": -np.pi / 2, "angle_increment": np.pi / 179}
    changed = {name: given.pop(name) for name in ("ranges", "angle_min", "angle_max") if name in given}
    if changed:
        given["scan"] = SimpleNamespace(**geometry | changed)
    before = navigator.step(scan._replace(), [], (0.0, 0.0, 0.0), now=0.5)
    assert before.v > 0 or "goal" in said
    assert navigator.step(**given) == (0.0, 0.0, 0, "")
    assert said in navigator.reason
    if "goal was" not in said and "future" not in said:
        assert navigator.step(scan._replace(), [], (0.0, 0.0, 0.0), now=1.5).v > 0 and navigator.reason == ""


def test_the_same_scan_again_is_an_old_one(drive):
    """Nobody says when it was measured; but who gives the same message for a second has a laser that is gone."""
    navigator, scan, _ = drive()
    speeds = [navigator.step(scan, [], (0.0, 0.0, 0.0), now=0.1 * i).v for i in range(10)]
    assert min(speeds[:6]) > 0 and max(speeds[6:]) == 0 and "stale: 0.90 s old" in navigator.reason
    assert navigator.step(scan._replace(), [], (0.0, 0.0, 0.0), now=1.0).v > 0


def test_time_that_runs_backwards_stops_it_once(drive):
    navigator, scan, _ = drive()
    assert navigator.step(scan, [], (0.0, 0.0, 0.0), now=10.0).v > 0
    assert navigator.step(scan, [], (0.0, 0.0, 0.0), now=9.0).v == 0
    assert navigator.reason == "time went backwards, from 10.000 to 9.000 s"
    assert navigator.step(scan, [], (0.0, 0.0, 0.0), now=9.1).v > 0


@pytest.mark.parametrize(
    ("pose", "said"), [((0.0, 9.0, 0.0), "9.0 m and 0.0 rad"), ((0.0, 0.0, 3.0), "0.0 m and 3.0 rad")]
)
def test_a_pose_that_jumps_stops_it_once(pose, said, drive):
    navigator, scan, _ = drive()
    assert navigator.step(scan, [], (0.0, 0.0, 0.0), now=0.0).v > 0
    assert navigator.step(scan, [], pose, now=0.1).v == 0
    assert navigator.reason == f"pose jumped by {said}"
    assert navigator.step(scan, [], pose, now=0.2).v > 0


def test_it_stands_at_its_goal_whatever_comes(drive):
    navigator, scan, _ = drive()
    assert navigator.step(scan, [], (4.8, 0.0, 0.0), now=1.0).v == 0
    assert navigator.arrived and navigator.reason == "arrived"
    for pose, now in (((4.0, 0.0, 0.0), 1.4), ((0.0, 0.0, 0.0), 1.5), ((0.0, 0.0, 0.0), 0.5), ((0.0, 0.0, 0.0), 99.0)):
        assert navigator.step(scan._replace(), [], pose, now=now).v == 0 and navigator.arrived
    navigator.reset((0.0, 0.0))
    assert not navigator.arrived and navigator.step(scan._replace(), [], (4.0, 0.0, 3.0), now=100.0).v > 0


def test_what_the_network_must_not_say_stops_it(drive):
    navigator, scan, modules = drive()
    for v, w in ((math.nan, 0.0), (0.5, math.inf)):
        navigator.policy.act = lambda _, v=v, w=w: modules.policy.Decision(v, w, 2, None, None, None)
        assert navigator.step(scan._replace(), [], (0.0, 0.0, 0.0)) == (0.0, 0.0, 0, "")
        assert "the network gave" in navigator.reason
    navigator.policy.act = lambda _: modules.policy.Decision(9.0, -9.0, 0, None, None, None)
    assert navigator.step(scan._replace(), [], (0.0, 0.0, 0.0))[:2] == (0.6, -0.9)

    def fail(_):
        raise RuntimeError("no memory")

    navigator.policy.act = fail
    assert navigator.step(scan._replace(), [], (0.0, 0.0, 0.0)).v == 0
    assert navigator.reason == "internal error: RuntimeError('no memory')"


def test_who_is_seen_comes_before_who_is_remembered(drive):
    """One row, and a nearer person that was lost from sight a moment ago."""
    navigator, scan, _ = drive()
    seen, act = [], navigator.policy.act
    navigator.policy.act = lambda observation: seen.append(observation) or act(observation)
    navigator.step(scan, [[1.0, 0.0, 0.0, 0.0], [1.7, 1.0, 0.0, 0.0]], (0.0, 0.0, 0.0), now=0.0)
    navigator.step(scan._replace(), [[1.7, 1.0, 0.0, 0.0]], (0.0, 0.0, 0.0), now=0.1)
    np.testing.assert_allclose(seen[0]["pedestrians"], [[1.0, 0.0, 0.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(seen[1]["pedestrians"], [[1.7, 1.0, 0.0, 0.0]], atol=1e-6)


def test_what_is_said_while_it_can_not_hear_is_heard_later(drive):
    navigator, scan, _ = drive()
    navigator.policy.understand = lambda words: (np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    somebody, vector = [[2.0, 0.0, -0.5, 0.0]], np.full(185, 0.1)
    assert navigator.step(None, somebody, (0.0, 0.0, 0.0), vector, now=0.0).utterance == ""
    said = navigator.step(scan, somebody, (0.0, 0.0, 0.0), now=0.1).utterance
    assert said in navigator.contract["sentences"]["acknowledge"]["robot stop"]


def test_it_stands_for_who_asks_it_to(drive):
    """For eight seconds; not in the way of who walks straight into it, whom it steers around."""
    for people, stands in (([[2.0, 1.0, -0.5, 0.0]], True), ([[2.0, 0.1, -0.5, 0.0]], False), ([[2.0, 0, 0, 0]], True)):
        navigator, scan, _ = drive()
        navigator.policy.understand = lambda words: (np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
        command = navigator.step(scan, people, (0.0, 0.0, 0.0), np.full(185, 0.1), now=0.0)
        assert (command[:2] == (0.0, 0.0)) == stands and command.utterance
        assert ("promised somebody to stop" in navigator.reason) == stands
    speeds = [navigator.step(scan._replace(), people, (0.0, 0.0, 0.0), now=0.4 * i).v for i in range(1, 25)]
    assert max(speeds[:18]) == 0.0 and min(speeds[20:]) > 0.0


def test_what_nobody_understood_is_asked_again(drive):
    navigator, scan, _ = drive()
    act = navigator.policy.act
    navigator.policy.act = lambda observation: act(observation)._replace(request=0)
    said = navigator.step(scan, [[2.0, 0.0, -0.5, 0.0]], (0.0, 0.0, 0.0), "unknown", now=0.0)
    assert said.utterance in navigator.contract["sentences"]["repeat"] and said.v > 0


def test_the_blind_zone_of_a_laser_is_kept_away(drive):
    """range_min of a laser in front of the middle."""
    _, _, modules = drive()
    navigator, _, _ = drive(mount=modules.scans.Mount(x=0.1))
    ranges = np.full(181, 0.33)
    for nearest, free in ((0.01, True), (0.3, False)):
        scan = SimpleNamespace(ranges=ranges, angle_min=-np.pi / 2, angle_increment=np.pi / 180, range_min=nearest)
        assert (navigator.step(scan, [], (0.0, 0.0, 0.0)).v > 0.02) == free


def test_a_deaf_policy_is_given_no_words(drive):
    navigator, scan, _ = drive()
    navigator.contract["hearing"] = False
    assert navigator.step(scan, [], (0.0, 0.0, 0.0), np.full(185, 0.1)).v == 0
    assert navigator.reason == "message is given, but this policy was trained deaf: give None"


def test_it_may_turn_for_an_hour(drive):
    """Headings add up, and a policy that was trained for a minute is given no more than a whole turn."""
    navigator, scan, _ = drive()
    for i in range(1000):
        heading = 0.3 * i
        command = navigator.step(
            scan._replace(), [], (0.0, 0.0, (heading + math.pi) % (2 * math.pi) - math.pi), now=0.4 * i
        )
        assert command.v > 0, navigator.reason


class Broken:
    """Whatever is asked of it fails."""

    def __array__(self, *_, **__):
        raise RuntimeError("broken")

    def __getattr__(self, name):
        raise RuntimeError("broken")


def test_nothing_makes_it_raise(drive):
    """10,000 calls on a walk among people, with all that may go wrong in a robot's software, and much that can't."""
    navigator, _, modules = drive()
    rng = np.random.default_rng(0)
    odd = [
        None, math.nan, math.inf, -math.inf, 1e300, -1, 0, "", "robot stop", [], [[]], [[1.0]], {}, object(), b"x",
        np.zeros((0, 4)), np.ones((3, 4)), np.full((2, 4), 1e30), np.full((2, 4), np.nan), np.zeros(185),
        np.ones(185), np.full(185, 1e9), [1, [2, 3]], (1, 2, 3), (1e9, 0, 0), (0, 0, 1e5), True, 3 + 4j,
        np.array(["a"]), np.array([None]), 10**400, [10**400], np.datetime64("2020-01-01"), Broken(),
        rng.uniform(-400, 400, (500, 4)),
    ]  # fmt: skip

    def odd_scan():
        ranges = [EMPTY, EMPTY[:3], [], None, "far", np.where(rng.random(180) < 0.5, np.nan, 5.0), np.full(180, np.inf),
                  np.full(180, -np.inf), np.zeros(180), np.full(180, -3.0), rng.uniform(0, 20, 720), EMPTY[None],
                  EMPTY.astype(int), EMPTY.astype(complex), [[1], [2, 3]]][rng.integers(15)]  # fmt: skip
        angles = [-np.pi / 2, np.pi / 179, 0.0, math.nan, 1e9, None, "0", -np.pi]
        chosen = [-np.pi / 2, np.pi / 179] if rng.random() < 0.5 else [angles[i] for i in rng.integers(8, size=2)]
        made = SimpleNamespace(ranges=ranges, angle_min=chosen[0], angle_increment=chosen[1])
        if rng.random() < 0.2:
            made.angle_max = odd[rng.integers(len(odd))]
        return made

    pose, people, now, moved, talked = np.zeros(3), rng.uniform(-3, 3, (3, 4)), 0.0, 0, 0
    limits = navigator.contract["control"]
    for i in range(10_000):
        if i % 500 == 0:
            navigator.reset(pose[:2] + np.array([5.0, 0.0]))
        jump = rng.random()
        now += rng.choice([0.0, 0.1, 0.1, 0.4]) if jump > 0.01 else rng.choice([3.0, 1e9, -1.0, -1e9])
        pose += rng.normal(0.0, 0.05, 3) if jump < 0.99 else rng.normal(0.0, 300.0, 3)
        people = np.clip(people + rng.normal(0.0, 0.1, people.shape), -3.0, 3.0)
        ranges = rng.uniform(0.3, 9.0) * np.ones(180)
        message = rng.normal(0.0, 0.1, 185) if rng.random() < 0.1 else None
        given = {"scan": modules.scans.Scan(ranges, -np.pi / 2, np.pi / 179), "pedestrians": people, "pose": pose,
                 "message": message, "now": now, "stamp": now - rng.choice([0.0, 0.2, 0.6])}  # fmt: skip
        for name in rng.choice([*given], size=rng.choice([0, 0, 1, 2, 3]), replace=False):
            given[name] = odd_scan() if name == "scan" and rng.random() < 0.8 else odd[rng.integers(len(odd))]
        numbers = [given[name] for name in ("now", "stamp")]
        stale = all(type(n) in (float, np.float64) for n in numbers) and numbers[0] - numbers[1] > 0.5
        command = navigator.step(**given)
        said = given, command, navigator.reason
        assert math.isfinite(command.v) and math.isfinite(command.w), said
        assert 0.0 <= command.v <= limits["max_v"] and abs(command.w) <= limits["max_w"], said
        assert command.request in (0, 1, 2, 3) and isinstance(command.utterance, str), said
        assert (command.v, command.w, command.request) == (0.0, 0.0, 0) or not (stale or navigator.arrived), said
        assert "internal error" not in navigator.reason, said
        moved += command.v > 0
        talked += bool(command.utterance)
    assert 1000 < moved < 9000 and talked > 20
