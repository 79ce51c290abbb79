"""Embree 4 as a depth camera: coherent rays in packets of sixteen, through a few lines of C.

Two figures. A frame from new poses, as our camera draws it: every body that can move is an instance, the tree above the
instances is rebuilt, rays are cast. And rays alone, in one scene of all triangles that was built beforehand: what is
left when nothing moves and nothing is counted but rays.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .agreement import Agreement
from .export import Episode, Export, Floats, Kitchen, camera_axes, rotations
from .measure import Answer, Result, main, shortest_s

LIBRARY = Path(os.environ.get("PEERS_EMBREE", ""))


@dataclass(frozen=True)
class Picture:
    """What the rays through all pixels hit."""

    depth_mm: npt.NDArray[np.uint16]
    depth_m: Floats
    triangle: npt.NDArray[np.uint32]
    from_behind: npt.NDArray[np.uint8]


class Embree:
    """Embree's library with one device of one thread."""

    def __init__(self, export: Export, library: Path = LIBRARY) -> None:
        self.library = ctypes.CDLL(str(library))
        self.library.peers_device.restype = ctypes.c_void_p
        self.library.peers_scene.restype = ctypes.c_void_p
        self.device = ctypes.c_void_p(self.library.peers_device())
        self.export = export

    def scene(self, triangles: Floats, robust: bool) -> ctypes.c_void_p:
        """A scene of [triangle, corner, xyz]; robust ones leave no cracks between triangles and are slower."""
        triangles = np.ascontiguousarray(triangles, dtype=np.float32)
        scene = self.library.peers_scene(self.device, pointer(triangles), len(triangles), int(robust))
        if not scene:
            raise RuntimeError("Embree could not build the scene")
        return ctypes.c_void_p(scene)

    def moving_scene(self, kitchen: Kitchen) -> MovingScene:
        """A scene of a kitchen whose bodies can be moved."""
        fixed = [index for index, body in enumerate(kitchen.bodies) if body.role == "static"]
        moving = [index for index, body in enumerate(kitchen.bodies) if body.role != "static"]
        return MovingScene(self, kitchen, fixed, moving)

    def release(self, scene: ctypes.c_void_p) -> None:
        """Frees a scene."""
        self.library.peers_release(scene)

    def cast(self, scene: ctypes.c_void_p, origin: Floats, axes: Floats, picture: Picture, all_of_it: bool) -> None:
        """Fills a picture; only its `depth_mm` unless all of it is asked for."""
        optional = (picture.depth_m, picture.triangle, picture.from_behind)
        self.library.peers_depth(
            scene,
            pointer(origin),
            pointer(axes),
            ctypes.c_float(self.export.tan_half_field_of_view),
            ctypes.c_float(self.export.near_m),
            self.export.frame_side,
            pointer(picture.depth_mm),
            *(pointer(array) if all_of_it else None for array in optional),
        )

    def picture(self) -> Picture:
        """An empty picture."""
        shape = (self.export.frame_side,) * 2
        return Picture(*(np.zeros(shape, kind) for kind in (np.uint16, np.float32, np.uint32, np.uint8)))


class MovingScene:
    """A kitchen as one instance of all that is fixed, and one of each body that can move."""

    def __init__(self, embree: Embree, kitchen: Kitchen, fixed: list[int], moving: list[int]) -> None:
        self.embree = embree
        self.kitchen = kitchen
        self.fixed = fixed
        self.moving = moving
        self.below: list[ctypes.c_void_p] = []
        self.scene = ctypes.c_void_p()

    def build(self, world_from_bodies: Floats) -> None:
        """Builds it; what is fixed stands at these poses from now on."""
        library = self.embree.library
        of_body = self.kitchen.triangle_body
        self.below = [self.embree.scene(self.kitchen.triangles[of_body == body], robust=False) for body in self.moving]
        fixed = self.kitchen.world_triangles(world_from_bodies)[np.isin(of_body, self.fixed)]
        handles = (ctypes.c_void_p * len(self.below))(*(scene.value for scene in self.below))
        library.peers_moving_scene.restype = ctypes.c_void_p
        self.scene = ctypes.c_void_p(
            library.peers_moving_scene(self.embree.device, pointer(fixed), len(fixed), handles, len(self.below))
        )
        if not self.scene:
            raise RuntimeError("Embree could not build the scene of instances")

    def rows(self, world_from_bodies: Floats) -> Floats:
        """[moving body, row, column]: the poses as Embree takes them."""
        poses = world_from_bodies[self.moving].astype(np.float64)
        rows = np.concatenate([rotations(poses[:, 3:]), poses[:, :3, None]], axis=2)
        return np.ascontiguousarray(rows, dtype=np.float32)

    def frame(self, rows: Floats, origin: Floats, axes: Floats, picture: Picture) -> None:
        """One frame from new poses."""
        self.embree.library.peers_move(self.scene, pointer(rows), len(self.moving))
        self.embree.cast(self.scene, origin, axes, picture, False)

    def release(self) -> None:
        """Frees everything."""
        for scene in (self.scene, *self.below):
            self.embree.release(scene)


def pointer(array: npt.NDArray) -> ctypes.c_void_p:
    """The address of an array's first element."""
    return ctypes.c_void_p(array.ctypes.data)


def compare(embree: Embree, kitchen: Kitchen, episode: Episode) -> dict[str, float]:
    """How far our frames are from Embree's."""
    agreement = Agreement()
    picture = embree.picture()
    for bodies, camera, depth_mm in frames(episode):
        scene = embree.scene(kitchen.world_triangles(bodies), robust=True)
        embree.cast(scene, *camera_axes(camera), picture, True)
        embree.release(scene)
        missed = picture.triangle == np.iinfo(np.uint32).max
        part = np.where(missed, -1, kitchen.triangle_part[np.where(missed, 0, picture.triangle)])
        agreement.add(depth_mm, picture.depth_m, part, picture.from_behind.astype(bool))
    return agreement.figures()


def time_frames(embree: Embree, kitchen: Kitchen, episode: Episode) -> tuple[float, float]:
    """Processor time of a frame from new poses, and of a frame's rays alone, seconds; mean over the episode."""
    moving = embree.moving_scene(kitchen)
    moving.build(episode.frame_bodies[0])
    whole, rays = [], []
    picture, other = embree.picture(), embree.picture()
    for bodies, camera, _ in frames(episode):
        origin, axes = camera_axes(camera)
        whole.append(shortest_s(partial(moving.frame, moving.rows(bodies), origin, axes, picture)))
        scene = embree.scene(kitchen.world_triangles(bodies), robust=False)
        rays.append(shortest_s(partial(embree.cast, scene, origin, axes, other, False)))
        embree.release(scene)
        if np.median(np.abs(picture.depth_mm.astype(float) - other.depth_mm)) > 1.0:
            raise RuntimeError("Embree's scene of instances shows something else than its scene of triangles")
    moving.release()
    return float(np.mean(whole)), float(np.mean(rays))


def frames(episode: Episode) -> Iterator[tuple[Floats, Floats, npt.NDArray[np.uint16]]]:
    """Poses of the bodies, pose of the camera, our image."""
    return zip(episode.frame_bodies, episode.frame_camera, episode.frame_depth_mm, strict=True)


def measure(export: Export) -> list[Answer]:
    """All kitchens under all policies."""
    embree = Embree(export)
    whole: dict[str, dict[str, Result]] = {policy: {} for policy in export.policies}
    rays: dict[str, dict[str, Result]] = {policy: {} for policy in export.policies}
    for policy in export.policies:
        for kitchen in export.kitchens:
            episode = kitchen.episode(policy)
            whole_s, rays_s = time_frames(embree, kitchen, episode)
            checks = compare(embree, kitchen, episode)
            whole[policy][str(kitchen.number)] = {"depth_s": whole_s, "checks": checks}
            rays[policy][str(kitchen.number)] = {"rays_s": rays_s}
    name = f"Embree {version('embreex').split('.post')[0]}"
    return [
        {"peer": f"{name}, packets of 16 rays", "results": whole, "notes": []},
        {"peer": f"{name}, nothing moves", "results": rays, "notes": []},
    ]


if __name__ == "__main__":
    main(measure)
