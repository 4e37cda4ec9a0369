"""The line laser on a LEGO RCX: motor A turns the stripe, output B feeds the laser, input 1 counts rotations.

The count lags behind the motor by the time of a question and its answer (over 0.1 s on the infrared wire): it serves
to bring the stripe back to its start, never to tell where the stripe is. That is measured in the frames.
"""

import serial

from rig.config import LaserConfig
from rig.drivers.clock import RigClock
from rig.drivers.link import Echo, Link
from rig.drivers.transport import SerialTransport
from rig.errors import DeviceError
from rig.protocols import rcx
from rig.protocols.rcx import Motor, Source

_REPLY_TIMEOUT_S = 1.0  # the longest exchange is 22 bytes of 4.6 ms each, and the RCX thinks for some more
_ATTEMPTS = 4  # an identical opcode is answered again, not executed again: everything is safe to repeat
_INPUT = 0
_POWER = 7
_POLL_LAG_S = 0.1  # between the count and the motor's answer to what follows from it
_STANDING_POLLS = 3
_MARGIN_S = 5.0
_LEAST_TURN = 0.7  # of what the nominal speed promises: weak batteries and cold gears cost less


class RcxLaser:
    """The laser unit.

    Its count is 0 where the RCX was switched on, so it is to be switched on at the start of the sweep. The RCX keeps
    the count as long as it has power: a session that takes over from a crashed one finds it valid.
    """

    def __init__(self, config: LaserConfig, clock: RigClock) -> None:
        """Nothing is opened yet."""
        self._config = config
        transport = SerialTransport("laser", config.port, baudrate=config.baudrate, parity=serial.PARITY_ODD)
        self._link: Link[bytes] = Link("laser", transport, rcx.PacketReader(), clock, echo=Echo())
        self._clock = clock
        self._toggle = False
        self._started_s: float | None = None

    def open(self) -> None:
        """Find the RCX, switch motor and laser off, keep it awake, set up the rotation sensor where it is not yet."""
        self._ask(rcx.alive(), "alive")
        self.stop()
        self._ask(rcx.power_down_delay(0), "never power down")
        self._ask(rcx.motor_power(Motor.A | Motor.B, _POWER), "motor power")
        kind = self._value(Source.SENSOR_TYPE, _INPUT, "sensor type")
        mode = self._value(Source.SENSOR_MODE, _INPUT, "sensor mode") & rcx.SENSOR_MODE_MASK
        if (kind, mode) != (rcx.SENSOR_TYPE_ROTATION, rcx.SENSOR_MODE_ANGLE):
            self._ask(rcx.sensor_type(_INPUT, rcx.SENSOR_TYPE_ROTATION), "rotation sensor")
            self._ask(rcx.sensor_mode(_INPUT, rcx.SENSOR_MODE_ANGLE), "angle mode")
            self._ask(rcx.clear_sensor(_INPUT), "count to zero")

    def rewind(self) -> None:
        """Laser off, motor back to the start of the sweep; waits. Raises DeviceError where the count stands still."""
        self.stop()
        near_ticks = self._config.ticks_per_s * _POLL_LAG_S
        count = self._count()
        if count <= near_ticks:
            return
        self._ask(rcx.motor_direction(Motor.A, rcx.DIRECTION_REVERSE), "motor in reverse")
        self._ask(rcx.motor_state(Motor.A, rcx.MOTOR_ON), "motor on")
        try:
            self._run_back(count, near_ticks)
        finally:
            self.stop()

    def start_sweep(self) -> None:
        """Laser on, motor on; returns. Raises DeviceError where the laser output does not read on."""
        self._ask(rcx.motor_direction(Motor.A | Motor.B, rcx.DIRECTION_FORWARD), "forward")
        self._ask(rcx.motor_state(Motor.B, rcx.MOTOR_ON), "laser on")
        if not self._is_on(1):
            raise DeviceError("laser: its output does not read on after it was switched on. Check the RCX' batteries.")
        self._ask(rcx.motor_state(Motor.A, rcx.MOTOR_ON), "motor on")
        self._started_s = self._clock.now_s()

    def end_sweep(self) -> None:
        """As `stop`; raises DeviceError where the motor did not turn as far as it should have by now."""
        elapsed_s = 0.0 if self._started_s is None else self._clock.now_s() - self._started_s
        self.stop()
        promised = min(elapsed_s * self._config.ticks_per_s, self._config.sweep_ticks)
        count = self._count()
        if count < _LEAST_TURN * promised:
            raise DeviceError(
                f"laser: the motor turned by {count} counts in {elapsed_s:.1f} s where {promised:.0f} were to come. "
                "Check batteries, gears and sensor."
            )

    def stop(self) -> None:
        """Motor and laser off, confirmed by reading both outputs back. Raises DeviceError where one still reads on."""
        self._ask(rcx.motor_state(Motor.A | Motor.B, rcx.MOTOR_OFF), "motor and laser off")
        for number, what in enumerate(("motor", "laser")):
            if self._is_on(number):
                raise DeviceError(
                    f"laser: the {what}'s output still reads on after it was switched off. Unplug the laser."
                )

    def sweep_time_s(self) -> float:
        """Forecast of one full sweep at the motor's nominal speed."""
        return self._config.sweep_ticks / self._config.ticks_per_s

    def close(self) -> None:
        """Close the wire; closing twice is allowed."""
        self._link.close()

    def _run_back(self, count: int, near_ticks: float) -> None:
        """Poll the count until it is near 0, seldom while it is far."""
        deadline_s = self._clock.now_s() + 2 * abs(count) / self._config.ticks_per_s + _MARGIN_S
        standing = 0
        while count > near_ticks:
            self._clock.sleep(max(0.0, (count - near_ticks) / self._config.ticks_per_s / 2 - _POLL_LAG_S))
            before, count = count, self._count()
            standing = standing + 1 if count >= before else 0
            if standing >= _STANDING_POLLS or self._clock.now_s() > deadline_s:
                raise DeviceError(
                    f"laser: the count stands at {count} while the motor runs back. Check motor, gears and sensor."
                )

    def _count(self) -> int:
        return self._value(Source.SENSOR_VALUE, _INPUT, "rotation count")

    def _is_on(self, output: int) -> bool:
        return bool(self._value(Source.MOTOR_STATE, output, "motor state") & rcx.MOTOR_ON)

    def _value(self, source: Source, argument: int, what: str) -> int:
        return rcx.value(self._ask(rcx.get_value(source, argument), what))

    def _ask(self, request: bytes, what: str) -> bytes:
        """The reply; each new request flips the toggle bit, so that the RCX never takes it for a repetition."""
        self._toggle = not self._toggle
        payload = rcx.toggled(request, self._toggle)
        return self._link.request(
            rcx.encode(payload),
            lambda reply: reply[0] == rcx.reply_opcode(payload),
            what=what,
            timeout_s=_REPLY_TIMEOUT_S,
            attempts=_ATTEMPTS,
        )
