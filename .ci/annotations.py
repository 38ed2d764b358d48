"""Count annotated arguments and returns of jaxnav's public functions and methods; exit with 1 below 95 %.

python .ci/annotations.py

Public is a function or method whose name, classes and modules don't begin with an underscore, and that isn't inside a
function. Neither self and cls count, nor the robot's runtime, which is written for Python 3.6.
"""

import ast
import pathlib
import sys
from collections.abc import Iterator

ROOT = pathlib.Path(__file__).parent.parent
LEAST = 0.95
EXCLUDED = ("jaxnav/export/robot/",)

_Function = ast.FunctionDef | ast.AsyncFunctionDef


def public_functions(body: list[ast.stmt], in_class: bool = False) -> Iterator[tuple[_Function, bool]]:
    """(function, whether it is a method) of a module's or class's public ones; __init__ and __call__ are public."""
    for node in body:
        if isinstance(node, _Function):
            if not node.name.startswith("_") or node.name in ("__init__", "__call__"):
                yield node, in_class
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node.body, True)


def counts(function: _Function, is_method: bool) -> tuple[int, int, int, int]:
    """(arguments, of these annotated, returns, of these annotated) of one function."""
    given = function.args
    arguments = [*given.posonlyargs, *given.args]
    decorators = {node.id for node in function.decorator_list if isinstance(node, ast.Name)}
    if is_method and "staticmethod" not in decorators:
        arguments = arguments[1:]
    arguments += [*given.kwonlyargs, *(one for one in (given.vararg, given.kwarg) if one is not None)]
    returns = int(function.name != "__init__")
    return (
        len(arguments),
        sum(argument.annotation is not None for argument in arguments),
        returns,
        returns * int(function.returns is not None),
    )


def main() -> int:
    """Print a table by package; 1 where a share is below the least."""
    table: dict[str, list[int]] = {}
    bare = []
    for path in sorted((ROOT / "jaxnav").rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if name.startswith(EXCLUDED) or (path.name.startswith("_") and path.name not in ("__init__.py", "__main__.py")):
            continue
        parts = path.relative_to(ROOT / "jaxnav").parts
        package = "jaxnav" if len(parts) == 1 else f"jaxnav.{parts[0]}"
        row = table.setdefault(package, [0, 0, 0, 0])
        for function, is_method in public_functions(ast.parse(path.read_text()).body):
            found = counts(function, is_method)
            row[:] = [a + b for a, b in zip(row, found, strict=True)]
            if found[0] > found[1] or found[2] > found[3]:
                bare.append(f"{name}:{function.lineno} {function.name}")
    table["all"] = [sum(column) for column in zip(*table.values(), strict=True)]
    print(f"{'package':20} {'arguments':>18} {'returns':>18}")
    for package, (arguments, typed, returns, typed_returns) in table.items():
        print(f"{package:20} {_share(typed, arguments)} {_share(typed_returns, returns)}")
    arguments, typed, returns, typed_returns = table["all"]
    enough = typed >= LEAST * arguments and typed_returns >= LEAST * returns
    if not enough or "--list" in sys.argv:
        print("\n".join(["", "not annotated:", *bare]))
    return 0 if enough else 1


def _share(part: int, whole: int) -> str:
    return f"{part:5} of {whole:4} {part / whole if whole else 1:6.1%}"


if __name__ == "__main__":
    sys.exit(main())
