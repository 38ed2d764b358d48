"""What tests of the calibration share: windows of people who walk evenly."""

import numpy as np
import pytest

from experiments.calibration.windows import Windows


@pytest.fixture(scope="session")
def walkers():
    """A function (position `[P, 2]`, velocity `[P, 2]`, future `[P, T, 2]`) -> `Windows` of one, two steps observed."""

    def window(position, velocity, future):
        position, velocity, future = (np.asarray(a, np.float32) for a in (position, velocity, future))
        count = len(position)
        yes = np.ones((1, count), bool)
        return Windows(
            instant=np.zeros(1, int), position=position[None], velocity=np.repeat(velocity[None, :, None], 2, axis=2),
            known=np.ones((1, count, 2), bool), goal=position[None] + 100 * velocity[None], standing=~yes, robot=~yes,
            present=yes, group=np.arange(count)[None], future=future[None], weight=yes.astype(np.float32),
            person=np.arange(count)[None],
        )  # fmt: skip

    return window
