"""Commands that work on files: merging photographs, laser images, benchmarks. Each yields the lines that it tells."""

import json
from collections.abc import Iterator
from pathlib import Path

from rig.errors import ConfigError
from service import bench


def benchmark(name: str, *, quick: bool, to: Path | None, listing: bool, records: Path) -> Iterator[str]:
    """Run, list or draw benchmarks. Raises ConfigError for a name that there is not."""
    if listing:
        yield from (f"{key:12} {meaning}" for key, meaning in bench.benchmarks().items())
        return
    if name == "report":
        found = sorted(records.glob("bench-*.json"))
        picture = records / "bench-report.png"
        yield f"{picture}: {bench.draw_report(found, picture)} points from {len(found)} records"
        return
    if not name:
        raise ConfigError("name a benchmark, or use --list")
    record = json.dumps(bench.run_benchmark(name, quick=quick), indent=2)
    if to is None:
        yield record
        return
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_text(record + "\n", encoding="utf-8")
    yield str(to)
