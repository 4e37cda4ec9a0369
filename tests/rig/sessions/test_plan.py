"""Plans: what a person may write, and one clear message for what he may not."""

import copy
import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import PlanError
from rig.sessions import load_plan, parse_plan, plan_data, plan_schema, plan_sha256
from tests.rig.sessions.fake_rig import PLANS

EXAMPLES = sorted((Path(__file__).parents[3] / "docs" / "plans").glob("*.toml"))


def changed(kind, **fields):
    return {**copy.deepcopy(PLANS[kind]), **fields}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_every_example_is_a_plan(path):
    plan = load_plan(path)
    assert plan.kind == path.stem.split("-")[0]


def test_there_is_an_example_of_every_kind():
    assert {path.stem for path in EXAMPLES} >= set(PLANS)


@pytest.mark.parametrize("kind", PLANS)
def test_a_plan_survives_json(kind, tmp_path):
    plan = parse_plan(PLANS[kind])
    (tmp_path / "plan.json").write_text(json.dumps(plan_data(plan)))
    again = load_plan(tmp_path / "plan.json")
    assert again == plan
    assert plan_sha256(again) == plan_sha256(plan)


@given(st.permutations(list(PLANS["btf"])))
@settings(max_examples=20, deadline=None)
def test_the_hash_does_not_depend_on_the_order_of_fields(order):
    plan = parse_plan({key: PLANS["btf"][key] for key in order})
    assert plan_sha256(plan) == plan_sha256(parse_plan(PLANS["btf"]))


def test_a_plan_from_before_there_were_several_lamps_keeps_its_hash():
    """What its sessions state: that of the fields that there were."""
    fields = ("kind", "sample", "arm_deg", "exposures_s", "camera", "lamp", "sphere_radius_mm", "card")
    data = plan_data(parse_plan(PLANS["srf"]))
    assert tuple(data) == fields
    several = plan_data(parse_plan(changed("srf", lamps=["led", "lamp0"], light_arc_deg=[45])))
    assert set(several) == {*fields, "lamps", "light_arc_deg"} - {"lamp"}
    assert plan_data(parse_plan(several)) == several


@pytest.mark.parametrize("kind", ["btf", "mdf"])
def test_a_plan_from_before_there_was_a_depth_keeps_its_hash(kind):
    assert "depth_mm" not in plan_data(parse_plan(PLANS[kind]))
    assert plan_data(parse_plan(changed(kind, depth_mm=0.0))) == plan_data(parse_plan(PLANS[kind]))
    deep = parse_plan(changed(kind, depth_mm=1.2))
    assert parse_plan(plan_data(deep)) == deep


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("btf", "texels", 65),
        ("btf", "depth_mm", 1.2),
        ("btf", "exposures_s", [0.05, 0.21]),
        ("mdf", "frame_rate_hz", 11.0),
        ("mdf", "laser_azimuth_deg", [[45], [-45]]),
        ("srf", "camera", "cam0"),
        ("calibrate", "board_poses", 4),
        ("sensor", "repeats", 3),
        ("environment", "files", "raw"),
    ],
)
def test_the_hash_tells_plans_apart(kind, field, value):
    assert plan_sha256(parse_plan(changed(kind, **{field: value}))) != plan_sha256(parse_plan(PLANS[kind]))


def test_azimuths_of_all_mountings_or_of_each_belong_to_elevations():
    """The elevations' order is the lists' order; both may stand in any."""
    shared = parse_plan(changed("mdf", laser_azimuth_deg=[45, -45], laser_elevations_deg=[50, 35]))
    assert shared.mountings_deg() == ((35, (45, -45)), (50, (45, -45)))
    each = parse_plan(changed("mdf", laser_azimuth_deg=[[60, 80, 100], [45]], laser_elevations_deg=[50, 35]))
    assert each.mountings_deg() == ((35, (45,)), (50, (60, 80, 100)))


def test_the_schema_knows_every_kind():
    text = json.dumps(plan_schema())
    assert all(f'"{kind}"' in text for kind in PLANS)


BAD = {
    "no kind": ({"sample": "brick"}, "kind"),
    "unknown kind": ({"kind": "panorama"}, "kind"),
    "not a table": ([1, 2], "dictionary"),
    "nothing": (None, "dictionary"),
    "misspelt field": (changed("btf", texel=5), "texel"),
    "missing field": ({k: v for k, v in PLANS["btf"].items() if k != "cameras"}, "cameras"),
    "empty list": (changed("btf", turntable_deg=[]), "turntable_deg"),
    "text for a number": (changed("btf", exposures_s=["0.1"]), "exposures_s.0"),
    "true for a number": (changed("mdf", exposure_s=True), "exposure_s"),
    "negative exposure": (changed("btf", exposures_s=[-0.1]), "exposures_s.0"),
    "no exposure": (changed("calibrate", exposure_s=0), "exposure_s"),
    "endless exposure": (changed("srf", exposures_s=[1e6]), "exposures_s.0"),
    "infinite angle": (changed("srf", arm_deg=[float("inf")]), "arm_deg.0"),
    "no number": (changed("srf", arm_deg=[float("nan")]), "arm_deg.0"),
    "repeated angle": (changed("srf", arm_deg=[10, 20, 10]), "arm_deg"),
    "angle a turn away": (changed("btf", turntable_deg=[-90, 270]), "turntable_deg"),
    "repeated exposure": (changed("btf", exposures_s=[0.1, 0.10001]), "exposures_s"),
    "repeated camera": (changed("btf", cameras=["cam0", "cam0"]), "cameras"),
    "path for a name": (changed("btf", cameras=["../../etc"]), "cameras.0"),
    "fraction of a texel": (changed("btf", texels=1.5), "texels"),
    "too many texels": (changed("btf", texels=10**6), "texels"),
    "too few board poses": (changed("calibrate", board_poses=2), "board_poses"),
    "one frame has no pair": (changed("sensor", repeats=1), "repeats"),
    "neither mirror nor white": ({k: v for k, v in PLANS["lamps"].items() if k not in ("mirror", "white")}, "mirror"),
    "no angle of any carrier": (changed("lamps", light_arc_deg=[], arm_deg=[]), "light_arc_deg"),
    "mirror without a radius": (changed("lamps", mirror={"exposures_s": [0.1]}), "mirror.radius_mm"),
    "exposure longer than the interval": (changed("mdf", exposure_s=0.5), "exposure_s"),
    "fewer lists than mountings": (changed("mdf", laser_azimuth_deg=[[45]]), "laser_azimuth_deg has 1 list"),
    "a mounting without azimuths": (changed("mdf", laser_azimuth_deg=[[45], []]), "field laser_azimuth_deg.1: "),
    "lists and angles mixed": (changed("mdf", laser_azimuth_deg=[[45], 60]), "field laser_azimuth_deg.1: "),
    "lists in lists": (changed("mdf", laser_azimuth_deg=[[45], [[60]]]), "field laser_azimuth_deg.1.0: "),
    "azimuth twice in a list": (changed("mdf", laser_azimuth_deg=[[45], [30, 390]]), "field laser_azimuth_deg.1: "),
    "no lights": ({k: v for k, v in PLANS["srf"].items() if k != "arm_deg"}, "neither arm_deg nor light_arc_deg"),
    "a lamp and several": (changed("srf", lamp="led", lamps=["led"]), "both lamp and lamps"),
    "two exposures are no bracket": (changed("environment", exposures_s=[0.5, 0.01]), "exposures_s"),
    "exposures that look alike": (changed("environment", exposures_s=[0.5, 0.45, 0.01]), "exposures_s"),
    "shorter than a shutter": (changed("environment", exposures_s=[0.5, 0.01, 1e-6]), "exposures_s.2"),
    "another kind of file": (changed("environment", files="png"), "files"),
    "no card": ({k: v for k, v in PLANS["srf"].items() if k != "card"}, "card"),
    "card of wrong size": (changed("srf", card={**PLANS["srf"]["card"], "width_mm": -1}), "card.width_mm"),
    "card brighter than white": (changed("srf", card={**PLANS["srf"]["card"], "reflectance": 1.2}), "card.reflectance"),
}


@pytest.mark.parametrize(("data", "field"), BAD.values(), ids=BAD.keys())
def test_a_bad_plan_is_refused_by_field(data, field):
    with pytest.raises(PlanError) as caught:
        parse_plan(data, source="here.toml")
    message = str(caught.value)
    assert message.startswith("here.toml: ")
    assert field in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("plan.toml", b"kind = ", "not TOML"),
        ("plan.toml", b"\xff\xfe\x00", "not TOML"),
        ("plan.json", b'{"kind": "srf"', "not JSON"),
        ("plan.json", b"[" * 100_000, "not JSON"),
        ("plan.toml", b"", "kind"),
    ],
)
def test_a_file_that_is_no_plan_is_refused_by_name(tmp_path, name, content, says):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(PlanError, match=says) as caught:
        load_plan(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(PlanError, match=r"absent\.toml"):
        load_plan(tmp_path / "absent.toml")
    with pytest.raises(PlanError, match="cannot be read"):
        load_plan(tmp_path)


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=8),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
        max_leaves=10,
    ),
    st.sampled_from(sorted(PLANS)),
    st.data(),
)
@settings(max_examples=50, deadline=None)
def test_whatever_stands_in_a_field_the_answer_is_a_plan_or_a_plan_error(value, kind, data):
    field = data.draw(st.sampled_from(sorted(PLANS[kind])))
    try:
        plan = parse_plan({**PLANS[kind], field: value})
    except PlanError:
        return
    assert parse_plan(plan_data(plan)) == plan
