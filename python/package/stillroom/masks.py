"""Masks of actions: which options an environment allows now, as Gymnasium's environments say it in `info`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

# Of each option 1 or 0; of several choices side by side.
MASK = "action_mask"


def mask_of(info: Any) -> NDArray[Any] | None:
    """What an `info` allows; None where it does not say."""
    return info.get(MASK)


def counts(space: spaces.Space) -> list[int]:
    """Options of each choice; none of numbers."""
    if isinstance(space, spaces.MultiDiscrete):
        return space.nvec.reshape(-1).tolist()
    return [int(space.n)] if isinstance(space, spaces.Discrete) else []


def chosen(space: spaces.Space, mask: NDArray[Any], pick: Callable[[NDArray[np.intp]], Any]) -> Any:
    """An action of `space`, of which `pick` takes each choice among the options that are allowed."""
    parts = np.split(np.asarray(mask), np.cumsum(counts(space))[:-1])
    return np.array([pick(np.flatnonzero(part)) for part in parts], space.dtype).reshape(space.shape or ())[()]


def sample(space: spaces.Space, mask: NDArray[Any] | None) -> Any:
    """An action by chance, as the space draws it."""
    return space.sample() if mask is None else chosen(space, mask, space.np_random.choice)
