"""The report: one set of data as a page and as JSON."""

import json
import re

from service.report import Measure, Picture, Report, Stage, write_report


def written(folder, *measures):
    folder.mkdir()
    (folder / "a picture.png").write_bytes(b"")
    stage = Stage("Stage", "Text with <b> & more.", 1.5, 2.0, measures, (Picture(folder / "a picture.png", "A & B"),))
    paths = write_report(Report("Title", "Introduction.", (stage,), {"x": float("nan")}, {"cores": 2}), folder)
    return [path.read_text() for path in paths]


def test_page_and_json_tell_the_same(tmp_path):
    page, data = written(tmp_path / "with spaces", Measure("error", 0.25, "mm", "how far off", 0.5))
    (stage,) = json.loads(data)["stages"]
    (measure,) = stage["measures"]
    assert (measure["name"], measure["value"], measure["bound"]) == ("error", 0.25, 0.5)
    assert stage["pictures"][0]["path"] == "a picture.png"
    assert re.search(r'<td class="number ">0.25 mm</td>\s*<td class="quiet">at most 0.5</td>', page)
    assert 'src="a picture.png" alt="A &amp; B"' in page
    assert "Text with &lt;b&gt; &amp; more." in page


def test_a_bound_is_missed_by_what_lies_above_it_and_by_what_is_no_number(tmp_path):
    measures = [Measure("m", value, "", "m", 1.0) for value in (0.9, 1.0, 1.1, float("nan"))]
    page, data = written(tmp_path / "report", *measures)
    shown = re.findall(r'class="number (miss)?">(\S+) </td>', page)
    assert shown == [("", "0.9"), ("", "1"), ("miss", "1.1"), ("miss", "nan")]

    def no_constant(name):
        raise AssertionError(f"{name} is not JSON")

    report = json.loads(data, parse_constant=no_constant)
    assert report["stages"][0]["measures"][3]["value"] is None
    assert report["figures"]["x"] is None
