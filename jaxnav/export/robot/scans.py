"""Any laser scan -> the beams that the policy was trained with, and the points that it hit. Written for Python 3.6."""

import collections
import math
import warnings

import numpy as np

Scan = collections.namedtuple("Scan", "ranges angle_min angle_increment")
Scan.__doc__ = """What `Navigator.step` reads of a ROS LaserScan: ranges, m, of which inf, nan and 0 are no return and
-inf is too near to measure; angle_min: rad, of the first; angle_increment: rad from each to the next, negative where
they go to the right."""

Mount = collections.namedtuple("Mount", "x y yaw upside_down")
Mount.__doc__ = """Where the laser sits on the robot: x, y from the middle of the robot, m; yaw: where its angle 0
points to, rad; upside_down: whether its angles run to the right although it says that they run to the left."""
Mount.__new__.__defaults__ = (0.0, 0.0, 0.0, False)


_NO_METRES = 100.0  # in the median: ranges that long are no metres


class Unusable(Exception):
    """An input that can't be used; the message says which and why."""


def finite(value, shape, bound):
    """``value`` as an array of float64; None unless it is of finite numbers of at most ``bound``, of that shape (None:
    of any)."""
    try:
        with warnings.catch_warnings():  # of lists of different lengths, which are none of numbers
            warnings.simplefilter("ignore")
            array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            return None
        array = array.astype(np.float64)
    except Exception:  # whatever an object does that is asked for its numbers
        return None
    if shape is not None and array.shape != shape:
        return None
    return array if bool((np.abs(array) <= bound).all()) and np.isfinite(array).all() else None


class LaserInput:
    """Resamples scans. laser: that part of a contract."""

    def __init__(self, laser, mount):
        if not hasattr(mount, "upside_down") or finite(mount[:3], (3,), 2 * math.pi) is None:
            raise ValueError("mount is %r: give Mount(x, y, yaw), m and rad, in numbers of at most 2 pi" % (mount,))
        self._mount, self._range_max = mount, laser["range_max"]
        self._elsewhere = mount.x != 0 or mount.y != 0
        self._angles = np.linspace(laser["angle_min"], laser["angle_max"], laser["beams"])
        self._spacing = self._angles[1] - self._angles[0]
        self.blind = 0.0  # distance from the robot's middle below which the last scan may have seen nothing
        self._known = None  # the geometry of the last scan, and what follows from it

    def __call__(self, scan):
        """(ranges [beams], points [n, 2] in the robot frame of all that was hit). Unusable says what is wrong.

        Each trained beam takes the nearest return of the measured beams in its direction: of several finer ones the
        closest, of coarser ones the one beside it.
        """
        ranges, first, step = self._read(scan)
        angles = self._measured_angles(len(ranges), first, step)
        nearest = finite(getattr(scan, "range_min", 0.0), (), 10.0)
        self.blind = 0.0 if nearest is None or nearest <= 0 else float(nearest) + math.hypot(*self._mount[:2])
        with np.errstate(invalid="ignore"):
            broken = np.isnan(ranges) | ((ranges < 0) & ~np.isneginf(ranges))
            hit = (ranges > 0) & (ranges < self._range_max)
        if broken.mean() > 0.5 or not (ranges != 0).any():
            raise Unusable("scan has %d ranges that are none, of %d: is the laser running?" % (
                (broken | (ranges == 0)).sum(), len(ranges)
            ))  # fmt: skip
        far = ranges[np.isfinite(ranges) & (ranges > 0)]
        if len(far) and np.median(far) > _NO_METRES:
            raise Unusable("scan has ranges of %g in the median: are they in metres?" % np.median(far))
        hit |= np.isneginf(ranges)
        ranges = np.where(np.isneginf(ranges), 1e-3, np.where(hit, ranges, self._range_max))
        points = ranges[hit, None] * np.stack([np.cos(angles[hit]), np.sin(angles[hit])], axis=1)
        if self._elsewhere:
            points += [self._mount.x, self._mount.y]
            ranges, angles = ranges.copy(), angles.copy()
            ranges[hit] = np.minimum(np.hypot(points[:, 0], points[:, 1]), self._range_max)
            angles[hit] = np.arctan2(points[:, 1], points[:, 0])
        return self._resample(ranges, angles), points

    def _read(self, scan):
        try:
            ranges, first, step = np.asarray(scan.ranges), float(scan.angle_min), float(scan.angle_increment)
            last = first + (len(ranges) - 1) * step
            last = float(getattr(scan, "angle_max", last))
        except Exception:  # whatever an object does that is no scan
            raise Unusable("scan has no ranges, angle_min and angle_increment: give a LaserScan or a Scan")
        if ranges.dtype.kind not in "fiu" or ranges.ndim != 1 or len(ranges) < 2:
            raise Unusable("scan.ranges are not a list of at least two numbers")
        if not (abs(first) <= 4 * math.pi and 1e-5 <= abs(step) <= math.pi / 2):
            raise Unusable("scan.angle_min %r or angle_increment %r is no angle in rad" % (first, step))
        if not abs(first + (len(ranges) - 1) * step - last) <= 1.5 * abs(step):
            raise Unusable("scan has %d ranges, not as many as from angle_min to angle_max" % len(ranges))
        if (len(ranges) - 1) * abs(step) > 2 * math.pi + abs(step):
            raise Unusable("scan has %d ranges of %g rad: more than once around" % (len(ranges), abs(step)))
        return ranges.astype(np.float64), first, step

    def _measured_angles(self, count, first, step):
        """Directions of the beams in the robot frame, from -pi to pi."""
        if self._known is None or self._known[0] != (count, first, step):
            angles = first + step * np.arange(count)
            angles = self._mount.yaw + (-angles if self._mount.upside_down else angles)
            angles = (angles + math.pi) % (2 * math.pi) - math.pi
            self._check_cover(angles, abs(step))
            self._known = (count, first, step), angles
        return self._known[1]

    def _check_cover(self, angles, step):
        """Unusable: there are directions in front in which nothing was measured."""
        before, after, angles = self._neighbours(angles[np.argsort(angles)])
        gap = np.minimum(self._angles - angles[before], angles[after] - self._angles).max()
        if gap > 1.01 * max(step, self._spacing):
            front = math.degrees(self._angles[0]), math.degrees(self._angles[-1]), math.degrees(gap)
            raise Unusable(
                "scan doesn't cover the front: the policy needs %.0f to %.0f degrees, and of some of it nothing was "
                "measured within %.1f degrees" % front
            )

    def _neighbours(self, angles):
        """Indices of the measured beams to the right and to the left of every trained one, and the sorted angles that
        they belong to: once more around at both ends, since what lies beyond pi lies before -pi."""
        angles = np.concatenate([angles[-1:] - 2 * math.pi, angles, angles[:1] + 2 * math.pi])
        after = np.clip(np.searchsorted(angles, self._angles), 1, len(angles) - 1)
        return after - 1, after, angles

    def _resample(self, ranges, angles):
        order = np.argsort(angles, kind="mergesort")
        before, after, angles = self._neighbours(angles[order])
        ranges = np.concatenate([ranges[order[-1:]], ranges[order], ranges[order[:1]]])
        right, left = self._angles - angles[before], angles[after] - self._angles
        found = np.where(right < left, ranges[before], ranges[after])
        position = (angles - self._angles[0]) / self._spacing
        beams = [np.rint(position)]
        if self._elsewhere:
            # From the middle of the robot near things are spread wider, and far ones show between their points: a point
            # counts for the beams on both sides of it. What the laser can't see from its place has the nearer edge.
            beams = [np.floor(position), np.ceil(position)]
            unseen = np.minimum(right, left) > self._spacing
            found[unseen] = np.minimum(ranges[before], ranges[after])[unseen]
        for beam in beams:  # the closest of all in a beam's direction
            inside = (beam >= 0) & (beam < len(self._angles))
            np.minimum.at(found, beam[inside].astype(int), ranges[inside])
        return found.astype(np.float32)
