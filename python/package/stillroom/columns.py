"""The environments of a vector environment, each in its own episode under its own seed.

A run begins every episode by `reset(seed)` with a seed of its own, and rebuilds an environment from that and its
actions. So a column is reset alone, by `options={"reset_mask": ...}`, as soon as its episode has ended: whatever the
vector's autoreset mode is, at its next step it finds no episode that has ended. A column that does not act while
others do is stepped all the same, as a vector has no other way, and is lost: before it acts again, the whole vector is
replayed.
"""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv

from stillroom.description import Refused
from stillroom.fault import told
from stillroom.masks import MASK, chosen, sample

# The share of steps in which a column beside the one that is looked at acts.
ACTS = 0.95

INSTEAD = "make single environments instead: an actor steps as many as --envs-per-actor says"


class Vector:
    """A vector environment whose columns take part in a run."""

    def __init__(self, env: VectorEnv) -> None:
        if any(base.__module__.startswith("envpool.") for base in type(env).__mro__):
            raise Refused(
                "the environment is a pool of EnvPool, which takes no seed once it is made: --env envpool:ID serves such"
            )
        mode = env.metadata.get("autoreset_mode")
        if not isinstance(mode, AutoresetMode):
            raise Refused(f'the environment is a vector whose metadata has no "autoreset_mode"; set it, or {INSTEAD}')
        self._env = env
        self._shows_next_episode = mode is AutoresetMode.SAME_STEP
        self._has_begun = False
        space = env.single_action_space
        nothing = np.zeros(space.shape or (), space.dtype)
        self._nothing = np.clip(nothing, space.low, space.high) if isinstance(space, Box) else nothing
        self.columns = [Column(self, index, env) for index in range(env.num_envs)]

    def __len__(self) -> int:
        """How many columns it has."""
        return len(self.columns)

    def take(self, actions: Sequence[Any]) -> None:
        """Steps all columns. One whose action is None, or left out, does not act."""
        acting = [(self.columns[index], action) for index, action in enumerate(actions) if action is not None]
        if any(column.is_lost for column, _ in acting):
            self._replay()
        for column in self.columns:
            column.is_lost = True
        for column, action in acting:
            column.is_lost = False
            column.actions.append(action)
        ended = self._step([None if column.is_lost else column.actions[-1] for column in self.columns])
        # The engine begins the next episodes of those that act.
        self._reset([column for column in ended if column.is_lost])

    def begin(self, column: Column, seed: int) -> tuple[Any, Any]:
        """Begins an episode of a column."""
        column.seed, column.actions = seed, []
        if self._has_begun:
            column.is_lost = False
            return self._reset([column])
        seen = self._reset_all()
        for other in self.columns:
            other.is_lost = other is not column
        return seen

    def result(self, index: int) -> tuple[Any, Any, Any, Any, Any]:
        """What the last step made of a column."""
        seen, rewards, terminated, truncated, info = self._stepped
        if self._shows_next_episode and (terminated[index] or truncated[index]):
            last, info = info["final_obs"][index], info["final_info"]
        else:
            last = _row(seen, index)
        return last, rewards[index], terminated[index], truncated[index], Info(info, index)

    def _step(self, actions: Sequence[Any]) -> list[Column]:
        """Steps by an action for each column, None where it does not act; returns those whose episodes have ended."""
        pairs = zip(actions, self.columns, strict=True)
        taken = [self._idle(column) if action is None else action for action, column in pairs]
        self._stepped = self._env.step(np.array(taken, self._env.action_space.dtype))
        _, _, terminated, truncated, info = self._stepped
        self._note_masks(info)
        return [column for column in self.columns if terminated[column.index] or truncated[column.index]]

    def _idle(self, column: Column) -> Any:
        """An action of a column that is stepped because others are."""
        if column.mask is None:
            return self._nothing
        return chosen(self._env.single_action_space, column.mask, lambda allowed: allowed[0])

    def _note_masks(self, info: dict[str, Any]) -> None:
        """Keeps what columns may do next. Of those that were not reset there is nothing."""
        if MASK not in info:
            return
        for column in self.columns:
            column.mask = Info(info, column.index).get(MASK, column.mask)

    def _reset(self, columns: Sequence[Column]) -> Any:
        if not columns:
            return None
        mask = np.zeros(len(self), np.bool_)
        mask[[column.index for column in columns]] = True
        seeds = [column.seed if mask[column.index] else None for column in self.columns]
        seen = self._env.reset(seed=seeds, options={"reset_mask": mask})  # type: ignore[arg-type]
        self._note_masks(seen[1])
        return seen

    def _reset_all(self) -> Any:
        try:
            seen = self._env.reset(seed=[column.seed for column in self.columns])  # type: ignore[arg-type]
        except Exception as error:
            problem = f"the vector takes no seed for each column (reset(seed=[1, 2])): {told(error)}"
            raise Refused(f"{problem}. Every episode of a run has a seed of its own; {INSTEAD}") from error
        self._has_begun = True
        self._note_masks(seen[1])
        return seen

    def _replay(self) -> None:
        """Brings every column where its seed and actions lead to. All take their last actions together."""
        self._reset_all()
        waiting = [column for column in self.columns if column.actions]
        resting = [column for column in self.columns if not column.actions]
        for left in range(max((len(column.actions) for column in waiting), default=0), 0, -1):
            begins = [column for column in waiting if len(column.actions) == left]
            waiting = [column for column in waiting if column not in begins]
            self._reset(begins)
            idle = [*waiting, *resting]
            ended = self._step([None if column in idle else column.actions[-left] for column in self.columns])
            self._reset([column for column in ended if column in idle])
        self._reset(resting)
        for column in self.columns:
            column.is_lost = False


class Column:
    """One environment of a vector, with Gymnasium's methods. The vector takes an action before it is reported here."""

    def __init__(self, vector: Vector, index: int, env: VectorEnv) -> None:
        self.observation_space, self.action_space = env.single_observation_space, env.single_action_space
        self.metadata = {"restore": env.metadata.get("restore", "replay")}
        self.vector, self.index = vector, index
        self.seed = 0
        self.actions: list[Any] = []
        self.mask: Any = None
        # Whether its state is not that of its seed and actions.
        self.is_lost = True

    def reset(self, *, seed: int) -> tuple[Any, Info]:
        """Begins an episode in this column alone."""
        seen, info = self.vector.begin(self, seed)
        return _row(seen, self.index), Info(info, self.index)

    def step(self, _action: Any) -> tuple[Any, Any, Any, Any, Any]:
        """What came of the action that the vector has taken."""
        return self.vector.result(self.index)


class Info:
    """What a vector's `info` holds for one column."""

    def __init__(self, table: dict[str, Any], index: int) -> None:
        self._table, self._index = table, index

    def __getitem__(self, key: str) -> Any:
        """KeyError where it holds nothing under this name for the column."""
        is_there = self._table.get(f"_{key}")
        if is_there is not None and not is_there[self._index]:
            raise KeyError(key)
        return self._table[key][self._index]

    def get(self, key: str, otherwise: Any = None) -> Any:
        """As of a dictionary."""
        try:
            return self[key]
        except KeyError:
            return otherwise


class Among:
    """A column while others around it do something else every time."""

    def __init__(self, vector: Vector) -> None:
        *self._others, self.column = vector.columns
        self.action_space, self.metadata = self.column.action_space, self.column.metadata
        self._chosen = copy.deepcopy(self.action_space)
        self._chosen.seed(0)
        self._random = np.random.default_rng(0)
        self._masks: list[Any] = [None] * len(self._others)

    def reset(self, *, seed: int) -> tuple[Any, Info]:
        """Begins an episode in each column, in this one that of the seed."""
        for index, other in enumerate(self._others):
            _, info = other.reset(seed=int(self._random.integers(1 << 31)))
            self._masks[index] = info.get(MASK)
        return self.column.reset(seed=seed)

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, Any]:
        """One column acts, the others by chance, or not at all."""
        drawn = [sample(self._chosen, mask) for mask in self._masks]
        others = [one if self._random.random() < ACTS else None for one in drawn]
        self.column.vector.take([*others, action])
        for index, (other, taken) in enumerate(zip(self._others, others, strict=True)):
            _, _, terminated, truncated, info = other.step(0)
            if terminated or truncated:
                _, info = other.reset(seed=other.seed)
            elif taken is None:
                continue
            self._masks[index] = info.get(MASK)
        return self.column.step(action)


def _row(table: Any, index: int) -> Any:
    """What an array, or a dictionary of such, has for one column."""
    return {key: array[index] for key, array in table.items()} if isinstance(table, dict) else table[index]


def halves(environments: int) -> list[int]:
    """How many environments the vectors of an actor have: while one is simulated, the policy computes for the other."""
    return [half for half in (environments - environments // 2, environments // 2) if half]


def takes_size(make_env: Callable[..., Any]) -> bool:
    """Whether `make_env` is called with the number of environments, `num_envs`."""
    given = getattr(make_env, "keywords", {})
    return "num_envs" in inspect.signature(make_env).parameters and "num_envs" not in given


def check_sizes(vectors: Sequence[Vector], environments: int) -> None:
    """Refuses vectors that are not the environments of an actor."""
    if [len(vector) for vector in vectors] != halves(environments):
        size = 2 * len(vectors[0])
        raise Refused(
            f"an actor has {environments} environments, in two vectors that take turns, but it makes vectors of"
            f" {len(vectors[0])}: give --envs-per-actor {size}, or give it an argument `num_envs`"
        )
