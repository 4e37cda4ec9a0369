"""A report that people look at (HTML with pictures) and programs read (JSON), from the same data."""

import json
from dataclasses import asdict, dataclass, field
from math import isfinite
from pathlib import Path

from jinja2 import Environment, PackageLoader, select_autoescape


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of the report; `path` lies in the report's folder."""

    path: Path
    caption: str


@dataclass(frozen=True, slots=True)
class Measure:
    """One measured quantity beside the bound that it is held to, where there is one."""

    name: str
    value: float
    unit: str
    meaning: str
    bound: float | None = None  # at most


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of the way from plan to picture: what it took and how far it is from the truth."""

    title: str
    text: str
    wall_s: float
    rig_s: float | None = None  # time on the rig's clock, where devices took part
    measures: tuple[Measure, ...] = ()
    pictures: tuple[Picture, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """Everything that is told."""

    title: str
    introduction: str
    stages: tuple[Stage, ...]
    figures: dict[str, float]
    machine: dict[str, object]
    versions: dict[str, str] = field(default_factory=dict)


def write_report(report: Report, folder: Path) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` into the folder and return their paths."""
    environment = Environment(loader=PackageLoader("service"), autoescape=select_autoescape(), trim_blocks=True)
    html_path, json_path = folder / "report.html", folder / "report.json"
    page = environment.get_template("report.html").render(report=report, folder=folder)
    html_path.write_text(page, encoding="utf-8")
    json_path.write_text(json.dumps(_plain(asdict(report), folder), indent=2, allow_nan=False), encoding="utf-8")
    return html_path, json_path


def _plain(value: object, folder: Path) -> object:
    """The value as JSON has it: paths relative to the folder, and null for a number that is none."""
    match value:
        case dict():
            return {key: _plain(part, folder) for key, part in value.items()}
        case list() | tuple():
            return [_plain(part, folder) for part in value]
        case float():
            return value if isfinite(value) else None
        case Path():
            return value.relative_to(folder).as_posix()
    return value
