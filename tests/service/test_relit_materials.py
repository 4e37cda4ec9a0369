"""Materials as scene files describe them: each becomes its reflectance, and what is none is told in one sentence."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from processing.errors import ImageError
from processing.lighting import brdfs
from processing.lighting.brdfs import BrdfKind
from processing.products.blinn_phong import BlinnPhong
from processing.products.light_environment import Environment
from processing.products.srf import Srf
from service.relit_materials import Material, material_brdf
from tests.reference.merl import SHAPE, write_merl
from tests.reference.sbrdf_plus import product

MATERIAL = TypeAdapter(Material)
RED = [0.5, 0.2, 0.1]
WAYS = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.8, 0.6]])


def made(table, folder=None):
    return material_brdf(MATERIAL.validate_python(table), *([folder] if folder else []))


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ({"kind": "lambert", "albedo": RED}, brdfs.lambert(RED)),
        ({"kind": "blinn_phong", "diffuse": RED, "specular": RED, "exponent": 20}, brdfs.blinn_phong(RED, RED, 20)),
        ({"kind": "ward", "diffuse": RED, "specular": RED, "roughness": [0.1, 0.3]}, brdfs.ward(RED, RED, (0.1, 0.3))),
        ({"kind": "ggx", "diffuse": RED, "normal_reflectance": RED, "roughness": 0.4}, brdfs.ggx(RED, RED, 0.4)),
    ],
)
def test_models_are_made_of_their_numbers(table, expected):
    found = made(table)
    assert found.kind is expected.kind
    assert np.array_equal(found.parameters, expected.parameters)


def test_an_srf_is_relit_by_its_lobe(tmp_path):
    lobe = BlinnPhong(np.array(RED), np.full(3, 0.3), 12.0)
    Srf(np.zeros((3, 2, 2, 3), np.float32), lobe, wrap=True).save(tmp_path / "srf")
    found = made({"product": "srf"}, tmp_path).evaluate(WAYS, WAYS[::-1])
    assert np.allclose(found * WAYS[:, 2:], lobe.evaluate(WAYS, WAYS[::-1]))


def test_an_sbrdf_plus_is_relit_by_the_mean_of_its_texels(tmp_path):
    """Where one texel without shifts and hidden points is all there is, that is what it evaluates to."""
    one = product(3, height=1, width=1, hidden=0.0, centres=0)
    one = replace(one, shadow=np.full_like(one.shadow, 0.5), shift=np.zeros_like(one.shift))
    one.save(tmp_path / "analysed")
    light = one.lights.directions[:5].astype(float)
    view = one.views.directions[1:6].astype(float)
    expected = one.evaluate(np.full((5, 2), 0.5), light, view) / light[:, 2:]
    assert np.allclose(made({"product": "analysed"}, tmp_path).evaluate(light, view), expected, rtol=0.01)


def test_a_merl_file_is_a_table(tmp_path):
    write_merl(tmp_path / "grey.binary", np.full((*SHAPE, 3), 0.25))
    found = made({"merl": "grey.binary"}, tmp_path)
    assert found.kind is BrdfKind.TABLE
    assert np.allclose(found.evaluate(WAYS, WAYS[::-1]), 0.25)


def test_products_without_a_mean_are_refused(tmp_path):
    Environment(np.ones((6, 2, 2, 3), np.float32)).save(tmp_path / "place")
    with pytest.raises(ImageError, match=r"product `environment` has no mean .* srf and sbrdf_plus have"):
        made({"product": "place"}, tmp_path)
    with pytest.raises(ImageError, match="not a product"):
        made({"product": "absent"}, tmp_path)
    with pytest.raises(ImageError, match="not a readable MERL file"):
        made({"merl": "absent.binary"}, tmp_path)


@pytest.mark.parametrize(
    ("table", "where", "message"),
    [
        ({"albedo": RED}, (), "`kind` .lambert, blinn_phong, ward or ggx., `product` or `merl`"),
        ({"kind": "velvet"}, (), "`kind` .lambert"),
        ("red", (), "`kind` .lambert"),
        ({"kind": "lambert", "albedo": [0.5, 1.2, 0.1]}, ("lambert", "albedo", 1), "less than or equal to 1"),
        ({"kind": "lambert", "albedo": [0.5, float("nan"), 0.1]}, ("lambert", "albedo", 1), "finite"),
        ({"kind": "lambert"}, ("lambert", "albedo"), "required"),
        ({"kind": "ggx", "diffuse": RED, "normal_reflectance": RED, "roughness": 0}, ("ggx", "roughness"), "0.03"),
        ({"merl": "a.binary", "product": "b"}, ("product", "merl"), "Extra"),
    ],
)
def test_what_is_no_material_is_told_with_its_field(table, where, message):
    with pytest.raises(ValidationError, match=message) as caught:
        MATERIAL.validate_python(table)
    assert caught.value.errors()[0]["loc"] == where
