"""The triangles of a MuJoCo model, drawn by Embree and by `stillroom.Scene`: for `make bench-depth`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import numpy.typing as npt
import stillroom

from .embree import Embree, MovingScene
from .export import Floats, world_triangles
from .shim import build


@dataclass(frozen=True)
class Meshes:
    """The drawn meshes of a model, each a body: [triangle, corner, xyz], and the body of each triangle."""

    geoms: npt.NDArray[np.int64]
    triangles: Floats
    triangle_body: npt.NDArray[np.int64]

    @staticmethod
    def of(model: mujoco.MjModel) -> Meshes:
        """Meshes of the groups that are drawn by default, and that can be seen."""
        shown = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_group < 3) & (model.geom_rgba[:, 3] > 0)
        geoms = np.flatnonzero(shown)
        parts = [corners(model, model.geom_dataid[geom]) for geom in geoms]
        bodies = np.repeat(np.arange(len(geoms)), [len(part) for part in parts])
        return Meshes(geoms, np.concatenate(parts) if parts else np.zeros((0, 3, 3), np.float32), bodies)

    def poses(self, data: mujoco.MjData) -> Floats:
        """[body, xyz and quaternion xyzw]."""
        poses = np.zeros((len(self.geoms), 7), np.float32)
        for pose, geom in zip(poses, self.geoms, strict=True):
            turned = np.zeros(4)
            mujoco.mju_mat2Quat(turned, data.geom_xmat[geom])
            pose[:3], pose[3:] = data.geom_xpos[geom], np.roll(turned, -1)
        return poses

    def world_triangles(self, poses: Floats) -> Floats:
        """[triangle, corner, xyz] in the world."""
        return world_triangles(self.triangles, self.triangle_body, poses)


def corners(model: mujoco.MjModel, mesh: int) -> Floats:
    """[triangle, corner, xyz] of a mesh of the model."""
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    return vertices[model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]].astype(np.float32)


def compare(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    camera: stillroom.CameraPose,
    side: int,
    timed: Callable[[Callable[[], object]], float],
) -> tuple[float, float, float] | None:
    """Seconds of a frame of all meshes from new poses, ours and Embree's, and the share of pixels that differ.

    They differ by more than 1 mm and 0.1%, and Embree does not meet a face from behind there. None without a mesh.
    """
    meshes = Meshes.of(model)
    if not len(meshes.geoms):
        return None
    near_m, far_m = (clip * model.stat.extent for clip in (model.vis.map.znear, model.vis.map.zfar))
    scene = stillroom.Scene()
    for body in range(len(meshes.geoms)):
        triangles = meshes.triangles[meshes.triangle_body == body]
        vertices, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        scene.mesh(vertices, index.reshape(-1, 3))
    places = data.geom_xpos[meshes.geoms], data.geom_xmat[meshes.geoms].reshape(-1, 3, 3)
    lens = {"near": near_m, "far": far_m}
    draw = partial(scene.render, *places, camera, side, side, **lens)

    with tempfile.TemporaryDirectory() as folder:
        tan_half = np.tan(np.radians(camera.fovy) / 2)
        lens_of_embree = SimpleNamespace(tan_half_field_of_view=tan_half, near_m=near_m, frame_side=side)
        embree = Embree(lens_of_embree, build(Path(folder)))
    turned = np.reshape(camera.rotation, (3, 3)).T
    axes = np.ascontiguousarray([turned[0], turned[1], -turned[2]], np.float32)
    origin, poses = np.asarray(camera.position, np.float32), meshes.poses(data)

    fixed = model.body_weldid[model.geom_bodyid[meshes.geoms]] == 0
    moving = MovingScene(embree, meshes, list(np.flatnonzero(fixed)), list(np.flatnonzero(~fixed)))
    moving.build(poses)
    picture = embree.picture()
    cast = partial(moving.frame, moving.rows(poses), origin, axes, picture)
    times = [(timed(draw), timed(cast)) for _ in range(5)]
    moving.release()

    exact = embree.scene(meshes.world_triangles(poses), robust=True)
    embree.cast(exact, origin, axes, picture, True)
    embree.release(exact)
    ours_m = scene.render(*places, camera, side, side, depth="float32", **lens)[0]
    theirs_m = np.where(picture.depth_m < far_m, picture.depth_m, 0)
    differs = np.abs(ours_m - theirs_m) > np.maximum(1e-3, 1e-3 * theirs_m)
    own_s, embree_s = (min(each) for each in zip(*times, strict=True))
    return own_s, embree_s, float((differs & ~picture.from_behind.astype(bool)).mean())
