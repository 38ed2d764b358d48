"""Drives a robot with a bundle's policy: laser scan, people, pose and words in, m/s, rad/s, request and sentence out.

    navigator = Navigator()                          # of the folder in which this file lies
    navigator.reset(goal=(4.0, 1.0))                 # in the frame of the poses
    v, w, request, utterance = navigator.step(scan, people, pose)

Call `Navigator.step` 5 to 20 times a second, with whatever is newest. It never raises: what it can't use stops the
robot, and `Navigator.reason` says why. Written for Python 3.6.
"""

import collections
import math
import time

import numpy as np
import torch
from bundle import HERE
from conversation import Conversation
from people import People
from policy import Policy
from safety import SafetyLayer
from scans import LaserInput, Mount, Scan, Unusable, finite

__all__ = ["Command", "Mount", "Navigator", "Scan"]

Command = collections.namedtuple("Command", "v w request utterance")
Command.__doc__ = """v: m/s; w: rad/s, to the left; request: what it asks of the nearest person, 0 nothing;
utterance: the sentence to speak, "" for none."""

_FAR = 1e6  # m: poses and goals are nearer
_WITHIN = 500.0  # m, m/s: people and the goal are nearer to the robot, and slower
_JUMP = 2.0, 5.0  # m, and m/s: by more than this a pose does not move, it is another one
_SPIN = 1.0, 5.0  # rad, and rad/s: likewise
_LATEST = 1e12  # s: of any clock
_PAUSE = 5  # periods without a usable pose after which nothing is remembered
_TURNED = 2 * math.pi  # rad: beyond a whole turn training has seen nothing


class Navigator(object):
    """A robot on its way to a goal. BundleError: the bundle can't be used. Sets torch to one thread: more take longer.

    mount: where the laser sits; safety: whether speed is reduced before obstacles, whatever the policy says; radius, m,
    deceleration, m/s2: of this robot, for the safety layer, by default those of the contract; gap: that it keeps beside
    the contract's, m.

    reason: why the last command is a stop or slower than the policy's, "" otherwise; arrived: whether it is at its
    goal; ranges: the last scan as the policy had it, from right to left; steps, interventions: how many commands the
    policy gave, and how many of them the safety layer slowed down.
    """

    def __init__(self, bundle=HERE, mount=Mount(), safety=True, radius=None, deceleration=None, gap=0.0):
        torch.set_num_threads(1)
        self.policy = Policy(bundle)
        self.contract = self.policy.contract
        self._control, self._timeout = self.contract["control"], self.contract["safety"]["timeout"]
        self._laser = LaserInput(self.contract["laser"], mount)
        self._conversation = Conversation(self.contract, self.policy)
        self._safety = SafetyLayer(self.contract, radius, deceleration, gap) if safety else None
        self._goal, self._now, self._scan_since = None, None, (None, 0.0)
        self.steps, self.interventions, self.ranges = 0, 0, None
        self._start_over()
        self.arrived, self.reason = False, ""

    def reset(self, goal):
        """Drive to ``goal``, (x, y) in the frame of the poses. ValueError: that is not two numbers."""
        found = finite(goal, (2,), _FAR)
        self._goal = None if found is None else found.tolist()
        self._start_over()
        self._conversation.forget()
        self.arrived, self.reason = False, ""
        if found is None:
            raise ValueError("goal is %.40r: give (x, y), m, two finite numbers in the frame of the poses" % (goal,))

    def step(self, scan, pedestrians, pose, message=None, stamp=None, now=None):
        """The `Command` for now. Never raises: what can't be used is a full stop, with a `reason`.

        scan: a ROS LaserScan or a `Scan`.
        pedestrians: [n, 4] x, y, velocity x, velocity y of the people in sight, in the robot frame, velocity over
            ground.
        pose: x, y, heading of the robot in a frame that stands still, m, m, rad.
        message: what a person has just said, once; None for nothing. A policy that understands words takes a vector of
            phrasebook.py, another one its meaning by name: "robot stop", "robot right", "robot left", "agrees" or
            "refuses"; "unknown" makes it ask to repeat. What is said while the robot can't use its other inputs is
            heard as soon as it can.
        stamp, now: when the oldest of all this was measured, and what time it is, s on one clock. By default now is
            that of time.monotonic(), and the scan is as old as this very object is known.
        """
        try:
            return self._step(scan, pedestrians, pose, message, stamp, now)
        except Unusable as why:
            return self._stop(str(why))
        except Exception as error:  # a defect of ours; a robot that stands is better than one without a command
            return self._stop("internal error: %r" % error)

    def _step(self, scan, pedestrians, pose, message, stamp, now):
        self._conversation.keep(message)
        now, age = self._time(now, stamp, scan)
        if self._goal is None:
            raise Unusable("no goal was set: call reset(goal)")
        pose = self._pose(pose, now)
        self.ranges, points = self._laser(scan)
        people = _people(pedestrians)
        pose = self._remember(now, *pose)
        self.arrived = self.arrived or self._away(pose) <= self._control["goal_tolerance"]
        if self.arrived:
            return self._stop("arrived")
        beats = self._beats(now)
        self._people.follow(people, pose, now)
        if beats:
            self._people.advance(beats, self._twist[0])
        said = self._conversation.listen(self._people, beats)
        decision = self.policy.act(self._observation(now, voice=beats > 0))
        v, w = self._within_limits(decision)
        if decision.request != 0:
            said = self._conversation.ask(self._people, decision.request)
        self.steps += 1
        v, w, self.reason = self._conversation.limit(self._people, v, w)
        slower = v if self._safety is None else self._safety(v, w, points, age, self._laser.blind)
        if slower < v:
            self.interventions += 1
            self.reason = "slowed from %.3f to %.3f m/s before an obstacle" % (v, slower)
        self._twist = slower, w
        return Command(slower, w, decision.request, said)

    def _start_over(self):
        """Forget everything but the goal."""
        self._people = People(self.contract)
        self._poses, self._start = collections.deque(), None
        self._beat, self._twist = 0, (0.0, 0.0)
        self._conversation.calm_down()

    def _stop(self, reason):
        self._twist, self.reason = (0.0, 0.0), reason
        return Command(0.0, 0.0, 0, "")

    def _time(self, now, stamp, scan):
        """(the time, age of the inputs); Unusable where they are too old, or the clock runs backwards."""
        now = finite(time.monotonic() if now is None else now, (), _LATEST)
        if now is None:
            raise Unusable("now is no time: give s, at most %g" % _LATEST)
        now, before, self._now = float(now), self._now, float(now)
        if before is not None and now < before:
            self._start_over()  # nothing that was remembered has a known age any more
            self._scan_since = None, now
            raise Unusable("time went backwards, from %.3f to %.3f s" % (before, now))
        if scan is not self._scan_since[0]:
            self._scan_since = scan, now
        stamp = finite(self._scan_since[1] if stamp is None else stamp, (), _LATEST)
        if stamp is None:
            raise Unusable("stamp is no time: give s, at most %g" % _LATEST)
        age = now - float(stamp)
        if age > self._timeout:
            clocks = ": are both times of one clock?" if age > 60 else ""
            raise Unusable("inputs are stale: %.2f s old, at most %.2f s%s" % (age, self._timeout, clocks))
        if age < -self._timeout:
            raise Unusable("inputs are %.2f s from the future: are both times of one clock?" % -age)
        return now, max(age, 0.0)

    def _pose(self, pose, now):
        pose = finite(pose, (3,), _FAR)
        if pose is None:
            raise Unusable("pose is not x, y, heading in finite numbers, m and rad")
        if self._away(pose) > _WITHIN:
            raise Unusable("the goal is %.0f m away, at most %.0f: is it in the frame of the poses?" % (
                self._away(pose), _WITHIN
            ))  # fmt: skip
        if self._poses:
            before, x, y, heading = self._poses[-1]
            passed, moved = now - before, math.hypot(pose[0] - x, pose[1] - y)
            turned = abs(_wrapped(pose[2] - heading))
            if passed > _PAUSE * self._control["period"]:
                self._start_over()
            elif moved > _JUMP[0] + _JUMP[1] * passed or turned > _SPIN[0] + _SPIN[1] * passed:
                self._start_over()
                raise Unusable("pose jumped by %.1f m and %.1f rad" % (moved, turned))
        return pose.tolist()

    def _away(self, pose):
        return math.hypot(self._goal[0] - pose[0], self._goal[1] - pose[1])

    def _remember(self, now, x, y, heading):
        """Keep the pose for as long as the policy looks back. Returns it, its heading without jumps of 2 pi."""
        if self._poses:
            heading = self._poses[-1][3] + _wrapped(heading - self._poses[-1][3])
            if self._poses[-1][0] == now:
                self._poses.pop()
        if self._start is None:
            self._start = now, heading
        self._poses.append((now, x, y, heading))
        while len(self._poses) > 2 and self._poses[1][0] < now - 2.5 * self._control["period"]:
            self._poses.popleft()
        return x, y, heading

    def _beats(self, now):
        """How many periods have begun since the last call, 1 at the first; a tenth of one too early counts."""
        beat = 1 + int((now - self._start[0]) / self._control["period"] + 0.1)
        passed, self._beat = beat - self._beat, beat
        return passed

    def _goal_at(self, when):
        """(goal x, goal y, turned) as the robot had it at a time; 0 before its start."""
        if when < self._start[0] - 0.1 * self._control["period"]:
            return 0.0, 0.0, 0.0
        times = [entry[0] for entry in self._poses]
        x, y, heading = (float(np.interp(when, times, [entry[i] for entry in self._poses])) for i in (1, 2, 3))
        cos, sin, dx, dy = math.cos(heading), math.sin(heading), self._goal[0] - x, self._goal[1] - y
        turned = min(max(self._start[1] - heading, -_TURNED), _TURNED)
        return cos * dx + sin * dy, cos * dy - sin * dx, turned

    def _observation(self, now, voice):
        period = self._control["period"]
        return dict(
            self._people.observe(),
            scan=self.ranges,
            pose=np.array([self._goal_at(now - i * period) for i in (2, 1, 0)]),
            twist=np.array(self._twist),
            voice=np.array(voice),
        )

    def _within_limits(self, decision):
        turn = self._control["max_w"]
        if not (math.isfinite(decision.v) and math.isfinite(decision.w)):
            raise Unusable("the network gave %r m/s, %r rad/s" % (decision.v, decision.w))
        return min(max(decision.v, 0.0), self._control["max_v"]), min(max(decision.w, -turn), turn)


def _wrapped(angle):
    return (angle + math.pi) % (2 * math.pi) - math.pi


def _people(pedestrians):
    if pedestrians is None:
        raise Unusable("pedestrians is None: give an empty list where nobody is seen")
    people = finite(pedestrians, None, _WITHIN)
    if people is not None and people.size == 0:
        return np.zeros((0, 4))
    if people is None or people.ndim != 2 or people.shape[1] != 4:
        raise Unusable("pedestrians are not [n, 4] numbers of at most 500: x, y, velocity x, velocity y")
    return people
