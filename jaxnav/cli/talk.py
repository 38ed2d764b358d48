"""jaxnav talk: a conversation with a run's robot while it drives."""

import dataclasses
import functools
import pathlib
import re
from typing import TYPE_CHECKING

from .. import fields
from ..errors import UserError, remedy
from .options import (
    EpisodeOptions,
    RunFolder,
    enable_compilation_cache,
    open_run,
    parse,
    run_folder,
    tolerate_any_encoding,
)
from .understand import interpreter_of, log_to_stderr

if TYPE_CHECKING:
    from ..talk import Conversation

_MOST_STEPS = 100  # that a number at the prompt lets pass


@dataclasses.dataclass(frozen=True)
class _Options(EpisodeOptions):
    """Speak for a pedestrian while a run's robot drives: see what it understands, does and says.

    At each prompt type what the nearest pedestrian says. An empty line lets a step pass (0.4 s), a number that many
    seconds; "quit" ends.
    """

    run: RunFolder = run_folder()
    script: str = fields.text(
        "", allowed="a path", doc='conversation to replay: lines of seconds and a sentence, like "2.0 I\'m in a hurry"'
    )
    gif: str = fields.text("", allowed="a path that ends in .gif", doc="where to draw what happened")
    speaker: str = fields.choice(
        "templates",
        ("templates", "llm"),
        doc="who words what the robot says; llm: the server of OPENAI_BASE_URL, OPENAI_MODEL and OPENAI_API_KEY",
    )
    interpreter: str = fields.choice(
        "embedding", ("embedding", "llm"), doc="who reads what people say: the policy itself, or llm"
    )


_EXAMPLES = """\
  jaxnav talk runs/quick-0 --scene hallway
  jaxnav talk runs/quick-0 --script conversation.txt --gif talk.gif
"""


def command(arguments: list[str]) -> None:
    from ..language.interpreter import LanguageModelInterpreter
    from ..language.llm import LanguageModel
    from ..language.speaker import LanguageModelSpeaker, TemplateSpeaker
    from ..talk import Conversation, read_script

    options = parse(_Options, arguments, "talk", _EXAMPLES)
    gif = pathlib.Path(options.gif) if options.gif else None
    if gif is not None and (gif.suffix.lower() != ".gif" or not gif.absolute().parent.is_dir()):
        raise UserError(f"--gif is {options.gif}: give a file that ends in .gif, in a folder that exists")
    script = read_script(pathlib.Path(options.script)) if options.script else None
    enable_compilation_cache()
    log_to_stderr()
    model = functools.cache(LanguageModel.from_environment)
    speaker = LanguageModelSpeaker(model()) if options.speaker == "llm" else TemplateSpeaker()
    reads = model() if options.interpreter == "llm" else None
    opened = open_run(options.run, options.policy, options.scene, hears=True)
    interpreter = interpreter_of(opened.policy)
    if reads is not None:
        interpreter = LanguageModelInterpreter(reads, interpreter)
    conversation = Conversation(opened.policy, 0, options.seed, interpreter, speaker)
    show = _Show(conversation)
    tolerate_any_encoding()
    try:
        _replay(conversation, script, show) if script is not None else _converse(conversation, show)
    except (EOFError, KeyboardInterrupt):
        print()
    conversation.finish_speaking()
    show()
    if conversation.ended:
        print(f"{conversation.seconds:5.1f} s  {conversation.ended}")
    if gif is not None:
        from ..render.animation import animate

        try:
            animate(opened.run.world, conversation.params, [conversation.episode()], gif)
        except OSError as error:
            raise UserError(f"--gif {gif} can't be written ({error.strerror}): {remedy(error)}") from error
        print(f"drawn in {gif}")


class _Show:
    """Prints the sentences, and what was understood of them, that it hasn't printed yet."""

    def __init__(self, conversation: "Conversation"):
        self._conversation, self._said = conversation, 0

    def __call__(self) -> None:
        said = self._conversation.said
        for seconds, speaker, sentence in said[self._said :]:
            print(f"{seconds:5.1f} s  {speaker}: {sentence}")
        self._said = len(said)


def _replay(conversation: "Conversation", script: list[tuple[float, str]], show: _Show) -> None:
    """Play the episode to its end, and say every sentence at its time."""
    left = list(script)
    while not conversation.ended:
        if left and conversation.seconds >= left[0][0] - 1e-6:
            conversation.hear(left.pop(0)[1])
        conversation.step()
        show()
    for seconds, sentence in left:
        print(f"not said, the episode was over: {seconds:g} {sentence}")


def _converse(conversation: "Conversation", show: _Show) -> None:
    """Ask the user at every step, until the episode ends."""
    from ..talk import scene_map

    print("R the robot and where it heads, P people, G the goal. Type what the nearest pedestrian says, Enter to wait.")
    while not conversation.ended:
        robot = conversation.state.robot
        print(scene_map(conversation))
        print(f"{conversation.seconds:5.1f} s  robot: {float(robot.v):.2f} m/s, {float(robot.w):+.2f} rad/s")
        text = input("you> ").strip()
        if text.lower() in ("quit", "exit"):
            return
        steps = 1
        if re.fullmatch(r"\d+(\.\d*)?", text):
            steps = min(_MOST_STEPS, max(1, round(float(text) / float(conversation.params.dt))))
        elif text:
            conversation.hear(text)
        for _ in range(steps):
            if not conversation.ended:
                conversation.step()
        show()
