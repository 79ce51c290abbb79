"""Whether `reset` and `step` returned what Gymnasium says: the same sentences in a run and in the trial before it."""

from __future__ import annotations

from typing import Any

import numpy as np

from stillroom import fault

VALUES = {
    "reset": ("observation", "info"),
    "step": ("observation", "reward", "terminated", "truncated", "info"),
}


def problem(method: str, returned: Any) -> str | None:
    """What is wrong with what a method returned. A run asks this of what it cannot read."""
    names = VALUES[method]
    needed = f"({', '.join(names)})"
    if not isinstance(returned, tuple):
        return f"{method}() returned {kind(returned)}, not {needed}"
    if len(returned) != len(names):
        return f"{method}() returned {len(returned)} value{'s' * (len(returned) != 1)}, not {needed}"
    for name, value in zip(names, returned, strict=True):
        if name in ("terminated", "truncated") and not isinstance(value, bool | np.bool_):
            return f"{method}()'s `{name}` is {kind(value)}, not a bool"
    # A column's `info` is none, and is read as one.
    if not hasattr(returned[-1], "get"):
        return f"{method}()'s info is {kind(returned[-1])}, not a dict"
    return None


def kind(value: Any) -> str:
    """What a value is: an array with its shape and type, anything else by the name of its type."""
    if value is None:
        return "None"
    if isinstance(value, np.ndarray):
        return f"an array of {list(value.shape)} {value.dtype}"
    return fault.a(type(value).__name__)
