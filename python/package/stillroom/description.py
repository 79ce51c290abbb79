"""What an environment says of itself, as a task's declaration says it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from . import _stillroom, returned

F32_MOST = float(np.finfo(np.float32).max)

# What a record holds for numbers of NumPy's types.
DTYPES = {
    "bool": "u8",
    "uint8": "u8",
    "uint16": "u16",
    "uint32": "u32",
    "int8": "i32",
    "int16": "i32",
    "int32": "i32",
    "int64": "i32",
    "float32": "f32",
    "float64": "f32",
}


class Refused(Exception):
    """An environment cannot take part, for this reason."""


@dataclass
class Described:
    """A declaration's beginning, and where each observation's channel is found."""

    description: dict[str, Any]
    observed: list[tuple[str, str | None]]
    warnings: list[str] = field(default_factory=list)


def describe(env: gymnasium.Env, name: str) -> Described:
    """The declaration that follows from an environment's spaces."""
    space = env.observation_space
    if isinstance(space, spaces.Dict):
        found = [(_channel_name(key), key, inner) for key, inner in space.spaces.items()]
    else:
        found = [("observation", None, space)]
    with _Gathered() as gathered:
        channels = [gathered(_channel, channel, key, inner) for channel, key, inner in found]
        actions, restore = gathered(_actions, env.action_space), gathered(_restore, env)
    description = {"name": name, "actions": actions, "channels": channels, "restore": restore}
    return Described(description, [(channel, key) for channel, key, _ in found])


class _Gathered:
    """Refuses at its end, with all that was refused in it."""

    def __init__(self) -> None:
        self._problems: list[str] = []

    def __enter__(self) -> _Gathered:
        return self

    def __call__(self, check: Callable[..., Any], *given: Any) -> Any:
        try:
            return check(*given)
        except Refused as refusal:
            self._problems.append(str(refusal))

    def __exit__(self, kind: object, *_: object) -> None:
        if self._problems and kind is None:
            raise Refused("; and ".join(self._problems))


def check_seen(described: Described, observation: Any, method: str = "reset") -> None:
    """Refuses an observation that is not as its space says: a run would refuse it at this step. Warns once of one that
    the space does not have."""
    by_name = {channel["name"]: channel for channel in described.description["channels"]}
    keys = [key for _, key in described.observed if key is not None]
    if keys and not isinstance(observation, Mapping):
        seen = f"{method}()'s observation is {returned.kind(observation)}, not a dict"
        raise Refused(f"{seen}: it has no `{keys[0]}`, which its space has")
    for unknown in [key for key in observation if key not in keys] if keys else []:
        warning = f"the environment's observation has `{unknown}`, which its space has not: it is left out"
        if warning not in described.warnings:
            described.warnings.append(warning)
    with _Gathered() as gathered:
        for name, key in described.observed:
            gathered(_check_channel, by_name[name], key, observation)


def _check_channel(channel: dict[str, Any], key: str | None, observation: Any) -> None:
    name, space = channel["name"], channel["doc"].removeprefix("Observation: ")
    if key is not None and not (isinstance(observation, Mapping) and key in observation):
        raise Refused(f"the environment's observation has no `{key}`, which its space has")
    seen = observation if key is None else observation[key]
    if channel.get("shape"):
        if not isinstance(seen, np.ndarray):
            raise Refused(f"the environment's observation `{name}` is {returned.kind(seen)}, and its space is {space}")
        fits = DTYPES.get(str(seen.dtype)) == channel["dtype"] or (channel["dtype"], seen.dtype) == ("u8", np.int8)
        if not (fits and list(seen.shape) == channel["shape"]):
            raise Refused(
                f"the environment's observation `{name}` is an array of {list(seen.shape)} {seen.dtype}, and its space"
                f" is {space}"
            )
    # Of an image of whole numbers every value is sound.
    if "range" in channel or channel["dtype"] == "f32":
        check_numbers(f"observation `{name}`", seen, channel)


def check_numbers(what: str, value: Any, channel: Mapping[str, Any]) -> None:
    """Refuses what is no number, not finite, or outside of a channel's range."""
    try:
        # NumPy makes numbers of texts and of None.
        numbers = np.asarray(value if isinstance(value, np.ndarray) else 0 + value, np.float64)
        numbers = numbers.reshape(channel.get("shape", ()))
    except (TypeError, ValueError):
        raise Refused(f"the environment's {what} is {value!r}, not {channel.get('shape') or 'a number'}") from None
    # As a record holds it, in 32 bits.
    kind, limit = (np.float32, F32_MOST) if channel.get("dtype", "f32") == "f32" else (np.float64, np.inf)
    least, most = channel.get("range", (-limit, limit))
    with np.errstate(over="ignore"):
        kept = numbers.astype(kind)
    wrong = np.argwhere(~((kind(least) <= kept) & (kept <= kind(most))))
    if len(wrong):
        first = tuple(int(index) for index in wrong[0])
        allowed = f"between {least} and {most}" if np.isfinite(numbers[first]) else "finite"
        place = f" at {list(first)}" if first else ""
        raise Refused(f"the environment's {what}{place} is {numbers[first]}, which is not {allowed}")


def way_of(env: gymnasium.Env) -> str:
    """How an environment is restored: as `metadata["restore"]` says, by snapshots if it has them, or by replay."""
    has_snapshots = all(callable(getattr(env, name, None)) for name in ("get_state", "set_state"))
    way = env.metadata.get("restore", "snapshot" if has_snapshots else "replay")
    if way not in ("replay", "snapshot", "none"):
        raise Refused(f'metadata["restore"] of the environment is {way!r}, not "replay", "snapshot" or "none"')
    if way == "snapshot" and not has_snapshots:
        raise Refused(
            'metadata["restore"] of the environment is "snapshot", but it has no get_state() and set_state(bytes)'
        )
    return way


def _restore(env: gymnasium.Env) -> dict[str, Any]:
    way = way_of(env)
    if way != "snapshot":
        return {"way": way}
    env.reset(seed=0)
    state = env.get_state()  # type: ignore[attr-defined]
    if not isinstance(state, bytes) or not state:
        raise Refused(
            f"the environment's get_state() returned {type(state).__name__}, not bytes, or none of them; if it is no"
            ' snapshot, set metadata["restore"] = "replay"'
        )
    return {"way": way, "bytes": int(env.metadata.get("snapshot_bytes", len(state)))}


def _channel_name(key: Any) -> str:
    name = re.sub(r"[^a-z0-9]+", "_", str(key).lower()).strip("_")
    if not isinstance(key, str) or not name[:1].isalpha():
        raise Refused(f"the environment's observation has the key {key!r}: a key begins with a letter")
    return f"observation_{name}" if _stillroom.is_reserved(name) else name


def _actions(space: spaces.Space) -> dict[str, Any]:
    wrap = "so wrap it (gymnasium.ActionWrapper)"
    if isinstance(space, spaces.Box):
        if space.dtype not in (np.float32, np.float64):
            raise Refused(
                f"the environment's actions are numbers of {space.dtype}; they are float32 or float64, {wrap}"
            )
        # Where there is no bound, that of 32 bits is one.
        bounds = np.stack([space.low, space.high], -1).reshape(-1, 2).astype(np.float64).clip(-F32_MOST, F32_MOST)
        return {"kind": "box", "bounds": bounds.tolist()}
    if not isinstance(space, spaces.Discrete | spaces.MultiDiscrete):
        raise Refused(f"the environment's action space is {space}; actions are Discrete, MultiDiscrete or Box, {wrap}")
    if np.any(space.start):
        raise Refused(f"the environment's actions begin with {space.start}; they begin with 0, {wrap}")
    if isinstance(space, spaces.MultiDiscrete):
        return {"kind": "multi_discrete", "counts": space.nvec.reshape(-1).tolist()}
    if space.n > 254:
        raise Refused(f"the environment has {space.n} actions; a task has at most 254")
    return {"kind": "discrete", "names": [f"action_{number}" for number in range(int(space.n))]}


def _remedy(space: spaces.Space) -> str:
    if isinstance(space, spaces.Tuple):
        return "gymnasium.wrappers.FlattenObservation makes a Box of a Tuple of these"
    if isinstance(space, spaces.Text):
        return "encode text as numbers in a wrapper of your own (gymnasium.ObservationWrapper)"
    return "make numbers of it in a wrapper of your own (gymnasium.ObservationWrapper)"


def _channel(name: str, key: str | None, space: spaces.Space) -> dict[str, Any]:
    if space.shape is not None and 0 in space.shape:
        raise Refused(f"the environment's observation `{name}` has the shape {space.shape}, which holds no number")
    channel: dict[str, Any] = {"name": name, "role": "observation", "doc": f"Observation: {space}."}
    channel |= {} if key is None else {"key": key}
    if isinstance(space, spaces.Discrete):
        return channel | {"dtype": "i32", "range": [float(space.start), float(space.start + space.n - 1)]}
    if isinstance(space, spaces.MultiBinary):
        # Bytes with rows and columns would be an image.
        least, most, dtype, shape = 0.0, 1.0, "uint8" if len(space.shape) == 1 else "int8", space.shape
    elif isinstance(space, spaces.MultiDiscrete):
        least, most = float(np.min(space.start)), float(np.max(space.start + space.nvec - 1))
        dtype, shape = str(space.dtype), space.shape
    elif isinstance(space, spaces.Box):
        least, most, dtype, shape = float(np.min(space.low)), float(np.max(space.high)), str(space.dtype), space.shape
    else:
        raise Refused(
            f"the environment's observation `{name}` is {space}; observations are Box, Discrete, MultiBinary,"
            f" MultiDiscrete or a Dict of these: {_remedy(space)}"
        )
    if dtype not in DTYPES:
        raise Refused(f"the environment's observation `{name}` is of {dtype}; there are {', '.join(DTYPES)}")
    kept = DTYPES[dtype]
    channel |= {"dtype": kept, "shape": list(shape)}
    if kept in ("u8", "u16") and len(shape) >= 2:
        return channel
    limit = (
        F32_MOST
        if kept == "f32"
        else float(np.iinfo({"u8": np.uint8, "u16": np.uint16, "u32": np.uint32}.get(kept, np.int32)).max)
    )
    bottom = -limit if kept in ("f32", "i32") else 0.0
    return channel | {"range": [max(least, bottom), min(most, limit)]}
