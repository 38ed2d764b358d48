"""A conversation in a live episode, with an interpreter that understands what the test says they do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav.agents.hsac import HSAC, HSACConfig, HSACHyperparameters
from jaxnav.errors import UserError
from jaxnav.language.interpreter import Understood, nothing
from jaxnav.language.llm import Answered
from jaxnav.language.speaker import TemplateSpeaker
from jaxnav.talk import Conversation, describe, message_of, read_script, scene_map
from jaxnav.training.policy import Policy
from jaxnav.world import Action, Params, World, WorldConfig
from jaxnav.world.types import AGREES, LEFT, NONE, REFUSES, RIGHT, STOP


def understood(message=NONE, reply=NONE, confidence=0.99, margin=0.98):
    return Understood("...", message, confidence, margin, reply, 0.9, message_of(message))


KNOWN = {
    "stop": understood(STOP), "right": understood(RIGHT), "left": understood(LEFT), "yes": understood(NONE, AGREES),
    "no": understood(STOP, REFUSES), "mumble": understood(RIGHT, NONE, 0.5, 0.1), "": nothing(),
}  # fmt: skip


class PolicyInterpreter:
    """Understands names instead of sentences."""

    def begin(self, text):
        return Answered(KNOWN[text])


class Driver(HSAC):
    """Full speed ahead, and always the request ``request``; steers by what it hears."""

    request = NONE

    def answer(self, actor, observation, heard):
        turn = 0.5 * (heard[0, 2] - heard[0, 1])
        request = jnp.where(observation.may_request, self.request, NONE)
        return Action(twist=jnp.stack([jnp.float32(1.0), turn]), request=request)


class Asker(Driver):
    request = RIGHT


@pytest.fixture(scope="module")
def world():
    return World(WorldConfig(scenes=("hallway", "square"), beams=4))


@pytest.fixture
def talk(world):
    def start(agent=Driver, scene=0, seed=1):
        policy = Policy(None, learner=DRIVERS[agent], world=world)
        return Conversation(policy, scene, seed, PolicyInterpreter(), TemplateSpeaker())

    return start


DRIVERS = {kind: kind(HSACConfig(actor_widths=(4,), critic_widths=(4,))) for kind in (Driver, Asker)}


def steps(conversation, count):
    for _ in range(count):
        if not conversation.ended:
            conversation.step()
    return conversation.episode().states


def test_nobody_speaks_unless_the_user_does(talk):
    states = steps(talk(), 40)
    assert not states.encounters.message.any() and not states.encounters.utterance.any()


@pytest.mark.parametrize(("word", "sign"), [("right", -1), ("left", 1)])
def test_it_goes_where_it_was_asked_and_says_so(talk, word, sign):
    conversation = talk()
    steps(conversation, 2)
    conversation.hear(word)
    states = steps(conversation, 4)
    assert (np.sign(np.asarray(states.robot.w)[3:]) == sign).all()
    assert (states.encounters.message[3:, 0] == KNOWN[word].message).all()
    assert [speaker for _, speaker, _ in conversation.said] == ["pedestrian", "understood", "robot"]
    assert word in conversation.said[2][2]
    assert conversation.episode().speech[-1][1][1].startswith("Robot: ")


def test_asked_to_stop_it_stands_until_the_pedestrian_has_passed(talk):
    """In the square, where paths cross: aside of the pedestrian's way it stands, and goes on after the encounter."""
    stood = 0
    for seed in range(6):
        conversation = talk(scene=1, seed=seed)
        steps(conversation, 1)
        conversation.hear("stop")
        states = steps(conversation, 60)
        e, robot, walker = states.encounters, states.robot, states.pedestrians
        vx, vy = walker.vx[:, 0], walker.vy[:, 0]
        aside = np.abs(vx * (robot.y - walker.y[:, 0]) - vy * (robot.x - walker.x[:, 0])) > 0.4201 * np.hypot(vx, vy)
        should = (e.is_open[:, 0] & (e.message[:, 0] == STOP) & (e.message_age[:, 0] < 20) & aside)[:-1]
        standing = np.asarray(robot.v)[1:] == 0.0
        # The first step takes in what was said just before it.
        assert standing[2:][should[2:]].all()
        stood += int(should[2:].sum())
        if not e.is_open[-1, 0]:
            assert not standing[-1], "it drives on when the pedestrian has passed"
    assert stood > 20


def test_a_refusal_makes_the_robot_yield_and_consent_is_obeyed(talk):
    for word, reply in (("no", REFUSES), ("yes", AGREES)):
        conversation = talk(Asker)
        for _ in range(30):
            steps(conversation, 1)
            if int(conversation.state.encounters.request[0]) != NONE:
                break
        assert int(conversation.state.encounters.request[0]) == RIGHT
        assert "right" in conversation.said[-1][2]
        states = steps(conversation, 3)
        assert (states.encounters.reply == NONE).all(), "it waits for the user's answer"
        conversation.hear(word)
        states = steps(conversation, 2)
        last = jax.tree.map(lambda leaf: leaf[-1, 0], states.encounters)
        if reply == AGREES:
            assert (last.reply, last.request) == (AGREES, RIGHT)
            assert "hank" in conversation.said[-1][2]
        else:
            assert (last.message, bool(last.pedestrian_first), last.request) == (STOP, True, NONE)
            assert "wait" in conversation.said[-1][2] or "stop" in conversation.said[-1][2]
            np.testing.assert_array_equal(conversation._heard[0], [1, 0, 0])


def test_unsure_it_slows_down_and_asks_again(talk):
    conversation = talk()
    steps(conversation, 2)
    conversation.hear("mumble")
    states = steps(conversation, 7)
    v = np.asarray(states.robot.v)
    assert (v[3:8] <= 0.15 + 1e-6).all() and v[2] > 0.5 and v[9] > 0.5
    assert not states.encounters.message.any()
    assert conversation.said[-1][2].endswith(("?", "please?"))
    assert "asks again" in describe(conversation.understood)


def test_sentences_in_quick_succession_are_all_heard(talk):
    conversation = talk()
    for word in ("left", "mumble", "right"):
        conversation.hear(word)
    states = steps(conversation, 1)
    assert states.encounters.message[-1, 0] == RIGHT
    assert [speaker for _, speaker, _ in conversation.said] == ["pedestrian"] * 3 + ["understood"] * 3 + ["robot"] * 3


def test_control_characters_are_not_repeated(talk):
    conversation = talk()
    KNOWN["\033[2Jstop"] = KNOWN["stop"]
    conversation.hear("\033[2Jstop")
    assert conversation.said[0][2] == "[2Jstop"


def test_silence_changes_nothing(talk):
    conversation, other = talk(), talk()
    conversation.hear("")
    for a, b in zip(*(jax.tree.leaves(steps(c, 5)) for c in (conversation, other)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_map_shows_everybody(talk):
    drawn = scene_map(talk())
    assert {"#", "R", "P", "G"} <= set(drawn) and set(drawn) & set("<>^v")
    assert max(map(len, drawn.splitlines())) == 64


def test_scripts(tmp_path):
    path = tmp_path / "script.txt"
    path.write_text("# a comment\n3 Stop!\n3 And wait!\n\n 1.5 Watch out on your right!\n")
    assert read_script(path) == [(1.5, "Watch out on your right!"), (3.0, "Stop!"), (3.0, "And wait!")]
    for content, complaint in (
        ("soon Stop!\n", r"script.txt:1 is 'soon Stop!': write seconds and a sentence"),
        ("1.0 Stop!\n2.0\n", r"script.txt:2 is '2.0': write"),
        ("-1 Stop!\n", r":1 is"),
        ("nan Stop!\n", r":1 is"),
        ("# nothing\n", "says nothing"),
    ):
        path.write_text(content)
        with pytest.raises(UserError, match=complaint):
            read_script(path)
    with pytest.raises(UserError, match="can't be read"):
        read_script(tmp_path / "missing.txt")


def test_no_episode_before_the_first_step(talk):
    with pytest.raises(UserError, match="nothing has happened"):
        talk().episode()


def test_an_untrained_learner_answers_by_its_own_network(world):
    """`HSAC.answer` hears what it is told, not what the observation says."""
    agent = HSAC(HSACConfig(actor_widths=(8,), critic_widths=(8,)))
    state = world.reset(jax.random.key(0), Params(), 0)
    observation = world.observe(state, Params())
    actor = jax.jit(agent.init)(jax.random.key(1), observation, HSACHyperparameters()).actor
    twists = [agent.answer(actor, observation, message_of(m)[None]).twist for m in (NONE, STOP, RIGHT, LEFT)]
    assert len({tuple(np.asarray(twist).tolist()) for twist in twists}) == 4
    silent = agent.best_action(actor, observation).twist
    np.testing.assert_allclose(twists[0], silent, rtol=1e-6)
