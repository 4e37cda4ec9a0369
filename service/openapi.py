"""Writes openapi.json, the REST interface that is checked in and compared by a test: `python -m service.openapi`."""

import json
from pathlib import Path

from service.app import interface

PATH = Path(__file__).parent / "openapi.json"

if __name__ == "__main__":
    PATH.write_text(json.dumps(interface().openapi(), indent=1) + "\n", encoding="utf-8")
