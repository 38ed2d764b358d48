"""Slows the robot down before what the laser sees, whatever the policy says. Written for Python 3.6."""

import numpy as np

_SPEEDS = np.linspace(1.0, 0.0, 17)  # shares of the wanted speed that are tried, the fastest first
_ALONG = np.linspace(0.0, 1.0, 9)  # points of the path that are looked at


class SafetyLayer:
    """(v, w, points [n, 2] in the robot frame, age of the points, s) -> the largest speed up to v at which the robot
    touches none of them.

    radius, deceleration: of the robot, by default those of the contract; gap: to be kept beside the contract's, m.
    Points stand still, and what is nearer to the robot's middle than ``blind`` can't be seen: it is kept away, too.

    It holds the twist for one period and the age of the points, and brakes then; on this path its body has to keep a
    gap that grows with speed, but where it is nearer already it may leave. It only ever reduces v: a round body
    that turns on the spot touches nothing.
    """

    def __init__(self, contract, radius=None, deceleration=None, gap=0.0):
        safety, control = contract["safety"], contract["control"]
        self._period, self._max_v = control["period"], control["max_v"]
        self._deceleration = safety["deceleration"] if deceleration is None else deceleration
        self._radius = contract["robot"]["radius"] if radius is None else radius
        for name, value in (("radius", self._radius), ("deceleration", self._deceleration), ("gap", gap)):
            if not isinstance(value, (int, float)) or not (0 < value < 100 or (name == "gap" and value == 0)):
                raise ValueError("%s is %r: give a number above 0, in m and m/s2" % (name, value))
        self._gap, self._more = safety["gap"] + gap, safety["gap_at_full_speed"] + gap

    def __call__(self, v, w, points, age=0.0, blind=0.0):
        if v <= 0 or not len(points):
            return v
        here = np.hypot(points[:, 0], points[:, 1])
        near = here < self._way(v, age) + self._keeps(v, blind)
        if not near.any():
            return v
        points, here = points[near], here[near]
        for share in _SPEEDS:
            if share == 0 or self._is_free(share * v, w, points, here, age, blind):
                return float(share * v)
        return 0.0

    def _way(self, v, age):
        """How far it comes until it stands, from where the points were measured."""
        return v * (self._period + age) + v * v / (2 * self._deceleration)

    def _keeps(self, v, blind):
        return max(self._radius, blind) + self._gap + (self._more - self._gap) * v / self._max_v

    def _is_free(self, v, w, points, here, age, blind):
        along = self._way(v, age) * _ALONG
        half = 0.5 * along * w / v
        chord = along * np.sinc(half / np.pi)
        x, y = chord * np.cos(half), chord * np.sin(half)
        away = np.hypot(points[:, :1] - x, points[:, 1:] - y).min(axis=1)
        return bool((away >= np.minimum(self._keeps(v, blind), here - 1e-9)).all())
