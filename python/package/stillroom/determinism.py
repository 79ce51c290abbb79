"""Whether an environment can be rebuilt from an episode's seed and its actions, as a run does after a kill."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from stillroom.description import Refused

# Of the episode that is played twice, and of another one between.
STEPS = 40
STEPS_BETWEEN = 10


def prove(env: gymnasium.Env) -> None:
    """Plays an episode twice, another one between, and refuses an environment that does not repeat the first."""
    once = _play(env, 1, STEPS)
    _play(env, 2, STEPS_BETWEEN)
    again = _play(env, 1, STEPS)
    for step, (first, second) in enumerate(zip(once, again, strict=True)):
        for what in first.keys() | second.keys():
            if what not in first or what not in second or not _same(first[what], second[what]):
                raise Refused(
                    f"it does not repeat itself: after reset(seed=1) and the same {step} actions its {what} is another"
                    " one. A run rebuilds an environment by its seed and actions: draw all random numbers from"
                    " self.np_random, and reset everything in reset(); a vector resets columns alone, each by a seed of"
                    ' its own: reset(seed=[1, None], options={"reset_mask": ...})'
                )


def _play(env: gymnasium.Env, seed: int, steps: int) -> list[dict[str, Any]]:
    """What is seen from the start on; a seed's actions are always the same."""
    random = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    seen: list[dict[str, Any]] = [{"observation": _copy(observation)}]
    ended = False
    for _ in range(steps):
        action = int(random.integers(env.action_space.n))  # type: ignore[attr-defined]
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
