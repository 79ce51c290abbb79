"""PyBullet's TinyRenderer as a depth camera: a software rasteriser, as ours is."""

from __future__ import annotations

from functools import partial
from importlib.metadata import version

import numpy as np
import pybullet

from .export import Episode, Export, Kitchen, camera_axes
from .measure import Answer, Result, main, shortest_s

#: Farther than anything in a room, metres.
FAR_M = 30.0
#: Frames of an episode that are timed: it is slow, and frames are alike.
FRAMES = 4


def load(kitchen: Kitchen) -> list[int]:
    """A body of PyBullet's for each of the kitchen's, made of the same triangles."""
    pybullet.resetSimulation()
    bodies = []
    for body in kitchen.bodies:
        triangles = kitchen.triangles[body.first_triangle : body.first_triangle + body.triangle_count]
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=triangles.reshape(-1, 3).tolist(),
            indices=list(range(3 * len(triangles))),
        )
        bodies.append(pybullet.createMultiBody(baseVisualShapeIndex=shape))
    return bodies


def look(side: int, view: list[float], projection: list[float]) -> np.ndarray:
    """One frame: what PyBullet keeps in its depth buffer."""
    _, _, _, depth, _ = pybullet.getCameraImage(
        side,
        side,
        view,
        projection,
        shadow=0,
        flags=pybullet.ER_NO_SEGMENTATION_MASK,
        renderer=pybullet.ER_TINY_RENDERER,
    )
    return depth


def measure_kitchen(export: Export, kitchen: Kitchen, episode: Episode) -> Result:
    """Times frames, and compares them with ours."""
    bodies = load(kitchen)
    side, near_m = export.frame_side, export.near_m
    field_of_view_deg = 2.0 * np.degrees(np.arctan(export.tan_half_field_of_view))
    projection = pybullet.computeProjectionMatrixFOV(field_of_view_deg, 1.0, near_m, FAR_M)
    times, medians = [], []
    frames = np.linspace(0, len(episode.frame_camera) - 1, min(FRAMES, len(episode.frame_camera)), dtype=int)
    for frame in frames:
        for body, pose in zip(bodies, episode.frame_bodies[frame], strict=True):
            pybullet.resetBasePositionAndOrientation(body, pose[:3].tolist(), pose[3:].tolist())
        origin, (_, up, ahead) = camera_axes(episode.frame_camera[frame])
        view = pybullet.computeViewMatrix(origin.tolist(), (origin + ahead).tolist(), up.tolist())
        times.append(shortest_s(partial(look, side, view, projection), repeats=2))
        buffer = np.reshape(look(side, view, projection), (side, side)).astype(np.float64)
        # Its axes are right-handed: the picture is mirrored.
        depth_m = (near_m * FAR_M / (FAR_M - (FAR_M - near_m) * buffer))[:, ::-1]
        medians.append(np.median(np.abs(depth_m * 1000.0 - episode.frame_depth_mm[frame])))
    return {"depth_s": float(np.mean(times)), "checks": {"depth_median_mm": float(np.median(medians))}}


def measure(export: Export) -> list[Answer]:
    """All kitchens under all policies."""
    pybullet.connect(pybullet.DIRECT)
    results = {
        policy: {
            str(kitchen.number): measure_kitchen(export, kitchen, kitchen.episode(policy))
            for kitchen in export.kitchens
        }
        for policy in export.policies
    }
    return [{"peer": f"PyBullet {version('pybullet')}, TinyRenderer", "results": results, "notes": []}]


if __name__ == "__main__":
    main(measure)
