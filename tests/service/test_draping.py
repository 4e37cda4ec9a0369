"""A draped SRF is a product with its mesh: previews draw it, and it fits nothing else."""

import numpy as np
import pytest

from processing.errors import ImageError
from processing.products import Srf
from render.errors import MeshError
from render.mesh_file import load_mesh, save_mesh
from render.shapes import torus
from service.draping import drape_product
from service.viewing import draw_product, lights_of
from tests.render.synthetic import stone

LIGHTS = lights_of(40.0, 45.0, None)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A stone, a mesh, and the one over the other."""
    folder = tmp_path_factory.mktemp("workshop")
    stone(40, 40).save(folder / "stone")
    save_mesh(folder / "ring.glb", torus(shape=(8, 20)))
    said = drape_product(folder / "stone", str(folder / "ring.glb"), folder / "worn", 1.5, 160)
    assert "320 triangles" in said
    return folder


def test_product_is_an_srf_that_says_what_it_was_made_of(workshop):
    worn, stone_ = Srf.load(workshop / "worn"), Srf.load(workshop / "stone")
    assert worn.phong.as_dict() == stone_.phong.as_dict()
    assert worn.basis is stone_.basis
    made_with = worn.provenance.parameters["skin"]
    assert made_with == {"mesh": "ring.glb", "repeats": 1.5, "size": 160, "seed": 0}
    mesh = load_mesh(workshop / "worn" / "mesh.glb")
    assert (mesh.uv >= 0).all()
    assert (mesh.uv <= 1).all()


def test_preview_draws_it_on_its_mesh(workshop):
    said = draw_product(workshop / "worn", workshop / "worn.png", "", LIGHTS, 64)
    assert "drawn by" in said
    assert (workshop / "worn.png").stat().st_size > 1000


def test_it_fits_no_other_mesh(workshop):
    with pytest.raises(ImageError, match="leave --shape out"):
        draw_product(workshop / "worn", workshop / "no.png", "torus", LIGHTS, 64)
    with pytest.raises(ImageError, match="name a picture"):
        draw_product(workshop / "worn", workshop / "no", "", LIGHTS, 64)
    with pytest.raises(ImageError, match="the SRF that it was made from"):
        drape_product(workshop / "worn", "vase", workshop / "twice", 1.5, 160)
    assert not (workshop / "no").exists()
    assert not (workshop / "twice").exists()


def test_nothing_is_written_where_something_is_wrong(workshop):
    with pytest.raises(MeshError, match="no such file"):
        drape_product(workshop / "stone", "nowhere.obj", workshop / "new", 1.5, 160)
    with pytest.raises(ImageError, match="draw it wider"):
        drape_product(workshop / "stone", str(workshop / "ring.glb"), workshop / "new", 50.0, 160)
    with pytest.raises(FileNotFoundError):
        drape_product(workshop / "stone", "vase", workshop / "missing" / "new", 1.5, 160)
    assert not (workshop / "new").exists()


def test_skin_from_before_stays_until_the_new_one_is_there(workshop, monkeypatch):
    before = {path.name: path.read_bytes() for path in (workshop / "worn").iterdir()}

    def cut_off(srf, folder):
        (folder / "srf.exr").write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(Srf, "save", cut_off)
    with pytest.raises(KeyboardInterrupt):
        drape_product(workshop / "stone", str(workshop / "ring.glb"), workshop / "worn", 1.5, 160, seed=1)
    assert {path.name: path.read_bytes() for path in (workshop / "worn").iterdir()} == before
    assert not list(workshop.glob(".part-*"))


def test_sample_is_not_written_over_nor_a_file_taken_for_a_folder(workshop):
    with pytest.raises(ImageError, match="name another folder"):
        drape_product(workshop / "stone", "vase", workshop / "worn" / ".." / "stone", 1.5, 160)
    with pytest.raises(NotADirectoryError, match="results are a folder"):
        drape_product(workshop / "stone", "vase", workshop / "ring.glb", 1.5, 160)


def test_normals_of_the_mesh_survive(workshop):
    """Charts cut the mesh where it is round: shading must not show that."""
    before, after = load_mesh(workshop / "ring.glb"), load_mesh(workshop / "worn" / "mesh.glb")
    at = {tuple(p): n for p, n in zip(before.positions.round(5), before.normals, strict=True)}
    others = np.array([at[tuple(p)] for p in after.positions.round(5)])
    np.testing.assert_allclose(after.normals, others, atol=1e-5)
