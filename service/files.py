"""Result files: whole under their name, or the earlier ones as they were."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

PART = ".part-"


@contextmanager
def replaced(out: Path) -> Iterator[Path]:
    """A path beside `out` to write to; on success what was written takes the place of `out`.

    Files of the same name with other endings, written beside it, go along. After a failure nothing has changed.
    Raises FileNotFoundError where the folder is missing.
    """
    check_folder(out)
    part = out.with_name(PART + out.name)
    try:
        yield part
        for written in _parts(part):
            written.replace(written.with_name(written.name.removeprefix(PART)))
    finally:
        for leftover in _parts(part):
            leftover.unlink()


@contextmanager
def filled(folder: Path) -> Iterator[Path]:
    """A folder to write to; on success what was written moves into `folder`, over files of the same names.

    After a failure nothing has changed. Raises FileNotFoundError where the folder that `folder` lies in is missing, and
    NotADirectoryError where `folder` is a file.
    """
    check_folder(folder)
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "it is a file, and results are a folder", str(folder))
    with TemporaryDirectory(prefix=PART, dir=folder.parent) as part:
        yield Path(part)
        for written in sorted(path for path in Path(part).rglob("*") if path.is_file()):
            target = folder / written.relative_to(part)
            target.parent.mkdir(parents=True, exist_ok=True)
            written.replace(target)


def check_new(folder: Path) -> None:
    """Raises FileExistsError where something lies there already, FileNotFoundError as `check_folder`.

    For results whose files do not mix with earlier ones: an array store of another shape, levels of another number.
    """
    check_folder(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(errno.EEXIST, "exists and is not empty; nothing was overwritten", str(folder))


def check_folder(out: Path) -> None:
    """Raises FileNotFoundError where the folder for `out` is missing: before anything is computed for it."""
    if not out.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "its folder does not exist", str(out))


def _parts(part: Path) -> list[Path]:
    return [path for path in part.parent.iterdir() if path.stem == part.stem]
