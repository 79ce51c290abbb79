"""A MuJoCo task with a cost: a half cheetah runs ahead, and does not exceed a speed limit.

stillroom up --env python/examples/cheetah.py:make_env --config python/examples/cheetah_stages.toml \
    --env-declaration python/examples/cheetah.toml

Limit and cost are those of Safety-Gymnasium's `SafetyHalfCheetahVelocity-v1`, whose package wants an older Gymnasium.
`--env-kwargs '{"task": "Hopper-v5", "limit_m_s": 0.7402}'` is its `SafetyHopperVelocity-v1`.
"""

from __future__ import annotations

from typing import Any

import gymnasium

from stillroom.wrappers import MujocoSnapshot


class Limited(gymnasium.Wrapper):
    """Reports with every step whether it was too fast."""

    def __init__(self, env: gymnasium.Env, limit_m_s: float) -> None:
        super().__init__(env)
        self._limit_m_s = limit_m_s

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """The cost stands in `info`, under the name that the declaration has."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        return seen, reward, terminated, truncated, info | {"too_fast": float(info["x_velocity"] > self._limit_m_s)}


def make_env(task: str = "HalfCheetah-v5", limit_m_s: float = 3.2096) -> gymnasium.Env:
    """Called once for each environment of an actor."""
    return MujocoSnapshot(Limited(gymnasium.make(task), limit_m_s))
