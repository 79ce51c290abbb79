"""EnvPool's environments, one by one."""

from __future__ import annotations

import importlib
from typing import Any

import gymnasium
import numpy as np


class PoolEnv(gymnasium.Env):
    """An environment of EnvPool. It takes a seed only when a pool is made, so every episode has a pool of its own."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        self._make = lambda seed: importlib.import_module("envpool").make(
            name, env_type="gymnasium", num_envs=1, num_threads=1, seed=seed, **kwargs
        )
        self._pool = self._make(0)
        self.observation_space, self.action_space = self._pool.observation_space, self._pool.action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Makes the pool of the episode; without a seed it has one by chance."""
        super().reset(seed=seed)
        self._pool = self._make(int(self.np_random.integers(2**31)) if seed is None else seed)
        seen, info = self._pool.reset()
        return _first(seen), _first(info)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Steps the pool's one environment."""
        seen, rewards, terminated, truncated, info = self._pool.step(np.array([action]))
        return _first(seen), float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(info)


def _first(tree: Any) -> Any:
    return {key: _first(inner) for key, inner in tree.items()} if isinstance(tree, dict) else tree[0]
