"""Environments that no seed and actions bring back: their weather goes on from episode to episode."""

import json
import os

import gymnasium
import numpy as np


class Walk(gymnasium.Env):
    metadata = {"restore": "none"}

    def __init__(self):
        self.action_space = gymnasium.spaces.Discrete(2)
        self.observation_space = gymnasium.spaces.Box(-9.0, 9.0, (2,), np.float32)
        self._weather = np.random.default_rng(7)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._at, self._wind, self._steps = float(self.np_random.uniform(-1, 1)), 0.0, 0
        return self._seen(), {}

    def step(self, action):
        self._wind = float(self._weather.uniform(-0.1, 0.1))
        self._at += 0.2 * (2 * int(action) - 1) + self._wind
        self._steps += 1
        return self._seen(), -abs(self._at), abs(self._at) > 2 or self._steps == 30, False, {}

    def _seen(self):
        return np.array([self._at, self._wind], np.float32)


class Kept(Walk):
    metadata = {"restore": "snapshot", "snapshot_bytes": 400}

    def get_state(self):
        weather, own = (generator.bit_generator.state for generator in (self._weather, self.np_random))
        return json.dumps([self._at, self._wind, self._steps, weather, own]).encode()

    def set_state(self, state):
        self._at, self._wind, self._steps, weather, own = json.loads(state)
        self._weather.bit_generator.state, self.np_random.bit_generator.state = weather, own


class Seeded(Kept):
    """Each episode follows from its seed: its recordings can be replayed."""

    def reset(self, *, seed=None, options=None):
        self._weather = np.random.default_rng(seed)
        return super().reset(seed=seed, options=options)


class Forgetful(Kept):
    """Its snapshots lack the weather."""

    def set_state(self, state):
        weather = self._weather.bit_generator.state
        super().set_state(state)
        self._weather.bit_generator.state = weather


class Claiming(Walk):
    metadata = {"restore": "replay"}


class ByProcess(Seeded):
    """Repeats itself within a process alone."""

    metadata = {"restore": "replay"}

    def reset(self, *, seed=None, options=None):
        return super().reset(seed=seed + os.getpid(), options=options)


class Leaking(Seeded):
    """Keeps three MiB of each episode, which has six steps."""

    metadata = {"restore": "replay"}

    def __init__(self):
        super().__init__()
        self._kept = []

    def reset(self, *, seed=None, options=None):
        self._kept.append(b"x" * (3 << 20))
        return super().reset(seed=seed, options=options)

    def step(self, action):
        *seen, _, truncated, info = super().step(action)
        return *seen, self._steps == 6, truncated, info
