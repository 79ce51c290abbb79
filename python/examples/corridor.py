"""A simulator of your own, with a cost: walk to the end of a corridor, and do not bump into its walls.

stillroom up --env python/examples/corridor.py:make_env --env-declaration python/examples/corridor.toml
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

LENGTH, HALF_WIDTH = 8.0, 1.0


class Corridor(gymnasium.Env):
    """Three actions: ahead, a step to the left, a step to the right. A draught blows to one side."""

    def __init__(self) -> None:
        self.observation_space = gymnasium.spaces.Box(-10.0, 10.0, (3,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(3)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """All that is random comes from `np_random`, which the seed sets."""
        super().reset(seed=seed)
        self._at, self._side, self._steps = 0.0, 0.0, 0
        self._draught = float(self.np_random.uniform(-0.3, 0.3))
        return self._seen(), {}

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """What the declaration reads of `info` is there at every step."""
        self._steps += 1
        self._at += 0.5 if action == 0 else 0.0
        side = self._side + self._draught + (0.0, -0.4, 0.4)[action]
        self._side = float(np.clip(side, -HALF_WIDTH, HALF_WIDTH))
        arrived = self._at >= LENGTH
        info = {"bumped": float(abs(side) > HALF_WIDTH), "arrived": arrived}
        return self._seen(), 1.0 if arrived else -0.01, arrived, self._steps >= 60, info

    def _seen(self) -> NDArray[np.float32]:
        return np.array([LENGTH - self._at, self._side, self._draught], np.float32)


def make_env() -> gymnasium.Env:
    """Called once for each environment of an actor."""
    return Corridor()
