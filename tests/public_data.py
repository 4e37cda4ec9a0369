"""Where public data lies that is not part of the project: a folder `shared/data` beside the checkout, or none."""

from pathlib import Path

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
