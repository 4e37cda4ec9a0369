"""The text of rig.toml: what the labels of the rig's parts say, in degrees and millimetres."""

import json
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from simulators.layout import (
    AxisLayout,
    BoardLayout,
    CameraLayout,
    HolderLayout,
    LampLayout,
    LaserLayout,
    Layout,
)
from simulators.phone import FIELD_DEG, PhoneLayout


def rig_toml(
    layout: Layout, phone: PhoneLayout, *, serial: Mapping[str, str], cameras: Mapping[str, str], clock: str
) -> str:
    """The text of rig.toml: nominal numbers, and where each device is reached.

    `serial` gives the ports of `bus`, `dmx` and `tower`, `cameras` host:port per camera name, `clock` the control port.
    """
    tables = [
        'name = "simulated rig"\n',
        _holder_table(layout.holder),
        _board_table(layout.board),
        _table("bus", port=serial["bus"]),
        *(_axis_table(name, axis) for name, axis in layout.axes.items()),
        _table("lamps", port=serial["dmx"]),
        *(_lamp_table(name, lamp) for name, lamp in layout.lamps.items()),
        *(_camera_table(name, camera, cameras[name]) for name, camera in layout.cameras.items()),
        _phone_table(phone, cameras[phone.name]),
        _laser_table(layout.laser, serial["tower"]),
        _table("clock", address=clock),
    ]
    return "".join(tables)


def _mm(length_m: float) -> float:
    return round(length_m * 1e3, 6)


def _deg(angle_rad: float) -> float:
    return round(float(np.degrees(angle_rad)), 9)


def _table(name: str, **values: object) -> str:
    """A table of a TOML file; texts, numbers and lists of them are written as JSON writes them."""
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in values.items()]
    return "\n".join([f"[{name}]", *lines, ""])


def _holder_table(holder: HolderLayout) -> str:
    return _table(
        "holder",
        sample_mm=_mm(holder.opening_m),
        margin_mm=_mm(holder.margin_m),
        inner_mm=_mm(holder.upper_m),
        outer_mm=_mm(holder.lower_m),
        step_mm=_mm(holder.step_m),
        sample_depth_mm=_mm(holder.depth_m),
        white_reflectance=holder.albedo,
    )


def _board_table(board: BoardLayout) -> str:
    return _table(
        "board",
        columns=board.columns,
        rows=board.rows,
        square_mm=_mm(board.square_m),
        marker_mm=_mm(board.marker_m),
        dictionary=board.dictionary,
    )


def _axis_table(name: str, axis: AxisLayout) -> str:
    return _table(f"axes.{name}", **asdict(axis))


def _lamp_table(name: str, lamp: LampLayout) -> str:
    return _table(
        f"lamps.lamp.{name}",
        channel=lamp.channel,
        mount=lamp.mount,
        elevation_deg=_deg(lamp.elevation_rad),
        distance_mm=_mm(lamp.distance_m),
    )


def _camera_table(name: str, camera: CameraLayout, address: str) -> str:
    return _table(
        f"cameras.{name}",
        address=address,
        serial=camera.serial,
        mount=camera.mount,
        elevation_deg=_deg(camera.elevation_rad),
        distance_mm=_mm(camera.distance_m),
        megabytes_per_s=camera.megabytes_per_s,
        frame_megabytes=round((2 * camera.width_px * camera.height_px + 1000) / 1e6, 6),
    )


def _phone_table(phone: PhoneLayout, address: str) -> str:
    return _table(
        f"cameras.{phone.name}",
        address=address,
        serial=phone.serial,
        mount="hand",
        field_deg=FIELD_DEG,
        megabytes_per_s=phone.megabytes_per_s,
        frame_megabytes=round((2 * phone.width_px * phone.height_px + 1000) / 1e6, 6),
    )


def _laser_table(laser: LaserLayout, port: str) -> str:
    return _table(
        "laser",
        port=port,
        distance_mm=_mm(laser.distance_m),
        elevations_deg=laser.elevations_deg,
        sweep_ticks=laser.sweep_ticks,
        ticks_per_s=laser.ticks_per_s,
    )
