"""The folder that `actor export-peers` writes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Body:
    """One body of a kitchen."""

    name: str
    role: str
    mass_kg: float | None
    first_triangle: int
    part_triangles: list[int]

    @property
    def triangle_count(self) -> int:
        """Triangles of all its convex parts."""
        return sum(self.part_triangles)


@dataclass(frozen=True)
class Episode:
    """One episode under a policy. Poses are x, y, z, then the quaternion x, y, z, w."""

    folder: Path

    def _array(self, name: str) -> npt.NDArray:
        return np.load(self.folder / f"{name}.npy")

    @cached_property
    def start(self) -> Floats:
        """[thing, pose]: movable things at the start."""
        return self._array("start")

    @cached_property
    def end(self) -> Floats:
        """[thing, pose]: movable things at the end."""
        return self._array("end")

    @cached_property
    def robot(self) -> Floats:
        """[sub-step, part, pose]: the robot's body, then its links."""
        return self._array("robot")

    @cached_property
    def held_index(self) -> npt.NDArray[np.int32]:
        """[sub-step]: the movable thing on the magnet, or -1."""
        return self._array("held_index")

    @cached_property
    def held(self) -> Floats:
        """[sub-step, pose]: where that goes."""
        return self._array("held")

    @cached_property
    def substeps_until(self) -> npt.NDArray[np.uint32]:
        """[action]: sub-steps taken when it was over."""
        return self._array("substeps_until")

    @cached_property
    def camera(self) -> Floats:
        """[action, pose]: the camera after it."""
        return self._array("camera")

    @cached_property
    def frame_bodies(self) -> Floats:
        """[frame, body, pose]: what was drawn."""
        return self._array("frame_bodies")

    @cached_property
    def frame_camera(self) -> Floats:
        """[frame, pose]: from where."""
        return self._array("frame_camera")

    @cached_property
    def frame_depth_mm(self) -> npt.NDArray[np.uint16]:
        """[frame, row, column]: and what came out of our camera; 0 where nothing is seen."""
        return self._array("frame_depth_mm")


@dataclass(frozen=True)
class Kitchen:
    """One kitchen."""

    number: int
    folder: Path
    bodies: list[Body]

    @cached_property
    def triangles(self) -> Floats:
        """[triangle, corner, xyz]: finest meshes, each in its body's frame."""
        return np.load(self.folder / "triangles.npy")

    @cached_property
    def triangle_body(self) -> npt.NDArray[np.int64]:
        """[triangle]: number of its body."""
        return np.repeat(np.arange(len(self.bodies)), [body.triangle_count for body in self.bodies])

    @cached_property
    def triangle_part(self) -> npt.NDArray[np.int64]:
        """[triangle]: number of its convex part among all of the kitchen."""
        counts = [count for body in self.bodies for count in body.part_triangles]
        return np.repeat(np.arange(len(counts)), counts)

    @property
    def movables(self) -> list[Body]:
        """Movable things, in the order of an episode's `start`."""
        return [body for body in self.bodies if body.role == "movable"]

    @property
    def mjcf(self) -> Path:
        """The kitchen as MJCF."""
        return self.folder / "kitchen.xml"

    def episode(self, policy: str) -> Episode:
        """The episode under this policy."""
        return Episode(self.folder / policy)

    def world_triangles(self, world_from_bodies: Floats) -> Floats:
        """[triangle, corner, xyz] in the world, bodies standing at these poses."""
        return world_triangles(self.triangles, self.triangle_body, world_from_bodies)


@dataclass(frozen=True)
class Export:
    """All of the folder."""

    timestep_s: float
    substeps: int
    frame_side: int
    tan_half_field_of_view: float
    near_m: float
    robot_body: str
    policies: list[str]
    kitchens: list[Kitchen]

    @staticmethod
    def load(folder: Path) -> Export:
        """Reads the index; arrays follow when they are asked for."""
        index = json.loads((folder / "index.json").read_text())
        kitchens = [
            Kitchen(
                kitchen["number"],
                folder / kitchen["folder"],
                [Body(**body) for body in kitchen["bodies"]],
            )
            for kitchen in index.pop("kitchens")
        ]
        return Export(**index, kitchens=kitchens)


def rotations(quaternions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """[n, 3, 3] rotation matrices of [n, xyzw] unit quaternions."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def world_triangles(triangles: Floats, triangle_body: npt.NDArray[np.integer], world_from_bodies: Floats) -> Floats:
    """[triangle, corner, xyz] in the world, bodies standing at these poses."""
    pose = world_from_bodies[triangle_body].astype(np.float64)
    turned = np.einsum("tij,tcj->tci", rotations(pose[:, 3:]), triangles.astype(np.float64))
    return (turned + pose[:, None, :3]).astype(np.float32)


def camera_axes(pose: Floats) -> tuple[Floats, Floats]:
    """A camera's position, and its right, up and ahead as rows."""
    axes = rotations(pose[None, 3:].astype(np.float64))[0].T
    return pose[:3].astype(np.float32), np.ascontiguousarray(axes, dtype=np.float32)
