"""Depth images on a CPU: of any MuJoCo model, and of scenes without MuJoCo.

A `DepthCamera` draws what `mujoco.Renderer` draws with the defaults of `mjvOption`, without OpenGL, GPU or display; a
`Scene` is the same for meshes and solids of your own. Both give depth along the camera's axis, 0 where nothing is in
sight, as 16-bit millimetres (at most 32,766) or as metres, and from the same pass which thing each pixel shows. The
same inputs give the same bits on every machine.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stillroom._stillroom import DepthMesh, DepthScene, choice, shown, sine_cosine, tangent, whole

SIDE_MOST = 4096
KINDS = {0: ("plane", 2), 2: ("sphere", 1), 3: ("capsule", 2), 4: ("ellipsoid", 3), 5: ("cylinder", 2), 6: ("box", 3)}
"""Kind and number of sizes of MuJoCo's types of geoms."""
HEIGHT_FIELD, MESH, SDF = 1, 7, 8
"""The other types."""
DEFAULT_COLOUR = (0.5, 0.5, 0.5, 1.0)
"""A geom of this colour has that of its material."""

Image = NDArray[Any]
Frame = tuple[list[tuple[NDArray[np.float64], NDArray[np.float64]]], NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class CameraPose:
    """Where a camera stands in the world. It looks along its -z axis, x is to the right and y up."""

    position: ArrayLike
    """Metres."""
    rotation: ArrayLike
    """[3, 3]; its columns are the camera's axes in the world."""
    fovy: float = 45.0
    """The angle that the image's height spans, degrees."""

    def focal_px(self, height: int) -> float:
        """Pixels per unit of slope."""
        if not 0 < self.fovy < 180:
            raise ValueError(f"fovy is {self.fovy}, not an angle between 0 and 180 degrees")
        return height / 2 / tangent(math.radians(self.fovy) / 2)


class Scene:
    """Things that a camera sees. Each method that adds one returns its number; poses come with each frame."""

    def __init__(self) -> None:
        self._scene = DepthScene()
        self._count = 0

    def plane(self, half_x: float = 0.0, half_y: float = 0.0) -> int:
        """The upper side of a rectangle in z = 0; a half extent of 0 is without an end."""
        return self._add("plane", [half_x, half_y])

    def box(self, half_extents: Sequence[float]) -> int:
        """A box."""
        return self._add("box", list(half_extents))

    def sphere(self, radius: float) -> int:
        """A sphere."""
        return self._add("sphere", [radius])

    def ellipsoid(self, radii: Sequence[float]) -> int:
        """An ellipsoid."""
        return self._add("ellipsoid", list(radii))

    def cylinder(self, radius: float, half_height: float) -> int:
        """A cylinder along z."""
        return self._add("cylinder", [radius, half_height])

    def capsule(self, radius: float, half_height: float) -> int:
        """A cylinder along z with half a sphere at each end."""
        return self._add("capsule", [radius, half_height])

    def mesh(self, vertices: ArrayLike, triangles: ArrayLike) -> int:
        """Triangles of any shape, counterclockwise as seen from outside; from behind they are not seen."""
        return self._add_mesh(mesh(vertices, triangles))

    def height_field(self, heights: ArrayLike, half_extents: tuple[float, float], base: float = 0.0) -> int:
        """A grid of heights [rows along y, columns along x] with walls down to `base` below 0."""
        grid = np.ascontiguousarray(heights, np.float32)
        return self._add_mesh(DepthMesh.height_field(grid, half_extents, base))

    def _add(self, kind: str, size: list[float]) -> int:
        self._scene.add(self._count, kind, size)
        self._count += 1
        return self._count - 1

    def _add_mesh(self, mesh: DepthMesh) -> int:
        self._scene.add_mesh(self._count, mesh)
        self._count += 1
        return self._count - 1

    def render(
        self,
        positions: ArrayLike,
        rotations: ArrayLike,
        camera: CameraPose,
        width: int = 224,
        height: int = 224,
        *,
        depth: str = "uint16",
        near: float = 0.01,
        far: float = 100.0,
    ) -> tuple[Image, NDArray[np.int32]]:
        """Depth and numbers [height, width] of things at these positions [n, 3] with these rotations [n, 3, 3]."""
        width, height = size("width", width), size("height", height)
        if not 0 < near < far < math.inf:
            raise ValueError(f"near is {near} and far {far}: both must be positive, and near the smaller")
        focal_px = camera.focal_px(height)
        lens = (width, height, (focal_px, focal_px), (width / 2, height / 2), float(near), float(far))
        frame = ([(numbers(positions), numbers(rotations))], numbers(camera.position), numbers(camera.rotation))
        image, ids = self._scene.render([frame], lens, in_metres(depth), True, 1)
        return image[0], ids[0]


class DepthCamera:
    """A depth camera for a MuJoCo model.

    `camera` is the name or number of one of the model's cameras, a `CameraPose`, or -1: the free camera as MuJoCo
    places it first. Geoms and sites are those of the groups 0 to 2, or of `groups`, that are not wholly transparent.
    The model is read here: after a change of its sizes, colours or meshes make another camera.
    """

    def __init__(
        self,
        model: Any,
        camera: str | int | CameraPose = -1,
        width: int = 224,
        height: int = 224,
        *,
        depth: str = "uint16",
        groups: Sequence[int] = (0, 1, 2),
        sites: bool = True,
    ) -> None:
        self.model = model = plain(model)
        self.width, self.height = size("width", width), size("height", height)
        self._in_metres = in_metres(depth)
        if model.nskin or model.nflex:
            kind, count = ("skin", model.nskin) if model.nskin else ("flex", model.nflex)
            raise ValueError(f"the model has {count} of the kind {kind}, which DepthCamera cannot draw: remove it")
        self._scene = DepthScene()
        self._add_geoms(model, set(groups))
        if sites:
            self._add_sites(model, set(groups))
        self._camera = -1 if isinstance(camera, CameraPose) else camera_number(model, camera)
        self._pose = camera if isinstance(camera, CameraPose) else free_camera(model)
        near, far = model.vis.map.znear * model.stat.extent, model.vis.map.zfar * model.stat.extent
        self._lens = (self.width, self.height, *self._optics(model), near, far)
        self._place = numbers(self._pose.position), numbers(self._pose.rotation)

    def render(self, data: Any, *, ids: bool = False) -> Any:
        """Depth [height, width] of this moment, after `mj_forward`. With `ids` a pair with int32 [height, width]: the
        number of a geom, for a site `model.ngeom` and its number, -1 where nothing is in sight."""
        image, shown_ids = self._scene.render([self._frame(data)], self._lens, self._in_metres, ids, 1)
        return (image[0], shown_ids[0]) if ids else image[0]

    def render_batch(self, datas: Sequence[Any], *, threads: int | None = None, ids: bool = False) -> Any:
        """The same of many moments, [n, height, width], drawn by threads while Python's lock is free; by default by
        as many as there are cores."""
        threads = len(os.sched_getaffinity(0)) if threads is None else whole("threads", threads, 1024, 1)
        frames = [self._frame(data) for data in datas]
        image, shown_ids = self._scene.render(frames, self._lens, self._in_metres, ids, threads)
        return (image, shown_ids) if ids else image

    def _frame(self, data: Any) -> Frame:
        data = plain(data)
        things = [(data.geom_xpos, data.geom_xmat), (data.site_xpos, data.site_xmat)]
        if self._camera < 0:
            return things, *self._place
        return things, data.cam_xpos[self._camera], data.cam_xmat[self._camera]

    def _optics(self, model: Any) -> tuple[tuple[float, float], tuple[float, float]]:
        """Focal lengths and centre, pixels."""
        width, height, camera = self.width, self.height, self._camera
        if camera >= 0 and model.cam_sensorsize[camera].any():
            focal_x, focal_y, left, up = (float(length) for length in model.cam_intrinsic[camera])
            sensor_x, sensor_y = (float(length) for length in model.cam_sensorsize[camera])
            per_x, per_y = width / sensor_x, height / sensor_y
            return (focal_x * per_x, focal_y * per_y), (width / 2 - left * per_x, height / 2 + up * per_y)
        fovy = self._pose.fovy if camera < 0 else float(model.cam_fovy[camera])
        focal_px = CameraPose((), (), fovy).focal_px(height)
        return (focal_px, focal_px), (width / 2, height / 2)

    def _add_geoms(self, model: Any, groups: set[int]) -> None:
        meshes: dict[tuple[int, int], DepthMesh] = {}
        for geom in range(model.ngeom):
            if int(model.geom_group[geom]) not in groups or is_transparent(model, "geom", geom):
                continue
            kind, sizes = int(model.geom_type[geom]), model.geom_size[geom]
            if kind in KINDS:
                name, count = KINDS[kind]
                self._scene.add(geom, name, [float(length) for length in sizes[:count]])
            elif kind in {HEIGHT_FIELD, MESH, SDF}:
                key = (kind == HEIGHT_FIELD, int(model.geom_dataid[geom]))
                if key not in meshes:
                    meshes[key] = (height_field_of if key[0] else mesh_of)(model, key[1])
                self._scene.add_mesh(geom, meshes[key])
            else:
                raise ValueError(f"geom {geom} has the type {kind}, which DepthCamera cannot draw")

    def _add_sites(self, model: Any, groups: set[int]) -> None:
        for site in range(model.nsite):
            kind = int(model.site_type[site])
            if int(model.site_group[site]) in groups and not is_transparent(model, "site", site) and kind in KINDS:
                name, count = KINDS[kind]
                self._scene.add(model.ngeom + site, name, [float(length) for length in model.site_size[site][:count]])


def plain(thing: Any) -> Any:
    """MuJoCo's own object of what dm_control and robosuite wrap."""
    return getattr(thing, "ptr", None) or getattr(thing, "_model", None) or getattr(thing, "_data", None) or thing


def is_transparent(model: Any, kind: str, number: int) -> bool:
    """Whether a geom or site is wholly transparent, by its colour or its material's."""
    colour = getattr(model, f"{kind}_rgba")[number]
    material = int(getattr(model, f"{kind}_matid")[number])
    if material >= 0 and tuple(float(part) for part in colour) == DEFAULT_COLOUR:
        colour = model.mat_rgba[material]
    return float(colour[3]) == 0.0


def camera_number(model: Any, camera: str | int) -> int:
    """The number of a camera of the model; -1 is the free one."""
    names = [model.camera(i).name for i in range(model.ncam)]
    if isinstance(camera, str):
        if camera not in names:
            known = ", ".join(f'"{name}"' for name in names) or "none"
            raise ValueError(f"camera is {shown(camera)}, and the model's cameras are {known}")
        camera = names.index(camera)
    elif camera == -1:
        orthographic = bool(model.vis.global_.orthographic)
    if camera != -1:
        camera = whole("camera", camera, max(model.ncam - 1, 0))
        if camera >= model.ncam:
            raise ValueError("the model has no camera: leave out camera, or give a CameraPose")
        # MuJoCo 3.3 has the other name; either is 1 of an orthographic camera.
        kinds = model.cam_projection if hasattr(model, "cam_projection") else model.cam_orthographic
        orthographic = int(kinds[camera]) == 1
    if orthographic:
        raise ValueError("the camera is orthographic, which DepthCamera is not: give a camera with a field of view")
    return int(camera)


def free_camera(model: Any) -> CameraPose:
    """Where `mjv_defaultFreeCamera` puts it."""
    globe = model.vis.global_
    azimuth, elevation = math.radians(globe.azimuth), math.radians(globe.elevation)
    (sin_a, cos_a), (sin_e, cos_e) = sine_cosine(azimuth), sine_cosine(elevation)
    ahead = np.array([cos_e * cos_a, cos_e * sin_a, sin_e])
    up = np.array([-sin_e * cos_a, -sin_e * sin_a, cos_e])
    rotation = np.stack([np.cross(ahead, up), up, -ahead], axis=1)
    return CameraPose(model.stat.center - 1.5 * model.stat.extent * ahead, rotation, float(globe.fovy))


def mesh_of(model: Any, number: int) -> DepthMesh:
    """A mesh of the model."""
    vertex, vertices = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
    face, faces = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
    return mesh(model.mesh_vert[vertex : vertex + vertices], model.mesh_face[face : face + faces])


def height_field_of(model: Any, number: int) -> DepthMesh:
    """A height field of the model."""
    rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
    first = int(model.hfield_adr[number])
    half_x, half_y, height, base = (float(length) for length in model.hfield_size[number])
    heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns) * np.float32(height)
    return DepthMesh.height_field(np.ascontiguousarray(heights, np.float32), (half_x, half_y), base)


def mesh(vertices: ArrayLike, triangles: ArrayLike) -> DepthMesh:
    """A mesh from whatever makes arrays [n, 3]."""
    corners = np.asarray(triangles)
    if corners.size and (corners.min() < 0 or not np.issubdtype(corners.dtype, np.integer)):
        raise ValueError("triangles are not whole numbers from 0 on")
    return DepthMesh(np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(corners, np.uint32))


def numbers(values: ArrayLike) -> NDArray[np.float64]:
    """What Rust reads."""
    return np.ascontiguousarray(values, np.float64)


def size(name: str, value: int) -> int:
    """A width or height, pixels."""
    return whole(name, value, SIDE_MOST, 1)


def in_metres(depth: str) -> bool:
    """Whether depth is wanted as float metres."""
    return choice("depth", depth, ["uint16", "float32"]) == "float32"
