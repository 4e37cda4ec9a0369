"""A sphere from above under lamps of the arc, and a body that is no sphere: from plan to products, against truth."""

from dataclasses import replace
from math import degrees

import numpy as np
import pytest

from processing.cameras.calibration import write_cameras
from processing.errors import CalibrationError
from processing.materials.measurements import sphere_measurements
from processing.materials.sight import sight_of_body
from processing.products import (
    AnisotropicPhong,
    BlinnPhong,
    LightStack,
    NormalMap,
    ReflectanceMaps,
    ResidualBasis,
    Srf,
    plane_points,
)
from render.mesh_file import load_mesh
from rig.config import load_config
from rig.sessions import Session, parse_plan
from service.capture import capture
from service.console import ConsoleProgress
from service.pipeline import process
from service.pipeline import srf as srf_pipeline
from service.pipeline.calibrations import CALIBRATION, CAMERAS
from service.pipeline.srf_model import model_for
from service.pipeline.stacks import stacks
from service.simulation import Simulation
from service.truth import srf_errors
from service.viewing import draw_product, shown_on
from tests.reference.lamp_rig import LampRig

CAMERA = "cam7"
DOME = {
    "kind": "srf", "camera": CAMERA, "lamps": ["lamp3", "lamp6"], "light_arc_deg": [-150, -30, 90],
    "exposures_s": [0.15], "sphere_radius_mm": 50,
    "card": {"y_mm": 64, "z_mm": 0, "width_mm": 11, "height_mm": 40, "reflectance": 0.9},
}  # fmt: skip
SHAPE = {name: value for name, value in DOME.items() if name != "sphere_radius_mm"} | {"sample": "figure"}


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A simulated rig, and a folder with cameras that are known to be true."""
    folder = tmp_path_factory.mktemp("dome")
    known = folder / "board" / "products" / CALIBRATION
    known.mkdir(parents=True)
    write_cameras(LampRig.of(1).cameras, known / CAMERAS)
    with Simulation(folder / "simulation", seed=1) as simulation:
        yield simulation, folder


def processed(lab, name, plan, calibrated):
    simulation, folder = lab
    config = load_config(simulation.rig_toml)
    capture(parse_plan(plan), config, folder / name, operator=simulation.mount, on_event=lambda event: None)
    with Session.open(folder / name) as session, ConsoleProgress() as progress:
        products = process(session, calibrated, progress)
        assert process(session, calibrated, progress) == products
    return products


def test_a_dome_gives_the_maps_and_the_srf_of_every_light(lab, monkeypatch):
    """The card is where the camera sees it, each lamp is read by itself, light comes from where it came."""
    monkeypatch.setattr(srf_pipeline, "MAP_SIZE", 64)  # a sixteenth of the time
    maps_folder, srf_folder = processed(lab, "dome", DOME, [lab[1] / "board"])
    maps, srf = ReflectanceMaps.load(maps_folder), Srf.load(srf_folder)
    with Session.open(lab[1] / "dome") as session:
        assert len(maps.reflectance_cos) == len(stacks(session.frames())) == 6
        errors = srf_errors(session, maps, srf, lab[0])
    brightness = np.nansum(maps.reflectance_cos, axis=(1, 2, 3)) / np.nansum(errors.truth, axis=(1, 2, 3))
    np.testing.assert_allclose(brightness, 1, atol=0.04)  # vignetting of 2 %, lamps half a degree from their labels
    assert errors.maps.median < 0.02
    assert errors.mse_over_phong < 0.7


def test_a_body_of_any_shape_gives_normals_and_a_surface_that_its_srf_is_drawn_on(lab):
    stack_folder, normals_folder, srf_folder = processed(lab, "shape", SHAPE, [lab[1] / "board"])
    stack, normals = LightStack.load(stack_folder), NormalMap.load(normals_folder)
    facing = {"sample": "figure", "card_elevation_deg": 88.0}
    true = np.load(lab[0].request("truth", what="normals", camera=CAMERA, at=facing)["path"])
    sight = sight_of_body(LampRig.of(1).cameras[CAMERA], np.zeros(3))
    places = plane_points(normals.status.shape, stack.pixel_m) * (1, -1, -1) / sight.radius_m
    column, row = np.moveaxis(np.rint(sight.image_points(places)).astype(int), -1, 0)
    cosine = (true[row, column] * normals.normals).sum(axis=-1)
    # Six lights, of which two or three are in shadow in the folds; the camera's axes are not quite the view's.
    assert degrees(np.nanmedian(np.arccos(np.clip(cosine, -1, 1)))) < 5
    assert np.isfinite(cosine).sum() > 0.7 * np.isfinite(true[row, column, 0]).sum()
    for folder in (stack_folder, normals_folder):
        assert "as measured" in draw_product(folder, lab[1] / f"{folder.name}.png", "", (), 64)
        assert (lab[1] / f"{folder.name}.png").stat().st_size > 10_000
    srf, mesh = shown_on(srf_folder, "")
    assert srf.residual.shape[1:3] == normals.status.shape
    assert load_mesh(srf_folder / "mesh.glb").positions.shape == mesh.positions.shape
    assert 0.07 < np.ptp(mesh.positions[:, 0]) < 0.10


def test_a_shape_without_a_calibrated_camera_is_told(lab):
    with pytest.raises(CalibrationError, match="name a calibrate session"):
        processed(lab, "uncalibrated", {**SHAPE, "light_arc_deg": [90], "lamps": ["lamp6"]}, [])


class Notes:
    def __init__(self):
        self.told = []

    def track(self, items, description):
        self.told.append(description)
        return iter(items)

    def note(self, text):
        self.told.append(text)


@pytest.mark.parametrize("lights", [np.eye(3)[[0, 1] * 20], np.eye(3)], ids=["in one plane", "few"])
def test_lights_that_tell_no_larger_basis_get_the_papers(lights):
    """Not even tried: there are no measurements to try it on."""
    notes = Notes()
    assert model_for(None, lights, notes) == (None, ResidualBasis.HALF)
    assert notes.told == []


def sphere_in_light(lobe, count, size=16):
    """Maps of a sphere of one lobe, without noise, under lights from all of the camera's side."""
    lights = fibonacci_lights(count)
    shape, distant = (count, size, size, 3), np.full(count, np.inf)
    variance = np.full(shape, 1e-6, np.float32)
    empty = ReflectanceMaps(np.zeros(shape, np.float32), variance, lights, distant, np.inf)
    value = -sphere_measurements(empty).delta(lobe).reshape(shape)
    return replace(empty, reflectance_cos=value.astype(np.float32))


def fibonacci_lights(count):
    z, azimuth = 1 - (np.arange(count) + 0.5) / count * 0.9, np.arange(count) * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), -z], axis=1)


def test_many_lights_show_a_brushed_material_and_it_is_told():
    brushed = AnisotropicPhong(np.full(3, 0.2), np.full(3, 0.3), np.array([50.0, 12.0]), 0.4)
    notes = Notes()
    fit = srf_pipeline.fit_material(sphere_in_light(brushed, 24), notes)
    np.testing.assert_allclose(fit.srf.phong.exponents, brushed.exponents, rtol=0.02)
    assert [text.split(":")[0] for text in notes.told] == [
        "choosing the residual basis",
        f"residual basis {fit.srf.basis}",
        "trying an anisotropic lobe",
        "anisotropic lobe",
    ]


def test_a_black_material_under_many_lights_is_no_error():
    maps = sphere_in_light(BlinnPhong(np.zeros(3), np.zeros(3), 1.0), 24, size=8)
    srf = srf_pipeline.fit_material(maps, Notes()).srf
    assert srf.basis is ResidualBasis.HALF
    assert not srf.phong.specular.any()
    assert not np.nan_to_num(srf.residual).any()


def test_maps_face_their_camera_however_it_is_tilted(lab):
    tilts_deg = set()
    for camera in load_config(lab[0].rig_toml).cameras.values():
        tilts_deg.add(camera.elevation_deg)
        c, s = np.cos(np.radians(camera.elevation_deg)), np.sin(np.radians(camera.elevation_deg))
        lifted = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        np.testing.assert_allclose(
            srf_pipeline.map_from_rig(camera) @ lifted, [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], atol=1e-12
        )
    assert len(tilts_deg) > 4
