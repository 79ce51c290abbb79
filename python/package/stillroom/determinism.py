"""Whether an environment can be restored as it says: from an episode's seed and its actions, or from a snapshot."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from itertools import zip_longest
from typing import Any

import gymnasium
import numpy as np

from stillroom.description import Described, Refused, way_of
from stillroom.masks import MASK, sample
from stillroom.trial import Tried

# Of the episode that is played twice, and of another one between.
STEPS = 40
STEPS_BETWEEN = 10
# A snapshot is taken after so many steps, or before the last one of an episode that is shorter.
STEPS_BEFORE = 20


def try_out(described: Described, env: Any, declared: Sequence[dict[str, Any]]) -> None:
    """Refuses what a run would refuse at an episode's start or first step. `declared`: channels that the user adds."""
    tried = env if isinstance(env, Tried) else Tried(env, described, declared)
    observation, info = tried.reset(seed=0)
    tried.step(_chance(env, 0)(_seen(observation, info)))


def prove(env: gymnasium.Env, make: Callable[[], gymnasium.Env]) -> None:
    """Refuses an environment that does not go on as it did when it is restored in the way that it declares.

    For "replay" an episode is played twice, another one between. For "snapshot" another environment, in an episode of
    its own, is put into the middle of the first one's; and episodes begin by their seeds.
    """
    way = way_of(env)
    if way == "none":
        return
    once = _play(env, 1, STEPS)
    _play(env, 2, STEPS_BETWEEN)
    if way == "replay":
        advice = (
            "A run rebuilds an environment by its seed and actions: draw all random numbers from self.np_random, and"
            ' reset everything in reset(). With metadata["restore"] = "none" it trains all the same, but not to'
            " the same bits after a kill. A vector resets columns alone, each by a seed of its own:"
            ' reset(seed=[1, None], options={"reset_mask": ...})'
        )
        return _compare(once, _play(env, 1, STEPS), 0, "reset(seed=1)", advice)
    start = _play(env, 1, 0)
    _compare(once[:1], start, 0, "reset(seed=1)", "Every episode begins by its seed")
    choose, actions, seen = _chance(env, 1), [], start
    for step in range(STEPS):
        if step <= STEPS_BEFORE:
            first, state = step, env.get_state()  # type: ignore[attr-defined]
        actions.append(choose(seen[-1]))
        seen.append(_step(env, actions[-1]))
        if seen[-1]["end"]:
            break
    other = make()
    _play(other, 2, STEPS_BETWEEN)
    other.set_state(state)  # type: ignore[attr-defined]
    again = [_step(other, action) for action in actions[first:]]
    other.close()
    advice = "A snapshot holds all that the next step depends on, generators and wrappers too"
    return _compare(seen[first + 1 :], again, first + 1, "set_state() of a snapshot in another environment", advice)


def _compare(once: list[dict[str, Any]], again: list[dict[str, Any]], first: int, after: str, advice: str) -> None:
    for step, (one, other) in enumerate(zip_longest(once, again, fillvalue={}), first):
        for what in ("observation", "reward", "end", MASK):
            if (what in one) != (what in other) or (what in one and not _same(one[what], other[what])):
                raise Refused(
                    f"the environment does not repeat itself: after {after} its {what} after {step} actions is another"
                    f" one. {advice}"
                )


def _play(env: gymnasium.Env, seed: int, steps: int) -> list[dict[str, Any]]:
    """What is seen from the start on; a seed's actions are always the same."""
    observation, info = env.reset(seed=seed)
    seen, choose = [_seen(observation, info)], _chance(env, seed)
    for _ in range(steps):
        seen.append(_step(env, choose(seen[-1])))
        if seen[-1]["end"]:
            break
    return seen


def _chance(env: gymnasium.Env, seed: int) -> Callable[[dict[str, Any]], Any]:
    """Chooses actions where this is seen."""
    space = copy.deepcopy(env.action_space)
    space.seed(seed)
    return lambda seen: sample(space, seen.get(MASK))


def _step(env: gymnasium.Env, action: Any) -> dict[str, Any]:
    observation, reward, terminated, truncated, info = env.step(action)
    return _seen(observation, info) | {"reward": float(reward), "end": bool(terminated or truncated)}


def _seen(observation: Any, info: Any) -> dict[str, Any]:
    mask = info.get(MASK)
    return {"observation": _copy(observation)} | ({} if mask is None else {MASK: np.array(mask)})


def _copy(observation: Any) -> Any:
    if isinstance(observation, dict):
        return {key: np.array(value) for key, value in observation.items()}
    return np.array(observation)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return all(_same(value, other[key]) for key, value in one.items())
    # The run itself refuses what is not a number.
    return bool(np.array_equal(one, other, equal_nan=np.issubdtype(np.asarray(one).dtype, np.floating)))
