"""A MuJoCo task whose environments are restored from snapshots, with three forces as its actions.

stillroom up --env python/examples/pendulum.py:make_env --run runs/pendulum
"""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from stillroom.wrappers import MujocoSnapshot

FORCES_N = (-1.0, 0.0, 1.0)


class Forces(gymnasium.ActionWrapper):
    """Actions are the numbers of forces on the cart."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.action_space = gymnasium.spaces.Discrete(len(FORCES_N))

    def action(self, action: int) -> NDArray[np.float32]:
        """The force of this number."""
        return np.array([FORCES_N[action]], np.float32)


def make_env() -> gymnasium.Env:
    """Called once for each environment of an actor."""
    return MujocoSnapshot(Forces(gymnasium.make("InvertedPendulum-v5")))
