"""What a relighting can be opened of: the scene files of a folder, and captured materials on a shape."""

from pathlib import Path

from processing.errors import ImageError
from processing.products.light_environment import KIND as ENVIRONMENT
from service.problems import NotFoundError
from service.relit_materials import ProductMaterial
from service.relit_scene import RelitScene, light_name, made_scene, open_scene
from service.scene_file import BodyTable, CameraTable, PrecomputationTable, SceneFile
from service.viewing import SHAPES, kind_of

PANORAMAS = (".exr", ".hdr")
_RADIUS_MM = 120.0  # of a shape, about
_FLOOR, _FLOOR_EDGE_MM = 2.5, 20.0  # half its side, in radii
_QUICK = PrecomputationTable(directions=8192, resolution=12)


class SceneFolder:
    """A folder of scene files and environments; sessions' environments are found in the folder of the sessions."""

    def __init__(self, folder: Path, sessions: Path) -> None:
        self._folder, self._sessions = folder, sessions

    def scenes(self) -> list[str]:
        """Names of the scene files."""
        return sorted(path.name for path in self._folder.glob("*.toml") if path.is_file())

    def environments(self) -> dict[str, Path]:
        """Light by its name: panoramas and products of the folder, and products of sessions."""
        places = sorted(self._folder.iterdir()) if self._folder.is_dir() else []
        products = [*places, *sorted(self._sessions.glob("*/products/*"))]
        found = [path for path in places if path.suffix.lower() in PANORAMAS and path.is_file()]
        found += [path for path in products if (path / "product.json").is_file() and _kind(path) == ENVIRONMENT]
        return {light_name(path): path for path in found}

    def open(self, name: str) -> RelitScene:
        """A scene by its file's name. Raises NotFoundError, and ConfigError as `open_scene` does."""
        if name not in self.scenes():
            known = ", ".join(self.scenes()) or "none"
            raise NotFoundError(f"no scene {name!r}; the folder {self._folder} has {known}.")
        return open_scene(self._folder / name)

    def with_product(self, product: Path, shape: str, environment: str) -> RelitScene:
        """A material on a shape that stands on a floor. Raises NotFoundError for an environment that is not there."""
        lights = self.environments()
        if environment not in lights:
            known = ", ".join(lights) or "none"
            raise NotFoundError(f"no environment {environment!r}; there is {known}.")
        others = [path for name, path in lights.items() if name != environment]
        return made_scene(_product_file(product, shape, [lights[environment], *others]), product)


def _product_file(product: Path, shape: str, lights: list[Path]) -> SceneFile:
    radius_m = _RADIUS_MM / 1e3
    lowest_m = radius_m * float(SHAPES[shape]().positions[:, 2].min())
    bodies = (
        BodyTable(name="floor", mesh="plane", scale=(_FLOOR * radius_m,) * 3, edge_mm=_FLOOR_EDGE_MM),
        BodyTable(
            name=shape, mesh=shape, scale=(radius_m,) * 3, place_mm=(0, 0, 1 - 1e3 * lowest_m), material=product.name
        ),
    )
    return SceneFile(
        environment=str(lights[0].resolve()),
        environments=tuple(str(path.resolve()) for path in lights[1:]),
        camera=CameraTable(),
        precomputation=_QUICK,
        materials={product.name: ProductMaterial(product=product.resolve())},
        body=bodies,
    )


def _kind(product: Path) -> str:
    try:
        return kind_of(product)
    except ImageError:
        return ""
