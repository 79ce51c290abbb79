"""`stillroom.DepthCamera` beside `mujoco.Renderer` on the models that Python packages ship.

    make bench-depth ARGS="--only FrankaKitchen,Humanoid --picture docs/depth.png"

Both draw the same moments with the same camera, 224 by 224 pixels, one after the other in turns. Times are processor
time of all threads of this process, the least of the turns, so that other programs on the machine count little. MuJoCo
draws with OSMesa or, where that is missing, with EGL; `MUJOCO_GL` chooses. What `DepthCamera` does not draw,
tendons and rays of sensors, is switched off there, too.

The meshes alone are also drawn by Embree, in packets of sixteen coherent rays with one thread: what the model welds to
the world is one tree, what moves has a tree of its own each, and the tree above them is built again for each frame.

Agreement: the share of pixels that differ from `mujoco.Renderer` by more than 1 mm and 0.1%; and the largest error
against `mj_multiRay`, of those beyond 1 mm, away from silhouettes and where MuJoCo's rays and its renderer show the
same geom (rays also meet faces from behind, which the renderer leaves out).
"""

from __future__ import annotations

import argparse
import ctypes.util
import os
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("MUJOCO_GL", "osmesa" if ctypes.util.find_library("OSMesa") else "egl")

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

import stillroom
from stillroom.wrappers import mujoco_of

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))
from peers import meshes

SIDE = 224
TURNS = 5
STEP = 0.02
"""Of two neighbouring pixels' depths: a larger one is a silhouette, of a thing before itself, too."""
Moment = tuple[Any, Any]

GYMNASIUM = [
    "Ant",
    "HalfCheetah",
    "Hopper",
    "Humanoid",
    "HumanoidStandup",
    "InvertedDoublePendulum",
    "Pusher",
    "Reacher",
    "Swimmer",
    "Walker2d",
]
ROBOTICS = [
    "FetchPickAndPlace-v4",
    "FetchSlide-v4",
    "HandReach-v3",
    "HandManipulateBlock-v1",
    "AdroitHandDoor-v1",
    "AdroitHandHammer-v1",
    "AdroitHandPen-v1",
    "AdroitHandRelocate-v1",
    "AntMaze_UMaze-v5",
    "PointMaze_UMaze-v3",
    "FrankaKitchen-v1",
]
CONTROL = [
    "cheetah-run",
    "fish-swim",
    "humanoid_CMU-walk",
    "manipulator-bring_ball",
    "quadruped-escape",
    "quadruped-fetch",
    "stacker-stack_4",
    "swimmer-swimmer15",
]
METAWORLD = ["assembly", "door-open", "drawer-open", "hammer", "soccer", "sweep-into"]
OGBENCH = ["antmaze-large-v0", "humanoidmaze-medium-v0", "cube-triple-v0", "scene-v0", "puzzle-4x5-v0"]
ROBOSUITE = {"Lift": "Panda", "Stack": "Sawyer", "NutAssembly": "IIWA", "PickPlace": "UR5e", "TwoArmLift": "Baxter"}


def of_gymnasium(name: str) -> Moment:
    env = gymnasium.make(name)
    env.reset(seed=0)
    return mujoco_of(env)


def of_control(name: str) -> Moment:
    from dm_control import suite

    domain, task = name.split("-")
    env = suite.load(domain, task, task_kwargs={"random": 0})
    env.reset()
    return env.physics.model.ptr, env.physics.data.ptr


def of_metaworld(name: str) -> Moment:
    import metaworld

    env = metaworld.ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE[f"{name}-v3-goal-observable"](seed=0)
    env.reset()
    return env.model, env.data


def of_robosuite(name: str) -> Moment:
    import robosuite

    quiet = {"has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False}
    env = robosuite.make(name, robots=ROBOSUITE[name], **quiet)
    env.reset()
    return env.sim.model._model, env.sim.data._data


def models(only: list[str]) -> Iterator[tuple[str, str, Moment]]:
    """Package, name, and a moment of each model."""
    import gymnasium_robotics
    import ogbench  # noqa: F401  # registers its environments

    gymnasium.register_envs(gymnasium_robotics)
    packages: list[tuple[str, list[str], Callable[[str], Moment]]] = [
        ("Gymnasium", [f"{name}-v5" for name in GYMNASIUM], of_gymnasium),
        ("Gymnasium-Robotics", ROBOTICS, of_gymnasium),
        ("dm_control", CONTROL, of_control),
        ("MetaWorld", METAWORLD, of_metaworld),
        ("OGBench", OGBENCH, of_gymnasium),
        ("robosuite", list(ROBOSUITE), of_robosuite),
    ]
    for package, names, load in packages:
        for name in names:
            if not only or any(part in name for part in only):
                yield package, name, load(name)


class Peer:
    """`mujoco.Renderer` with what `DepthCamera` draws."""

    def __init__(self, model: Any, camera: int) -> None:
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, SIDE)
        model.vis.global_.offheight = max(model.vis.global_.offheight, SIDE)
        self.camera = camera
        self.option = mujoco.MjvOption()
        for flag in (mujoco.mjtVisFlag.mjVIS_TENDON, mujoco.mjtVisFlag.mjVIS_RANGEFINDER):
            self.option.flags[flag] = 0
        self.renderer = mujoco.Renderer(model, SIDE, SIDE)
        self.renderer.enable_depth_rendering()

    def depth_m(self, data: Any) -> NDArray[np.float32]:
        self.renderer.update_scene(data, self.camera, self.option)
        return self.renderer.render()

    def geoms(self, data: Any) -> NDArray[np.int32]:
        self.renderer.enable_segmentation_rendering()
        self.renderer.update_scene(data, self.camera, self.option)
        shown = self.renderer.render()
        return np.where(shown[..., 1] == mujoco.mjtObj.mjOBJ_GEOM, shown[..., 0], -1)


def least_s(draw: Callable[[], object]) -> float:
    """Processor time of one call."""
    calls, begun = 0, time.process_time()
    while calls < 3 or time.process_time() - begun < 0.05:
        draw()
        calls += 1
    return (time.process_time() - begun) / calls


def rays(model: Any, data: Any, camera: stillroom.CameraPose) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """What MuJoCo's rays through the centres of pixels meet: geom, and depth along the camera's axis."""
    slopes = (np.arange(SIDE) + 0.5 - SIDE / 2) / camera.focal_px(SIDE)
    right, down = np.meshgrid(slopes, slopes)
    directions = np.stack([right, -down, -np.ones_like(right)], axis=-1) @ np.reshape(camera.rotation, (3, 3)).T
    lengths = np.linalg.norm(directions, axis=-1)
    unit = (directions / lengths[..., None]).reshape(-1, 1)
    count = SIDE * SIDE
    geoms, distances = np.zeros(count, np.int32), np.zeros(count)
    groups = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    position = np.array(camera.position, float).reshape(3, 1)
    mujoco.mj_multiRay(model, data, position, unit, groups, 1, -1, geoms, distances, count, mujoco.mjMAXVAL)
    return geoms.reshape(SIDE, SIDE), distances.reshape(SIDE, SIDE) / lengths


def interior(shown: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Where a pixel and its eight neighbours show the same."""
    return np.all(around(shown) == shown, axis=0)


def around(image: NDArray[Any]) -> NDArray[Any]:
    """Of each pixel itself and its eight neighbours, [9, row, column]."""
    padded = np.pad(image, 1, mode="edge")
    return np.stack([padded[y : y + SIDE, x : x + SIDE] for y in range(3) for x in range(3)])


def row(package: str, name: str, model: Any, data: Any) -> tuple[dict[str, Any], NDArray[Any], NDArray[Any]]:
    """Figures of a model, and both pictures."""
    mujoco.mj_forward(model, data)
    number = 0 if model.ncam else -1
    ours = stillroom.DepthCamera(model, number, SIDE, SIDE)
    metres = stillroom.DepthCamera(model, number, SIDE, SIDE, depth="float32")
    peer = Peer(model, number)
    depth_m, ids = metres.render(data, ids=True)
    theirs_m = peer.depth_m(data)
    times = [(least_s(lambda: ours.render(data)), least_s(lambda: peer.depth_m(data))) for _ in range(TURNS)]
    own_s, peer_s = (min(times) for times in zip(*times, strict=True))

    near_m, far_m = (clip * model.stat.extent for clip in (model.vis.map.znear, model.vis.map.zfar))
    shown_m = np.where(depth_m == 0, theirs_m.max() if (theirs_m > 0.99 * far_m).any() else far_m, depth_m)
    differs = np.abs(shown_m - theirs_m) > np.maximum(1e-3, 1e-3 * theirs_m)
    if number < 0:
        pose = stillroom.depth.free_camera(model)
    else:
        pose = stillroom.CameraPose(data.cam_xpos[number], data.cam_xmat[number], float(model.cam_fovy[number]))
    geoms, rays_m = rays(model, data, pose)
    same = interior(geoms) & interior(peer.geoms(data)) & (geoms == peer.geoms(data)) & (geoms >= 0)
    same &= (rays_m > near_m) & (rays_m < 0.999 * far_m) & (ids < model.ngeom)
    same &= np.ptp(around(rays_m), axis=0) < STEP * rays_m
    errors = np.where(np.abs(depth_m - rays_m) <= 1e-3, 0, np.abs(depth_m - rays_m) / np.maximum(rays_m, 1e-9))[same]
    peer.renderer.close()
    embree = meshes.compare(model, data, pose, SIDE, least_s)
    figures = {
        "package": package,
        "model": name,
        "triangles": int(sum(model.mesh_facenum[model.geom_dataid[model.geom_type == mujoco.mjtGeom.mjGEOM_MESH]])),
        "own_s": own_s,
        "peer_s": peer_s,
        "differs": float(differs.mean()),
        "error": float(errors.max(initial=0.0)),
        "other_ids": int((ids != geoms)[same].sum()),
        "compared": int(same.sum()),
        "embree": embree,
    }
    return figures, theirs_m, shown_m


def picture(path: Path, pairs: list[tuple[str, NDArray[Any], NDArray[Any]]]) -> None:
    """Eight models, theirs above ours: near is dark, and nothing white."""
    from PIL import Image, ImageDraw

    columns, gap, caption = 4, 6, 16
    width, height = SIDE + gap, 2 * (SIDE + caption) + gap
    sheet = Image.new("L", (columns * width + gap, -(-len(pairs) // columns) * height), 255)
    for index, (name, *images) in enumerate(pairs):
        left, top = gap + index % columns * width, index // columns * height
        ImageDraw.Draw(sheet).text((left, top + 2), f"{name}: MuJoCo", fill=0)
        inverse = [1 / image for image in images]
        far, near = np.quantile(inverse[1][images[1] < 0.99 * images[1].max()], [0.02, 0.98])
        for place, image in enumerate(inverse):
            shade = 8 + 224 * np.clip((near - image) / max(near - far, 1e-9), 0, 1)
            shade = np.where(images[place] < 0.99 * images[1].max(), shade, 255).astype(np.uint8)
            sheet.paste(Image.fromarray(shade), (left, top + caption + place * (SIDE + caption)))
        ImageDraw.Draw(sheet).text((left, top + SIDE + caption + 2), "Stillroom", fill=0)
    sheet.quantize(64).save(path, optimize=True)


PICTURED = ("Humanoid-v5", "HandManipulateBlock-v1", "FrankaKitchen-v1", "quadruped-escape", "hammer", "cube-triple-v0")
PICTURED += ("NutAssembly", "TwoArmLift")


def dented_ball(rings: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A ball of radius 1 with dents, and its triangles."""
    up, around = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij")
    radius = 1 + 0.1 * np.sin(9 * up) * np.sin(7 * around)
    vertices = radius[..., None] * np.stack([np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)], -1)
    first = (np.arange(rings)[:, None] * (2 * rings + 1) + np.arange(2 * rings)).ravel()
    a, b, c, d = first, first + 1, first + 2 * rings + 1, first + 2 * rings + 2
    return vertices.reshape(-1, 3), np.concatenate([np.stack([a, c, d], 1), np.stack([a, d, b], 1)])


def scaling() -> None:
    """Times of one concave mesh that fills the image, as its triangles grow."""
    print("\n| triangles | ms a frame | ns a triangle |\n|---|---|---|")
    camera = stillroom.CameraPose((0, 0, 3), np.eye(3), fovy=45)
    for rings in (16, 50, 158, 500):
        scene = stillroom.Scene()
        vertices, triangles = dented_ball(rings)
        scene.mesh(vertices, triangles)
        draw = partial(scene.render, np.zeros((1, 3)), np.eye(3)[None], camera, SIDE, SIDE)
        own_s = min(least_s(draw) for _ in range(TURNS))
        print(f"| {len(triangles):,} | {1e3 * own_s:.3f} | {1e9 * own_s / len(triangles):.1f} |")


def cells(embree: tuple[float, float, float] | None) -> str:
    """The columns of `meshes.compare`."""
    if embree is None:
        return "| | | | "
    own_s, embree_s, differs = embree
    return f"| {1e3 * embree_s:.2f} | {1e3 * own_s:.3f} | {embree_s / own_s:.1f} | {differs:.2%} "


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="models whose names contain one of these, separated by commas")
    parser.add_argument("--picture", type=Path, help="writes the pictures of eight models here")
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore")
    print(f"{os.environ['MUJOCO_GL']}, mujoco {mujoco.__version__}, {SIDE} by {SIDE}\n")
    print(
        "| model | triangles | MuJoCo, ms | ours, ms | times faster | differs | error, rays | ids differ "
        "| meshes: Embree, ms | ours, ms | times faster | differs |"
    )
    print(f"|{'---|' * 12}")
    rows, pairs = [], []
    for package, name, (model, data) in models([part for part in arguments.only.split(",") if part]):
        figures, theirs, ours = row(package, name, model, data)
        rows.append(figures)
        if name in PICTURED:
            pairs.append((name, theirs, ours))
        own_ms, peer_ms = (1e3 * figures[key] for key in ("own_s", "peer_s"))
        print(
            f"| {package} {name} | {figures['triangles']:,} | {peer_ms:.2f} | {own_ms:.3f} | {peer_ms / own_ms:.1f} "
            f"| {figures['differs']:.2%} | {figures['error']:.3%} "
            f"| {figures['other_ids']} of {figures['compared']:,} {cells(figures['embree'])}|",
            flush=True,
        )
    ratios = [figures["peer_s"] / figures["own_s"] for figures in rows]
    print(f"\n{len(rows)} models: median {statistics.median(ratios):.1f} times faster, least {min(ratios):.1f}")
    beside_embree = [embree_s / own_s for own_s, embree_s, _ in filter(None, (figures["embree"] for figures in rows))]
    if beside_embree:
        print(
            f"meshes of {len(beside_embree)} models beside Embree: median {statistics.median(beside_embree):.1f} times "
            f"faster, least {min(beside_embree):.1f}"
        )
    scaling()
    if arguments.picture:
        picture(arguments.picture, pairs)


if __name__ == "__main__":
    main()
