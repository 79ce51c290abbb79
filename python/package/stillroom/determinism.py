"""Whether an environment can be restored as it says: from an episode's seed and its actions, or from a snapshot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from stillroom.description import Refused, way_of

# Of the episode that is played twice, and of another one between.
STEPS = 40
STEPS_BETWEEN = 10
# A snapshot is taken after so many steps, or in an episode that is shorter before its last one.
STEPS_BEFORE = 20


def prove(env: gymnasium.Env, make: Callable[[], gymnasium.Env]) -> None:
    """Refuses an environment that does not go on as it did when it is restored in the way that it declares.

    For "replay" an episode is played twice, another one between. For "snapshot" another environment, in an episode of its
    own, is put into the middle of the first one's; and episodes begin by their seeds.
    """
    way = way_of(env)
    if way == "none":
        return
    once = _play(env, 1, STEPS)
    _play(env, 2, STEPS_BETWEEN)
    if way == "replay":
        again = _play(env, 1, STEPS)
        advice = (
            "A run rebuilds an environment by its seed and actions: draw all random numbers from self.np_random, and reset"
            ' everything in reset(). An environment with metadata["restore"] = "none" trains all the same, but not to the'
            " same bits after a kill"
        )
        return _compare(once, again, 0, "reset(seed=1)", advice)
    played = sum(1 for step in once if step) - 1
    before = min(STEPS_BEFORE, max(0, played - 1))
    advice = "A snapshot holds all that the next step depends on, generators and wrappers too"
    _compare(once[:1], _play(env, 1, 0), 0, "reset(seed=1)", "Every episode begins by its seed")
    _play(env, 1, before)
    state = env.get_state()  # type: ignore[attr-defined]
    other = make()
    _play(other, 2, STEPS_BETWEEN)
    other.set_state(state)  # type: ignore[attr-defined]
    again = _go_on(other, 1, before, STEPS)
    other.close()
    _compare(once[before + 1 :], again, before + 1, "set_state() of a snapshot in another environment", advice)


def _compare(once: list[dict[str, Any]], again: list[dict[str, Any]], first: int, after: str, advice: str) -> None:
    for step, (one, other) in enumerate(zip(once, again, strict=True), first):
        for what in sorted(one.keys() | other.keys()):
            if what not in one or what not in other or not _same(one[what], other[what]):
                raise Refused(
                    f"it does not repeat itself: after {after} its {what} after {step} actions is another one. {advice}"
                )


def _play(env: gymnasium.Env, seed: int, steps: int) -> list[dict[str, Any]]:
    """What is seen from the start on; a seed's actions are always the same."""
    observation, _ = env.reset(seed=seed)
    return [{"observation": _copy(observation)}, *_go_on(env, seed, 0, steps)]


def _go_on(env: gymnasium.Env, seed: int, first: int, steps: int) -> list[dict[str, Any]]:
    random = np.random.default_rng(seed)
    actions = [int(random.integers(env.action_space.n)) for _ in range(steps)]  # type: ignore[attr-defined]
    seen: list[dict[str, Any]] = []
    ended = False
    for action in actions[first:]:
        if ended:
            seen.append({})
            continue
        observation, reward, terminated, truncated, _ = env.step(action)
        ended = bool(terminated or truncated)
        seen.append({"observation": _copy(observation), "reward": float(reward), "end": ended})
    return seen


def _copy(observation: Any) -> Any:
    if isinstance(observation, dict):
        return {key: np.array(value) for key, value in observation.items()}
    return np.array(observation)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return all(np.array_equal(value, other[key]) for key, value in one.items())
    return bool(np.array_equal(one, other))
