"""Benchmarks: the record's form, the listing, the drawing."""

import json

import pytest

from rig.errors import ConfigError
from service import bench
from service.measuring import benchmark


def test_every_benchmark_says_what_it_measures():
    assert "demo" in bench.benchmarks()
    assert all(meaning for meaning in bench.benchmarks().values())


def test_a_record_carries_figures_rows_machine_and_versions(tmp_path, monkeypatch):
    (tmp_path / "square.py").write_text(
        '"""Squares."""\nfrom service.bench import Result\n\n\ndef run(*, quick):\n'
        '    rows = [{"method": "ours", "seconds": 0.1, "error": 1e-3},\n'
        '            {"method": "theirs", "seconds": 1.0, "error": 1e-2, "peer": True}]\n'
        '    return Result({"error": 1e-3 if quick else 1e-4}, rows)\n'
    )
    monkeypatch.setattr(bench, "FOLDER", tmp_path)
    to = tmp_path / "out" / "bench-square.json"
    assert list(benchmark("square", quick=True, to=to, as_json=False, records=tmp_path)) == [str(to)]
    record = json.loads(to.read_text())
    assert set(record) >= {"bench", "figures", "rows", "machine", "versions"}
    assert record["figures"] == {"error": 1e-3}
    (told,) = benchmark("square", quick=True, to=None, as_json=True, records=tmp_path)
    assert json.loads(told) == record
    (line,) = benchmark("square", quick=True, to=None, as_json=False, records=tmp_path)
    assert line.split() == ["error", "0.001"]
    assert list(benchmark("", quick=True, to=None, as_json=False, records=tmp_path)) == ["square       Squares."]
    (line,) = benchmark("report", quick=False, to=None, as_json=False, records=tmp_path / "out")
    assert "2 points from 1 records" in line
    assert (tmp_path / "out" / "bench-report.png").stat().st_size > 5000


def test_an_unknown_benchmark_names_the_known_ones():
    with pytest.raises(ConfigError, match="demo"):
        bench.run_benchmark("speed", quick=True)
