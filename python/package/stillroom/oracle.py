"""The planner with privileged state, as a source of demonstrations."""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from stillroom._stillroom import ACTIONS, choice
from stillroom.simulated import Simulated


class Oracle:
    """What the planner would do now. Made by `stillroom.oracle`."""

    def __init__(self, env: Simulated, variant: str) -> None:
        self._env = env
        self._variant = variant

    def action(self) -> int | NDArray[np.int64]:
        """The next action: an int for one environment, [n] int64 for a `VectorEnv`.

        It plans from the present moment if the last action was not the one it advised, as when a learner acts and the
        oracle corrects it. In an episode that has ended it is 0.
        """
        actions = self._env._playing().oracle(self._variant)
        return int(actions[0]) if isinstance(self._env, gymnasium.Env) else actions

    __call__ = action


def oracle(env: gymnasium.Env | gymnasium.vector.VectorEnv, variant: str = "fast") -> Oracle:
    """The oracle of an environment, wrapped or not, or of a `stillroom.VectorEnv`.

    It plans with the state that policies do not see: "fast" takes the shortest way and pushes things aside; "careful"
    keeps clear of everything, and a plan can take it a second. It is of the task arm_point_nav, and needs
    `action_space="large"`.
    """
    variant = choice("variant", variant, ["fast", "careful"])
    own = getattr(env, "unwrapped", None)
    if not isinstance(own, Simulated):
        raise TypeError(f"env is a {type(env).__name__}: there is an oracle for environments of stillroom only")
    if own.action_names != ACTIONS:
        task = 'task="arm_point_nav" and action_space="large"'
        raise ValueError(f"the oracle needs all 21 actions of arm_point_nav: make the environment with {task}")
    return Oracle(own, variant)
