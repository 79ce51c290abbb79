"""One environment: `gymnasium.make("stillroom/ArmPointNav-v0", kitchen=7)`."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from stillroom._stillroom import Kitchen, Snapshot, shown, whole
from stillroom.simulated import Simulated, task_of
from stillroom.spaces import (
    NUMBER_MAX,
    RENDER_MODES,
    Parts,
    choice_of,
    kitchen_of,
    observation_space,
    options_of,
    pictures_of,
)
from stillroom.types import Observation, RewardParts, State


class KitchenEnv(Simulated, gymnasium.Env):
    """A robot has a task in a kitchen, and should move nothing else: in `arm_point_nav` it fetches an object and brings
    it to its goal, in `point_nav` it drives to a point of the room.

    Observations are dictionaries (`stillroom.types.Observation`), actions are `Discrete`: 21 of `arm_point_nav`, 13
    with `action_space="small"`, 4 of `point_nav`; `action_names` has their names. An episode is terminated by the
    action Done or Stop, and truncated after `max_steps` actions.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": 5}

    def __init__(
        self,
        kitchen: int | Kitchen | None = None,
        *,
        scene: str | PathLike[str] | None = None,
        number: int = 0,
        task: str | None = None,
        preset: str = "paper",
        reward: str | Callable[[RewardParts], float] = "r",
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
        """Makes the environment; the kitchen is built (a second or two) unless another environment is in it.

        Args:
            kitchen: number of a built-in kitchen (`stillroom.kitchens("train")`), or a `stillroom.Kitchen`; 1
                without one.
            scene: TOML file of a scene of your own, instead of a kitchen.
            number: which environment of its kitchen this is; environments with other numbers sample other episodes.
            task: one of `stillroom.tasks()`; the preset's without one.
            preset: preset whose settings these are (`stillroom config` lists them); the following override it.
            reward: "r" (the task), "r_prime" (minus `disturbance_weight` for each metre of displacement), or a function
                of the reward's parts.
            disturbance_weight: reward of one metre less displacement in "r_prime", and for it only; 15 in the paper.
            action_space: "large" (21 actions) or "small" (13: no elbow, wrist rotation or camera).
            max_steps: actions after which an episode is truncated; 200 in the paper.
            start_distance_max_m: the robot starts at most this far from the target, metres; 0 is anywhere.
            goal_distance_max_m: the goal is at most this far from the target's start, metres; 0 is anywhere.
            carried_goal: what the goal vector is while the target is held: "goal_to_object" (the paper) or
                "object_to_goal" (presets `demo`, `short-...`, `recipe...`, `procedural-...`). A policy wants the sign
                that it was trained with.
            depth: "uint16" for millimetres, "float32" for metres.
            frame_side: width and height of the depth frame, pixels. The camera and its 100 degrees stay the same.
            render_mode: "rgb_array" or "depth_array".
            render_side: height of each of the two views in an "rgb_array", pixels.
        """
        if scene is not None and kitchen is not None:
            raise ValueError("give either a kitchen or a scene")
        self.render_mode, self._render_side = pictures_of(render_mode, render_side)
        room = kitchen_of(1 if kitchen is None else kitchen) if scene is None else Kitchen(scene=scene)
        self._make([room], [whole("number", number, NUMBER_MAX)], "Disabled", 1, task_of(locals()))
        self._objects = room.objects
        self._ended = False
        self.observation_space = observation_space(self._views, self._settings.bounds, len(self.action_names))
        self.action_space = gymnasium.spaces.Discrete(len(self.action_names))

    @property
    def kitchen(self) -> Kitchen:
        """The kitchen."""
        self.batch  # noqa: B018  # refuses a closed environment
        return self._made[0][0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode: the next one, episode 0 of a new seed, or the one that `options` names (`choice_of`).

        The same seed, kitchen, number and episode begin the same, on every machine, as in training with this seed.
        """
        batch = self.batch
        series, seed, episode = choice_of(options_of(options), seed)
        own = int(self.np_random.integers(2**63)) if seed is None and not self._begun[0] else seed
        facts = batch.reset([(series, own, episode)])
        # Only what begins changes anything.
        super().reset(seed=seed)
        self._begun[0], self._ended = True, False
        return self._observation(), self._info(facts)

    def step(self, action: int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Takes an action; returns observation, reward, terminated, truncated and `stillroom.types.Info`."""
        self._playing()
        if self._ended:
            raise gymnasium.error.ResetNeeded("call reset() first: the episode has ended")
        number = whole("action", action, len(self.action_names) - 1)
        rewards, terminated, truncated, facts, _, _, _ = self._act(np.array([number], np.int64))
        # Before the reward: a function of the user may raise.
        self._ended = bool(terminated[0] or truncated[0])
        info = self._info(facts)
        reward = rewards[0] if self._reward is None else self._reward(Parts(info["reward_parts"]))
        try:
            reward = float(reward)
        except (ArithmeticError, TypeError, ValueError):
            raise ValueError(f"the reward function returned {shown(reward)}, not a number") from None
        return self._observation(), reward, bool(terminated[0]), bool(truncated[0]), info

    def render(self) -> NDArray[Any] | None:
        """The moment as a picture. "rgb_array": [rows, columns, 3] uint8, the robot's depth view and the room from
        outside, target and goal marked, captions. "depth_array": [side, side] float32, metres, 0 where nothing is."""
        batch = self._playing()
        if self.render_mode == "rgb_array":
            return batch.picture(0, self._render_side)
        if self.render_mode == "depth_array":
            depth = self._views["depth"][0]
            return depth.copy() if depth.dtype == np.float32 else depth.astype(np.float32) / np.float32(1000.0)
        return None

    def state(self) -> State:
        """The privileged state: poses of everything."""
        return self._playing().state(0)

    def displacement_m(self) -> dict[str, float]:
        """Each object that is not where it stood at the episode's start, and how far from there, metres."""
        return moved(self._objects, self._playing().displacements_m(0))

    def snapshot(self) -> Snapshot:
        """The moment, to return to it with `restore`: an exact copy. It can be pickled: it then holds the episode's
        actions, and reading it simulates them again, to the same bits."""
        return self._playing().snapshot(0)

    def restore(self, snapshot: Snapshot) -> tuple[Observation, dict[str, Any]]:
        """Returns to a moment of the same kitchen; returns observation and info as `reset` does."""
        facts = self._restore(0, snapshot)
        info = self._info(facts)
        self._ended = self.batch.ended(0)
        return self._observation(), info

    def close(self) -> None:
        """Frees the simulation. Whatever is asked of it afterwards raises `gymnasium.error.ClosedEnvironmentError`."""
        super().close()
        self._free()

    def _act(self, actions: NDArray[np.int64]) -> tuple[Any, ...]:
        return self.batch.step(actions)

    def _observation(self) -> Observation:
        # A number is no array of numpy.
        return {name: view[0].copy() if view.ndim > 1 else view[0] for name, view in self._views.items()}

    def _info(self, facts: dict[str, Any]) -> dict[str, Any]:
        parts = {name: float(part[0]) for name, part in facts.pop("reward_parts").items()}
        info = {name: fact[0].item() for name, fact in facts.items()}
        # Of Python's own ints Gymnasium's AsyncVectorEnv makes signed 64-bit numbers; half of all hashes are larger.
        info["state_hash"] = facts["state_hash"][0]
        for name, meanings in self._settings.meanings.items():
            info[name] = meanings[info[name]]
        info["displacement_m"] = self.displacement_m()
        info["reward_parts"] = parts
        return info


ArmPointNav = KitchenEnv
"""The older name of `KitchenEnv`; the task is `arm_point_nav` unless `task` or `preset` says otherwise."""


def moved(objects: list[str], displacements_m: NDArray[np.float32]) -> dict[str, float]:
    """The objects that are not where they stood."""
    return {objects[index]: float(displacements_m[index]) for index in np.flatnonzero(displacements_m)}
