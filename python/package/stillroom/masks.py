"""Masks of actions: which options an environment allows now, as Gymnasium's environments say it in `info`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from stillroom.description import Described, Refused

# Of each option 1 or 0; of several choices side by side.
MASK = "action_mask"


def add_mask(described: Described, env: gymnasium.Env) -> None:
    """Declares the mask that is in the `info` of an episode's start, if one is."""
    _, info = env.reset(seed=0)
    mask, options = info.get(MASK), sum(_counts(env.action_space))
    if mask is None or options == 0:
        return
    if np.shape(mask) != (options,):
        raise Refused(
            f'info["{MASK}"] of the environment has the shape {np.shape(mask)}, not ({options},): one number for each'
            " option, of several choices side by side"
        )
    doc = "Whether each option may be chosen."
    channel = {"name": MASK, "role": "mask", "dtype": "u8", "shape": [options], "doc": doc}
    described.description["channels"].append(channel)


def sample(space: spaces.Space, mask: NDArray[Any] | None) -> Any:
    """An action by chance, as the space draws it."""
    return space.sample() if mask is None else chosen(space, mask, space.np_random.choice)


def chosen(space: spaces.Space, mask: NDArray[Any], pick: Callable[[NDArray[np.intp]], Any]) -> Any:
    """An action of `space`, of which `pick` takes each choice among the options that are allowed."""
    allowed = [np.flatnonzero(part) for part in np.split(np.asarray(mask), np.cumsum(_counts(space))[:-1])]
    if not all(options.size for options in allowed):
        raise Refused(f"the environment's {MASK} allows no option of a choice: one at least can always be chosen")
    return np.array([pick(options) for options in allowed], space.dtype).reshape(space.shape or ())[()]


def _counts(space: spaces.Space) -> list[int]:
    """Options of each choice; none of numbers."""
    if isinstance(space, spaces.MultiDiscrete):
        return space.nvec.reshape(-1).tolist()
    return [int(space.n)] if isinstance(space, spaces.Discrete) else []
