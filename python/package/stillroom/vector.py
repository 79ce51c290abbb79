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

from stillroom._stillroom import Batch, Kitchen, Snapshot
from stillroom._stillroom import kitchens as kitchens_of
from stillroom.env import moved
from stillroom.spaces import actions_of, check_pictures, choice_of, kitchen_of, observation_space, settings_of
from stillroom.types import Observation, RewardParts, State


class VectorEnv(gymnasium.vector.VectorEnv):
    """`num_envs` environments in one or many kitchens, behind Gymnasium's vector API.

    `step` releases Python's lock; `threads` threads share the work, and the results do not depend on their number.

    **Observations are views** of arrays that every `step` and `reset` overwrites: what is to be kept must be copied, or
    ask for `copy=True`. `torch.from_dlpack(observations["depth"])` shares the same memory. Rewards, flags and infos are
    new arrays each time.
    """

    metadata = {
        "render_modes": ["rgb_array", "depth_array"],
        "render_fps": 5,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        kitchens: int | str | Kitchen | Sequence[int | Kitchen] = "train",
        scenes: str | PathLike[str] | Sequence[str | PathLike[str]] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        copy: bool = False,
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
            kitchens: a split ("train", "validation", "test"), a number or a `Kitchen`, or a list of them.
            scenes: TOML file of a scene of your own, or a list of them, instead of kitchens.
            autoreset_mode: `NextStep`, `SameStep` or `Disabled`, as Gymnasium defines them; it is in
                `metadata["autoreset_mode"]`.
            threads: threads that step; by default one for each processor that this process may use.
            copy: return copies of the observations.
            reward: "r", "r_prime", or a function of the reward's parts, arrays [n], that returns [n].

        The others are those of `stillroom.ArmPointNav`.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode {render_mode!r} is not there: use 'rgb_array' or 'depth_array'")
        self.render_mode = render_mode
        self._render_side = render_side
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = num_envs
        self.copy = copy
        self._settings = settings_of(
            reward=reward,
            depth=depth,
            frame_side=frame_side,
            preset=preset,
            action_space=action_space,
            max_steps=max_steps,
            start_distance_max_m=start_distance_max_m,
            goal_distance_max_m=goal_distance_max_m,
            disturbance_weight=disturbance_weight,
            carried_goal=carried_goal,
        )
        self.action_names: list[str] = self._settings.actions
        """Names of the actions."""
        self._reward = reward if callable(reward) else None
        check_pictures(render_side)
        if num_envs < 1 or (threads is not None and threads < 1):
            raise ValueError(f"num_envs is {num_envs} and threads {threads}: at least one of each is needed")
        rooms, count = _kitchens(kitchens, scenes, num_envs)
        self.kitchens: list[Kitchen] = [rooms[index % count] for index in range(num_envs)]
        """The kitchen of each environment."""
        numbers = [index // count for index in range(num_envs)]
        threads = len(os.sched_getaffinity(0)) if threads is None else threads
        self.batch = Batch(self._settings, self.kitchens, numbers, self.autoreset_mode.value, threads)
        self.single_observation_space = observation_space(self._settings, depth=depth, frame_side=frame_side)
        self.single_action_space = gymnasium.spaces.Discrete(len(self.action_names))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._views: Observation = {
            "depth": self.batch.depth,
            "goal": self.batch.goal,
            "previous_action": self.batch.previous_action,
        }
        self._all = np.ones(num_envs, np.bool_)
        self._begun = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins episodes in all environments, or in those of `options["reset_mask"]` ([n] bool).

        Args:
            seed: one for each environment, or s, which gives environment i the seed s + i, as Gymnasium's own do.
            options: as of `ArmPointNav.reset`; a number may be a sequence [n].
        """
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", self._all))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ValueError(f"reset_mask is an array of {self.num_envs} bools")
        if seed is None and not self._begun:
            super().reset(seed=None)
            seed = int(self.np_random.integers(2**62))
        elif isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        if isinstance(seed, int | np.integer):
            seeds: Sequence[int | None] = [int(seed) + index for index in range(self.num_envs)]
        else:
            seeds = [None] * self.num_envs if seed is None else seed
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds for {self.num_envs} environments")
        asked = []
        for index in range(self.num_envs):
            own = {name: int(np.broadcast_to(number, self.num_envs)[index]) for name, number in options.items()}
            asked.append(choice_of(own, seeds[index]) if mask[index] else None)
        facts = self.batch.reset(asked)
        self._begun = True
        return self._observations(), self._infos(facts)

    def step(
        self, actions: NDArray[np.integer[Any]]
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Takes an action in each environment; returns observations, rewards [n], terminated [n], truncated [n], infos.

        What happens after an episode's end is `autoreset_mode`. In `SameStep` the infos have `final_obs` ([n] objects,
        None but where an episode ended) and `final_info` (arrays [n], valid where `_final_info` is true).
        """
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        rewards, terminated, truncated, done, now, was_reset, last = self.batch.step(actions_of(actions, self.num_envs))
        if self._reward is not None:
            rewards = np.where(was_reset, 0.0, self._own_reward(done["reward_parts"]))
        infos = self._infos(now)
        if last:
            ended = np.logical_or(terminated, truncated)
            final = np.full(self.num_envs, None, dtype=object)
            for index, depth, goal, previous in last:
                if self._views["depth"].dtype == np.float32:
                    depth = depth.astype(np.float32) / np.float32(1000.0)
                final[index] = {"depth": depth, "goal": goal, "previous_action": np.int64(previous)}
            infos.update(final_obs=final, _final_obs=ended, final_info=_masked(done, ended), _final_info=ended)
        return self._observations(), rewards, terminated, truncated, infos

    def render(self) -> tuple[NDArray[Any], ...] | None:
        """A picture of each environment, as `ArmPointNav.render` describes it."""
        if self.render_mode == "rgb_array":
            return tuple(self.batch.picture(index, self._render_side) for index in range(self.num_envs))
        if self.render_mode == "depth_array":
            depth = self.batch.depth
            return tuple(depth.copy() if depth.dtype == np.float32 else depth.astype(np.float32) / np.float32(1000.0))
        return None

    def state(self, index: int) -> State:
        """The privileged state of environment `index`."""
        return self.batch.state(index)

    def displacement_m(self, index: int) -> dict[str, float]:
        """Each object of environment `index` that is not where it stood, and how far from there, metres."""
        return moved(self.kitchens[index].objects, self.batch.displacements_m(index))

    def snapshot(self, index: int) -> Snapshot:
        """The moment of environment `index`, as of `ArmPointNav.snapshot`."""
        return self.batch.snapshot(index)

    def restore(self, index: int, snapshot: Snapshot) -> tuple[Observation, dict[str, Any]]:
        """Returns environment `index` to a moment of its kitchen; returns the observations and infos of all."""
        facts = self.batch.restore(index, snapshot)
        self._begun = True
        return self._observations(), self._infos(facts)

    def _own_reward(self, parts: RewardParts) -> NDArray[np.float64]:
        assert self._reward is not None
        rewards = self._reward(parts)
        array = np.full(0, 0.0) if rewards is None else np.asarray(rewards, np.float64)
        if array.shape not in ((), (self.num_envs,)):
            what = "None" if rewards is None else f"an array of shape {array.shape}"
            raise ValueError(
                f"the reward function returned {what}, not one number for each of {self.num_envs} environments"
            )
        return array

    def _observations(self) -> Observation:
        if self.copy:
            return {name: array.copy() for name, array in self._views.items()}  # type: ignore[return-value]
        return dict(self._views)  # type: ignore[return-value]

    def _infos(self, facts: dict[str, Any]) -> dict[str, Any]:
        return _masked(facts, self._all.copy())


def _masked(facts: dict[str, Any], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """The facts, each with the mask of the environments that it is about, as Gymnasium's infos have them."""
    infos = dict(facts)
    infos.update({f"_{name}": mask for name in facts})
    return infos


def _kitchens(
    kitchens: int | str | Kitchen | Sequence[int | Kitchen],
    scenes: str | PathLike[str] | Sequence[str | PathLike[str]] | None,
    num_envs: int,
) -> tuple[list[Kitchen], int]:
    """The kitchens that so many environments are in, and how many are in the list: what is not used is not built."""
    if scenes is not None:
        if not (isinstance(kitchens, str) and kitchens == "train"):
            raise ValueError("give either kitchens or scenes")
        paths = [scenes] if isinstance(scenes, str | PathLike) else list(scenes)
        rooms = [Kitchen(scene=scene, scene_index=index) for index, scene in enumerate(paths[:num_envs])]
        count = len(paths)
    else:
        if isinstance(kitchens, str):
            chosen: list[int | Kitchen] = list(kitchens_of(kitchens))
        elif isinstance(kitchens, int | np.integer | Kitchen):
            chosen = [kitchens]
        else:
            chosen = list(kitchens)
        rooms = [kitchen_of(kitchen) for kitchen in chosen[:num_envs]]
        count = len(chosen)
    if not rooms:
        raise ValueError("give at least one kitchen or scene")
    return rooms, count
