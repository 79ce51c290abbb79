"""Embree 4 as a depth camera: coherent rays in packets of sixteen, through a few lines of C.

The scene is built beforehand and its building is not counted, which favours Embree: only rays are.
"""

from __future__ import annotations

import ctypes
import os
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .agreement import Agreement
from .export import Episode, Export, Floats, Kitchen, camera_axes
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

    def __init__(self, export: Export) -> None:
        self.library = ctypes.CDLL(str(LIBRARY))
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


def pointer(array: npt.NDArray) -> ctypes.c_void_p:
    """The address of an array's first element."""
    return ctypes.c_void_p(array.ctypes.data)


def measure_kitchen(embree: Embree, kitchen: Kitchen, episode: Episode) -> Result:
    """Times every frame of the episode, and compares it with ours."""
    agreement = Agreement()
    times = []
    picture = embree.picture()
    for bodies, camera, depth_mm in zip(
        episode.frame_bodies, episode.frame_camera, episode.frame_depth_mm, strict=True
    ):
        triangles = kitchen.world_triangles(bodies)
        origin, axes = camera_axes(camera)
        scene = embree.scene(triangles, robust=False)
        times.append(shortest_s(partial(embree.cast, scene, origin, axes, picture, False)))
        embree.release(scene)
        scene = embree.scene(triangles, robust=True)
        embree.cast(scene, origin, axes, picture, True)
        embree.release(scene)
        missed = picture.triangle == np.iinfo(np.uint32).max
        part = np.where(missed, -1, kitchen.triangle_part[np.where(missed, 0, picture.triangle)])
        agreement.add(depth_mm, picture.depth_m, part, picture.from_behind.astype(bool))
    checks = agreement.figures()
    return {"depth_s": float(np.mean(times)), "checks": checks}


def measure(export: Export) -> Answer:
    """All kitchens under all policies."""
    embree = Embree(export)
    results = {
        policy: {
            str(kitchen.number): measure_kitchen(embree, kitchen, kitchen.episode(policy))
            for kitchen in export.kitchens
        }
        for policy in export.policies
    }
    return {
        "peer": f"Embree {version('embreex').split('.post')[0]}, packets of 16 rays",
        "results": results,
        "notes": ["Embree: rays alone; the scene is built beforehand, outside of the time"],
    }


if __name__ == "__main__":
    main(measure)
