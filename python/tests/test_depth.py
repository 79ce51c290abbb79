"""Depth images of MuJoCo models and of scenes, against MuJoCo's own rays and renderer."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import stillroom

SIDE = 96
LEVEL = np.eye(3)

MODEL = """
<mujoco>
  <visual><map znear="0.005" zfar="20"/><global fovy="60"/></visual>
  <asset>
    <hfield name="hills" nrow="3" ncol="4" size="0.5 0.4 0.3 0.1" elevation="0 1 2 1  2 3 1 0  1 1 2 2"/>
    <mesh name="wedge" vertex="0 0 0  .4 0 0  0 .4 0  0 0 .4  .4 .4 .4  .4 .1 .4  .1 .4 .1"/>
    <material name="clear" rgba="1 1 1 0"/>
  </asset>
  <worldbody>
    <geom type="plane" size="3 2 .1"/>
    <geom type="hfield" hfield="hills" pos="-1 .8 .1"/>
    <geom type="sphere" size=".3" pos="0 0 .4"/>
    <geom type="capsule" size=".1 .3" pos=".8 0 .4" euler="40 30 0"/>
    <geom type="ellipsoid" size=".1 .3 .2" pos="-.8 -.4 .4" euler="10 60 20"/>
    <geom type="cylinder" size=".2 .3" pos="0 .9 .4" euler="70 0 30"/>
    <geom type="box" size=".2 .1 .3" pos="0 -.9 .4" euler="20 30 40"/>
    <geom type="mesh" mesh="wedge" pos=".9 .7 .4" euler="0 50 0"/>
    <geom type="sphere" size=".5" pos="0 0 1" group="3"/>
    <geom type="sphere" size=".5" pos="0 0 1" material="clear"/>
    <geom type="box" size=".1 .1 .1" pos=".9 -.8 .3" rgba="1 1 1 .4"/>
    <site name="mark" type="sphere" size=".15" pos=".3 -.4 .6"/>
    <camera name="above" pos="0 -1.8 2.2" xyaxes="1 0 0 0 .8 .6"/>
    <camera name="side" pos="2.5 .2 1" xyaxes="0 1 0 -.3 0 1" fovy="50"/>
    <camera name="sensor" pos="0 -1.8 2.2" xyaxes="1 0 0 0 .8 .6" resolution="96 96" sensorsize=".01 .01"
      focal=".009 .011" principal=".001 -.002"/>
    <camera name="flat" pos="0 -1.8 2.2" projection="orthographic"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def mujoco() -> Any:
    return pytest.importorskip("mujoco")


@pytest.fixture
def moment(mujoco: Any) -> tuple[Any, Any]:
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def interior(shown: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Where a pixel and its eight neighbours show the same."""
    padded = np.pad(shown, 1, mode="edge")
    shifts = [(y, x) for y in range(3) for x in range(3)]
    return np.all([padded[y : y + SIDE, x : x + SIDE] == shown for y, x in shifts], axis=0)


def rays(mujoco: Any, model: Any, data: Any, camera: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """What MuJoCo's rays meet: geom, and depth along the camera's axis, metres."""
    focal_px = SIDE / 2 / np.tan(np.radians(model.cam_fovy[camera]) / 2)
    right, down = np.meshgrid(*[(np.arange(SIDE) + 0.5 - SIDE / 2) / focal_px] * 2)
    directions = np.stack([right, -down, -np.ones_like(right)], -1) @ data.cam_xmat[camera].reshape(3, 3).T
    lengths = np.linalg.norm(directions, axis=-1)
    geoms, distances = np.zeros(SIDE * SIDE, np.int32), np.zeros(SIDE * SIDE)
    groups = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    unit = (directions / lengths[..., None]).reshape(-1, 1)
    position = data.cam_xpos[camera].reshape(3, 1)
    mujoco.mj_multiRay(model, data, position, unit, groups, 1, -1, geoms, distances, None, len(geoms), mujoco.mjMAXVAL)
    return geoms.reshape(SIDE, SIDE), distances.reshape(SIDE, SIDE) / lengths


@pytest.mark.parametrize("camera", ["above", "side"])
def test_depth_and_ids_are_those_of_rays(mujoco: Any, moment: tuple[Any, Any], camera: str) -> None:
    model, data = moment
    geoms, expected_m = rays(mujoco, model, data, model.camera(camera).id)
    arguments = {"camera": camera, "width": SIDE, "height": SIDE, "sites": False}
    depth_m, ids = stillroom.DepthCamera(model, depth="float32", **arguments).render(data, ids=True)
    inside = interior(geoms)
    assert inside.mean() > 0.6
    assert len(np.unique(geoms[inside])) >= 9, "nearly every kind of geom is compared"
    np.testing.assert_array_equal(ids[inside], geoms[inside])
    hit = inside & (geoms >= 0)
    off = np.abs(depth_m - expected_m)[hit] > np.maximum(1e-3, 1e-3 * expected_m[hit])
    # A thing can stand before itself.
    assert off.mean() < 0.003
    np.testing.assert_array_equal(depth_m[ids < 0], 0)
    depth_mm = stillroom.DepthCamera(model, **arguments).render(data)
    assert depth_mm.dtype == np.uint16
    assert np.abs(depth_mm - 1000 * depth_m).max() < 0.51


def test_sites_groups_and_transparency(moment: tuple[Any, Any]) -> None:
    model, data = moment
    _, ids = stillroom.DepthCamera(model, "above").render(data, ids=True)
    hidden = {i for i in range(model.ngeom) if model.geom_group[i] == 3 or model.geom_matid[i] >= 0}
    assert len(hidden) == 2
    assert not hidden & set(np.unique(ids))
    assert model.ngeom in ids, "the site"
    assert model.ngeom - 1 in ids, "half transparent"
    _, ids = stillroom.DepthCamera(model, "above", groups=[3]).render(data, ids=True)
    assert set(np.unique(ids)) == {-1, min(hidden)}


def test_poses_free_camera_and_batches(moment: tuple[Any, Any]) -> None:
    model, data = moment
    camera = stillroom.DepthCamera(model, "side", 64, 48)
    number = model.camera("side").id
    image = camera.render(data)
    assert image.shape == (48, 64)
    pose = stillroom.CameraPose(data.cam_xpos[number], data.cam_xmat[number].reshape(3, 3), fovy=50)
    np.testing.assert_array_equal(stillroom.DepthCamera(model, pose, 64, 48).render(data), image)
    np.testing.assert_array_equal(stillroom.DepthCamera(model, number, 64, 48).render(data), image)
    assert stillroom.DepthCamera(model).render(data).any()
    for threads in (1, 3):
        images, ids = camera.render_batch([data] * 5, threads=threads, ids=True)
        assert ids.shape == images.shape == (5, 48, 64)
        np.testing.assert_array_equal(images, np.stack([image] * 5))
    assert camera.render_batch([]).shape == (0, 48, 64)


def test_a_camera_with_a_sensor(moment: tuple[Any, Any]) -> None:
    model, data = moment
    number = model.camera("sensor").id
    position, rotation = data.cam_xpos[number], data.cam_xmat[number].reshape(3, 3)
    depth_m, ids = stillroom.DepthCamera(model, "sensor", SIDE, SIDE, depth="float32").render(data, ids=True)
    # Where the middle of the ball is seen on the sensor of .01 m.
    right, up, back = (data.geom_xpos[2] - position) @ rotation
    column = SIDE * (0.5 + (0.009 * right / -back - 0.001) / 0.01)
    row = SIDE * (0.5 - (0.011 * up / -back + 0.002) / 0.01)
    rows, columns = np.nonzero(ids == 2)
    assert abs(columns.mean() - column) < 1.5
    assert abs(rows.mean() - row) < 1.5
    assert abs(depth_m[round(row), round(column)] - (-back - 0.3)) < 0.02


def test_what_cannot_be_drawn_is_refused(mujoco: Any, moment: tuple[Any, Any]) -> None:
    model, _ = moment
    for arguments, words in [
        ({"camera": "none"}, "cameras are"),
        ({"camera": 9}, "camera is 9"),
        ({"camera": "flat"}, "orthographic"),
        ({"width": 0}, "width is 0"),
        ({"depth": "float64"}, "depth is"),
        ({"camera": stillroom.CameraPose((0, 0, 0), LEVEL, 180)}, "fovy is 180"),
    ]:
        with pytest.raises(ValueError, match=words):
            stillroom.DepthCamera(model, **arguments)
    cloth = """<mujoco><worldbody><body><freejoint/><flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1"
        mass="1" radius=".01"/></body></worldbody></mujoco>"""
    with pytest.raises(ValueError, match="flex"):
        stillroom.DepthCamera(mujoco.MjModel.from_xml_string(cloth))


def test_any_gymnasium_environment(mujoco: Any) -> None:
    env = stillroom.wrappers.Depth(gymnasium.make("InvertedPendulum-v5"), width=40, height=30, ids=True)
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert observation["depth"].shape == (30, 40)
    assert (observation["segmentation"] >= 0).any()
    observation, *_ = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation)
    vector = gymnasium.make_vec("InvertedPendulum-v5", num_envs=2, wrappers=[stillroom.wrappers.Depth])
    observations, _ = vector.reset(seed=1)
    assert observations["depth"].shape == (2, 224, 224)
    vector.close()
    with pytest.raises(ValueError, match="no MuJoCo model"):
        stillroom.wrappers.Depth(gymnasium.make("CartPole-v1"))


def test_a_scene_without_mujoco() -> None:
    scene = stillroom.Scene()
    box = scene.box((0.5, 0.5, 0.5))
    ball = scene.sphere(0.5)
    corners = [[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]
    card = scene.mesh(corners, [[0, 1, 2], [0, 2, 3]])
    hill = scene.height_field([[0.1, 0.1], [0.1, 0.1]], (0.5, 0.5))
    camera = stillroom.CameraPose((0, 0, 5), LEVEL, fovy=90)
    places = [(-2, 0, 0), (2, 0, 0), (0, 2, 0), (0, -2, 0)]
    depth_m, ids = scene.render(places, [LEVEL] * 4, camera, 101, 101, depth="float32")
    for thing, (x, y, _), expected_m in zip([box, ball, card, hill], places, [4.5, 4.5, 5, 4.9], strict=True):
        row, column = (round(50 - y * 10.1), round(50 + x * 10.1))
        assert ids[row, column] == thing
        assert abs(depth_m[row, column] - expected_m) < 0.06
    assert ids[0, 0] == -1
    assert depth_m[0, 0] == 0


def test_scenes_refuse_what_cannot_be() -> None:
    scene = stillroom.Scene()
    with pytest.raises(ValueError, match="above 0"):
        scene.sphere(0)
    with pytest.raises(ValueError, match="vertex 3"):
        scene.mesh(np.zeros((3, 3)), [[0, 1, 3]])
    with pytest.raises(ValueError, match="whole numbers"):
        scene.mesh(np.zeros((3, 3)), [[0, 1, -1]])
    with pytest.raises(ValueError, match="grid"):
        scene.height_field([[0.0, 1.0]], (1, 1))
    scene.plane()
    camera = stillroom.CameraPose((0, 0, 1), LEVEL)
    with pytest.raises(ValueError, match="needs 1 poses"):
        scene.render(np.zeros((0, 3)), np.zeros((0, 3, 3)), camera)
    with pytest.raises(ValueError, match="near is"):
        scene.render([(0, 0, 0)], [LEVEL], camera, near=0)
