"""What environments return, with shapes and units. `n` is the number of environments of a `VectorEnv`.

What depends on the task follows from its declaration: `stillroom.channels("arm_point_nav")` lists every channel with
its role, type, shape, unit, and what it is.
"""

from __future__ import annotations

from typing import Any, TypeAlias

Observation: TypeAlias = dict[str, Any]
"""What the robot sees and knows. A `VectorEnv` has one more axis, `n`, in front.

* `depth`: [side, side], row-major from the top left: depth along the camera's axis, 0 where nothing is seen.
  Millimetres (uint16), or metres (float32) with `depth="float32"`.
* The task's channels with the role `observation`, named without their unit: `goal`, float32 [3], metres. While
  ArmPointNav's target is held it lies between target and goal, with the sign that the preset's `network.carried_goal`
  says.
* `previous_action`: number of the action that led here, or the number of actions at an episode's start.
"""

RewardParts: TypeAlias = dict[str, Any]
"""Parts of a step's reward before any weighting: the task's channels with the role `part`, floats. A `VectorEnv` has
arrays [n] of float32."""

Info: TypeAlias = dict[str, Any]
"""What is told beside the observation. A `VectorEnv` has arrays [n], the number of a name (of `target` the index in
`stillroom.TARGETS`), and no `displacement_m` (ask `VectorEnv.displacement_m(index)`).

* `state_hash`: uint64, equal for equal states. The same seed, episode and actions give the same hashes as in training.
* `episode_number`. (`episode` is the key of Gymnasium's and Stable-Baselines3's statistics.)
* `step`: actions taken in the episode.
* `displacement_m`: each object that is not where it stood at the episode's start, and how far from there, metres.
* `reward_parts`: what the reward is made of.
* The task's channels with the role `outcome`, and its metrics that are true or false of a step (`success`,
  `success_without_disturbance`, `picked_up`). `action_failed` is the part `failed_action` as a bool.
"""

State: TypeAlias = dict[str, Any]
"""The privileged state. Positions are [3] in the world (y up), metres; the base's is [2], (x, z). Rotations are unit
quaternions (x, y, z, w). `k` is the number of movable objects, in the order of `Kitchen.objects`.

* `kitchen`, `seed`, `episode`, `step`, `state_hash`
* The task's channels with the role `state` or `privileged`, such as `base_position_m`, `goal_position_m`, `holding`.
* `target_object`: index of the target among the objects, where the task has one.
* `arm_ticks`: int32 [7]: height, wrist x, y, z, elbow, wrist yaw, wrist pitch, each in steps of its action.
* `camera_position_m`, `camera_rotation_xyzw` [4]; the camera looks along its z axis.
* `object_positions_m` [k, 3], `object_rotations_xyzw` [k, 4]
* `object_displacements_m` [k]: distance from where it stood at the episode's start; 0 for the target.
"""
