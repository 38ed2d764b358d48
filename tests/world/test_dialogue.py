"""The dialogue: gate, initiator, words, replies, obedience, commitment, and how two pass each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.world import Params, World, dialogue
from jaxnav.world.types import AGREES, LEFT, NONE, REFUSES, RIGHT, STOP

FACING = [(2.5, 0.0, -4.5, 0.0)]  # walking toward the robot at the origin
CROSSING = [(1.5, 1.5, 1.5, -4.5)]  # walking across its path from the left
WORLD = World()
USUAL = Params(message_exceptions=0.0)
WORD = np.uint32(12345)
ASKED = {"is_open": True, "met": True, "distance": 2.6}


@jax.jit
def advance(state, params, word=WORD, turns=False):
    """`dialogue.advance` of every pedestrian of a state; the state with the new encounters."""
    encounters = jax.vmap(dialogue.advance, in_axes=(0, 0, None, 0, None, None, None, None))(
        state.encounters, state.traits, state.robot, state.pedestrians, turns, WORLD.walls(state.scene), word, params
    )
    return state.replace(encounters=encounters)


def only(state, name):
    return getattr(state.encounters, name)[0].item()


class TestGate:
    @pytest.mark.parametrize(
        ("pedestrian", "twist", "opens"),
        [
            ((2.9, 0.0, -4.5, 0.0), (0.6, 0.0), True),
            ((3.1, 0.0, -4.5, 0.0), (0.6, 0.0), False),  # beyond 3 m
            ((2.9, 0.0, 4.5, 0.0), (0.6, 0.0), False),  # walks ahead: 0.1 m/s of approach, 2.4 m apart after 5 s
            ((2.9, 0.0, 4.5, 0.0), (0.0, 0.0), False),  # walks away
            ((2.5, 0.9, -4.5, 0.9), (0.6, 0.0), True),  # passes within 1 m
            ((2.5, 1.1, -4.5, 1.1), (0.6, 0.0), False),  # passes more than 1 m away
            ((-2.5, 0.0, 4.5, 0.0), (0.0, 0.0), True),  # from behind, to a robot that stands
            ((-2.9, 0.0, 4.5, 0.0), (0.3, 0.0), False),  # from behind, 1.9 m apart after 5 s
        ],
    )
    def test_opens_when_near_and_closing_in(self, situation, pedestrian, twist, opens):
        state = advance(situation(twist=twist, pedestrians=[pedestrian]), USUAL)
        assert only(state, "is_open") == only(state, "met") == opens

    @pytest.mark.parametrize(("x", "opens"), [(4.8, True), (5.0, False)])
    def test_its_distance_grows_with_the_walking_speed(self, situation, x, opens):
        """A walker of 1.2 m/s is met at 3 m (0.6 + 1.2) / (0.6 + 0.5) = 4.9 m."""
        state = situation(twist=(0.6, 0.0), pedestrians=[(x, 0.0, -4.5, 0.0)], speed=1.2)
        assert only(advance(state, USUAL), "is_open") == opens

    def test_closes_when_the_distance_has_grown_for_two_steps_and_never_opens_again(self, situation):
        state = advance(situation(twist=(0.6, 0.0), pedestrians=FACING, first_draw=0.0), USUAL)
        seen = []
        # Away, closer, away twice, then closing in again.
        for x in (2.6, 2.4, 2.5, 2.6, 2.0, 1.0):
            state = advance(state.replace(pedestrians=state.pedestrians.replace(x=np.full(1, x, np.float32))), USUAL)
            seen.append((only(state, "is_open"), only(state, "message"), only(state, "utterance") != 0))
        assert seen == [(True, RIGHT, True)] * 3 + [(False, NONE, False)] * 3
        assert not only(state, "pedestrian_first")

    def test_the_lines_of_both_are_frozen_at_the_opening(self, situation):
        state = advance(situation(robot=(0.0, 0.0, 0.3), goal=(0.0, 4.0), pedestrians=FACING), USUAL)
        moved = state.replace(
            robot=state.robot.replace(x=np.float32(1.0)),
            pedestrians=state.pedestrians.replace(y=np.full(1, 1.0, np.float32)),
        )
        for now in (state, advance(moved, USUAL)):
            names = ("x", "y", "ux", "uy", "robot_x", "robot_y", "robot_ux", "robot_uy")
            assert [only(now, name) for name in names] == pytest.approx([2.5, 0, -1, 0, 0, 0, 0, 1], abs=1e-6)

    def test_where_the_pedestrian_turns_its_line_is_frozen_anew(self, situation):
        state = advance(situation(robot=(0.0, 0.0, 0.3), goal=(0.0, 4.0), pedestrians=FACING), USUAL)
        turned = state.pedestrians.replace(y=np.full(1, 1.0, np.float32), goal_x=np.full(1, 2.5, np.float32))
        now = advance(state.replace(pedestrians=turned), USUAL, turns=True)
        assert [only(now, name) for name in ("x", "y", "ux", "uy")] == pytest.approx([2.5, 1, 0, -1], abs=1e-6)
        assert [only(now, name) for name in ("robot_x", "robot_ux")] == [
            only(state, "robot_x"),
            only(state, "robot_ux"),
        ]

    def test_those_who_are_not_there_meet_nobody(self, situation):
        state = situation(twist=(0.6, 0.0), pedestrians=FACING)
        absent = state.replace(pedestrians=state.pedestrians.replace(present=np.zeros(1, bool)))
        assert only(advance(state, USUAL), "met") and not only(advance(absent, USUAL), "met")


class TestWords:
    @pytest.mark.parametrize(("p", "first"), [(0.5, True), (0.3, False)])
    def test_the_initiator_is_drawn_at_the_opening(self, situation, p, first):
        state = advance(situation(pedestrians=FACING, first_draw=0.4), USUAL.replace(p_pedestrian_first=p))
        assert only(state, "pedestrian_first") == first
        assert (only(state, "message") != NONE) == first

    @pytest.mark.parametrize(("y", "wider"), [(-0.3, RIGHT), (0.3, LEFT)])
    def test_facing_it_names_its_wider_side(self, situation, y, wider):
        """Walking toward -x in the hallway: from y < 0 there is more room on its right, +y."""
        state = situation(pedestrians=[(2.0, y, -4.5, y)], scene=1, first_draw=0.0)
        assert only(advance(state, USUAL), "message") == wider

    @pytest.mark.parametrize("heading", [-134, -90, -46, 46, 90, 134])
    def test_crossing_it_asks_to_stop(self, situation, heading):
        assert self.message_of_heading(situation, heading) == STOP

    @pytest.mark.parametrize("heading", [-180, -136, -44, 0, 44, 136])
    def test_not_crossing_it_names_a_side(self, situation, heading):
        assert self.message_of_heading(situation, heading) in (RIGHT, LEFT)

    def message_of_heading(self, situation, degrees):
        """What a pedestrian 0.5 m ahead says that walks in that direction."""
        x, y = 0.5 + 3 * np.cos(np.deg2rad(degrees)), 3 * np.sin(np.deg2rad(degrees))
        return only(advance(situation(pedestrians=[(0.5, 0.0, x, y)], first_draw=0.0), USUAL), "message")

    @pytest.mark.parametrize(("pedestrians", "usual"), [(FACING, RIGHT), (CROSSING, STOP)])
    def test_a_fifth_of_the_messages_are_others_evenly(self, situation, pedestrians, usual):
        state = situation(pedestrians=pedestrians, twist=(0.6, 0.0), first_draw=0.0)
        draws = jnp.array((np.arange(1000) + 0.5) / 1000, jnp.float32)[:, None]

        def message(draw):
            return advance(state.replace(traits=state.traits.replace(message=draw)), Params()).encounters.message[0]

        counts = np.bincount(jax.vmap(message)(draws), minlength=4)
        expected = np.array([0, 100, 100, 100])
        expected[usual] = 800
        np.testing.assert_allclose(counts, expected, atol=1)

    def test_small_talk_is_an_utterance_without_message_and_0_is_silence(self, situation):
        words = jnp.arange(20_000, dtype=jnp.uint32) * jnp.uint32(2654435761)

        def said(state, small_talk):
            after = jax.vmap(lambda word: advance(state, USUAL.replace(small_talk=small_talk), word))(words)
            return np.asarray(after.encounters.utterance[:, 0]), np.asarray(after.encounters.message[:, 0])

        far = situation()
        utterances, messages = said(far, 0.25)
        assert np.mean(utterances != 0) == pytest.approx(0.25, abs=0.01)
        assert np.all(messages == NONE)
        assert np.all(said(far, 0.0)[0] == 0)
        # With a message it is always worded, also by the word 0, and small talk doesn't replace a message that is held.
        utterances, messages = said(situation(pedestrians=FACING, first_draw=0.0), 0.25)
        assert np.all(utterances != 0)
        assert np.all(messages == RIGHT)
        held = situation(
            pedestrians=FACING, is_open=True, met=True, pedestrian_first=True, message=RIGHT, utterance=5, distance=3.0
        )
        assert np.all(said(held, 1.0)[0] == 5)


class TestRequests:
    @pytest.mark.parametrize(
        ("encounter", "counts"),
        [
            ({}, True),
            ({"is_open": False}, False),
            ({"pedestrian_first": True, "message": RIGHT}, False),
            ({"request": STOP}, False),
        ],
        ids=["gate open", "gate closed", "pedestrian first", "used"],
    )
    def test_requests_count_only_while_open_first_and_unused(self, default, situation, action, encounter, counts):
        state = situation(pedestrians=FACING, **ASKED | encounter)
        assert default.observe(state, Params()).may_request.item() == counts
        after, outcome = default.act(state, action(request=LEFT))
        assert outcome.requested.item() == (LEFT if counts else NONE)
        assert only(after, "request") == (LEFT if counts else encounter.get("request", NONE))

    def test_only_the_nearest_that_may_be_asked_is_asked(self, crowd, situation, action):
        """Nearest of all: gate closed. Then: pedestrian first. Then two that may be asked."""
        places = [(4.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.5), (1.5, 0.5), (4.5, 2.0)]
        state = situation(pedestrians=[(*place, *place) for place in places], **ASKED)
        at = np.array(places, np.float32)
        encounters = state.encounters.replace(
            distance=np.hypot(*at.T), is_open=np.array([1, 0, 1, 1, 1, 0], bool), pedestrian_first=np.arange(6) == 4
        )
        after, _ = crowd.act(state.replace(encounters=encounters), action(request=STOP))
        assert after.encounters.request.tolist() == [NONE, NONE, STOP, NONE, NONE, NONE]

    @pytest.mark.parametrize("delay", [0, 1, 2])
    @pytest.mark.parametrize(("compliance", "reply"), [(1.0, AGREES), (0.0, REFUSES)])
    def test_the_reply_comes_after_its_delay_and_is_kept(self, default, situation, action, delay, compliance, reply):
        params = Params(compliance=compliance)
        state = situation(pedestrians=FACING, compliance_draw=0.5, reply_delay=delay, **ASKED)
        replies, speeds = [], []
        for i in range(5):
            state, _ = default.act(state, action(request=STOP if i == 0 else NONE), params)
            replies.append(only(state, "reply"))
            speeds.append(float(np.hypot(state.pedestrians.vx[0], state.pedestrians.vy[0])))
        assert replies == [NONE] * delay + [reply] * (5 - delay)
        assert speeds == pytest.approx([0.5 if reply == REFUSES or i < delay else 0.0 for i in range(5)], abs=1e-6)
        assert only(state, "request_age") == 5

    def test_obeys_for_ten_steps(self, default, situation, action):
        state = situation(pedestrians=FACING, reply_delay=1, **ASKED)
        stands = []
        for _ in range(14):
            state, _ = default.act(state, action(request=STOP))
            stands.append(abs(float(state.pedestrians.vx[0])) < 1e-6)
        assert stands == [False] + [True] * 10 + [False] * 3

    def test_obedience_ends_when_the_encounter_closes(self, default, situation, action):
        """The robot drives off the way it came: after 2 steps of growing distance the walker goes on."""
        state = situation(robot=(0.0, 0.0, np.pi), pedestrians=FACING, **ASKED | {"distance": 2.5})
        stands, is_open = [], []
        for _ in range(5):
            state, _ = default.act(state, action(v=0.6, request=STOP))
            stands.append(abs(float(state.pedestrians.vx[0])) < 1e-6)
            is_open.append(only(state, "is_open"))
        assert is_open == [True, False, False, False, False]
        assert stands == [True, True, False, False, False]
        assert (only(state, "request"), only(state, "reply")) == (NONE, NONE)

    @pytest.mark.parametrize(
        ("pedestrian", "fits"),
        [
            ((2.0, 0.3, -4.5, 0.3), RIGHT),  # facing, on its right of the robot's path
            ((2.0, -0.3, -4.5, -0.3), LEFT),
            ((2.0, 0.3, 4.5, 0.3), LEFT),  # walking ahead: its left is +y
            ((2.0, -0.3, 4.5, -0.3), RIGHT),
            ((2.0, 2.0, 2.0, -4.5), STOP),
            ((2.0, -2.0, 2.0, 4.5), STOP),
        ],
    )
    def test_fitting_request(self, situation, pedestrian, fits):
        """Stop when crossing; else the margin on the side on which the pedestrian already is."""
        state = situation(pedestrians=[pedestrian])
        walker = jax.tree.map(lambda leaf: leaf[0], state.pedestrians)
        assert dialogue.fitting_request(state.robot, walker) == fits


class TestCommitment:
    @pytest.mark.parametrize("delay", [2, 3, 4])
    def test_commits_its_delay_after_speaking(self, default, situation, action, delay):
        """Until then it walks to its goal; from then on to its side, and straight at a robot in its way."""
        params = USUAL.replace(awareness=0.0)
        state = situation(
            robot=(-2.0, 0.0, 0.0), pedestrians=[(1.5, 0.0, -4.5, 0.0)], first_draw=0.0, commit_delay=delay
        )
        state, _ = default.act(state, action(v=0.6), params)
        state, _ = default.act(state, action(v=0.6), params)
        assert (only(state, "message"), only(state, "message_age")) == (RIGHT, 0)
        turned = []
        for _ in range(6):
            state, _ = default.act(state, action(v=0.6), params)
            turned.append(float(state.pedestrians.vy[0]) > 0.1)
        assert turned.index(True) == delay

    @staticmethod
    def pass_each_other(default, situation, action, message, robot_side, delay, y=0.0):
        """Smallest surface distance: 0.6 m/s each, apart 6 m; from the opening on the robot drives to its own line.

        robot_side: +1 keeps to the robot's left, -1 to its right, by half the passing distance, 0 stays on its line.
        """
        state = situation(
            robot=(-3.0, 0.0, 0.0), twist=(0.6, 0.0), pedestrians=[(3.0, y, -4.5, y)], first_draw=0.0,
            commit_delay=delay,
        )  # fmt: skip
        offset, distances = 0.0, []
        for _ in range(20):
            if only(state, "is_open") and offset == 0.0:
                offset = robot_side * 0.635
                said = state.encounters.replace(message=np.full(1, message, np.int32))
                state = state.replace(encounters=said) if only(state, "message_age") == 0 else state
            turn = np.clip(2.0 * (offset - float(state.robot.y)), -0.8, 0.8) - float(state.robot.heading)
            state, outcome = default.act(state, action(0.6, np.clip(turn / 0.4, -0.9, 0.9)), USUAL)
            distances.append(float(outcome.pedestrian_distance))
        return min(distances)

    @pytest.mark.parametrize("delay", [2, 3, 4])
    @pytest.mark.parametrize(("message", "side"), [(RIGHT, -1), (LEFT, 1)])
    def test_the_same_word_passes_a_metre_clear(self, default, situation, action, message, side, delay):
        """However late in its 2-4 steps the pedestrian commits."""
        clear = self.pass_each_other(default, situation, action, message, side, delay)
        assert clear == pytest.approx(1.0, abs=0.1)

    @pytest.mark.parametrize("delay", [2, 4])
    @pytest.mark.parametrize(("message", "side"), [(RIGHT, 1), (LEFT, -1)])
    def test_opposite_words_collide(self, default, situation, action, message, side, delay):
        assert self.pass_each_other(default, situation, action, message, side, delay) < 0

    def test_robot_stop_walks_straight_on_over_a_robot_that_stays(self, default, situation, action):
        assert self.pass_each_other(default, situation, action, STOP, 0, 2) < 0

    def test_crossing_a_robot_that_stops_is_passed_one_that_drives_on_is_hit(self, default, situation, action):
        """The walker is due at the crossing with the robot; aware of it or not, it yields no more once committed."""
        nearest = {}
        for speed in (0.0, 0.6):
            state = situation(twist=(0.6, 0.0), pedestrians=[(2.4, 2.0, 2.4, -4.5)], first_draw=0.0)
            distances, message = [], NONE
            for _ in range(15):
                heard = only(state, "message") == STOP
                state, outcome = default.act(state, action(speed if heard else 0.6), USUAL.replace(awareness=2.0))
                distances.append(float(outcome.pedestrian_distance))
                message = max(message, only(state, "message"))
                if heard and only(state, "message_age") > 2 and only(state, "is_open"):
                    np.testing.assert_allclose([state.pedestrians.vx[0], state.pedestrians.vy[0]], [0, -0.5], atol=0.01)
            assert message == STOP
            nearest[speed] = min(distances)
        assert nearest[0.0] > 0.5
        assert nearest[0.6] < 0


class TestDecidingAlone:
    @pytest.mark.parametrize(
        ("encounter", "decides"),
        [
            ({}, True),
            ({"age": 2}, False),
            ({"age": 9}, True),
            ({"is_open": False}, False),
            ({"pedestrian_first": True, "message": STOP}, False),
            ({"request": STOP}, True),
            ({"request": STOP, "reply": REFUSES}, True),
            ({"request": STOP, "reply": AGREES}, False),
        ],
        ids=["due", "too early", "long since", "closed", "announced", "asked", "refused", "agreed"],
    )
    def test_only_one_with_whom_nothing_is_agreed_does_and_after_its_delay(self, situation, encounter, decides):
        state = situation(decide_delay=3, **{"is_open": True, "age": 3} | encounter)
        assert dialogue.decides_alone(state.encounters, state.traits, Params(p_decides_late=1.0)).item() == decides

    @pytest.mark.parametrize(("p", "share"), [(0.0, 0.0), (0.3, 0.3), (1.0, 1.0)])
    def test_a_share_of_all_do(self, situation, p, share):
        state = situation(is_open=True, age=4)
        draws = ((np.arange(1000) + 0.5) / 1000).astype(np.float32)
        decided = dialogue.decides_alone(
            state.encounters, state.traits.replace(decides=draws), Params(p_decides_late=p)
        )
        assert decided.mean() == pytest.approx(share)

    @pytest.mark.parametrize("delay", [1, 2, 4])
    @pytest.mark.parametrize(("side_draw", "side"), [(0.2, 1), (0.8, -1)])
    def test_from_the_opening_on_it_takes_its_delay_and_then_its_side(
        self, default, situation, action, delay, side_draw, side
    ):
        """It walks toward -x, so that +y is its right."""
        params = USUAL.replace(awareness=0.0, p_decides_late=1.0)
        state = situation(
            robot=(-2.0, 0.0, 0.0), pedestrians=[(1.5, 0.0, -4.5, 0.0)], decide_delay=delay, side_draw=side_draw
        )
        ages, turned = [], []
        for _ in range(8):
            state, _ = default.act(state, action(v=0.6), params)
            if only(state, "is_open"):
                ages.append(only(state, "age"))
                turned.append(side * float(state.pedestrians.vy[0]) > 0.1)
        assert ages == list(range(len(ages)))
        # The velocity that led to a state was chosen at the age before.
        assert turned.index(True) == delay + 1
        assert turned[delay + 1]


def test_a_deaf_robot_observes_silence_while_the_pedestrian_commits(default, variant, situation, action):
    state = situation(pedestrians=FACING, first_draw=0.0)
    for _ in range(4):
        state, _ = variant.act(state, action(), USUAL)
    heard, silent = default.observe(state, USUAL).dialogue, variant.observe(state, USUAL).dialogue
    assert (heard.message.item(), heard.message_age.item(), heard.utterance.item() != 0) == (RIGHT, 3, True)
    assert (silent.message.item(), silent.message_age.item(), silent.utterance.item()) == (NONE, 0, 0)
    assert silent.is_open.item() == heard.is_open.item() == 1
    assert state.pedestrians.vy[0] > 0.1


def test_chance_is_spread_as_specified(random_episodes):
    """Replies after 0-2 steps, commitments after 2-4, own decisions after 1-4, evenly; the draws are independent."""
    traits = jax.tree.map(lambda leaf: leaf[0, :, 0], random_episodes[0].traits)
    for delays, first, last in ((traits.reply_delay, 0, 2), (traits.commit_delay, 2, 4), (traits.decide_delay, 1, 4)):
        values, counts = np.unique(delays, return_counts=True)
        assert values.tolist() == list(range(first, last + 1))
        assert counts / len(delays) == pytest.approx([1 / len(values)] * len(values), abs=0.04)
    uniform = np.stack([traits.first, traits.message, traits.compliance, traits.decides, traits.side])
    np.testing.assert_allclose(uniform.mean(axis=1), 0.5, atol=0.03)
    assert np.abs(np.corrcoef(uniform) - np.eye(5)).max() < 0.08


def test_the_dialogue_is_consistent_along_random_episodes(random_episodes):
    states, outcomes = random_episodes
    e = jax.tree.map(lambda leaf: leaf[..., 0], states.encounters)
    assert np.all(e.is_open <= e.met)
    assert not np.any((e.message != NONE) & ~(e.is_open & e.pedestrian_first))
    assert not np.any((e.request != NONE) & ~(e.is_open & ~e.pedestrian_first))
    assert not np.any((e.reply != NONE) & (e.request == NONE))
    assert not np.any((e.message != NONE) & (e.utterance == 0))
    opened = np.diff(e.is_open.astype(int), axis=0) == 1
    assert np.all(opened.sum(axis=0) + e.is_open[0] <= 1)  # once an episode
    first = e.pedestrian_first[e.is_open]
    assert first.mean() == pytest.approx(0.5, abs=0.05)
    held = (e.message[1:] != NONE) & (e.message[:-1] != NONE)
    for name in ("message", "utterance"):
        assert np.all(getattr(e, name)[1:][held] == getattr(e, name)[:-1][held])
    assert np.all(e.message_age[1:][held] == e.message_age[:-1][held] + 1)
    # A request counts at most once an encounter, in the state in which the robot was told that it may ask.
    asked = outcomes.requested != NONE
    assert asked.any()
    assert np.all(asked.sum(axis=0) <= 1)
    assert np.all(dialogue.may_request(jax.tree.map(lambda leaf: leaf[:-1], e))[asked])
    assert set(np.unique(e.reply)) == {NONE, AGREES, REFUSES}
    silent = (e.utterance != 0) & (e.message == NONE)
    assert np.mean(silent[e.message == NONE]) == pytest.approx(0.05, abs=0.005)
