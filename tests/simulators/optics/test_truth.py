import json
from functools import partial
from math import radians
from pathlib import Path

import numpy as np
import pytest

from simulators.lens import project
from simulators.optics import Optics

TEXELS = 48
SIDE_M = 0.054  # the opening of 60 mm less a margin of 3 mm on each side


def _array(answer, key: str = "path") -> np.ndarray:
    return np.load(answer[key])


@pytest.mark.parametrize("plane_m", [0.0, 0.001])
@pytest.mark.parametrize(("camera", "turntable_rad"), [("cam7", 0.0), ("cam3", 0.7), ("cam1", -1.9)])
def test_displacement_leads_from_the_plane_to_the_surface(optics, studio, pose, camera, turntable_rad, plane_m):
    """Start on z = 0 where the texel's ray crosses it, go that far along: there is the surface, and nothing before."""
    here = pose(sample="brick", turntable_rad=turntable_rad)
    depth = _array(optics.truth("displacement", here, camera=camera, texels=TEXELS, depth_m=plane_m))
    assert np.all(depth > 0)
    grid = (np.arange(TEXELS) + 0.5) / TEXELS * SIDE_M - SIDE_M / 2
    x, y = np.meshgrid(grid, -grid)
    texel = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -plane_m)])
    eye = studio.to_scene(here, optics.layout.cameras[camera].rig_from_camera[:3, 3])
    way = (texel - eye) / np.linalg.norm(texel - eye, axis=1, keepdims=True)
    start = texel - texel[:, 2:] / way[:, 2:] * way
    brick = studio.scene("brick")

    def above(share: float) -> np.ndarray:
        points = start + share * depth.ravel()[:, None] * way
        return points[:, 2] - brick.sample.heights(points[:, 0], points[:, 1])

    end = start + depth.ravel()[:, None] * way
    on_relief = np.max(np.abs(end[:, :2]), axis=1) < 0.03 - 1e-9
    assert on_relief.mean() > 0.7
    assert np.abs(above(1.0)[on_relief]).max() < 1e-8
    for share in np.linspace(0.0, 0.99, 60):
        assert above(share)[on_relief].min() > -2e-6  # how far a ray may graze a bump between two of its steps


def test_displacement_points_project_into_their_own_pixels(optics, pose):
    """The camera sees at those pixels what the texels' rays hit: compared with the pixels' own first hits."""
    here = pose(sample="brick", turntable_rad=0.4)
    points = _array(optics.truth("displacement", here, camera="cam6", texels=TEXELS), "points_path").reshape(-1, 3)
    seen = _array(optics.truth("points", here, camera="cam6"))
    uv = np.rint(project(optics.layout.cameras["cam6"], points)).astype(int)
    distance = np.linalg.norm(seen[uv[:, 1], uv[:, 0]] - points, axis=1)
    assert np.median(distance) < 0.0005  # a pixel is 0.5 mm wide


def test_truth_of_another_rig_in_the_same_folder_is_its_own(pose, tmp_path):
    """What an earlier run left there, whole or broken off, is neither told again nor overwritten by another rig's."""
    here = pose(sample="white")
    first = Optics(1, "small", tmp_path).truth("radiance", here, camera="cam1")["path"]
    other = Optics(2, "small", tmp_path).truth("radiance", here, camera="cam1")["path"]
    whole = np.load(first)
    assert np.any(np.load(other) != whole)
    Path(first).write_bytes(Path(first).read_bytes()[:100])
    again = Optics(1, "small", tmp_path).truth("radiance", here, camera="cam1")["path"]
    np.testing.assert_array_equal(np.load(again), whole)


def test_lit_texels_are_those_the_laser_reaches(optics, studio, pose):
    here = pose(sample="brick", light_arc_rad=radians(120))
    answer = optics.truth("displacement", here, camera="cam5", texels=TEXELS)
    lit = _array(answer, "lit_path")
    assert 0.5 < lit.mean() < 1
    swept = pose(sample="brick", light_arc_rad=radians(120), laser_on=True, laser_sweep=(0.6, 1.2))
    rate = optics.laser_rate("cam5", swept)
    uv = np.rint(project(optics.layout.cameras["cam5"], _array(answer, "points_path").reshape(-1, 3))).astype(int)
    bright = rate[uv[:, 1], uv[:, 0]] > 0
    assert (
        np.mean(bright == lit.ravel()) > 0.9
    )  # they differ at shadow edges: texel centre and pixel centre are two points


def test_the_btf_of_white_is_albedo_over_pi(optics, pose):
    for lamp, camera in (("lamp0", "cam7"), ("lamp5", "cam0"), ("lamp7", "cam3")):
        image = _array(optics.truth("btf", pose(light_arc_rad=2.0), camera=camera, lamp=lamp, texels=16))
        np.testing.assert_allclose(image, 0.9 / np.pi, rtol=1e-3)


def test_the_btf_under_the_horizon_is_missing(optics, pose):
    image = _array(optics.truth("btf", pose(sample="brick"), camera="cam7", lamp="led", texels=8))
    assert np.isnan(image).all()


def test_the_btf_of_texels_under_the_opening_is_moved_toward_the_camera(optics, pose):
    """Seen from 30 deg over the horizon at azimuth 0, what lies a texel's tan 30 deg deep crosses z = 0 a texel on."""
    texels = 24
    depth_m = SIDE_M / texels * np.tan(np.radians(30))
    truth = partial(optics.truth, "btf", pose(sample="brick", light_arc_rad=2.0), camera="cam1", lamp="lamp6")
    level, deep = (_array(truth(texels=texels, depth_m=depth)) for depth in (0.0, depth_m))
    moved, stayed = (np.abs(deep[:, :-1] - other).mean() for other in (level[:, 1:], level[:, :-1]))
    assert moved < 0.2 * stayed  # the camera is a metre away: the elevation changes by 2 deg over the sample


def test_the_btf_predicts_the_picture(optics, pose):
    """A frame of brick over a frame of white, at the texels' pixels, is the BTF over white's, on average."""
    texels = 96
    here = pose(sample="brick", lamps=(("lamp6", 1.0),))
    image = _array(optics.truth("btf", here, camera="cam7", lamp="lamp6", texels=texels))
    brick = optics.rate("cam7", here) - optics.rate("cam7", pose(sample="brick"))
    white = optics.rate("cam7", pose(lamps=(("lamp6", 1.0),))) - optics.rate("cam7", pose())
    grid = (np.arange(texels) + 0.5) / texels * SIDE_M - SIDE_M / 2
    x, y = np.meshgrid(grid, -grid)
    uv = np.rint(project(optics.layout.cameras["cam7"], np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])))
    column, row = uv.astype(int).T
    ratio = brick[row, column] / white[row, column] * 0.9 / np.pi
    channel = row % 2 + column % 2
    for k in range(3):
        picked, true = ratio[channel == k], image.reshape(-1, 3)[channel == k, k]
        assert np.corrcoef(picked, true)[0, 1] > 0.8  # pixel and texel cover different areas
        # the texture varies by half its mean; of each of 2000 texels and more that leaves 1.2 %
        assert picked.mean() == pytest.approx(image[..., k].mean(), rel=0.03)


def test_reflectance_maps_agree_with_the_picture(optics, pose):
    """Each cell's value against the green pixel that its point of the sphere is projected to."""
    size, arm_rad = 65, radians(30)
    answer = optics.truth("srf", pose(), lights=[("led", 30.0), ("led", -20.0)], size=size)
    maps = _array(answer)
    assert maps.shape == (2, size, size, 3)
    lit = pose(sample="sphere", arm_rad=arm_rad, lamps=(("led", 1.0),))
    rate = optics.rate("front", lit) - optics.rate("front", pose(sample="sphere", arm_rad=arm_rad))
    camera = optics.layout.cameras["front"]
    grid = (np.arange(size) + 0.5) * 2 / size - 1
    q, p = np.meshgrid(grid, grid, indexing="ij")
    normals = np.stack([p, q, -np.ones_like(p)], axis=-1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = 0.05 * normals @ camera.rig_from_camera[:3, :3].T
    column, row = np.rint(project(camera, points)).astype(int).T
    green = ((row % 2 + column % 2) == 1) & (normals[:, 2] < -0.8)
    led, source = optics.layout.lamps["led"], optics.layout.lamp_position("led", 0.0, arm_rad)
    irradiance = led.gains[1] * led.distance_m**2 / np.sum((source - points[green]) ** 2, axis=1)
    predicted = maps[0].reshape(-1, 3)[green, 1] * irradiance * 60000 * np.pi / 0.9
    measured = rate[row, column][green]
    assert np.corrcoef(predicted, measured)[0, 1] > 0.95
    assert measured.mean() == pytest.approx(predicted.mean(), rel=0.02)


def test_the_limb_of_the_truth_is_that_of_a_long_lens(optics, pose):
    answer = optics.truth("srf", pose(), lights=[("led", 30.0)], size=9)
    camera = optics.layout.cameras["front"]
    assert answer["radius_px"] == pytest.approx(camera.matrix[0, 0] * 0.05 / 1.1, rel=5e-3)


def test_records_tell_cameras_lamps_laser_and_board(optics, pose):
    here = pose(sample="charuco", board_pose=2, lamps=(("lamp1", 0.5),), laser_on=True, laser_sweep=(0.8, 0.81))
    cameras = json.loads(Path(optics.truth("cameras", here)["path"]).read_text())
    np.testing.assert_allclose(cameras["cam2"]["rig_from_camera"], optics.layout.cameras["cam2"].rig_from_camera)
    lamps = optics.truth("lamps", here)["lamps"]
    assert lamps["lamp1"]["level"] == 0.5
    np.testing.assert_allclose(
        lamps["lamp1"]["position_m"], optics.layout.lamp_position("lamp1", here.light_arc_rad, 0.0)
    )
    # a perfect diffuser 1 m away against white of albedo 0.9 at 0.9 m, which gives 60 000 e-/s at nominal strength
    gain = lamps["lamp1"]["intensity_e_s"][1] / (60000 / 0.9 * 0.9**2)
    assert gain == pytest.approx(optics.layout.lamps["lamp1"].gains[1])
    laser = optics.truth("laser", here)["laser"]
    source = np.array(laser["source_m"])
    for plane in laser["planes"]:
        assert np.dot(plane["normal"], source) == pytest.approx(plane["offset_m"])
    board = optics.truth("board", here)["board"]
    np.testing.assert_allclose(board["rig_from_board"], optics.layout.rig_from_board(2), atol=1e-12)
    assert "radiance" in optics.truth("radiance", here, camera="cam2")["path"]


def test_truth_of_a_sensor_is_what_its_frames_are_made_with(optics, pose, studio):
    told = optics.truth("sensor", pose(), camera="cam5")
    unit = studio.sensor("cam5")
    assert told["sensor"]["serial"] == "VC-0005"
    assert told["sensor"]["gain_e_per_dn"] == unit.sensor.gain_e_per_dn
    assert json.loads(Path(told["path"]).read_text()) == told["sensor"]
    np.testing.assert_array_equal(np.load(told["offset_path"]), unit.offset_dn)
    field = optics.rate("cam5", pose(sample="lightbox")) - np.load(told["dark_path"])
    ratio = field[::2, ::2] / np.load(told["flat_path"])[::2, ::2]
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=2e-3)  # under a hot pixel float32 has fewer digits
