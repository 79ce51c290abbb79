"""The planner with privileged state, as a source of demonstrations."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray


class Oracle:
    """What the planner would do now. Made by `stillroom.oracle`."""

    def __init__(self, batch: Any, variant: str, single: bool) -> None:
        self._batch = batch
        self._variant = variant
        self._single = single

    def action(self) -> int | NDArray[np.int64]:
        """The next action: an int for one environment, [n] int64 for a `VectorEnv`.

        It plans from the present moment if the last action was not the one it advised, as when a learner acts and the
        oracle corrects it. In an episode that has ended it is 0.
        """
        actions = self._batch.oracle(self._variant)
        return int(actions[0]) if self._single else actions

    __call__ = action


def oracle(env: gymnasium.Env | gymnasium.vector.VectorEnv, variant: str = "fast") -> Oracle:
    """The oracle of an environment, wrapped or not, or of a `stillroom.VectorEnv`.

    It plans with the state that policies do not see: "fast" takes the shortest way and pushes things aside; "careful"
    keeps clear of everything, and a plan can take it a second. It needs `action_space="large"`.
    """
    if variant not in ("fast", "careful"):
        raise ValueError(f'variant `{variant}` is none of "fast", "careful"')
    batch = getattr(env.unwrapped, "batch", None)
    if batch is None:
        raise TypeError(
            f"there is an oracle for environments of stillroom only, not for {type(env.unwrapped).__name__}"
        )
    return Oracle(batch, variant, single=isinstance(env, gymnasium.Env))
