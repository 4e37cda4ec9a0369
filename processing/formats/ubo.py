"""Import of BTFs as the University of Bonn published them in 2003: a picture for each pair of directions.

A folder or a zip, in any folders, holds pictures of 8 bits whose names end in `tl015 pl060 tv030 pv090.jpg`, with
spaces, underscores or nothing between: polar angle and azimuth of the light, then of the view, in degrees. UBO2003 and
ATRIUM are named so, as is the BTF database of UTIA Prague.

What the names and values mean is not written in the files. Taken are, as public readers do:
- azimuths count from the right of the pictures counterclockwise, so the top row lies at +Y;
- values are sRGB of the radiance that the surface sends back under constant irradiance at normal incidence (UTIA says
  so of its pictures, and renderers of Bonn's undo a gamma by default), or linear where `encoding` says so;
- that radiance has the cosine to the light inside, and 1 is that of a perfect diffuser lit and seen from the normal,
  or of what `white` says. So reflectance = value / (pi white cos(theta_L)).
"""

import io
import re
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import BadZipFile, ZipFile, is_zipfile

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from processing.errors import ImageError
from processing.products import Provenance, StoredBtf
from processing.products.arrays import Float32, Float64
from processing.products.btf import describe, write_blocks
from processing.radiometry.display import linear_of_srgb
from processing.threads import in_parts

_NAME = re.compile(r"tl(\d+)[ _-]*pl(\d+)[ _-]*tv(\d+)[ _-]*pv(\d+)\.(?:jpe?g|png)$", re.IGNORECASE)
_EXAMPLE = "tl015 pl060 tv030 pv090.jpg"
_AGAIN = "Copy or download it again, or leave it out."

_UNREADABLE = (OSError, ValueError, SyntaxError, RuntimeError, BadZipFile, zlib.error, Image.DecompressionBombError)
_CODES = np.arange(256) / 255

Angles = tuple[int, int]
Read = Callable[[], bytes]
Report = Callable[[int, int], None]


class Encoding(StrEnum):
    """What the values of the pictures are of the radiance."""

    SRGB = "srgb"
    LINEAR = "linear"


_LINEAR = {Encoding.SRGB: linear_of_srgb(_CODES), Encoding.LINEAR: _CODES}


@dataclass(frozen=True)
class UboOptions:
    """How pictures become reflectance, and which part of them.

    `white` is the linear value, 1 for the brightest, of a perfect diffuser lit and seen from the normal; `region` (top,
    left, rows, columns) in pixels is cut out first, then averaged down to `size` (rows, columns). Raises ImageError for
    a white that is not above 0.
    """

    encoding: Encoding = Encoding.SRGB
    white: float = 1.0
    region: tuple[int, int, int, int] | None = None
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if not self.white > 0:
            raise ImageError(f"the value of white is {self.white:g}; it lies above 0, and 1 is the brightest.")


AS_PUBLISHED = UboOptions()


def _say_nothing(read: int, count: int) -> None:
    """No report."""


def import_ubo(
    source: Path, folder: Path, options: UboOptions = AS_PUBLISHED, report: Report = _say_nothing
) -> StoredBtf:
    """Make a stored `btf` in `folder`, which must be new or empty, of a folder or zip of pictures.

    Directions come sorted by polar angle, then azimuth; pairs without a picture are NaN, as are lights that do not
    stand above the surface. At most 64 pictures are in memory at a time. `report` is told pictures read and their
    number. The share of pixels at the brightest value, which may be cut off, is among the provenance's parameters.

    Raises ImageError that says what to do where nothing is named so, two pictures are of the same directions, one is
    damaged, deeper than 8 bits or of another size, the region lies outside or the folder is in use; then nothing is
    left behind.
    """
    with _opened(source) as pictures:
        btf = _Pictures.of(source, pictures, options)
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise ImageError(f"{folder}: exists already; name a folder that is new or empty.")
        folder.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".part-", dir=folder.parent) as part:
            made = Path(part) / "btf"
            made.mkdir()
            btf.write(made, report)
            if folder.exists():
                folder.rmdir()
            made.rename(folder)
    return StoredBtf.open(folder)


@contextmanager
def _opened(source: Path) -> Iterator[dict[str, Read]]:
    """Readers of all files of a folder or zip by name, in the order of their names."""
    if source.is_dir():
        paths = sorted(path for path in source.rglob("*") if path.is_file())
        yield {path.relative_to(source).as_posix(): path.read_bytes for path in paths}
        return
    if not source.is_file() or not is_zipfile(source):
        raise ImageError(
            f"{source}: neither a folder nor a zip of pictures. Unpack other archives, then name the folder."
        )
    try:
        archive = ZipFile(source)
    except (OSError, BadZipFile) as error:
        raise ImageError(f"{source}: not a whole zip ({error}). {_AGAIN}") from error
    with archive:
        yield {name: partial(archive.read, name) for name in sorted(archive.namelist())}


@dataclass(frozen=True, eq=False)
class _Pictures:
    """The pictures of a BTF: readers by the place of their directions (light, view), and what becomes of them."""

    source: Path
    lights: list[Angles]
    views: list[Angles]
    named: dict[tuple[int, int], tuple[str, Read]]
    shape: tuple[int, int]
    options: UboOptions

    @classmethod
    def of(cls, source: Path, pictures: dict[str, Read], options: UboOptions) -> "_Pictures":
        """Sort them by their names. Raises ImageError as `import_ubo` says."""
        pairs = _pairs(source, pictures)
        lights, views = (sorted({pair[i] for pair in pairs}) for i in (0, 1))
        named = {(lights.index(a), views.index(b)): (name, pictures[name]) for (a, b), name in pairs.items()}
        first, read = next(iter(named.values()))
        shape = _codes(f"{source}: {first}", read).shape[:2]
        _check_part(source, shape, options)
        return cls(source, lights, views, named, shape, options)

    def write(self, folder: Path, report: Report) -> None:
        """Store the BTF, at most 64 pictures at a time."""
        rows, columns = self.options.size or (self.options.region or (0, 0, *self.shape))[2:]
        shares: list[float] = []

        def block(lights: slice, views: slice) -> Float32:
            found = np.full(
                (lights.stop - lights.start, views.stop - views.start, rows, columns, 3), np.nan, np.float32
            )
            shares.extend(self._fill(found, (lights.start, views.start)))
            report(len(shares), len(self.named))
            return found

        write_blocks(folder, (len(self.lights), len(self.views), rows, columns, 3), block)
        told: dict[str, Any] = {"pictures": len(shares), "brightest": float(np.mean(shares)), **asdict(self.options)}
        describe(folder, (_vectors(self.lights), _vectors(self.views)), Provenance((self.source.name,), "", told))

    def _fill(self, block: Float32, first: tuple[int, int]) -> list[float]:
        """Put pictures into a block (light, view, y, x, 3) that starts at a place; their shares of brightest pixels."""
        inside = [(n, m) for n, m in np.ndindex(block.shape[:2]) if (first[0] + n, first[1] + m) in self.named]
        shares = [0.0] * len(inside)

        def fill(start: int, stop: int) -> None:
            for i in range(start, stop):
                n, m = inside[i]
                block[n, m], shares[i] = self._reflectance((first[0] + n, first[1] + m))

        in_parts(fill, len(inside), 1)
        return shares

    def _reflectance(self, place: tuple[int, int]) -> tuple[Float32, float]:
        """Of one picture (y, x, 3), and the share of pixels whose value is the brightest that there is."""
        name, read = self.named[place]
        codes = _codes(f"{self.source}: {name}", read)
        if codes.shape[:2] != self.shape:
            raise ImageError(
                f"{self.source}: {name} has {_size(codes.shape)} pixels, those before it {_size(self.shape)}; all "
                "pictures of a BTF are of one size. Leave out those that do not belong to it."
            )
        if self.options.region:
            top, left, rows, columns = self.options.region
            codes = codes[top : top + rows, left : left + columns]
        polar_deg = self.lights[place[0]][0]
        cosine = np.cos(np.radians(polar_deg)) if polar_deg < 90 else np.nan
        linear = (_LINEAR[self.options.encoding] / (np.pi * self.options.white * cosine)).astype(np.float32)[codes]
        if self.options.size:
            linear = np.asarray(cv2.resize(linear, self.options.size[::-1], interpolation=cv2.INTER_AREA), np.float32)
        return linear, float((codes == 255).any(axis=-1).mean())


def _pairs(source: Path, names: Iterable[str]) -> dict[tuple[Angles, Angles], str]:
    """Names of the pictures by polar angle and azimuth of light and view, in degrees."""
    found: dict[tuple[Angles, Angles], str] = {}
    for name in names:
        match = _NAME.search(name)
        if not match or PurePosixPath(name).name.startswith("."):  # what some systems add to a zip
            continue
        light_polar, light_azimuth, view_polar, view_azimuth = (int(angle) for angle in match.groups())
        pair = _angles(light_polar, light_azimuth), _angles(view_polar, view_azimuth)
        if pair in found:
            raise ImageError(f"{source}: {found[pair]} and {name} are of the same directions. Leave one of them out.")
        found[pair] = name
    if not found:
        raise ImageError(
            f"{source}: no picture has a name that ends like {_EXAMPLE} (polar angle and azimuth of the light, then of "
            "the view, in degrees). Name the folder or zip of one BTF with its pictures, as UBO2003 has them."
        )
    return found


def _angles(polar_deg: int, azimuth_deg: int) -> Angles:
    """Every azimuth is the same at the top."""
    return polar_deg, azimuth_deg % 360 if polar_deg else 0


def _vectors(angles: list[Angles]) -> Float64:
    """Unit vectors (n, 3) of polar angles and azimuths."""
    polar, azimuth = np.radians(np.array(angles, np.float64)).T
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)


def _codes(name: str, read: Read) -> NDArray[np.uint8]:
    """A picture as it is stored (y, x, 3)."""
    try:
        with Image.open(io.BytesIO(read())) as picture:
            if picture.mode[0] in "IF":
                raise ImageError(f"{name}: more than 8 bits. Save the pictures with 8 bits per channel.")
            return np.asarray(picture.convert("RGB"))
    except _UNREADABLE as error:
        raise ImageError(f"{name}: not a whole picture ({error}). {_AGAIN}") from error


def _check_part(source: Path, shape: tuple[int, ...], options: UboOptions) -> None:
    top, left, rows, columns = options.region or (0, 0, *shape)
    if min(top, left) < 0 or min(rows, columns) < 1 or top + rows > shape[0] or left + columns > shape[1]:
        raise ImageError(
            f"{source}: a region of {rows} x {columns} pixels from row {top} and column {left} reaches beyond the "
            f"{_size(shape)} pixels of the pictures."
        )
    size = options.size or (rows, columns)
    if min(size) < 1 or size[0] > rows or size[1] > columns:
        raise ImageError(f"{source}: {_size((rows, columns))} pixels cannot be averaged down to {_size(size)}.")


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[0]} x {shape[1]}"
