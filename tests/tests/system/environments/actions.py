"""Environments whose actions are numbers, several choices, or masked, and one of images. Slow: a run is killed in it."""

import time

import gymnasium
import numpy as np
from stillroom.wrappers import ActionMasks

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


class Told(Choices):
    """Tells the critic alone, by `info`, how far the episode is and what pays."""

    def reset(self, *, seed=None, options=None):
        seen, _ = super().reset(seed=seed)
        return seen, self._info(seen)

    def step(self, action):
        *stepped, _ = super().step(action)
        return *stepped, self._info(stepped[0])

    def _info(self, seen):
        return {"elapsed": self._steps, "wanted": seen.astype(np.float32)}


class Masked(gymnasium.Env):
    """Allows some options, others at every step, and fails if another one is taken. At its end it allows nothing."""

    def __init__(self, counts, space, stuck=False):
        self._counts, self.action_space, self._stuck = counts, space, stuck
        self.observation_space = gymnasium.spaces.Box(0, 1, (3,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._steps, self._is_limit = 0, self.np_random.random() < 0.5
        return self._see(), {}

    def step(self, action):
        chosen = np.ravel(action)
        assert all(allowed[option] for allowed, option in zip(self._allowed, chosen, strict=True)), action
        self._steps += 1
        ended = self._steps == 7
        seen = self._see()
        if ended or self._stuck:
            self._allowed = [allowed & False for allowed in self._allowed]
        return seen, float(chosen.sum()), ended and not self._is_limit, ended and self._is_limit, {}

    def action_masks(self):
        return np.concatenate(self._allowed)

    def _see(self):
        self._allowed = [self.np_random.random(count) < 0.4 for count in self._counts]
        for allowed in self._allowed:
            allowed[self.np_random.integers(len(allowed))] = True
        return self.np_random.random(3, np.float32)


def masked():
    return Slow(ActionMasks(Masked([5], gymnasium.spaces.Discrete(5))))


def masked_choices():
    return Slow(ActionMasks(Masked([3, 4], gymnasium.spaces.MultiDiscrete([3, 4]))))


def stuck():
    return ActionMasks(Masked([5], gymnasium.spaces.Discrete(5), stuck=True))


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


def told():
    return Slow(Told())


def choices():
    return Slow(Choices())


def images():
    return Slow(Images())
