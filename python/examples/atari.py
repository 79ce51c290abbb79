"""An Atari game as DQN sees it: four grey images of 84 x 84. `pip install ale-py opencv-python-headless` brings it.

orchestrator up --env python/examples/atari.py:make_env --config python/examples/atari.toml --run runs/breakout
"""

from __future__ import annotations

import ale_py
import gymnasium
import numpy as np
from gymnasium import wrappers

gymnasium.register_envs(ale_py)


def make_env(game: str = "Breakout") -> gymnasium.Env:
    """Called once for each environment of an actor; `--env-kwargs '{"game": "Pong"}'` is another game."""
    # The wrapper repeats actions. Actions that are repeated at random make a game hard to learn by heart.
    env = gymnasium.make(f"ALE/{game}-v5", frameskip=1, repeat_action_probability=0.0)
    env = wrappers.AtariPreprocessing(env, noop_max=30, terminal_on_life_loss=True)
    env = wrappers.TransformReward(env, lambda reward: float(np.sign(reward)))
    return wrappers.FrameStackObservation(env, 4)
