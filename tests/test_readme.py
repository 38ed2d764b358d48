"""What the README says is true: its Python runs, its commands exist, its files are there."""

import pathlib
import re
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def test_the_python_runs():
    code = "\n".join(re.findall(r"```python\n(.*?)```", README, re.DOTALL)[:2])
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "(1000, 2)"


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
