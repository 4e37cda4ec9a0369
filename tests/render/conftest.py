"""Fixtures of the renderer's tests: one OpenGL renderer for all of them, and materials made by formula."""

from collections.abc import Iterator

import pytest

from processing.products import FactoredBtf, SbrdfPlus, Srf
from render.errors import GlUnavailableError
from render.flat import FlatTexture
from render.opengl import GlRenderer
from tests.render import synthetic


@pytest.fixture(scope="session")
def gl() -> Iterator[GlRenderer]:
    """The renderer that shaders are tested on; without OpenGL there is nothing to compare."""
    try:
        renderer = GlRenderer()
    except GlUnavailableError as error:
        pytest.skip(str(error))
    yield renderer
    renderer.release()


@pytest.fixture(scope="session")
def srf() -> Srf:
    """A bumpy stone that repeats; its sides are no powers of two."""
    return synthetic.stone(height=96, width=120)


@pytest.fixture(scope="session")
def btf() -> FactoredBtf:
    """Bricks over 25 light and 25 view directions, rank 4."""
    return synthetic.bricks(texels=36, rank=4)


@pytest.fixture(scope="session")
def sbrdf() -> SbrdfPlus:
    """Three lobes, shadows, shifts and hidden points over 25 light and 25 view directions."""
    return synthetic.weave()


@pytest.fixture(scope="session")
def flat() -> FlatTexture:
    """A smooth coloured pattern."""
    return synthetic.pattern(64)
