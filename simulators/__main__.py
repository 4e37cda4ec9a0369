"""`python -m simulators --state DIR`: every device of a rig in a process of its own.

Ends on SIGTERM, on SIGINT and when the standard input ends, so that it does not outlive who started it.
"""

import argparse
import signal
import sys
from pathlib import Path
from types import FrameType

from simulators.faults import FaultError
from simulators.serve import Settings, serve


def parse(arguments: list[str] | None = None) -> Settings:
    """Settings from the command line."""
    parser = argparse.ArgumentParser(prog="python -m simulators", description="Simulated devices of a capture rig.")
    parser.add_argument("--state", type=Path, required=True, help="folder for serial ports, rig.toml and truth")
    parser.add_argument("--seed", type=int, default=1, help="same seed, same bits")
    parser.add_argument("--rate", type=float, default=0.0, help="simulated seconds per second; 0: none by themselves")
    parser.add_argument("--ptp-port", type=int, default=0, help="of the cameras on 127.0.0.1, .2, ...; 0: free ports")
    parser.add_argument("--size", choices=("small", "full"), default="small", help="of the cameras' frames")
    parser.add_argument("--faults", type=Path, default=None, help="fault schedule (TOML)")
    return Settings(**vars(parser.parse_args(arguments)))


def _end(_number: int, _frame: FrameType | None) -> None:
    sys.exit(0)


def main() -> None:
    """Serve until told to end."""
    settings = parse()
    signal.signal(signal.SIGTERM, _end)
    signal.signal(signal.SIGINT, _end)
    try:
        serve(settings)
    except (FaultError, OSError) as error:
        sys.exit(f"simulators: {error}")


if __name__ == "__main__":
    main()
