"""An Atari game as DQN sees it: four grey images of 84 x 84. `pip install ale-py opencv-python-headless` brings it.

stillroom up --env python/examples/atari.py:make_env --config python/examples/atari.toml --run runs/breakout
"""

from __future__ import annotations

from typing import Any

import ale_py
import gymnasium
import numpy as np
from gymnasium import wrappers
from gymnasium.utils import seeding

gymnasium.register_envs(ale_py)


class LoadedOnce(gymnasium.Wrapper):
    """Seeds the number of first actions that do nothing. `ale_py` loads the game again for a seed, which takes as long as
    150 steps, and needs it only where actions are repeated at random."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins the episode of a seed."""
        if seed is not None:
            self.unwrapped.np_random, _ = seeding.np_random(seed)
        return self.env.reset(options=options)


def make_env(game: str = "Breakout") -> gymnasium.Env:
    """Called once for each environment of an actor; `--env-kwargs '{"game": "Pong"}'` is another game."""
    # The wrapper repeats actions. Actions that are repeated at random make a game hard to learn by heart.
    env = gymnasium.make(f"ALE/{game}-v5", frameskip=1, repeat_action_probability=0.0)
    env = wrappers.AtariPreprocessing(LoadedOnce(env), noop_max=30, terminal_on_life_loss=True)
    env = wrappers.TransformReward(env, lambda reward: float(np.sign(reward)))
    return wrappers.FrameStackObservation(env, 4)
