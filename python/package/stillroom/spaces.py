"""Spaces and arguments that `ArmPointNav` and `VectorEnv` share."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from stillroom._stillroom import Kitchen, Settings

# Farther than any room is wide: a scene of a user may be large, and spaces must not depend on the kitchen.
GOAL_MAX_M = 1000.0


# What the simulator counts with.
NUMBER_MAX = 2**32 - 1
SEED_MAX = 2**64 - 1


def whole(name: str, number: Any, most: int = NUMBER_MAX) -> int:
    """A whole number from 0 to `most`, or an error that names it."""
    try:
        value = operator.index(number)
    except TypeError:
        raise TypeError(f"{name} is {number!r}, not a whole number") from None
    if not 0 <= value <= most:
        raise ValueError(f"{name} is {value}, not 0 to {most}")
    return value


def settings_of(
    *,
    reward: str | Callable[[dict[str, Any]], Any],
    depth: str,
    frame_side: int,
    preset: str,
    max_steps: int | None,
    **overrides: Any,
) -> Settings:
    """The settings of the arguments; a reward that is a function leaves the composed one at r."""
    if not (isinstance(reward, str) or callable(reward)):
        raise ValueError(f"reward is {reward!r}, neither \"r\", \"r_prime\" nor a function of the reward's parts")
    if depth not in ("uint16", "float32"):
        raise ValueError(f'depth `{depth}` is none of "uint16" (millimetres), "float32" (metres)')
    return Settings(
        preset=preset,
        reward="r" if callable(reward) else reward,
        frame_side=whole("frame_side", frame_side),
        in_metres=depth == "float32",
        max_steps=None if max_steps is None else whole("max_steps", max_steps),
        **overrides,
    )


def actions_of(actions: Any, count: int) -> NDArray[np.int64]:
    """Actions as the simulator takes them, one for each of `count` environments, from anything that holds integers."""
    array = np.asarray(actions)
    if array.dtype.kind not in "iu":
        raise ValueError(f"actions are integers, not {array.dtype}: {actions!r}")
    if array.shape != (count,):
        found = f"{len(array)} actions" if array.ndim == 1 else f"actions of shape {array.shape}"
        raise ValueError(f"{found} for {count} environment{'s' if count > 1 else ''}")
    # A column of a matrix is not contiguous.
    return np.ascontiguousarray(array, np.int64)


def check_pictures(render_side: int) -> None:
    """Refuses a side of pictures that cannot be drawn."""
    if not 8 <= render_side <= 4096:
        raise ValueError(f"render_side is {render_side}, not 8 to 4096 pixels")


def kitchen_of(kitchen: int | Kitchen) -> Kitchen:
    """The kitchen with this number, or the one given."""
    return kitchen if isinstance(kitchen, Kitchen) else Kitchen(kitchen)


def observation_space(settings: Settings, *, depth: str, frame_side: int) -> gymnasium.spaces.Dict:
    """What `types.Observation` describes."""
    shape = (frame_side, frame_side)
    if depth == "float32":
        depths = gymnasium.spaces.Box(0.0, np.float32(65.535), shape, np.float32)
    else:
        depths = gymnasium.spaces.Box(0, 65535, shape, np.uint16)
    return gymnasium.spaces.Dict(
        {
            "depth": depths,
            "goal": gymnasium.spaces.Box(-GOAL_MAX_M, GOAL_MAX_M, (3,), np.float32),
            "previous_action": gymnasium.spaces.Discrete(len(settings.actions) + 1),
        }
    )


SERIES = ("sampled", "fixed", "drawn")


def choice_of(options: dict[str, Any] | None, seed: int | None) -> tuple[str | None, int | None, int | None]:
    """The episode that the options of `reset` ask for: (series, seed, number), None as before or the next.

    `{"episode": 5}` is the sampled episode 5 of the seed, `{"fixed": 5}` the fixed one with this number (validation and
    test kitchens), `{"drawn": 5}` the one that an evaluation draws.
    """
    options = dict(options or {})
    if "episode" in options:
        options["sampled"] = options.pop("episode")
    unknown = sorted(set(options) - set(SERIES))
    if unknown:
        raise ValueError(f"reset has no option {unknown[0]!r}; it has 'episode', 'fixed', 'drawn'")
    if len(options) > 1:
        raise ValueError("give one of the options 'episode', 'fixed', 'drawn'")
    seed = None if seed is None else whole("seed", seed, SEED_MAX)
    for series, number in options.items():
        return series, seed, whole("episode" if series == "sampled" else series, number)
    return None, seed, None
