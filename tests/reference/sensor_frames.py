"""Dark and flat frames of a simulated sensor, without a rig: the forward model of the photon transfer tests."""

from dataclasses import dataclass, field

import numpy as np

from processing.radiometry.frame_series import Frame
from processing.radiometry.sensor import Sensor
from simulators.sensor import Sensor as SimulatedSensor
from simulators.sensor import build_unit

CHANNELS = np.array([[0.60, 1.00], [1.00, 0.72]])
DARK_S = (2.0, 0.7, 0.1, 0.0005)
FLAT_S = (0.002, 0.01, 0.03, 0.06, 0.09, 0.12, 0.16, 0.2, 0.235, 0.25, 0.3, 0.345, 0.41, 0.5)
GREEN_E_S = 60000.0


@dataclass
class Camera:
    """A unit of a simulated sensor before a light box; `light(taken_s)` is its relative level then."""

    seed: int = 0
    shape: tuple[int, int] = (120, 160)
    model: SimulatedSensor = field(default_factory=SimulatedSensor)
    repeats: int = 4
    light: object = lambda taken_s: 1.0

    def __post_init__(self):
        self.unit = build_unit(self.model, self.shape, (self.seed, "camera"))
        rows, columns = (np.linspace(-1, 1, side) for side in self.shape)
        self.vignette = 1 - 0.04 * (rows[:, None] ** 2 + columns**2)
        self.stated = Sensor(self.model.black_dn, self.model.white_dn, 4.0, 4.0)

    @property
    def flat(self):
        """True relative response with mean 1 per phase of the mosaic."""
        flat = self.vignette * self.unit.response
        for r in (0, 1):
            for c in (0, 1):
                flat[r::2, c::2] /= flat[r::2, c::2].mean()
        return flat

    @property
    def field_e_s(self):
        """Electron rates of the light box."""
        rows, columns = np.indices(self.shape)
        return GREEN_E_S * CHANNELS[rows % 2, columns % 2] * self.vignette * self.unit.response

    def frame(self, exposure_s, rate_e_s, key, taken_s=0.0):
        rate = (rate_e_s + self.unit.dark_e_s).astype(np.float32)
        return Frame(self.unit.expose(rate, exposure_s, (self.seed, *key)), taken_s)

    def dark(self, exposures_s=DARK_S):
        for exposure_s in exposures_s:
            yield exposure_s, (self.frame(exposure_s, 0.0, ("dark", repr(exposure_s), k)) for k in range(self.repeats))

    def flats(self, exposures_s=FLAT_S):
        """In rounds of all exposures, one every half a second."""
        for place, exposure_s in enumerate(exposures_s):
            times = [0.5 * (k * len(exposures_s) + place) for k in range(self.repeats)]
            yield (
                exposure_s,
                (
                    self.frame(exposure_s, self.light(t) * self.field_e_s, ("flat", repr(exposure_s), k), t)
                    for k, t in enumerate(times)
                ),
            )
