"""What environments return, with shapes and units. `n` is the number of environments of a `VectorEnv`."""

from __future__ import annotations

from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray


class Observation(TypedDict):
    """What the robot sees and knows. A `VectorEnv` has one more axis, `n`, in front."""

    depth: NDArray[Any]
    """[side, side], row-major from the top left: depth along the camera's axis, 0 where nothing is seen. Millimetres
    (uint16), or metres (float32) with `depth="float32"`."""
    goal: NDArray[np.float32]
    """[3], metres, in the robot's frame (x right, y up, z ahead): from wrist to target; while the target is held
    between target and goal, with the sign that the preset's `network.carried_goal` says (from goal to target)."""
    previous_action: int | np.int64
    """Number of the action that led here, or the number of actions at an episode's start."""


class RewardParts(TypedDict):
    """Parts of a step's reward before any weighting. A `VectorEnv` has arrays [n] of float32."""

    wrist_object_progress_m: float
    """Previous minus current distance of wrist and target, metres; 0 in an episode's first step."""
    object_goal_progress_m: float
    """Previous minus current distance of target and goal, metres; 0 in an episode's first step."""
    disturbance_progress_m: float
    """Previous minus current displacement of all objects but the target, metres: negative if more was disturbed."""
    failed_action: float
    """1 if the action failed, else 0."""
    picked_up: float
    """1 if this step picked the target up, else 0."""
    goal_success: float
    """1 if this step was a successful Done, else 0."""


class Info(TypedDict):
    """What is told beside the observation. A `VectorEnv` has arrays [n], for `target` the index in
    `stillroom.TARGETS`, and no `displacement_m` (ask `VectorEnv.displacement_m(index)`)."""

    state_hash: np.uint64
    """64 bits: equal for equal states. The same seed, episode and actions give the same hashes as in training."""
    episode_number: int
    """Number of the episode. (`episode` is the key of Gymnasium's and Stable-Baselines3's statistics.)"""
    step: int
    """Actions taken in the episode."""
    target: str
    """Category of the target."""
    success: bool
    """This step was a Done with the target at its goal."""
    success_without_disturbance: bool
    """The same, with a `disturbance_m` of less than 0.01."""
    picked_up: bool
    """This step picked the target up."""
    holding: bool
    """The target is held."""
    action_failed: bool
    """The action failed: blocked, out of reach, or a PickUp that holds nothing."""
    disturbance_m: float
    """Sum of the displacements of all objects but the target, metres."""
    peak_disturbance_m: float
    """The largest sum of this episode so far, metres."""
    farthest_m: float
    """Displacement of the object that is farthest from its place, metres."""
    peak_farthest_m: float
    """The largest displacement of any one object in this episode so far, metres."""
    disturbed_objects: int
    """Objects other than the target that are more than 0.01 m from their place on some axis."""
    ever_disturbed_objects: int
    """Objects that were so after some step of this episode."""
    wrist_object_m: float
    """Distance of wrist and target, metres."""
    object_goal_m: float
    """Distance of target and goal, metres."""
    displacement_m: dict[str, float]
    """Each object that is not where it stood at the episode's start, and how far from there, metres."""
    reward_parts: RewardParts
    """What the reward is made of."""


class State(TypedDict):
    """The privileged state. Positions are [3] in the world (y up), metres; the base's is [2], (x, z). Rotations are
    unit quaternions (x, y, z, w). `k` is the number of movable objects, in the order of `Kitchen.objects`."""

    kitchen: int
    seed: int
    episode: int
    step: int
    state_hash: int
    target: str
    target_object: int
    """Index of the target among the objects."""
    holding: bool
    base_position_m: NDArray[np.float32]
    base_yaw_rad: float
    """Positive to the right."""
    camera_pitch_rad: float
    """Positive downwards."""
    wrist_position_m: NDArray[np.float32]
    target_position_m: NDArray[np.float32]
    goal_position_m: NDArray[np.float32]
    wrist_to_object_m: NDArray[np.float32]
    """In the robot's frame."""
    object_to_goal_m: NDArray[np.float32]
    """In the robot's frame."""
    arm_ticks: NDArray[np.int32]
    """[7]: height, wrist x, y, z, elbow, wrist yaw, wrist pitch, each in steps of its action."""
    camera_position_m: NDArray[np.float32]
    camera_rotation_xyzw: NDArray[np.float32]
    """[4]; the camera looks along its z axis."""
    object_positions_m: NDArray[np.float32]
    """[k, 3]"""
    object_rotations_xyzw: NDArray[np.float32]
    """[k, 4]"""
    object_displacements_m: NDArray[np.float32]
    """[k]: distance from where it stood at the episode's start; 0 for the target."""
