"""Benchmarks: the record's form, the listing, the drawing."""

import json

import numpy as np
import pytest
from matplotlib.text import Text

from rig.errors import ConfigError
from service import bench, bench_curves, bench_report
from service.bench_report import draw_report, report_figure
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


@pytest.mark.parametrize("bound", [{}, {"bound": 1.0}])
def test_labels_of_the_report_do_not_touch(bound):
    """Fifteen methods with nearly the same error, one far off, one a little under the bound."""
    errors = [0.998, *np.linspace(1, 1.001, 15), 40.0]
    rows = [
        {"method": f"method {i}", "seconds": 0.1 * (1 + i % 4), "error": e, "peer": i > 0, "size": size} | bound
        for i, e in enumerate(errors)
        for size in ("small", "large")
    ]
    figure = report_figure([("first", rows), ("second", rows[:4])])
    figure.draw_without_rendering()
    for axes in figure.axes:
        boxes = [Text.get_window_extent(text) for text in axes.texts if text.get_text().startswith("method")]
        assert len(boxes) == len({row["method"] for row in (rows if axes is figure.axes[0] else rows[:4])})
        for i, box in enumerate(boxes):
            assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
            assert not any(box.y0 < other.y1 and other.y0 < box.y1 for other in boxes[i + 1 :])


def test_parts_of_a_benchmark_have_panels_of_their_own(tmp_path):
    rows = [{"method": "one", "seconds": 1.0, "error": 0.1, "part": part} for part in ("axis", "lamps", "axis")]
    rows += [{"method": "two", "seconds": 1.0, "error": None}, {"method": "three", "missing": "not installed"}]
    (tmp_path / "bench-a.json").write_text(json.dumps({"bench": "a", "rows": rows}))
    assert draw_report([tmp_path / "bench-a.json"], tmp_path / "report.png") == 3
    assert [title for title, _ in bench_report._panels(tmp_path / "bench-a.json")] == ["a: axis", "a: lamps"]


def test_a_report_without_points_says_so():
    assert [text.get_text() for text in report_figure([]).texts] == ["no record with run time and error"]


def test_variations_have_a_picture_of_their_own(tmp_path):
    """A panel per parameter with a line per method and the bound; the panels of run time leave them out."""
    rows = [
        {"method": method, "peer": method != "ours", "seconds": 1.0, "error": error, "bound": 1.0, "unit": "mm",
         "parameter": parameter, "value": value, "measured": 0.5}
        for parameter in ("slope", "width", "speed", "light")
        for value in (("fine", "wide", "none") if parameter == "width" else (1, 10, 100))
        for method, error in (("ours", 1.0), ("theirs", 2.0), ("lost", None))
    ]  # fmt: skip
    (tmp_path / "bench-a.json").write_text(json.dumps({"bench": "a", "rows": rows}))
    (tmp_path / "bench-b.json").write_text(json.dumps({"bench": "b", "rows": []}))
    lines = list(benchmark("report", quick=False, to=None, as_json=False, records=tmp_path))
    assert "0 points from 2 records" in lines[0]
    assert lines[1:] == [f"{tmp_path / 'bench-a-curves.png'}: errors over what was varied"]
    figure = bench_curves.curves_figure("a", rows)
    drawn = [axes for axes in figure.axes if axes.lines]
    assert [axes.get_xlabel() for axes in drawn] == ["slope", "width", "speed", "light"]
    for axes in drawn:
        assert {text.get_text() for text in axes.texts} == {"bound", "ours", "theirs"}
        assert [len(line.get_xdata()) for line in axes.lines] == [3, 3, 3]
        assert axes.get_ylabel() == "error in mm"
        told = ["fine", "wide", "none"] if axes.get_xlabel() == "width" else ["1", "10", "100"]
        assert [label.get_text() for label in axes.get_xticklabels()] == told
