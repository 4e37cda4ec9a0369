"""What can go wrong between a plan and a frame.

    RigError
    ├── TransportError           the wire
    │   ├── ConnectError         port or address cannot be opened
    │   └── ReadTimeoutError     no answer in time (also a TimeoutError)
    ├── ProtocolError            the bytes
    │   ├── FrameError           not a datagram: length, checksum, complement
    │   └── ReplyError           a datagram, but not the answer to the request, or a refusal
    ├── DeviceError              the device did not do it
    │   ├── LimitError           outside the soft limits; nothing was moved
    │   ├── InterlockError       would collide or block the view; nothing was moved
    │   └── FrameCheckError      the frame that came is not the frame that was asked for
    ├── UnknownDeviceError       no such device in rig.toml
    ├── StateError               not in this state (names the state and what is allowed in it)
    ├── BusyError                another session holds the rig
    ├── PlanError                the plan cannot be carried out; raised before anything moves
    ├── ConfigError              rig.toml is malformed
    └── StoreError               the session folder
        ├── DiskFullError        the frame could not be made durable
        └── MissingFrameError    the journal names a frame that is not there, or not whole

A message says which device, what was asked, what came back (bytes in hex) and what to do.
"""


class RigError(Exception):
    """Root of every error that the rig raises."""


class TransportError(RigError):
    """The wire failed."""


class ConnectError(TransportError):
    """A port or an address cannot be opened."""


class ReadTimeoutError(TransportError, TimeoutError):
    """No answer came before the deadline."""


class ProtocolError(RigError):
    """The bytes are wrong."""


class FrameError(ProtocolError):
    """Not a whole datagram: length, checksum or complement is wrong."""


class ReplyError(ProtocolError):
    """A datagram, but a refusal or not the answer to the request."""


class DeviceError(RigError):
    """A device did not do what it was asked to."""


class LimitError(DeviceError):
    """Outside the soft limits; nothing was moved."""


class InterlockError(DeviceError):
    """Would collide or block the view; nothing was moved."""


class FrameCheckError(DeviceError):
    """The frame that came is not the frame that was asked for."""


class UnknownDeviceError(RigError):
    """No such device in rig.toml."""


class StateError(RigError):
    """The request does not fit the state; the message names the state and what is allowed in it."""


class BusyError(RigError):
    """Another session holds the rig."""


class PlanError(RigError):
    """The plan cannot be carried out; raised before anything moves."""


class ConfigError(RigError):
    """rig.toml is malformed."""


class StoreError(RigError):
    """The session folder cannot be read or written."""


class DiskFullError(StoreError):
    """A frame could not be made durable; its step stays open."""


class MissingFrameError(StoreError):
    """The journal names a frame that is not there, or that is not whole."""
