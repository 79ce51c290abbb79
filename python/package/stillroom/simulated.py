"""What `KitchenEnv` and `VectorEnv` share: their simulation, which `close` frees and copies and pickles take along."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from stillroom._stillroom import Batch, Kitchen, Snapshot, shown
from stillroom.spaces import settings_of

TASK = [
    *("task", "preset", "reward", "depth", "frame_side", "action_space", "max_steps", "start_distance_max_m"),
    *("goal_distance_max_m", "disturbance_weight", "carried_goal"),
]


def task_of(arguments: dict[str, Any]) -> dict[str, Any]:
    """Those of an environment's arguments that are about its task."""
    return {name: arguments[name] for name in TASK}


class Simulated:
    """An environment, or many."""

    _batch: Batch | None = None

    def _make(
        self, kitchens: list[Kitchen], numbers: list[int], autoreset: str, threads: int, task: dict[str, Any]
    ) -> None:
        """Makes an environment in each of `kitchens`; `task` is what `settings_of` takes."""
        self._settings = settings = settings_of(**task)
        self._made = (kitchens, numbers, autoreset, threads, task)
        self._batch = batch = Batch(settings, kitchens, numbers, autoreset, threads)
        self.action_names: list[str] = settings.actions
        """Names of the actions."""
        self._reward: Callable[[Any], Any] | None = task["reward"] if callable(task["reward"]) else None
        self._begun = np.zeros(len(kitchens), np.bool_)
        # Views: whoever makes one read-only does not keep the simulation from writing.
        self._views: dict[str, NDArray[Any]] = {name: array.view() for name, array in batch.observations.items()}

    @property
    def batch(self) -> Batch:
        """The simulation: private."""
        if self._batch is None:
            raise gymnasium.error.ClosedEnvironmentError("this environment is closed: make another one")
        return self._batch

    def _playing(self, index: int | None = None) -> Batch:
        """The simulation, if environment `index` (all, without it) has begun an episode."""
        batch = self.batch
        if not (self._begun.all() if index is None else self._begun[index]):
            raise gymnasium.error.ResetNeeded("call reset() first: no episode has begun")
        return batch

    def _restore(self, index: int, snapshot: Snapshot) -> dict[str, Any]:
        if not isinstance(snapshot, Snapshot):
            raise TypeError(f"snapshot is {shown(snapshot)}, not a stillroom.Snapshot")
        facts = self.batch.restore(index, snapshot)
        self._begun[index] = True
        return facts

    def _free(self) -> None:
        self._batch = self._made = self._views = None  # type: ignore[assignment]

    def __getstate__(self) -> dict[str, Any]:
        """What a pickle or a copy holds: all arguments, and a snapshot of each environment that plays an episode."""
        state = self.__dict__.copy()
        batch = state.pop("_batch", None)
        state.pop("_views", None)
        state.pop("_settings", None)
        if batch is not None:
            state["_snapshots"] = [batch.snapshot(index) if begun else None for index, begun in enumerate(self._begun)]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        snapshots = state.pop("_snapshots", None)
        self.__dict__.update(state)
        if snapshots is not None:
            self._make(*self._made)
            for index, snapshot in enumerate(snapshots):
                if snapshot is not None:
                    self._restore(index, snapshot)
