"""`jaxnav talk` and an exported policy follow the same rules of a conversation."""

import itertools
import json
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnav import talk
from jaxnav.language.dialogue_rules import RULES, speaker
from jaxnav.language.interpreter import Understood
from jaxnav.language.llm import Answered
from jaxnav.language.speaker import TemplateSpeaker
from jaxnav.world import Action
from jaxnav.world.types import AGREES, NONE, REFUSES, RIGHT, STOP

ASIDE, HEAD_ON, WAITING = (2.0, 0.6, -0.5, 0.0), (2.0, 0.1, -0.5, 0.0), (2.0, 0.1, 0.0, 0.0)


class Situation(NamedTuple):
    """A sentence of a person at ``person``, which was heard ``age`` periods ago, and what the robot has to do then."""

    person: tuple[float, float, float, float]
    message: int
    speed: float  # share of the top speed, of a policy that goes at full speed
    sentence: str
    reply: int = NONE
    margin: float = 0.9
    reply_probability: float = 0.9
    awaited: bool = False
    age: int = 0


SITUATIONS = {
    "asked to stop": Situation(ASIDE, STOP, 0.0, "acknowledge"),
    "by who stands": Situation(WAITING, STOP, 0.0, "acknowledge"),
    "by who walks into it": Situation(HEAD_ON, STOP, 1.0, "acknowledge"),
    "a while ago": Situation(ASIDE, STOP, 0.0, "acknowledge", age=19),
    "long ago": Situation(ASIDE, STOP, 1.0, "acknowledge", age=20),
    "asked for a side": Situation(ASIDE, RIGHT, 1.0, "acknowledge"),
    "barely understood": Situation(ASIDE, RIGHT, 1.0, "acknowledge", margin=0.41),
    "not understood": Situation(ASIDE, RIGHT, 0.25, "repeat", margin=0.39),
    "careful at last": Situation(ASIDE, RIGHT, 0.25, "repeat", margin=0.39, age=4),
    "careful no more": Situation(ASIDE, RIGHT, 1.0, "repeat", margin=0.39, age=5),
    "small talk": Situation(ASIDE, NONE, 1.0, ""),
    "agreed": Situation(ASIDE, NONE, 1.0, "reply", AGREES, awaited=True),
    "refused": Situation(ASIDE, STOP, 0.0, "reply", REFUSES, awaited=True),
    "refused and walks on": Situation(HEAD_ON, STOP, 1.0, "reply", REFUSES, awaited=True),
    "refused long ago": Situation(ASIDE, NONE, 1.0, "reply", REFUSES, awaited=True, age=20),
    "agreed to nothing": Situation(ASIDE, NONE, 1.0, "", AGREES),
    "perhaps an answer": Situation(ASIDE, NONE, 1.0, "", AGREES, reply_probability=0.5, awaited=True),
    "an unsure answer": Situation(ASIDE, RIGHT, 1.0, "reply", AGREES, margin=0.1, awaited=True),
}


def kind_of(sentence, contract):
    """Which of the contract's sentences it is."""
    for kind, sentences in contract["sentences"].items():
        if sentence in (sentences if isinstance(sentences, list) else itertools.chain(*sentences.values())):
            return kind
    return sentence


def on_the_robot(case, folder, policy, navigator, scans):
    made = navigator.Navigator(str(folder), safety=False)
    made.reset((5.0, 0.0))
    scan, top = scans.Scan(np.full(180, 5.0), -np.pi / 2, np.pi / 179), made.contract["control"]["max_v"]
    heard, answer = np.zeros(3), np.zeros(3)
    if case.message:
        heard[case.message - 1] = 0.5 + 0.5 * case.margin  # the rest is silence
    answer[[case.reply, (case.reply + 1) % 3]] = case.reply_probability, 1.0 - case.reply_probability
    made.policy.understand = lambda words: (heard, answer)
    made.policy.act = lambda seen: policy.Decision(
        top, 0.0, 2 if case.awaited and seen["may_request"] else 0, None, None, None
    )
    words, times = np.full(185, 0.1), iter(0.4 * np.arange(100))

    def step(message=None):
        return made.step(scan._replace(), [case.person], (0.0, 0.0, 0.0), message, now=next(times))

    if case.awaited:
        assert step().request == 2
    command = said = step(words)
    for _ in range(case.age):
        command = step()
    return command.v / top, kind_of(said.utterance, made.contract)


@pytest.fixture(scope="module")
def start(bundles):
    """A state of the world, whatever it is."""
    run = bundles("lidar")[0]
    return jax.jit(run.world.reset)(jax.random.key(0), run.params, jnp.int32(0))


def in_talk(case, run, actor, start, contract, monkeypatch):
    found = Understood(
        "", case.message, 0.9, case.margin, case.reply, case.reply_probability, talk.message_of(case.message)
    )
    taken, no = [], np.bool_(False)

    def step(world, key, state, action, params):
        taken.append(action)
        e = state.encounters
        aged = e.replace(message_age=e.message_age + 1, request_age=e.request_age + 1)
        outcome = SimpleNamespace(requested=NONE, arrived=no, collided=no, truncated=no)
        return state.replace(encounters=aged), outcome

    monkeypatch.setattr(talk, "_answer", lambda *_: Action(twist=jnp.array([1.0, 0.0]), request=jnp.int32(NONE)))
    monkeypatch.setattr(talk, "_step", step)
    interpreter = SimpleNamespace(begin=lambda _: Answered(found))
    made = talk.Conversation(run.policy_of(actor), 0, 0, interpreter, TemplateSpeaker())
    x, y, vx, vy = (jnp.full_like(start.pedestrians.x, value) for value in case.person)
    robot, encounters = start.robot.replace(x=jnp.float32(0), y=jnp.float32(0)), start.encounters
    if case.awaited:
        encounters = encounters.replace(
            is_open=jnp.ones_like(encounters.is_open), request=jnp.full_like(encounters.request, RIGHT)
        )
    people = start.pedestrians.replace(x=x, y=y, vx=vx, vy=vy)
    made.state = made.state.replace(pedestrians=people, robot=robot, encounters=encounters)
    made.hear("...")
    for _ in range(case.age + 1):
        made.step()
    sentences = [sentence for _, who, sentence in made.said if who == "robot"]
    return (float(taken[-1].twist[0]) + 1.0) / 2.0, kind_of(*(sentences or [""]), contract)


@pytest.mark.parametrize("name", SITUATIONS)
def test_both_decide_alike(name, bundles, robot, start, monkeypatch):
    case, modules = SITUATIONS[name], robot("lidar")
    run, actor, _ = bundles("lidar")
    contract = json.loads((modules[0] / "contract.json").read_text())
    assert contract["dialogue"] == RULES
    wanted = pytest.approx(case.speed), case.sentence
    assert in_talk(case, run, actor, start, contract, monkeypatch) == wanted
    assert on_the_robot(case, *modules) == wanted


def test_a_sentence_is_taken_for_that_of_the_nearest_who_has_said_nothing():
    """(distance, in a dialogue, nothing said in it) of each."""
    assert speaker([(1.0, True, False), (3.0, True, True), (2.0, True, True), (0.5, False, False)]) == 2
    assert speaker([(1.0, False, False), (2.0, True, False)]) == 1
    assert speaker([(2.0, False, False), (1.0, False, False)]) == 1
    assert speaker([]) is None
