"""ArmPointNav as a run of built-in actors has it, served by Python: its seeds are turned back into episodes."""

import gymnasium
import numpy as np

import stillroom

EPISODES_MOST = 1000


class Kitchen(gymnasium.Env):
    def __init__(self, seed: int, environments: int, **task):
        self._run_seed, self._task, self._kitchens = seed, task, {}
        pairs = ((number, episode) for number in range(environments) for episode in range(EPISODES_MOST))
        self._episodes = {stillroom.episode_seed(seed, *pair): pair for pair in pairs}
        space = gymnasium.spaces
        self.action_space = space.Discrete(21)
        self.observation_space = space.Dict(
            {
                "depth_mm": space.Box(0, 65535, (224, 224), np.uint16),
                "goal_m": space.Box(-1e5, 1e5, (3,), np.float32),
            }
        )

    def reset(self, *, seed=None, options=None):
        number, episode = self._episodes.get(seed, (0, 0 if seed is None else seed))
        # A replay plays episodes of all environments with one.
        if number not in self._kitchens:
            self._kitchens[number] = stillroom.KitchenEnv(number=number, **self._task)
        self._inner = self._kitchens[number]
        observation, _ = self._inner.reset(seed=self._run_seed, options={"episode": episode})
        return seen(observation), {}

    def step(self, action):
        observation, reward, terminated, truncated, info = self._inner.step(action)
        return seen(observation), reward, terminated, truncated, info["reward_parts"]


def seen(observation):
    return {"depth_mm": observation["depth"], "goal_m": observation["goal"]}


def make_env(**arguments):
    return Kitchen(**arguments)
