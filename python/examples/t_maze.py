"""A task that needs memory: what is shown at a corridor's start says where to turn at its end (Bakker 2002).

stillroom up --preset gym --env python/examples/t_maze.py:make_env --frames 30000 --set network.memory=gru \
    --set network.hidden=32 --set ppo.rollout_steps=64

With `lstm` it is learnt too; with `none` the mean return stays near 0.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

LENGTH = 6


class TMaze(gymnasium.Env):
    """Two actions: left, right. Each step goes ahead; only the last one's action counts."""

    def __init__(self) -> None:
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """All that is random comes from `np_random`, which the seed sets."""
        super().reset(seed=seed)
        self._right, self._at = int(self.np_random.integers(2)), 0
        return self._seen(), {}

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """1 for the right turn, −1 for the wrong one."""
        self._at += 1
        ends = self._at == LENGTH
        reward = (1.0 if action == self._right else -1.0) if ends else 0.0
        return self._seen(), reward, ends, False, {}

    def _seen(self) -> NDArray[np.float32]:
        sign = 2.0 * self._right - 1.0 if self._at == 0 else 0.0
        return np.array([sign, self._at == LENGTH - 1], np.float32)


def make_env() -> gymnasium.Env:
    """Called once for each environment of an actor."""
    return TMaze()
