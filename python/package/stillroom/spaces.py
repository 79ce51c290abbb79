"""Spaces and arguments that `KitchenEnv` and `VectorEnv` share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import gymnasium
import numpy as np
from numpy.typing import NDArray

from stillroom._stillroom import Kitchen, Settings, shown, whole

# What the simulator counts with.
NUMBER_MAX = 2**32 - 1
SEED_MAX = 2**64 - 1
ENVIRONMENTS_MAX = 65_536


class Parts(dict[str, Any]):
    """Parts of a reward, for a function that computes one. A part that is not there is named beside those that are."""

    def __missing__(self, name: object) -> NoReturn:
        raise KeyError(f"the reward has no part {shown(name)}; it has {', '.join(self)}")


def flag(name: str, value: Any) -> bool:
    """A truth value, or an error that names it."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"{name} is {shown(value)}, neither True nor False")
    return bool(value)


def items(name: str, value: Any, count: int | None = None) -> list[Any]:
    """The items of a list, a tuple, an array: `count` of them if that is given."""
    try:
        # Without a length it may have no end.
        found = list(value) if len(value) >= 0 and not isinstance(value, str | bytes | Mapping) else None
    except TypeError:
        found = None
    if found is None:
        raise TypeError(f"{name} is {shown(value)}, neither one nor a list of them")
    if count is not None and len(found) != count:
        raise ValueError(f"{name} has {len(found)} items for {count} environment{'s' if count > 1 else ''}")
    return found


def is_single(value: Any) -> bool:
    """Whether it counts as one number, such as an array without axes."""
    return hasattr(value, "__index__") and not getattr(value, "shape", ())


RENDER_MODES = ["rgb_array", "depth_array"]


def pictures_of(render_mode: Any, render_side: Any) -> tuple[str | None, int]:
    """What is drawn, and how large."""
    if render_mode is not None and not (isinstance(render_mode, str) and render_mode in RENDER_MODES):
        raise ValueError(
            f"render_mode is {shown(render_mode)}, and stillroom opens no window: use 'rgb_array' (and show or save the"
            " pictures) or 'depth_array'"
        )
    return render_mode, whole("render_side", render_side, 4096, 8)


def settings_of(*, reward: str | Callable[[dict[str, Any]], Any], **task: Any) -> Settings:
    """The settings of the arguments; a reward that is a function leaves the composed one at r."""
    return Settings(reward="r" if callable(reward) else reward, **task)


def actions_of(actions: Any, count: int, space: int) -> NDArray[np.int64]:
    """Actions as the simulator takes them, one of `space` for each of `count` environments."""
    try:
        array = np.asarray(actions)
    except (ValueError, TypeError):
        raise ValueError(f"actions are one integer for each environment, not {shown(actions)}") from None
    if array.dtype.kind not in "iu":
        raise ValueError(f"actions are integers, not {array.dtype}: {shown(actions)}")
    if array.shape != (count,):
        found = f"{len(array)} actions" if array.ndim == 1 else f"actions of shape {array.shape}"
        raise ValueError(f"{found} for {count} environment{'s' if count > 1 else ''}")
    wrong = np.flatnonzero((array < 0) | (array >= space))
    if wrong.size:
        raise ValueError(f"environment {wrong[0]}: there are actions 0 to {space - 1}, not {array[wrong[0]]}")
    # A copy: they may be a column of a matrix, or an array that the step overwrites.
    return np.array(array, np.int64)


def kitchen_of(kitchen: int | Kitchen) -> Kitchen:
    """The kitchen with this number, or the one given."""
    return kitchen if isinstance(kitchen, Kitchen) else Kitchen(kitchen)


def observation_space(
    views: dict[str, NDArray[Any]], bounds: dict[str, list[float]], actions: int
) -> gymnasium.spaces.Dict:
    """What `types.Observation` describes, of environments that see into these arrays, within these bounds."""
    shape = views["depth"].shape[1:]
    if views["depth"].dtype == np.float32:
        depths = gymnasium.spaces.Box(0.0, np.float32(65.535), shape, np.float32)
    else:
        depths = gymnasium.spaces.Box(0, 65535, shape, np.uint16)
    vectors = {
        name: gymnasium.spaces.Box(np.float32(least), np.float32(most), views[name].shape[1:], np.float32)
        for name, (least, most) in bounds.items()
    }
    previous = gymnasium.spaces.Discrete(actions + 1)
    return gymnasium.spaces.Dict({"depth": depths, **vectors, "previous_action": previous})


SERIES = {"episode": "sampled", "fixed": "fixed", "drawn": "drawn"}


def options_of(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """The options of `reset`."""
    if not isinstance(options, Mapping | None):
        raise TypeError(f"options is {shown(options)}, not a dictionary")
    return dict(options or {})


def choice_of(options: dict[str, Any], seed: int | None) -> tuple[str | None, int | None, int | None]:
    """The episode that the options of `reset` ask for: (series, seed, number), None as before or the next.

    `{"episode": 5}` is the sampled episode 5 of the seed, `{"fixed": 5}` the fixed one with this number (validation and
    test kitchens), `{"drawn": 5}` the one that an evaluation draws.
    """
    for name in options:
        if name not in SERIES:
            raise ValueError(f"reset has no option {shown(name)}; it has 'episode', 'fixed', 'drawn'")
    if len(options) > 1:
        raise ValueError("give one of the options 'episode', 'fixed', 'drawn'")
    seed = None if seed is None else whole("seed", seed, SEED_MAX)
    for name, number in options.items():
        return SERIES[name], seed, whole(name, number, NUMBER_MAX)
    return None, seed, None
