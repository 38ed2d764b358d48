"""A conversation in a live episode: a person speaks for the nearest pedestrian, a trained robot drives and answers."""

import collections
import functools
import itertools
import math
import pathlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .agents.networks import message_codes
from .errors import UserError
from .language import dialogue_rules
from .language.dialogue_rules import RULES
from .language.interpreter import LanguageModelInterpreter, PolicyInterpreter, Understood
from .language.sides import clean
from .language.speaker import REPEAT, Context, LanguageModelSpeaker, TemplateSpeaker
from .training.evaluation import episode_keys
from .training.policy import Policy
from .training.rollout import Episode
from .world import Outcome, State, dialogue, sensing
from .world.types import AGREES, NONE, REPLIES, STOP

_NEVER = 1_000_000  # steps after which a pedestrian would answer by itself
_CAREFUL = 2.0 * RULES["careful_speed"] - 1.0  # the most of the twist's first number, which goes from -1 to 1
_STAND = np.array([-1.0, 0.0], np.float32)


class Conversation:
    """An episode of a policy in which nobody speaks but its user.

    policy: one that hears sentences; scene: index of a scene of its world; seed: of the episode.
    interpreter, speaker: see `jaxnav.language`; language models are asked without waiting, so that no step is late for
    words. `hear` runs the sentence encoder, `step` never does.
    """

    def __init__(
        self,
        policy: Policy,
        scene: int,
        seed: int,
        interpreter: PolicyInterpreter | LanguageModelInterpreter,
        speaker: TemplateSpeaker | LanguageModelSpeaker,
    ) -> None:
        world = policy.world
        self._policy = policy
        self._interpreter, self._speaker = interpreter, speaker
        # Chance says nothing here: people speak when the user does.
        self.params = policy.params.replace(p_pedestrian_first=0.0, small_talk=0.0)
        self.scene = world.scenes[scene]
        key_reset, self._key = jax.random.split(episode_keys(seed, jnp.arange(1))[0])
        state = jax.jit(world.reset)(key_reset, self.params, jnp.int32(scene))
        self.state = state.replace(
            traits=state.traits.replace(reply_delay=jnp.full_like(state.traits.reply_delay, _NEVER))
        )
        self._states: list[State] = [self.state]
        self._outcomes: list[Outcome] = []
        self._speech: list[list[tuple[str, str]]] = [[]]
        self._heard = np.zeros((world.config.pedestrians, 3), np.float32)
        self._listening: collections.deque[Any] = collections.deque()
        self._speaking: collections.deque[Any] = collections.deque()
        self._careful = 0
        # (seconds, speaker, sentence) of everything; of what was understood, speaker is "understood".
        self.said: list[tuple[float, str, str]] = []
        self.understood: Understood | None = None  # what was understood last

    @property
    def seconds(self) -> float:
        """Time since the start."""
        return len(self._outcomes) * float(self.params.dt)

    @property
    def ended(self) -> str:
        """How it ended: arrived, collision, time out, or "" while it goes on."""
        if self._outcomes:
            last = self._outcomes[-1]
            for event, word in (("arrived", "arrived"), ("collided", "collision"), ("truncated", "time out")):
                if getattr(last, event):
                    return word
        return ""

    def hear(self, text: str) -> None:
        """The pedestrian says ``text``: the robot begins to think about it."""
        self._say("pedestrian", clean(text))
        self._listening.append(self._interpreter.begin(text))

    def step(self) -> None:
        """One control step of ``params.dt``; what is understood or ready to be said by now counts in it."""
        while self._listening and (found := self._listening[0].take()) is not None:
            self._listening.popleft()
            self._take_in(found)
        action = _answer(self._policy, self.state, self._heard, self.params)
        if self._careful:
            self._careful -= 1
            action = action.replace(twist=action.twist.at[0].min(_CAREFUL))
        if self._stands():
            action = action.replace(twist=_STAND)
        self._key, key = jax.random.split(self._key)
        self.state, outcome = _step(self._policy.world, key, self.state, action, self.params)
        outcome = jax.device_get(outcome)
        if outcome.requested != NONE:
            self._begin(Context(int(outcome.requested)))
        # Who has passed has nothing more to say.
        self._heard *= np.asarray(self.state.encounters.is_open)[:, None]
        self._utter()
        self._states.append(self.state)
        self._outcomes.append(outcome)
        self._speech.append(self._lines())

    def finish_speaking(self) -> None:
        """Wait for a sentence that is still being found; at most the time limit of a language model."""
        while self._speaking:
            self._speaking[0].wait()
            self._utter()
        self._speech[-1] = self._lines()

    def episode(self) -> Episode:
        """The episode so far, to be drawn. UserError: nothing has happened."""
        if not self._outcomes:
            raise UserError("nothing has happened yet: there is no episode to draw")
        return Episode(
            scene=self.scene.name, states=_stack(self._states), outcomes=_stack(self._outcomes), speech=self._speech
        )

    def _take_in(self, found):
        """Act upon what was understood."""
        self.understood = found
        self._say("understood", describe(found))
        encounters, traits = self.state.encounters, self.state.traits
        waits = np.asarray(encounters.is_open & (encounters.request != NONE) & (encounters.reply == NONE))
        reply = found.reply if dialogue_rules.is_reply(found.reply_confidence, RULES) else NONE
        reaction = dialogue_rules.reaction(found.message, reply, found.unsure, bool(waits.any()))
        if reaction == "reply":
            i = int(np.argmin(np.where(waits, self._distances(), np.inf)))
            self._begin(Context(int(encounters.request[i]), "robot", reply))
            if reply == AGREES:
                agreed = encounters.replace(reply=encounters.reply.at[i].set(AGREES))
                # From now on, for as long as it obeys.
                delay = traits.reply_delay.at[i].set(encounters.request_age[i])
                comply = traits.compliance.at[i].set(-1.0)
                self.state = self.state.replace(
                    encounters=agreed, traits=traits.replace(reply_delay=delay, compliance=comply)
                )
            else:
                # It goes first, as if it had said so: the robot yields.
                self._speak(i, STOP, message_of(STOP))
        elif reaction == "repeat":
            self._careful = RULES["careful_periods"]
            self._begin(REPEAT)
        elif reaction == "obey":
            self._speak(self._speaking_person(), found.message, found.heard)
            self._begin(Context(found.message, "pedestrian"))

    def _speak(self, i, message, heard):
        one = jax.tree.map(lambda leaf: leaf[i], (self.state.encounters, self.state.pedestrians))
        spoken = dialogue.speak(one[0], self.state.robot, one[1], message)
        encounters = jax.tree.map(lambda leaf, new: leaf.at[i].set(new), self.state.encounters, spoken)
        self.state = self.state.replace(encounters=encounters)
        self._heard[i] = heard

    def _distances(self):
        """`[P]` m to everybody, infinite to those who are not there."""
        people, robot = jax.device_get((self.state.pedestrians, self.state.robot))
        return np.where(people.present, np.hypot(people.x - robot.x, people.y - robot.y), np.inf)

    def _speaking_person(self):
        """The index of the person who is taken for the speaker."""
        encounters = jax.device_get(self.state.encounters)
        free = np.asarray(dialogue.may_request(encounters))
        return dialogue_rules.speaker(list(zip(self._distances(), encounters.is_open, free, strict=True)))

    def _stands(self):
        """Whether the robot stands because it promised to. A refusal is the message stop here, see `_take_in`."""
        e, people, robot = jax.device_get((self.state.encounters, self.state.pedestrians, self.state.robot))
        clearance = float(self.params.robot_radius + self.params.body_radius) + RULES["stand_gap"]
        promises = [
            (
                e.message_age[i],
                dialogue_rules.walks_into(
                    (people.x[i], people.y[i], people.vx[i], people.vy[i]), (robot.x, robot.y), clearance, RULES
                ),
            )
            for i in np.flatnonzero(e.is_open & (e.message == STOP))
        ]
        return dialogue_rules.stands(promises, RULES)

    def _begin(self, context):
        self._speaking.append(self._speaker.begin(context))

    def _utter(self):
        while self._speaking and (sentence := self._speaking[0].take()) is not None:
            self._speaking.popleft()
            self._say("robot", sentence)

    def _say(self, speaker, sentence):
        self.said.append((self.seconds, speaker, sentence))

    def _lines(self):
        """The last thing that each has said, the pedestrian first, as captions."""
        lines = []
        for speaker, name in (("pedestrian", "Pedestrian"), ("robot", "Robot")):
            spoken = [(when, sentence) for when, who, sentence in self.said if who == speaker]
            if spoken and self.seconds - spoken[-1][0] <= 8.0:
                lines.append((speaker, f'{name}: "{spoken[-1][1]}"'))
        return lines


def message_of(message: int) -> np.ndarray:
    """S_c `[3]` of a message that is certain."""
    return np.eye(4, dtype=np.float32)[message, 1:]


def describe(found: Understood) -> str:
    """The understood meaning as text for people: "stop (0.98)"."""
    replied = dialogue_rules.is_reply(found.reply_confidence, RULES)
    if found.unsure:
        return f"{found.name}? (only {found.confidence:.2f}: asks again)"
    reply = f", a reply: {REPLIES[found.reply]}" if found.reply != NONE and replied else ""
    return f"{found.name} ({found.confidence:.2f}){reply}"


def read_script(path: pathlib.Path) -> list[tuple[float, str]]:
    """[(seconds, sentence)] in order of time, of lines like "2.0 I'm in a hurry"; # begins a comment.

    UserError names file, line and remedy.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise UserError(f"--script {path} can't be read ({error.strerror}): give a text file") from None
    except UnicodeDecodeError:
        raise UserError(f"--script {path} can't be read: save it in UTF-8") from None
    script = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        when, _, sentence = line.strip().partition(" ")
        try:
            seconds = float(when)
        except ValueError:
            seconds = math.nan
        if not 0 <= seconds < math.inf or not sentence.strip():
            raise UserError(
                f'--script {path}:{number} is {line!r}: write seconds and a sentence, like "2.0 Please stop"'
            )
        script.append((seconds, sentence.strip()))
    if not script:
        raise UserError(f'--script {path} says nothing: write lines like "2.0 Please stop"')
    return sorted(script, key=lambda line: line[0])  # what is said at one time stays in its order


def scene_map(conversation: Conversation, columns: int = 64) -> str:
    """The scene from above in characters: # walls, R the robot, > where it heads, P people, G the goal."""
    points = np.concatenate([np.array(chain) for chain in conversation.scene.chains])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = (columns - 1) / (high[0] - low[0])
    rows = max(4, round((high[1] - low[1]) * scale / 2) + 1)  # a character is twice as high as it is wide
    canvas = np.full((rows, columns), " ")

    def put(x, y, mark):
        column = round((float(x) - low[0]) * scale)
        row = rows - 1 - round((float(y) - low[1]) * scale / 2)
        if 0 <= row < rows and 0 <= column < columns:
            canvas[row, column] = mark

    for chain in conversation.scene.chains:
        corners = np.array([*chain, chain[0]])
        for a, b in itertools.pairwise(corners):
            for share in np.linspace(0.0, 1.0, 2 * columns):
                x, y = a + share * (b - a)
                put(x, y, "#")
    robot, people = conversation.state.robot, conversation.state.pedestrians
    put(robot.goal_x, robot.goal_y, "G")
    heading = float(robot.heading)
    put(
        robot.x + 0.5 * math.cos(heading), robot.y + 0.5 * math.sin(heading), ">^<v"[round(heading / (math.pi / 2)) % 4]
    )
    for x, y, present in zip(people.x, people.y, people.present, strict=True):
        if present:
            put(x, y, "P")
    put(robot.x, robot.y, "R")
    return "\n".join("".join(row).rstrip() for row in canvas)


@jax.jit
def _answer(policy, state, heard, params):
    world = policy.world
    observation = world.observe(state, params)
    snapshot = world.snapshot(state)
    order = sensing.nearest_first(snapshot.pedestrians, snapshot, world.config)
    spoke = message_codes(observation.dialogue).any(axis=-1, keepdims=True)
    return policy.learner.answer(policy.parameters, observation, jnp.where(spoke, heard[order], 0.0))


@functools.partial(jax.jit, static_argnums=0)
def _step(world, key, state, action, params):
    return world.step(key, state, action, params)


def _stack(items):
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *items)
