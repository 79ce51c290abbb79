"""A kitchen in MuJoCo, driven by a recorded episode."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from .export import Body, Episode, Export, Floats, Kitchen, camera_axes

#: The rate at which spin dies out in our engine, 1/s.
ANGULAR_DAMPING = 1.0
#: What a thing's geoms touch: everything; and all but the robot, while the robot holds it.
TOUCHES_ALL, TOUCHES_NOT_THE_ROBOT = 3, 1


@dataclass(frozen=True)
class Settings:
    """The options of MuJoCo's that speed depends on; names are MuJoCo's."""

    solver: str = "NEWTON"
    cone: str = "PYRAMIDAL"
    integrator: str = "EULER"
    iterations: int = 100
    sleep: bool = True
    sleep_tolerance: float = 1e-3

    def __str__(self) -> str:
        sleep = f"sleep below {self.sleep_tolerance:g}" if self.sleep else "no sleep"
        return (
            f"{self.solver}, {self.cone.lower()} cone, {self.integrator.lower()}, {self.iterations} iterations, {sleep}"
        )


class Scene:
    """Model and state of a kitchen."""

    def __init__(self, export: Export, kitchen: Kitchen, settings: Settings) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(kitchen.mjcf))
        self._apply(settings)
        self.data = mujoco.MjData(self.model)
        self.kitchen = kitchen
        self.movables = [self.model.body(body.name).id for body in kitchen.movables]
        self.links = [body for body in kitchen.bodies if body.role == "robot"]
        self.robot = [self._mocap(name) for name in [export.robot_body, *(body.name for body in self.links)]]
        for body in self.movables:
            self._damp_spin(body)

    def _apply(self, settings: Settings) -> None:
        option = self.model.opt
        option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{settings.solver}")
        option.cone = getattr(mujoco.mjtCone, f"mjCONE_{settings.cone}")
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{settings.integrator}")
        option.iterations = settings.iterations
        option.sleep_tolerance = settings.sleep_tolerance
        if settings.sleep:
            option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP

    def _mocap(self, name: str) -> int:
        return int(self.model.body(name).mocapid[0])

    def _address(self, body: int) -> int:
        return int(self.model.jnt_qposadr[self.model.body_jntadr[body]])

    def _damp_spin(self, body: int) -> None:
        """A torque against spin that slows it at the rate of our engine: damping is that rate times inertia."""
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, self.model.body_iquat[body])
        turn = matrix.reshape(3, 3)
        inertia = np.diag(turn @ np.diag(self.model.body_inertia[body]) @ turn.T)
        first = self.model.jnt_dofadr[self.model.body_jntadr[body]]
        self.model.dof_damping[first + 3 : first + 6] = ANGULAR_DAMPING * inertia

    def mass_error(self) -> float:
        """Largest relative difference between a thing's mass here and in our engine."""
        masses = [
            (self.model.body_mass[body], ours.mass_kg)
            for body, ours in zip(self.movables, self.kitchen.movables, strict=True)
        ]
        return max(abs(mass / ours - 1.0) for mass, ours in masses)

    def place(self, body: int, pose: Floats) -> None:
        """Puts a movable thing there."""
        first = self._address(body)
        self.data.qpos[first : first + 3] = pose[:3]
        self.data.qpos[first + 3 : first + 7] = pose[[6, 3, 4, 5]]

    def start(self, episode: Episode) -> None:
        """The episode's start: things where they stand, the robot at the beginning of its way."""
        mujoco.mj_resetData(self.model, self.data)
        for body, pose in zip(self.movables, episode.start, strict=True):
            self.place(body, pose)
        self.data.mocap_pos[self.robot] = episode.robot[0, :, :3]
        self.data.mocap_quat[self.robot] = episode.robot[0][:, [6, 3, 4, 5]]
        mujoco.mj_forward(self.model, self.data)

    def positions(self) -> npt.NDArray[np.float64]:
        """[thing, xyz]."""
        return self.data.xpos[self.movables].copy()

    def rest(self, substeps: int) -> None:
        """Lets time pass."""
        for _ in range(substeps):
            mujoco.mj_step(self.model, self.data)

    def show(self, kitchen_bodies: list[Body], poses: Floats) -> None:
        """Poses everything for a picture."""
        for ours, pose in zip(kitchen_bodies, poses, strict=True):
            if ours.role == "movable":
                self.place(self.model.body(ours.name).id, pose)
            elif ours.role == "robot":
                mocap = self._mocap(ours.name)
                self.data.mocap_pos[mocap] = pose[:3]
                self.data.mocap_quat[mocap] = pose[[6, 3, 4, 5]]
        mujoco.mj_kinematics(self.model, self.data)

    def aim(self, pose: Floats) -> None:
        """Puts the camera there. MuJoCo's looks along −z, and its axes are right-handed: its picture is mirrored."""
        origin, (right, up, ahead) = camera_axes(pose)
        self.data.cam_xpos[0] = origin
        self.data.cam_xmat[0] = np.stack([-right, up, -ahead], axis=1).ravel()


class Replay:
    """A recorded episode, step by step, with as little Python on the way as possible."""

    def __init__(self, scene: Scene, episode: Episode) -> None:
        self.scene = scene
        order = np.argsort(scene.robot)
        robot = episode.robot[:, order].astype(np.float64)
        self.positions = np.ascontiguousarray(robot[:, :, :3])
        self.rotations = np.ascontiguousarray(robot[:, :, [6, 3, 4, 5]])
        self.held_index = episode.held_index.tolist()
        self.held = episode.held
        self.bounds = [0, *episode.substeps_until.tolist()]
        self.holding = -1

    def step(self, action: int) -> None:
        """The sub-steps of one action."""
        model, data = self.scene.model, self.scene.data
        for substep in range(self.bounds[action], self.bounds[action + 1]):
            data.mocap_pos[:] = self.positions[substep]
            data.mocap_quat[:] = self.rotations[substep]
            if self.held_index[substep] >= 0:
                self._carry(substep)
            mujoco.mj_step(model, data)

    def finish(self) -> None:
        """Lets go, so that the scene can be used again."""
        if self.holding >= 0:
            self._touch(self.holding, TOUCHES_ALL)
            self.holding = -1

    def _carry(self, substep: int) -> None:
        """What is held goes where the hand goes, and does not collide with the robot."""
        body = self.scene.movables[self.held_index[substep]]
        if self.holding != body:
            self.finish()
            self._touch(body, TOUCHES_NOT_THE_ROBOT)
            self.holding = body
        self.scene.place(body, self.held[substep])
        first = self.scene.model.body_dofadr[body]
        self.scene.data.qvel[first : first + 6] = 0.0

    def _touch(self, body: int, mask: int) -> None:
        model = self.scene.model
        first = model.body_geomadr[body]
        model.geom_conaffinity[first : first + model.body_geomnum[body]] = mask
        model.body_conaffinity[body] = mask
