"""What the README says is true: its Python runs, its commands exist, its files are there."""

import pathlib
import re
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize(
    ("package", "code", "printed"),
    [(None, "\n".join(BLOCKS[1:3]), "(1000, 2)"), ("gymnasium", BLOCKS[3], ""), ("gymnax", BLOCKS[4], "")],
    ids=["world", "gymnasium", "gymnax"],
)
def test_the_python_runs(package, code, printed):
    """All but the first and the last block, which train: other tests do so with less."""
    if package:
        pytest.importorskip(package, exc_type=ImportError)
        assert f"jaxnav.adapters.{package}" in code
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == printed


@pytest.mark.parametrize("mark", ["train", "test"])
def test_the_two_commands_are_single_lines_that_install(mark):
    block = re.search(rf"<!-- {mark} -->\n```bash\n(.*?)```", README, re.DOTALL).group(1).strip()
    assert "\n" not in block
    assert " && " in block
    assert "pip install" in block


def test_every_file_it_links_to_exists():
    links = re.findall(r"\]\(([^)#:]+)\)", README)
    assert len(links) >= 3
    assert [link for link in links if not (ROOT / link).exists()] == []
