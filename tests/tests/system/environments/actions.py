"""Environments whose actions are numbers, or several choices. Slow: a run is to be killed in its middle."""

import time

import gymnasium
import numpy as np

STEP_S = 0.005


class Slow(gymnasium.Wrapper):
    def step(self, action):
        assert self.action_space.contains(action), action
        time.sleep(STEP_S)
        return super().step(action)


class Choices(gymnasium.Env):
    """Pays for each choice that is as it was seen at the start."""

    def __init__(self):
        self.action_space = gymnasium.spaces.MultiDiscrete([[3, 2], [4, 2]])
        self.observation_space = gymnasium.spaces.MultiDiscrete([3, 2, 4, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._wanted, self._steps = self.np_random.integers(self.action_space.nvec), 0
        return self._wanted.flatten(), {}

    def step(self, action):
        self._steps += 1
        paid = float((action == self._wanted).sum())
        return self._wanted.flatten(), paid, self._steps == 7, False, {}


def numbers():
    return Slow(gymnasium.make("Pendulum-v1"))


def choices():
    return Slow(Choices())
