"""The kitchens under MuJoCo's physics: `gymnasium.make("stillroom/ArmPointNavMuJoCo-v0", kitchen=7)`.

Episodes, the robot and what stops it at fixed things, the magnet, the camera, rewards and metrics are the module's. The
things that can be moved are MuJoCo's: after each action the module is told where they are.
"""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from stillroom._stillroom import JAM_DEPTH_M, JAM_GROWTH_M, SUBSTEPS, Kitchen, Snapshot
from stillroom.env import KitchenEnv
from stillroom.types import Observation

STEPS_IN_SUBSTEP = 4
"""Steps of MuJoCo's in a sub-step of ours: at 1/60 s its contacts are too soft to be pushed by a robot."""
SLEEP_TOLERANCE = 1e-2
"""MuJoCo lets sleep what is slower. Its default keeps a kitchen awake for long."""
SPIN_DAMPING_PER_S = 1.0
"""Spin dies out at this rate, as in rapier: it stands for rolling friction."""
ROBOT_KG = 1e4
"""Mass of each of the robot's parts: nothing in a kitchen stops it."""
SETTLE_SUBSTEPS = 240
"""In which everything comes to rest at an episode's start."""
TOUCHES_ALL, TOUCHES_NOT_THE_ROBOT = 3, 1
"""`conaffinity` of a thing, and of what the robot holds."""

Poses = NDArray[np.float64]


class Physics:
    """A kitchen's things in MuJoCo, and the robot that pushes them.

    The robot's parts are free bodies, as heavy as can be, that have the velocity of their way: MuJoCo's mocap bodies
    have none, and do not wake what sleeps. What is held is welded to the hand.
    """

    def __init__(self, kitchen: Kitchen) -> None:
        import mujoco

        if not hasattr(mujoco.mjtEnableBit, "mjENBL_SLEEP"):
            raise ImportError(f"MuJoCo {mujoco.__version__} lets nothing sleep: pip install 'mujoco>=3.9'")
        self._mujoco = mujoco
        spec = mujoco.MjSpec.from_string(kitchen.mjcf())
        parts = self._made_free(spec)
        weld = spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, active=False)
        weld.name1, weld.name2 = "Hand", kitchen.objects[0]
        spec.option.timestep /= STEPS_IN_SUBSTEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.sleep_tolerance = SLEEP_TOLERANCE
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        self.model = model = spec.compile()
        self.data = mujoco.MjData(model)
        self._robot = [self._freedoms(name) for name in parts]
        self._things = [self._freedoms(name) for name in kitchen.objects]
        self._bodies = [model.body(name).id for name in kitchen.objects]
        self._hand = model.body("Hand").id
        self._qpos = np.array([np.arange(qpos, qpos + 7) for qpos, _ in self._things])
        self._robot_qpos = np.array([np.arange(qpos, qpos + 7) for qpos, _ in self._robot])
        self._robot_qvel = np.array([np.arange(qvel, qvel + 6) for _, qvel in self._robot]).ravel()
        self._velocities = np.zeros(model.nv)
        things_qvel = np.array([np.arange(qvel, qvel + 6) for _, qvel in self._things])
        # Of the things alone: the solver's accuracy is relative to it.
        model.stat.meaninertia = model.dof_M0[things_qvel].mean()
        model.dof_damping[things_qvel[:, 3:]] = SPIN_DAMPING_PER_S * model.dof_M0[things_qvel[:, 3:]]
        model.eq_solref[0] = 2 * model.opt.timestep, 1
        self._held: int | None = None

    def _made_free(self, spec: Any) -> list[str]:
        """The names of the robot's parts, in the order of a way: the body, then the links."""
        parts = [body for body in spec.bodies if body.mocap]
        for body in parts:
            body.mocap = False
            body.gravcomp = 1
            body.add_freejoint()
            for geom in body.geoms:
                geom.mass = ROBOT_KG
        *links, body = [body.name for body in parts]
        return [body, *links]

    def _freedoms(self, name: str) -> tuple[int, int]:
        """Where the position and the velocity of a body begin."""
        joint = self.model.body_jntadr[self.model.body(name).id]
        return int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])

    def begin(self, poses: Poses, parts: Poses) -> None:
        """An episode's start: things and the robot's parts are here. The things come to rest."""
        if self._held is not None:
            self._touch(self._held, TOUCHES_ALL)
            self._held = None
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._qpos] = poses
        self.data.qpos[self._robot_qpos] = parts
        self.rest(SETTLE_SUBSTEPS)
        # Contacts give way otherwise than in rapier, by less than a millimetre: that is no displacement.
        self._given_way = self.data.qpos[self._qpos][:, :3] - poses[:, :3]

    def poses(self) -> Poses:
        """Where the things are."""
        poses = self.data.qpos[self._qpos]
        poses[:, :3] -= self._given_way
        return poses

    def hold(self, thing: int) -> None:
        """What the hand holds from now on."""
        if self._held is not None:
            return
        self._held, body, model, data = thing, self._bodies[thing], self.model, self.data
        self._touch(thing, TOUCHES_NOT_THE_ROBOT)
        hand, held = (data.qpos[start : start + 7] for start in (self._robot[-1][0], self._things[thing][0]))
        back_position, back_turn, position, turn = np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4)
        self._mujoco.mju_negPose(back_position, back_turn, hand[:3], hand[3:])
        self._mujoco.mju_mulPose(position, turn, back_position, back_turn, held[:3], held[3:])
        model.eq_obj2id[0] = body
        model.eq_data[0] = [0, 0, 0, *position, *turn, 1]
        data.eq_active[0] = 1

    def _touch(self, thing: int, mask: int) -> None:
        body = self._bodies[thing]
        first = self.model.body_geomadr[body]
        self.model.geom_conaffinity[first : first + self.model.body_geomnum[body]] = mask
        self.model.body_conaffinity[body] = mask

    def drive(self, way: Poses, arrives: bool) -> bool:
        """Takes the robot along a way; back again if it does not arrive, or if something jams. Whether it arrived."""
        at, least_m, jammed = 0, self._deepest_contact_m(), False
        while at + 1 < len(way) and not jammed:
            at += 1
            self._advance(way[at])
            depth_m = self._deepest_contact_m()
            jammed = depth_m > max(JAM_DEPTH_M, least_m + JAM_GROWTH_M)
            least_m = min(least_m, depth_m)
        used, arrived = at, arrives and not jammed
        if not arrived:
            for parts in way[:at][::-1]:
                self._advance(parts)
            used += at
        self.rest(SUBSTEPS - used)
        return arrived

    def rest(self, substeps: int) -> None:
        """Lets time pass while the robot stands still."""
        self.data.qvel[self._robot_qvel] = 0.0
        if substeps > 0:
            self._mujoco.mj_step(self.model, self.data, substeps * STEPS_IN_SUBSTEP)

    def _advance(self, parts: Poses) -> None:
        """A sub-step, in which the robot goes here."""
        model, data = self.model, self.data
        there = data.qpos.copy()
        there[self._robot_qpos] = parts
        substep_s = model.opt.timestep * STEPS_IN_SUBSTEP
        self._mujoco.mj_differentiatePos(model, self._velocities, substep_s, data.qpos, there)
        data.qvel[self._robot_qvel] = self._velocities[self._robot_qvel]
        self._mujoco.mj_step(model, data, STEPS_IN_SUBSTEP)
        data.qpos[self._robot_qpos] = parts

    def _deepest_contact_m(self) -> float:
        """How deeply something has entered another, of all that is awake."""
        return max(0.0, -float(self.data.contact.dist.min())) if self.data.ncon else 0.0


class MujocoKitchenEnv(KitchenEnv):
    """`KitchenEnv` of the task `arm_point_nav` with MuJoCo's physics: the same arguments, episodes and observations.

    `model` and `data` are MuJoCo's. The same seed and actions give the same bits with the same version of MuJoCo on the
    same kind of machine. There are no snapshots, copies or pickles.
    """

    def __init__(self, kitchen: int | Kitchen | None = None, **arguments: Any) -> None:
        super().__init__(kitchen, **arguments)
        if self._settings.task != "arm_point_nav":
            raise ValueError(f"task is {self._settings.task!r}: MuJoCo moves the things of arm_point_nav alone")
        self._physics = Physics(self.kitchen)
        self.model, self.data = self._physics.model, self._physics.data

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins the episode that `KitchenEnv` begins."""
        begun = super().reset(seed=seed, options=options)
        state = self.batch.state(0)
        x, y, z, w = state["object_rotations_xyzw"].T
        poses = np.column_stack([state["object_positions_m"], w, x, y, z]).astype(np.float64)
        # Every way begins where the robot is.
        way, _ = self.batch.way(np.array([0], np.int64))
        self._physics.begin(poses, way[0])
        self._target = int(state["target_object"])
        return begun

    def _act(self, actions: NDArray[np.int64]) -> tuple[Any, ...]:
        arrived = self._physics.drive(*self.batch.way(actions))
        told = self.batch.finish(actions, arrived, self._physics.poses())
        if told[3]["holding"][0]:
            self._physics.hold(self._target)
        return told

    def snapshot(self) -> NoReturn:
        """There is none."""
        raise TypeError("MuJoCo's physics has no snapshots: reset to the episode, and repeat its actions")

    def restore(self, snapshot: Snapshot) -> NoReturn:
        """There is nothing to restore."""
        self.snapshot()

    def __getstate__(self) -> NoReturn:
        self.snapshot()
