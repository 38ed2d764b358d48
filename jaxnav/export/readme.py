"""README.md of a bundle, written from its contract for an engineer who has never seen this package."""

import pathlib
from typing import Any

_TEMPLATE = pathlib.Path(__file__).parent / "robot" / "README.template.md"


def readme_of(contract: dict[str, Any]) -> str:
    """The text of README.md."""
    head = _TEMPLATE.read_text(encoding="utf-8").format(**_facts(contract))
    return "\n".join([head, *_words(contract), *_tables(contract), *_origin(contract)])


def _facts(contract: dict[str, Any]) -> dict[str, str]:
    control, safety, requests = contract["control"], contract["safety"], contract["requests"]
    asks = [request["name"] for request in requests[1:]]
    names = '", "'.join(contract["messages"][1:] + contract["replies"][1:])
    hears = contract["language"] is not None
    encoder = contract["network"]["encoder"]
    hearing = "deaf" if not contract["hearing"] else "sentences" if hears else "messages by name"
    heard = ", as a vector: see 4" if hears else f', by name: "{names}"'
    if not contract["hearing"]:
        hears, heard = False, ": always None, this policy was trained deaf"
    return {
        "summary": f"{encoder}, {'hears ' * contract['hearing']}{hearing}, "
        f"{'asks people' if asks else 'says nothing'}",
        "talks": f", and may ask them to give way ({', '.join(asks)})" if asks else "",
        "scenes": ", ".join(contract["origin"]["config"]["world"]["scenes"]),
        "gap": f"{100 * safety['gap']:g}", "gap_fast": f"{100 * safety['gap_at_full_speed']:g}",
        "period": f"{control['period']:g}", "timeout": f"{safety['timeout']:g}",
        "message": heard,
        "radius": f"{contract['robot']['radius']:g}", "deceleration": f"{safety['deceleration']:g}",
    }  # fmt: skip


def _words(contract: dict[str, Any]) -> list[str]:
    language = contract["language"]
    if language is None or not contract["hearing"]:
        return []
    return [
        "## 4. Words",
        f"`phrasebook.py` knows {language['phrases']} sentences by heart:",
        "```python",
        "from phrasebook import Phrasebook",
        "",
        "book = Phrasebook()",
        "vector = book.look_up(\"I'm in a hurry\")  # None if it isn't known, zeros if it says nothing",
        "```",
        "Capitals and punctuation don't matter. `None` is no sentence that it knows: give `step` the message "
        '`"unknown"` then, and the robot asks to repeat. Asked to stop, or refused a request, it stands '
        "for 8 s at most, unless the person would walk into it: then it steers aside first. Don't let it listen to "
        "itself while it speaks.",
        "",
        f"Any other sentence needs the sentence encoder `{language['sentence_encoder']}` ({language['features']} "
        "numbers; from PyPI, Python 3.8 or newer, in a process of its own, never in the control loop): "
        "`sentence, side = book.to_embed(text)`, then `book.vector(features_of(sentence), side)`. Give `step` the "
        "vector once, when it was said, as `message`.",
        "",
    ]


def _tables(contract: dict[str, Any]) -> list[str]:
    lines = [
        "## Inputs and outputs of the policy itself",
        "`Policy().act({name: value, ...})` in policy.py, which `Navigator` calls, takes these. All of it, exactly, is "
        "in contract.json. K people are observed, nearest first.",
        "",
    ]
    for kind in ("inputs", "outputs"):
        lines += [f"| {kind[:-1]} | shape | type | unit | range | frame; order | |", f"|{7 * '---|'}"]
        for entry in contract[kind]:
            low, high = entry["range"]
            shape = " x ".join(map(str, entry["shape"])) or "-"
            lines.append(
                f"| `{entry['name']}` | {shape} | {entry['dtype']} | {entry['unit']} | {low:g} to {high:g} | "
                f"{entry['frame']}; {entry['order']} | {entry['meaning']} |"
            )
        lines.append("")
    requests = ", ".join(f"{request['request']} {request['name']}" for request in contract["requests"])
    messages = ", ".join(f"{i} {name}" for i, name in enumerate(contract["messages"]))
    replies = ", ".join(f"{i} {name}" for i, name in enumerate(contract["replies"]))
    inputs = ", ".join(f"`{name}`" for name in contract["network"]["inputs"])
    maps = " `maps` [1, 4, 48, 48] is what `Policy().rasterise(scan, pedestrians, seen)` makes of scan and people."
    return [
        *lines,
        f"Requests: {requests}. Messages: {messages}. Replies: {replies}.",
        "",
        "## Other formats",
        "Where they were asked for, `policy.onnx` (opset 13, for onnxruntime 1.10 or newer; made for TensorRT 8.2, and "
        "not tested on it) and `policy.pt` (TorchScript of torch 1.10 or older) hold the same network. Their inputs "
        f"are float32 with a batch of 1 in front, in this order: {inputs}; "
        "those that this policy does not use are left out. "
        f"{maps if 'maps' in contract['network']['inputs'] else ''} "
        "Outputs as above, but `request` is called `chosen_request` in `policy.onnx`. "
        "`python3 policy.py --torchscript policy.pt` writes the latter on the robot.",
        "",
    ]


def _origin(contract: dict[str, Any]) -> list[str]:
    origin = contract["origin"]
    versions = ", ".join(f"{name} {version}" for name, version in origin.get("versions", {}).items())
    lines = [
        "## Where it comes from",
        f"Run `{origin['run']}`, policy {origin['policy']}, trained with {versions},",
        f"commit {origin.get('git_commit')}, on {origin.get('device')}; exported by {origin['exported_by']}.",
        "The whole configuration is in contract.json. It was trained in simulation, with at most "
        f"{contract['people']['trained_with']} people in sight.",
    ]
    evaluation = origin.get("evaluation")
    if evaluation:
        lines += [
            "",
            f"In simulation, {evaluation['episodes']} episodes a scene of seed {evaluation['seed']}:",
            "",
            "| scene | success (95 % interval) | collisions with people | mean smallest distance |",
            "|---|---|---|---|",
        ]
        for name, scene in evaluation["scenes"].items():
            low, high = scene["success_ci95"]
            distance = "-" if scene["min_distance"] is None else f"{scene['min_distance']:.2f} m"
            success = f"{scene['success']:.3f} ({low:.3f}-{high:.3f})"
            lines.append(f"| {name} | {success} | {scene['human_collision']:.3f} | {distance} |")
    return [*lines, ""]
