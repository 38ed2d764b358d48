"""Where a result comes from: versions, git commit and device."""

import importlib.metadata
import os
import pathlib
import platform
import subprocess
from typing import Any

import jax


def provenance() -> dict[str, Any]:
    """Versions, git commit and device: what a result needs beside its configuration and seed."""
    packages = ("jaxnav", "jax", "jaxlib", "flax", "optax", "numpy")
    return {
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in packages}},
        "git_commit": _git_commit(),
        "device": f"{jax.devices()[0].device_kind}, {os.cpu_count()} CPU cores",
    }


def _version(package):
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _git_commit():
    """The commit of this source tree, "+" appended if it has changes; None outside of git."""
    here = pathlib.Path(__file__).parent

    def git(*arguments):
        done = subprocess.run(["git", "-C", here, *arguments], capture_output=True, text=True, timeout=10)
        return done.stdout.strip() if done.returncode == 0 else None

    try:
        commit = git("rev-parse", "HEAD")
        # An installed copy may lie inside some other repository: only a tracked file speaks for its commit.
        if commit is None or not git("ls-files", pathlib.Path(__file__).name):
            return None
        return commit + ("+" if git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.TimeoutExpired):
        return None
