"""jaxnav talk: a conversation with a run's robot while it drives."""

import dataclasses
import pathlib
import re
import sys
from typing import Annotated

import tyro

from ..errors import UserError, remedy
from .options import check_policy, check_seed, enable_compilation_cache, parse
from .understand import interpreter_of, log_to_stderr, open_hearing

_MOST_STEPS = 100  # that a number at the prompt lets pass


@dataclasses.dataclass(frozen=True)
class _TalkOptions:
    """Speak for a pedestrian while a run's robot drives: see what it understands, does and says.

    At each prompt type what the nearest pedestrian says, or nothing: an empty line lets a step pass (0.4 s), a number
    that many seconds. "quit" ends.

    Args:
        run: the run's folder.
        scene: a scene of the run; the first one if not given.
        seed: of the episode.
        policy: last, or best: the one with the best evaluation during training.
        script: a conversation to replay instead: lines of seconds and a sentence, like "2.0 I'm in a hurry".
        gif: where to draw what happened.
        speaker: who words what the robot says: templates, or llm: the server that OPENAI_BASE_URL, OPENAI_MODEL and
            OPENAI_API_KEY name.
        interpreter: who reads what people say: embedding, the policy's own ears, or llm.
    """

    run: Annotated[str, tyro.conf.Positional]
    scene: str = ""
    seed: int = 0
    policy: str = "last"
    script: str = ""
    gif: str = ""
    speaker: str = "templates"
    interpreter: str = "embedding"


def command(arguments):
    from ..language.interpreter import LanguageModelInterpreter
    from ..language.llm import LanguageModel
    from ..language.speaker import LanguageModelSpeaker, TemplateSpeaker
    from ..talk import Conversation, read_script

    options = parse(_TalkOptions, arguments, "talk")
    check_seed(options.seed)
    check_policy(options.policy)
    for name, choices in (("speaker", ("templates", "llm")), ("interpreter", ("embedding", "llm"))):
        if getattr(options, name) not in choices:
            raise UserError(f"--{name} {getattr(options, name)!r} is unknown: choose {' or '.join(choices)}")
    gif = pathlib.Path(options.gif) if options.gif else None
    if gif is not None and (gif.suffix.lower() != ".gif" or not gif.absolute().parent.is_dir()):
        raise UserError(f"--gif is {options.gif}: give a file that ends in .gif, in a folder that exists")
    script = read_script(pathlib.Path(options.script)) if options.script else None
    enable_compilation_cache()
    log_to_stderr()
    model = LanguageModel.from_environment() if "llm" in (options.speaker, options.interpreter) else None
    policy = open_hearing(options.run, options.policy)
    names = [scene.name for scene in policy.world.scenes]
    if options.scene and options.scene not in names:
        raise UserError(f"--scene {options.scene!r} is not in this run: choose one of {', '.join(names)}")
    ears = interpreter_of(policy)
    interpreter = LanguageModelInterpreter(model, ears) if options.interpreter == "llm" else ears
    speaker = LanguageModelSpeaker(model) if options.speaker == "llm" else TemplateSpeaker()
    scene = names.index(options.scene) if options.scene else 0
    conversation = Conversation(policy, scene, options.seed, interpreter, speaker)
    show = _Show(conversation)
    sys.stdin.reconfigure(errors="replace")
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
            animate(policy.world, conversation.params, [conversation.episode()], gif)
        except OSError as error:
            raise UserError(f"--gif {gif} can't be written ({error.strerror}): {remedy(error)}") from error
        print(f"drawn in {gif}")


class _Show:
    """Prints what is new: what was said and what was understood."""

    def __init__(self, conversation):
        self._conversation, self._said = conversation, 0

    def __call__(self):
        said = self._conversation.said
        for seconds, speaker, sentence in said[self._said :]:
            print(f"{seconds:5.1f} s  {speaker}: {sentence}")
        self._said = len(said)


def _replay(conversation, script, show):
    """Play the episode to its end, and say every sentence at its time."""
    left = list(script)
    while not conversation.ended:
        if left and conversation.seconds >= left[0][0] - 1e-6:
            conversation.hear(left.pop(0)[1])
        conversation.step()
        show()
    for seconds, sentence in left:
        print(f"not said, the episode was over: {seconds:g} {sentence}")


def _converse(conversation, show):
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
