"""Many environments that threads step together: `stillroom.VectorEnv`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from stillroom._stillroom import Kitchen, Snapshot, choice, shown, whole
from stillroom._stillroom import kitchens as kitchens_of
from stillroom.env import moved
from stillroom.simulated import Simulated, task_of
from stillroom.spaces import (
    ENVIRONMENTS_MAX,
    RENDER_MODES,
    SEED_MAX,
    Parts,
    actions_of,
    choice_of,
    flag,
    is_single,
    items,
    kitchen_of,
    observation_space,
    options_of,
    pictures_of,
)
from stillroom.types import Observation, RewardParts, State


class VectorEnv(Simulated, gymnasium.vector.VectorEnv):
    """`num_envs` environments in one or many kitchens, behind Gymnasium's vector API.

    `step` releases Python's lock; `threads` threads share the work, and the results do not depend on their number.

    **Observations are views** of arrays that every `step` and `reset` overwrites: what is to be kept must be copied, or
    ask for `copy=True`. `torch.from_dlpack(observations["depth"])` shares the same memory. Rewards, flags and infos are
    new arrays each time.
    """

    metadata = {
        "render_modes": RENDER_MODES,
        "render_fps": 5,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        kitchens: int | str | Kitchen | Sequence[int | Kitchen] | None = None,
        scenes: str | PathLike[str] | Sequence[str | PathLike[str]] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        copy: bool = False,
        task: str | None = None,
        preset: str = "paper",
        reward: str | Callable[[RewardParts], NDArray[Any]] = "r",
        disturbance_weight: float | None = None,
        action_space: str | None = None,
        max_steps: int | None = None,
        start_distance_max_m: float | None = None,
        goal_distance_max_m: float | None = None,
        carried_goal: str | None = None,
        depth: str = "uint16",
        frame_side: int = 224,
        render_mode: str | None = None,
        render_side: int = 448,
    ) -> None:
        """Makes the environments. Environment i is in kitchen i of the list, which begins again after its last one.

        Args:
            num_envs: number of environments.
            kitchens: a split ("train", which it is without one, "validation", "test"), a number or a `Kitchen`, or a
                list of them.
            scenes: TOML file of a scene of your own, or a list of them, instead of kitchens.
            autoreset_mode: `NextStep`, `SameStep` or `Disabled`, as Gymnasium defines them; it is in
                `metadata["autoreset_mode"]`.
            threads: threads that step; by default one for each processor that this process may use.
            copy: return copies of the observations.
            reward: "r", "r_prime", or a function of the reward's parts, arrays [n], that returns [n].

        The others are those of `stillroom.KitchenEnv`.
        """
        self.render_mode, self._render_side = pictures_of(render_mode, render_side)
        modes = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode):
            autoreset_mode = AutoresetMode(choice("autoreset_mode", autoreset_mode, modes))
        self.autoreset_mode = autoreset_mode
        self.metadata = {**type(self).metadata, "autoreset_mode": autoreset_mode}
        self.num_envs = whole("num_envs", num_envs, ENVIRONMENTS_MAX, 1)
        self.copy = flag("copy", copy)
        threads = len(os.sched_getaffinity(0)) if threads is None else whole("threads", threads, ENVIRONMENTS_MAX, 1)
        rooms, count = _kitchens(kitchens, scenes, self.num_envs)
        kitchen_of_each = [rooms[index % count] for index in range(self.num_envs)]
        numbers = [index // count for index in range(self.num_envs)]
        self._make(kitchen_of_each, numbers, autoreset_mode.value, threads, task_of(locals()))
        self.single_observation_space = observation_space(self._views, self._settings.bounds, len(self.action_names))
        self.single_action_space = gymnasium.spaces.Discrete(len(self.action_names))
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @property
    def kitchens(self) -> list[Kitchen]:
        """The kitchen of each environment."""
        self.batch  # noqa: B018  # refuses a closed environment
        return list(self._made[0])

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins episodes in all environments, or in those of `options["reset_mask"]` ([n] bool).

        If one cannot begin, all stay as they are.

        Args:
            seed: one for each environment, or s, which gives environment i the seed s + i, as Gymnasium's own do.
            options: as of `KitchenEnv.reset`; a number may be a sequence [n].
        """
        batch, count, options = self.batch, self.num_envs, options_of(options)
        mask = options.pop("reset_mask", None)
        mask = [True] * count if mask is None else [flag("reset_mask", one) for one in items("reset_mask", mask, count)]
        if seed is None:
            seeds: list[Any] = [None] * count
        elif is_single(seed):
            seed = whole("seed", seed, SEED_MAX - count + 1)
            seeds = [seed + index for index in range(count)]
        else:
            seeds = items("seed", seed, count)
        chosen = {
            name: [number] * count if is_single(number) else items(f"option {shown(name)}", number, count)
            for name, number in options.items()
        }
        asked = []
        for index in range(count):
            series, own, number = choice_of({name: numbers[index] for name, numbers in chosen.items()}, seeds[index])
            if own is None and not self._begun[index]:
                own = int(self.np_random.integers(2**63))
            asked.append((series, own, number) if mask[index] else None)
        facts = batch.reset(asked)
        self._begun |= mask
        if is_single(seed):
            super().reset(seed=seed)
        return self._observations(), self._infos(facts)

    def step(
        self, actions: NDArray[np.integer[Any]]
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Takes an action in each environment; returns observations, rewards [n], terminated [n], truncated [n], infos.

        What happens after an episode's end is `autoreset_mode`. In `SameStep` the infos have `final_obs` ([n] objects,
        None but where an episode ended) and `final_info` (arrays [n], valid where `_final_info` is true).
        """
        batch = self._playing()
        taken = actions_of(actions, self.num_envs, len(self.action_names))
        rewards, terminated, truncated, done, now, was_reset, last = batch.step(taken)
        if self._reward is not None:
            rewards = np.where(was_reset, 0.0, self._own_reward(done["reward_parts"]))
        infos = self._infos(now)
        if last:
            ended = np.logical_or(terminated, truncated)
            final = np.full(self.num_envs, None, dtype=object)
            for index, seen in last:
                if self._views["depth"].dtype == np.float32:
                    seen["depth"] = seen["depth"].astype(np.float32) / np.float32(1000.0)
                final[index] = seen | {"previous_action": np.int64(seen["previous_action"])}
            infos.update(final_obs=final, _final_obs=ended, final_info=_masked(done, ended), _final_info=ended)
        return self._observations(), rewards, terminated, truncated, infos

    def render(self) -> tuple[NDArray[Any], ...] | None:
        """A picture of each environment, as `KitchenEnv.render` describes it."""
        batch = self._playing()
        if self.render_mode == "rgb_array":
            return tuple(batch.picture(index, self._render_side) for index in range(self.num_envs))
        if self.render_mode == "depth_array":
            depth = self._views["depth"]
            return tuple(depth.copy() if depth.dtype == np.float32 else depth.astype(np.float32) / np.float32(1000.0))
        return None

    def state(self, index: int) -> State:
        """The privileged state of environment `index`."""
        index = self._at(index)
        return self._playing(index).state(index)

    def displacement_m(self, index: int) -> dict[str, float]:
        """Each object of environment `index` that is not where it stood, and how far from there, metres."""
        index = self._at(index)
        return moved(self.kitchens[index].objects, self._playing(index).displacements_m(index))

    def snapshot(self, index: int) -> Snapshot:
        """The moment of environment `index`, as of `KitchenEnv.snapshot`."""
        index = self._at(index)
        return self._playing(index).snapshot(index)

    def restore(self, index: int, snapshot: Snapshot) -> tuple[Observation, dict[str, Any]]:
        """Returns environment `index` to a moment of its kitchen; returns the observations and infos of all."""
        facts = self._restore(self._at(index), snapshot)
        return self._observations(), self._infos(facts)

    def __enter__(self) -> VectorEnv:
        """`with` closes the environment at its end, as Gymnasium's `Env` does."""
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close_extras(self, **_: Any) -> None:
        """Frees the simulation. Whatever is asked of it afterwards raises `gymnasium.error.ClosedEnvironmentError`."""
        self._free()

    def _at(self, index: int) -> int:
        self.batch  # noqa: B018  # refuses a closed environment
        try:
            return whole("index", index, self.num_envs - 1)
        except ValueError as error:
            raise IndexError(str(error)) from None

    def _own_reward(self, parts: RewardParts) -> NDArray[np.float64]:
        assert self._reward is not None
        rewards = self._reward(Parts(parts))
        try:
            array = np.full(0, 0.0) if rewards is None else np.asarray(rewards, np.float64)
        except (ArithmeticError, TypeError, ValueError):
            array = np.full(0, 0.0)
        if array.shape not in ((), (self.num_envs,)):
            found, count = shown(rewards), self.num_envs
            raise ValueError(f"the reward function returned {found}, not one number for each of {count} environments")
        return array

    def _observations(self) -> Observation:
        if self.copy:
            return {name: array.copy() for name, array in self._views.items()}
        return dict(self._views)

    def _infos(self, facts: dict[str, Any]) -> dict[str, Any]:
        return _masked(facts, self._begun.copy())


def _masked(facts: dict[str, Any], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """The facts, each with the mask of the environments that it is about, as Gymnasium's infos have them."""
    infos = dict(facts)
    infos.update({f"_{name}": mask for name in facts})
    return infos


def _kitchens(
    kitchens: int | str | Kitchen | Sequence[int | Kitchen] | None,
    scenes: str | PathLike[str] | Sequence[str | PathLike[str]] | None,
    num_envs: int,
) -> tuple[list[Kitchen], int]:
    """The kitchens that so many environments are in, and how many are in the list: what is not used is not built."""
    if scenes is not None:
        if kitchens is not None:
            raise ValueError("give either kitchens or scenes")
        paths = [scenes] if isinstance(scenes, str | PathLike) else items("scenes", scenes)
        rooms = [Kitchen(scene=scene, scene_index=index) for index, scene in enumerate(paths[:num_envs])]
        count = len(paths)
    else:
        if kitchens is None or isinstance(kitchens, str):
            chosen: list[Any] = kitchens_of(choice("kitchens", kitchens or "train", ["train", "validation", "test"]))
        elif isinstance(kitchens, Kitchen) or is_single(kitchens):
            chosen = [kitchens]
        else:
            chosen = items("kitchens", kitchens)
        rooms = [kitchen_of(kitchen) for kitchen in chosen[:num_envs]]
        count = len(chosen)
    if not rooms:
        raise ValueError("give at least one kitchen or scene")
    return rooms, count
