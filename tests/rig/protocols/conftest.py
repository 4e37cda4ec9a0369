"""Byte vectors with their sources."""

import tomllib
from pathlib import Path
from typing import Any

VECTORS = Path(__file__).parents[2] / "vectors"


def pytest_generate_tests(metafunc):
    """`vector` runs through a module's vectors: `VECTORS = ("tmcl", "reply")` names the file and the kind."""
    for fixture, table in (("vector", "vector"), ("malformed", "malformed"), ("lenient", "lenient")):
        if fixture in metafunc.fixturenames:
            marker = metafunc.definition.get_closest_marker("vectors")
            protocol, *kinds = marker.args
            chosen = [entry for entry in _load(protocol)[table] if not kinds or entry["kind"] in kinds]
            assert chosen, f"{protocol}.toml has no {table} of {kinds}"
            metafunc.parametrize(fixture, chosen, ids=[entry["name"] for entry in chosen])


def pytest_configure(config):
    config.addinivalue_line("markers", "vectors(protocol, *kinds): byte vectors that the test runs through")


def _load(protocol: str) -> dict[str, list[dict[str, Any]]]:
    tables = tomllib.loads((VECTORS / f"{protocol}.toml").read_text(encoding="utf-8"))
    for entry in (entry for table in tables.values() for entry in table):
        if "bytes" not in entry:
            zeros = bytes(entry["zeros"])
            entry["bytes"] = f"{entry['bytes_start']} {zeros.hex(' ')} {entry['bytes_end']}"
        entry["wire"] = bytes.fromhex(entry["bytes"])
    return tables
