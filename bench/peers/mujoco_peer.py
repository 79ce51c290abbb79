"""MuJoCo: physics of a recorded episode, depth frames by its OpenGL renderer, and both together.

The robot's bodies are driven along the way they took in our simulator, sub-step by sub-step. Of several settings the
quickest are taken. `MUJOCO_GL` says how OpenGL is reached (`egl` or `osmesa`); without it there is physics alone.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
import numpy.typing as npt

from .export import Episode, Export, Kitchen
from .measure import Answer, Result, main, shortest_s
from .mujoco_scene import Replay, Scene, Settings

#: Sub-steps in which a kitchen comes to rest before an episode is replayed: four seconds.
REST_SUBSTEPS = 240
#: What is tried; the quickest over the first kitchens is taken for all.
CANDIDATES = [
    Settings(),
    Settings(sleep_tolerance=1e-2),
    Settings(sleep=False),
    Settings(integrator="IMPLICITFAST"),
    Settings(cone="ELLIPTIC"),
    Settings(solver="CG"),
    Settings(solver="PGS", iterations=20),
    Settings(iterations=5),
    Settings(iterations=5, integrator="IMPLICITFAST", sleep_tolerance=1e-2),
]
#: Kitchens that settings are tried in.
TRIAL_KITCHENS = 3
#: A thing that moved further than this is disturbed, metres.
DISTURBED_M = 0.01


class Picture:
    """Depth frames by MuJoCo's renderer, at its quickest: no light, no shadow, back faces culled, depth read alone."""

    def __init__(self, export: Export, scene: Scene) -> None:
        model, side = scene.model, export.frame_side
        self.scene = scene
        model.vis.headlight.active = 0
        self.context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.context)
        self.abstract = mujoco.MjvScene(model, maxgeom=2 * model.ngeom)
        self.abstract.flags[:] = 0
        self.abstract.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = 1
        self.options = mujoco.MjvOption()
        self.options.flags[:] = 0
        self.options.flags[mujoco.mjtVisFlag.mjVIS_STATIC] = 1
        self.options.geomgroup[:] = 0
        self.options.geomgroup[0] = 1
        self.camera = mujoco.MjvCamera()
        self.camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self.camera.fixedcamid = 0
        self.perturbation = mujoco.MjvPerturb()
        self.viewport = mujoco.MjrRect(0, 0, side, side)
        self.buffer = np.zeros((side, side), np.float32)
        self.near_m = model.vis.map.znear * model.stat.extent
        self.far_m = model.vis.map.zfar * model.stat.extent

    def depth_m(self) -> npt.NDArray[np.float32]:
        """[row, column] as MuJoCo gives them: from the bottom up, and mirrored."""
        mujoco.mjv_updateScene(
            self.scene.model,
            self.scene.data,
            self.options,
            self.perturbation,
            self.camera,
            mujoco.mjtCatBit.mjCAT_ALL,
            self.abstract,
        )
        mujoco.mjr_render(self.viewport, self.abstract, self.context)
        mujoco.mjr_readPixels(None, self.buffer, self.viewport, self.context)
        return self.near_m / (1.0 - self.buffer * (1.0 - self.near_m / self.far_m))

    def close(self) -> None:
        """Frees what lies in OpenGL."""
        self.context.free()


def replay_s(scene: Scene, episode: Episode, after_action: list | None = None) -> float:
    """Processor time of an episode's physics, and of what is called after each action, seconds."""
    scene.start(episode)
    scene.rest(REST_SUBSTEPS)
    replay = Replay(scene, episode)
    actions = range(len(episode.substeps_until))
    started = time.process_time()
    for action in actions:
        replay.step(action)
        for call in after_action or []:
            call(action)
    elapsed = time.process_time() - started
    replay.finish()
    return elapsed


def quickest_settings(export: Export) -> tuple[Settings, list[str]]:
    """The settings that the first kitchens' episodes take least time with, and a line for each that was tried."""
    seconds: dict[Settings, float] = {}
    for settings in CANDIDATES:
        seconds[settings] = 0.0
        for kitchen in export.kitchens[:TRIAL_KITCHENS]:
            scene = Scene(export, kitchen, settings)
            for policy in export.policies:
                episode = kitchen.episode(policy)
                seconds[settings] += min(replay_s(scene, episode) for _ in range(2)) / len(episode.substeps_until)
    count = len(export.kitchens[:TRIAL_KITCHENS]) * len(export.policies)
    lines = [f"MuJoCo, tried: {settings}: {count / total:.0f} physics steps/s" for settings, total in seconds.items()]
    return min(seconds, key=lambda settings: seconds[settings]), lines


def check_physics(scene: Scene, episode: Episode) -> dict[str, float]:
    """Whether it is the same kitchen: masses, what rests at the start, what is disturbed at the end."""
    scene.start(episode)
    before = scene.positions()
    scene.rest(REST_SUBSTEPS)
    rested = scene.positions()
    awake = scene.data.ntree_awake
    replay = Replay(scene, episode)
    for action in range(len(episode.substeps_until)):
        replay.step(action)
    replay.finish()
    moved_m = np.linalg.norm(scene.positions() - rested, axis=1)
    moved_in_ours_m = np.linalg.norm(episode.end[:, :3] - episode.start[:, :3], axis=1)
    return {
        "mass_error": scene.mass_error(),
        "rest_drift_mm": float(np.linalg.norm(rested - before, axis=1).max() * 1e3),
        "awake_at_rest": float(awake),
        "disturbed": float((moved_m > DISTURBED_M).sum()),
        "disturbed_in_ours": float((moved_in_ours_m > DISTURBED_M).sum()),
    }


def measure_pictures(export: Export, kitchen: Kitchen, scene: Scene, episode: Episode) -> Result:
    """Times frames by themselves and after each action; and compares them with ours."""
    picture = Picture(export, scene)
    times, medians = [], []
    for bodies, camera, depth_mm in zip(
        episode.frame_bodies, episode.frame_camera, episode.frame_depth_mm, strict=True
    ):
        scene.show(kitchen.bodies, bodies)
        scene.aim(camera)
        upright = picture.depth_m()[::-1, ::-1]
        medians.append(np.median(np.abs(upright * 1000.0 - depth_mm)))
        times.append(shortest_s(picture.depth_m))

    def look(action: int) -> None:
        scene.aim(episode.camera[action])
        picture.depth_m()

    whole = replay_s(scene, episode, [look])
    picture.close()
    return {
        "depth_s": float(np.mean(times)),
        "whole_step_s": whole / len(episode.substeps_until),
        "checks": {"depth_median_mm": float(np.median(medians))},
    }


@contextmanager
def opengl(side: int) -> Iterator[str | None]:
    """An OpenGL context and the name of who draws; nothing where there is none."""
    try:
        context = mujoco.GLContext(side, side)
        context.make_current()
    except Exception as error:  # Each way to OpenGL has errors of its own.
        yield None
        print(f"MuJoCo has no OpenGL: {error}", flush=True, file=sys.stderr)
        return
    try:
        from OpenGL import GL  # noqa: PLC0415  It asks for a display when it is loaded.

        yield GL.glGetString(GL.GL_RENDERER).decode()
    finally:
        context.free()


def measure(export: Export) -> list[Answer]:
    """All kitchens under all policies."""
    settings, notes = quickest_settings(export)
    results: dict[str, dict[str, Result]] = {policy: {} for policy in export.policies}
    with opengl(export.frame_side) as renderer:
        for kitchen in export.kitchens:
            scene = Scene(export, kitchen, settings)
            for policy in export.policies:
                episode = kitchen.episode(policy)
                seconds = min(replay_s(scene, episode) for _ in range(2))
                result: Result = {
                    "physics_s": seconds / len(episode.substeps_until),
                    "checks": check_physics(scene, episode),
                }
                if renderer:
                    pictures = measure_pictures(export, kitchen, scene, episode)
                    result["depth_s"] = pictures["depth_s"]
                    result["whole_step_s"] = pictures["whole_step_s"]
                    result["checks"] |= pictures["checks"]
                results[policy][str(kitchen.number)] = result
    notes.append(f"MuJoCo, taken: {settings}; drawn by {renderer or 'nothing: there is no OpenGL'}")
    return [{"peer": f"MuJoCo {mujoco.__version__}", "results": results, "notes": notes}]


if __name__ == "__main__":
    main(measure)
