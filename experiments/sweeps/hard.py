"""Hybrid SAC in the hard suite: how fast it learns, how much it explores, what it is paid for talking.

jaxnav sweep experiments/sweeps/hard.py
"""

from jaxnav import preset
from jaxnav.sweep import Guard, Range, Sweep

sweep = Sweep(
    base=preset("quick", scenes="hard"),
    space={
        "hyper.actor_lr": Range(2e-4, 4e-3, log=True),
        "hyper.critic_lr": Range(2e-4, 4e-3, log=True),
        "hyper.tau": Range(0.003, 0.05, log=True),
        "hyper.target_entropy_twist": Range(-4.0, -0.5),
        "hyper.target_entropy_request": Range(0.05, 0.7),
        "world.params.reward_request": Range(1.0, 100.0, log=True),
        "world.params.reward_response": Range(0.5, 40.0, log=True),
    },
    sizes={"agent.updates_per_step": (2, 4, 8)},
    guard=Guard(scene="all"),
    trials=300,
    members=40,
    rungs=(250, 500),
    confirm=3,
    seeds=10,
)
