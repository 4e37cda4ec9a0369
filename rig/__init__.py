"""Devices and sessions of a capture rig: talks to hardware, knows no image processing.

`load_config` reads rig.toml, `open_rig` opens what it names; `rig.sessions` runs plans on it.
"""

from rig.assembly import open_rig
from rig.config import RigConfig, load_config
from rig.devices import Rig
from rig.errors import RigError

__all__ = ["Rig", "RigConfig", "RigError", "load_config", "open_rig"]
