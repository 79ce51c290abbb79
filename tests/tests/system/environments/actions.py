"""Environments whose actions are numbers, or several choices, and one of images. Slow: a run is to be killed in its
middle."""

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


class Images(gymnasium.Env):
    """Pays for the side that is brighter, in two images of different types."""

    def __init__(self):
        self.action_space = gymnasium.spaces.Discrete(2)
        self.observation_space = gymnasium.spaces.Dict(
            {
                "screen": gymnasium.spaces.Box(0, 255, (40, 44, 3), np.uint8),
                "heat": gymnasium.spaces.Box(-1.0, 1.0, (2, 36, 37), np.float32),
            }
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._steps = 0
        return self._seen(), {}

    def step(self, action):
        paid, self._steps = float(action == self._bright), self._steps + 1
        return self._seen(), paid, self._steps == 9, False, {}

    def _seen(self):
        self._bright = int(self.np_random.integers(2))
        screen = self.np_random.integers(0, 100, (40, 44, 3), np.uint8)
        screen[:, 22 * self._bright : 22 * self._bright + 22] += 100
        heat = self.np_random.uniform(-1, 1, (2, 36, 37)).astype(np.float32)
        return {"screen": screen, "heat": heat}


def numbers():
    return Slow(gymnasium.make("Pendulum-v1"))


def choices():
    return Slow(Choices())


def images():
    return Slow(Images())
