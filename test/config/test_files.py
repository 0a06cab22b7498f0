# SPDX-License-Identifier: Apache-2.0
"""Parameter files and overrides: ROS 2's meanings, all sections, and every mistake in one line."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.config.files import GivenParameters, parameter_file_text, read_parameter_file
from imgu_ros.config.parameters import Parameters, declarations
from imgu_ros.config.rcl_parameters import RclParameters
from imgu_ros.config.values import parameter_values, parameters_from
from imgu_ros.errors import FileError, ParameterError


def read(tmp_path, text, node_name="perception"):
    (tmp_path / "p.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_parameter_file(tmp_path / "p.yaml", node_name)


def parse_override(text: str) -> tuple[str, object]:
    """Return name and value of "name:=value"."""
    parameters = RclParameters()
    name = parameters.add_override(text)
    return name, parameters.entries(lambda section: True)[name].value


VALUES = {
    "5": 5, "-5": -5, "+5": 5, "0x1F": 31, "010": 8, "08": 8.0, "0": 0, "-0x10": -16,
    "1.5": 1.5, "1e-3": 0.001, "-.5": -0.5, "1.": 1.0, ".inf": float("inf"), "-.inf": float("-inf"),
    ".nan": float("nan"), "inf": float("inf"), "Infinity": float("inf"), "0x1p3": 8.0, "1e400": "1e400",
    "99999999999999999999": 1e20,
    "true": True, "False": False, "on": True, "N": False, "yes": True, "tRuE": "tRuE",
    "'5'": "5", '"true"': "true", "!!str 5": "5", "rggb": "rggb", "1:30": "1:30", "2001-01-01": "2001-01-01",
    "null": "null", "~": "~", "~/poster.png": "~/poster.png", "a:=b": "a:=b", "''": "", "0x": "0x", "1e": "1e",
    "[1, 2]": [1, 2], "[1.0, 2e1]": [1.0, 20.0], "[a, 'b c', '']": ["a", "b c", ""],
    "[true, off]": [True, False], " 5 # why": 5, "1_000": "1_000", "=": "=",
}  # fmt: skip


@pytest.mark.parametrize(("text", "value"), [*VALUES.items(), ("[]", [])])
def test_values_mean_what_they_mean_in_ros(text, value):
    name, got = parse_override(f"seed:={text}")
    assert name == "seed"
    assert repr(got) == repr(value)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # rclpy's own, at import
def test_ros_itself_reads_the_same_values(ros_domain):
    rclpy = pytest.importorskip("rclpy", reason="needs the ros extra")
    from rclpy.node import Node

    arguments = ["--ros-args"]
    for i, text in enumerate(VALUES):
        arguments += ["-p", f"x{i}:={text}"]
    context = rclpy.Context()
    rclpy.init(args=arguments, context=context)
    try:
        node = Node(
            "values", context=context, automatically_declare_parameters_from_overrides=True,
            start_parameter_services=False, enable_rosout=False,
        )  # fmt: skip
        for i, text in enumerate(VALUES):
            value = node.get_parameter(f"x{i}").value
            value = value.tolist() if hasattr(value, "tolist") else value
            assert repr(value) == repr(parse_override(f"x:={text}")[1]), text
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("seed=5", "need NAME:=VALUE"), (":=5", "need NAME:=VALUE"), ("seed", "need NAME:=VALUE"),
        ("", "need NAME:=VALUE"), ("seed:=", "no value"), ("seed:=[1", "need valid YAML"),
        ("seed:='a", "need valid YAML"), ("seed:={a: 1}", "a mapping; need"), ("seed:=[{a: 1}]", "a mapping"),
        ("seed:=[*a]", "need"), ("seed:=a: b: c", "a mapping"), ("seed:=[1, 2.0]", "write 1.0, not 1"),
        ("seed:=[1, a]", "a list of int and str; need values of one type"),
        ("seed:=[1,,]", "need valid YAML"), ("seed:=\x00", "need valid YAML"),
    ],
)  # fmt: skip
def test_bad_overrides_are_refused_in_one_line(text, reason):
    with pytest.raises(ParameterError, match=reason) as error:
        parse_override(text)
    assert "\n" not in str(error.value)


@given(st.text(max_size=30))
def test_any_text_gives_a_value_or_a_parameter_error(text):
    try:
        name, _ = parse_override(f"seed:={text}")
        assert name == "seed"
    except ParameterError as error:
        lines = str(error).splitlines()
        assert len(lines) == 1


def test_groups_and_dots_are_the_same(tmp_path):
    nested = "perception:\n  ros__parameters:\n    homography:\n      threshold_px: 2\n    demosaic: {method: malvar}\n"
    dotted = "perception:\n  ros__parameters:\n    homography.threshold_px: 2.0\n    demosaic.method: malvar\n"
    expected = {"homography.threshold_px": 2.0, "demosaic.method": "malvar"}
    assert read(tmp_path, nested) == read(tmp_path, dotted) == expected


@pytest.mark.parametrize(
    "section",
    [
        "/**",
        "perception",
        "/perception",
        "/*",
        "/**/perception",
        "camera/perception",
        "/a/b/perception",
        "/*/perception",
    ],
)
def test_the_nodes_sections(tmp_path, section):
    text = f"{section}:\n  ros__parameters:\n    seed: 3\nother:\n  ros__parameters:\n    anything: 5\n"
    if section == "/*/perception":  # that is one in some namespace; without ROS there is none
        with pytest.raises(ParameterError, match="no section"):
            read(tmp_path, text)
        assert read(tmp_path, text, "/left/perception") == {"seed": 3}
    else:
        assert read(tmp_path, text) == {"seed": 3}


def test_nested_namespaces_and_precedence(tmp_path):
    text = (
        "left:\n  perception:\n    ros__parameters: {seed: 1}\nright:\n  perception:\n    ros__parameters: {seed: 2}\n"
    )
    with pytest.raises(
        ParameterError, match=r"several sections for node 'perception' \(/left/perception, /right/perception\)"
    ):
        read(tmp_path, text)
    assert read(tmp_path, text, "/right/perception") == {"seed": 2}
    # rclpy applies sections as they come
    own_first = "perception:\n  ros__parameters: {seed: 1}\n/**:\n  ros__parameters: {seed: 2, autostart: false}\n"
    assert read(tmp_path, own_first) == {"seed": 2, "autostart": False}


def test_what_every_node_has_is_passed_over(tmp_path):
    text = "/**:\n  ros__parameters:\n    use_sim_time: true\n    qos_overrides: {/clock: {depth: 1}}\n    seed: 3\n"
    assert read(tmp_path, text) == {"seed": 3}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", r"no section for node 'perception' \(found: none\)"),
        ("[1, 2]", "line 1: a list in place of a name; need NAME: VALUE"),
        ("perception: 5\n", "line 1: a value outside of 'ros__parameters:'; need '/\\*\\*:'"),
        ("other:\n  ros__parameters:\n    seed: 3\n", r"no section for node 'perception' \(found: /other\)"),
        ("ros__parameters:\n  seed: 3\n", "outside of a node's section"),
        ("seed: 3\n", "line 1: a value outside of 'ros__parameters:'"),
        ("/**:\n  ros__parameters: 5\n", "line 2: a value outside of"),
        ("/**:\n  ros__parameters:\n    sed: 3\n", "sed: unknown parameter; nearest known: seed"),
        ("/**:\n  ros__parameters:\n    homography:\n      treshold_px: 3\n", "nearest known: homography.threshold_px"),
        ("/**:\n  ros__parameters:\n    seed: high\n", "seed: 'high' .* need an integer"),
        ("/**:\n  ros__parameters:\n    seed: -1\n", "seed: -1; need 0 to"),
        ("/**:\n  ros__parameters:\n    seed:\n", "line 3: seed: no value"),
        ("/**:\n  ros__parameters:\n    seed: 3\n   bad: 4\n", "line 4: .*need valid YAML"),
        ("/**:\n\tros__parameters: 3\n", "line 2: .*need valid YAML"),
        ("/**:\n  ros__parameters: &a\n    seed: 3\nperception: *a\n", "line 4: an alias"),
        ("/**:\n  ros__parameters:\n    [1, 2]: 3\n", "line 3: a list in place of a name"),
        ("/**:\n  ros__parameters:\n    raw.gains: [1, 2.0]\n", "line 3: raw.gains: a list of int and float; .*1.0"),
        ("/**:\n  ros__parameters: {}\nother node: {ros__parameters: {}}\n", "line 3: 'other node' is not a node name"),
        ("/**:\n  ros__parameters: {seed: 1}\n# \u00e9\n".encode("latin-1"), "line 3: byte 0xE9 is not UTF-8"),
        (
            "/**:\n  ros__parameters: {tracking: {}}\n/*: {ros__parameters: {trackng: {}}}\n",
            "trackng: unknown parameter",
        ),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, text, reason):
    with pytest.raises(ParameterError, match=reason) as error:
        read(tmp_path, text)
    assert "\n" not in str(error.value)
    assert "p.yaml" in str(error.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(FileError, match="No such file"):
        read_parameter_file(tmp_path / "none.yaml")
    with pytest.raises(FileError, match="need a parameter file"):
        read_parameter_file(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(ParameterError, match="line 1: byte 0x89 is not UTF-8"):
        read_parameter_file(tmp_path / "binary.yaml")


@pytest.mark.parametrize(
    "text",
    [
        # As launch_ros writes a list of a launch file.
        (
            "/**:\n  ros__parameters:\n    targets.images: !!python/tuple\n    - a.png\n"
            "    targets.widths_m: !!python/tuple\n    - 0.594\n"
        ),
        "/**:\n  ros__parameters: {targets: {images: [a.png], widths_m: [0.594], names: [], poses: []}}\n",
        # One value for a list of one, a group and a list without anything.
        "/**:\n  ros__parameters: {targets: {images: a.png, widths_m: 0.594, names: [[]]}}\n",
        "\ufeff/**:\r\n  ros__parameters:\r\n    targets.images: [a.png]\r\n    targets.widths_m: [0.594]\r\n",
    ],
)
def test_lists_as_tools_and_people_write_them(tmp_path, text):
    values = {name: value for name, value in read(tmp_path, text).items() if value != ()}
    assert values == {"targets.images": ("a.png",), "targets.widths_m": (0.594,)}


def test_files_and_overrides_together(tmp_path):
    (tmp_path / "a.yaml").write_text("/**: {ros__parameters: {seed: 1, targets.widths_m: [1]}}")
    (tmp_path / "b.yaml").write_text("left: {perception: {ros__parameters: {tracking.enabled: false}}}")
    given = GivenParameters()
    given.add_file(tmp_path / "a.yaml")
    given.add_file(tmp_path / "b.yaml")
    assert given.add_override("seed:=2") == "seed"
    assert given.values() == {"seed": 2, "targets.widths_m": (1.0,), "tracking.enabled": False}
    assert given.warnings() == []
    given.add_override("targets.widths_m:=[0.5]")
    assert given.values()["targets.widths_m"] == (1.0,), "as rcl has it"
    (line,) = given.warnings()
    assert line.startswith("targets.widths_m: [1] is in force, not the later [0.5]: ROS 2 keeps ")


def test_the_written_file_gives_the_defaults(tmp_path):
    text = parameter_file_text()
    values = read(tmp_path, text)
    assert parameter_values(parameters_from(values)) == parameter_values(Parameters())
    # ROS cannot read an empty list, so those alone are left out
    assert set(values) == {d.name for d in declarations() if d.default != ()}
    for known in declarations():
        assert known.description in text


def test_the_written_file_gives_given_values(tmp_path):
    wanted = {
        "targets.images": ("a b.png", 'q"\\.png'), "targets.widths_m": (0.5, 1e-07), "frames.map": "yes",
        "seed": 7, "publish_tf": True,
    }  # fmt: skip
    values = read(tmp_path, parameter_file_text(wanted))
    assert {name: values[name] for name in wanted} == wanted
