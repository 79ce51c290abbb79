"""The arithmetic of actor/c/examples/cart_pole.c."""

import math

import gymnasium
import numpy as np

MASK = (1 << 64) - 1


def drawn(state):
    """Of SplitMix64, a number from -0.05 to 0.05."""
    z = state
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return float((z ^ (z >> 31)) >> 11) / 9007199254740992.0 * 0.1 - 0.05


class CartPole(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1e9, 1e9, (4,), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        self._state = [drawn((seed + step * 0x9E3779B97F4A7C15) & MASK) for step in range(1, 5)]
        self._steps = 0
        return self._seen(), {}

    def step(self, action):
        x, v, angle, turning = self._state
        force, sine, cosine = 10.0 if action else -10.0, math.sin(angle), math.cos(angle)
        push = (force + 0.05 * (turning * turning) * sine) / 1.1
        bend = (9.8 * sine - cosine * push) / (0.5 * (4.0 / 3.0 - 0.1 * (cosine * cosine) / 1.1))
        pull = push - 0.05 * bend * cosine / 1.1
        self._state = [x + 0.02 * v, v + 0.02 * pull, angle + 0.02 * turning, turning + 0.02 * bend]
        self._steps += 1
        terminated = abs(self._state[0]) > 2.4 or abs(self._state[2]) > 0.20943951
        return self._seen(), 1.0, terminated, self._steps >= 500, {}

    def _seen(self):
        return np.array(self._state, np.float32)


def make_env():
    return CartPole()
