"""The comparison with other worlds: ratios, and peers that are not installed. No clock."""

import importlib.util
import json
import pathlib
import sys

import pytest

BENCHMARKS = pathlib.Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def peers(monkeypatch):
    """The benchmark as a module, without either of the peers."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    for package in ("jaxmarl", "socialjym"):
        monkeypatch.setitem(sys.modules, package, None)
    spec = importlib.util.spec_from_file_location("peers", BENCHMARKS / "peers.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(peers, rates, monkeypatch, capsys, *arguments):
    """What it prints when worlds have these rates; a world without one is built, which needs its package."""

    def rate(world, episodes, steps, seconds):
        return rates[world](episodes) if world in rates else world(episodes)

    monkeypatch.setattr(peers, "rate", rate)
    monkeypatch.setattr(sys, "argv", ["peers.py", *arguments])
    peers.main()
    return capsys.readouterr()


def test_absent_peers_are_named_as_not_run(peers, monkeypatch, capsys):
    printed = run(peers, {peers.jaxnav: float}, monkeypatch, capsys, "--json")
    assert [json.loads(line) for line in printed.out.splitlines()] == [
        {"name": "peer", "peer": "jaxnav", "rate_per_s": 4096, "ratio": 1.0}
    ]
    for peer in ("JaxNav", "LaserNav"):
        assert f"{peer}: not run" in printed.err
    table = run(peers, {peers.jaxnav: float}, monkeypatch, capsys).out
    assert table.count("not run") == 2


def test_a_ratio_is_our_best_rate_by_the_best_of_the_peer(peers, monkeypatch, capsys):
    rates = {
        peers.jaxnav: lambda n: 9000.0 if n == 1024 else 800.0,
        peers.jaxmarl: lambda n: 64.0 - n,
        peers.social_jym: float,
    }
    printed = run(peers, rates, monkeypatch, capsys, "--json")
    rows = {row["peer"]: row for row in map(json.loads, printed.out.splitlines())}
    assert [rows[peer]["rate_per_s"] for peer in ("jaxnav", "JaxNav", "LaserNav")] == [9000, 48, 1024]
    assert [rows[peer]["ratio"] for peer in ("jaxnav", "JaxNav", "LaserNav")] == [1.0, 187.5, 8.8]
    assert "not run" not in printed.err


def test_what_a_peer_prints_stays_out_of_the_results(peers, monkeypatch, capsys):
    def noisy(episodes):
        sys.stdout = sys.__stdout__
        print("welcome")
        return 1.0

    printed = run(peers, {peers.jaxnav: float, peers.jaxmarl: noisy}, monkeypatch, capsys, "--json")
    assert [json.loads(line)["peer"] for line in printed.out.splitlines()] == ["jaxnav", "JaxNav"]
    assert "welcome" in printed.err


@pytest.mark.parametrize("seconds", ["0", "nan", "inf"])
def test_no_time_and_time_without_end_are_refused(peers, seconds, monkeypatch, capsys):
    with pytest.raises(SystemExit, match="2"):
        run(peers, {}, monkeypatch, capsys, "--seconds", seconds)
    assert f"--seconds is {float(seconds)}: give a finite number above 0" in capsys.readouterr().err
