"""Devices: what the rig has, where it stands, and moving an axis by hand."""

from math import degrees, radians
from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel

from rig.assembly import open_rig
from rig.errors import UnknownDeviceError
from service.routes.dependencies import Host

router = APIRouter(prefix="/devices", tags=["devices"])


class Move(BaseModel, extra="forbid", allow_inf_nan=False):
    """Where an axis is to go."""

    angle_deg: float


@router.get("")
def list_devices(host: Host) -> dict[str, Any]:
    """Every device of rig.toml with its settings, and the session that holds the rig, if one does."""
    return {**host.config.model_dump(mode="json"), "held_by": host.running()}


@router.get("/axes/{name}")
def read_axis(name: str, host: Host) -> dict[str, Any]:
    """The angle that an axis reports; 409 while a session holds the rig."""
    _check_axis(name, host)
    with open_rig(host.config) as rig:
        return {"name": name, "angle_deg": degrees(rig.axes[name].angle_rad())}


@router.post("/axes/{name}/moves")
def move_axis(name: str, move: Move, host: Host) -> dict[str, Any]:
    """Home the axis, move it and wait; out of range is an error before anything moves."""
    _check_axis(name, host)
    with open_rig(host.config) as rig:
        axis = rig.axes[name]
        axis.check(radians(move.angle_deg))
        axis.home()
        axis.move_to(radians(move.angle_deg))
        axis.wait()
        return {"name": name, "angle_deg": degrees(axis.angle_rad())}


def _check_axis(name: str, host: Host) -> None:
    if name not in host.config.axes:
        raise UnknownDeviceError(f"no axis {name!r}; rig.toml has: {', '.join(host.config.axes)}.")
