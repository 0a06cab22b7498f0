# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import array
import ast
import dataclasses
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.config.parameters import FramesParameters, Parameters, declaration, declarations
from imgu_ros.config.values import checked_value, parameter_values, parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.vision.estimation.sampling import Sampler
from imgu_ros.vision.formation.bands import BandMode
from imgu_ros.vision.formation.demosaic import DemosaicMethod
from imgu_ros.vision.matching.metrics import Metric
from imgu_ros.vision.methods import DESCRIPTORS, DETECTORS, ESTIMATORS
from imgu_ros.vision.scale_space.gaussian import GaussianKernel
from imgu_ros.vision.scale_space.pyramid import PyramidKind

ALL = declarations()
SCALAR_TYPES = {"bool": bool, "integer": int, "double": float, "string": str}

#: Names of interfaces.md, written down here once more.
PROMISED = """
    reference targets.images targets.widths_m targets.names targets.poses image_transport image_topic camera_info_topic
    camera.rectified autostart publish_tf path.max_length seed demosaic.method raw.black_level raw.white_level
    raw.significant_bits raw.gains raw.bands pyramid.kind pyramid.kernel pyramid.levels pyramid.scales_per_octave
    preprocess.brightness preprocess.contrast preprocess.gamma preprocess.equalisation preprocess.threshold
    keypoints.detector keypoints.max_count descriptor.kind matching.metric matching.ratio matching.mutual
    homography.sampler homography.threshold_px homography.confidence homography.max_iterations homography.error
    homography.refine refinement.enabled tracking.enabled pose.ambiguity_ratio
""".split()


def test_promised_names_exist():
    assert set(PROMISED) <= {known.name for known in ALL}


@pytest.mark.parametrize("known", ALL, ids=lambda known: known.name)
def test_every_declaration_is_whole(known):
    assert re.fullmatch(r"[a-z_]+(\.[a-z_]+)*", known.name)
    assert known.description.endswith(".") and "\n" not in known.description
    element = known.type_name.removesuffix("_array")
    assert element in SCALAR_TYPES
    got = checked_value(known.name, known.default)
    assert got == known.default and type(got) is type(known.default)
    assert type(got) is (tuple if known.type_name.endswith("_array") else SCALAR_TYPES[element])
    if element in ("bool", "string"):
        assert known.bounds is None
    else:
        assert known.bounds is None or known.bounds[0] < known.bounds[1]
    assert declaration(known.name) is known


@pytest.mark.parametrize("known", ALL, ids=lambda known: known.name)
def test_values_of_other_types_are_refused(known):
    wrong = {
        "bool": [1, 0.0, "true", None, [True]],
        "integer": [1.0, True, "1", None, [1]],
        "double": [True, "1.0", None, [1.0], 1j],
        "string": [1, True, None, ["a"], b"a"],
    }
    if known.type_name.endswith("_array"):
        element = known.type_name.removesuffix("_array")
        for value in (b"ab", {}, {"a": 1}, {1.0}, iter(()), np.array(1.0)):
            with pytest.raises(ParameterError, match=re.escape(known.name)):
                checked_value(known.name, value)
        for value in wrong[element][:3]:
            with pytest.raises(ParameterError, match=re.escape(f"{known.name}[0]")):
                checked_value(known.name, [value])
            if isinstance(value, bool | int | float | str):
                with pytest.raises(ParameterError, match=re.escape(known.name)):
                    checked_value(known.name, value)
        one = {"bool": True, "integer": 1, "double": 1, "string": "a.png"}[element]
        assert checked_value(known.name, one) == (one,) == checked_value(known.name, [one])
        assert checked_value(known.name, []) == checked_value(known.name, None) == ()
    else:
        for value in wrong[known.type_name]:
            with pytest.raises(ParameterError, match=r"^[^\n]+need[^\n]+$"):
                checked_value(known.name, value)


@pytest.mark.parametrize("known", [k for k in ALL if k.bounds], ids=lambda k: k.name)
def test_ranges_are_inclusive_and_their_outside_is_refused(known):
    element = known.type_name.removesuffix("_array")

    def wrapped(value):
        return [value] if known.type_name.endswith("_array") else value

    for limit, outwards in zip(known.bounds, (-1, 1), strict=True):
        inside = int(limit) if element == "integer" else float(limit)
        checked_value(known.name, wrapped(inside))
        outside = inside + outwards if element == "integer" else math.nextafter(inside, outwards * math.inf)
        with pytest.raises(ParameterError) as caught:
            checked_value(known.name, wrapped(outside))
        # What is needed is said in full: the limit can be read back from the message.
        numbers = [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?", str(caught.value).split("need")[1])]
        assert float(limit) in numbers
    if element == "double":
        for value in (math.nan, math.inf, -math.inf):
            with pytest.raises(ParameterError):
                checked_value(known.name, wrapped(value))


@pytest.mark.parametrize("known", [k for k in ALL if k.choices], ids=lambda k: k.name)
def test_choices(known):
    assert known.default in known.choices
    for choice in known.choices:
        assert checked_value(known.name, choice) == choice
    for other in ("", known.choices[0].upper(), known.choices[0] + "x"):
        with pytest.raises(ParameterError) as caught:
            checked_value(known.name, other)
        assert all(choice in str(caught.value) for choice in known.choices)


def test_nearest_choice_and_reserved_names():
    with pytest.raises(ParameterError, match=r"'malvra'; need .*\(nearest: malvar\)"):
        checked_value("demosaic.method", "malvra")
    for reserved in ("keyframe", "rotation"):
        with pytest.raises(ParameterError, match=f"reference: '{reserved}' is reserved"):
            checked_value("reference", reserved)
    with pytest.raises(ParameterError, match="reference: 'other'; need 'target'"):
        checked_value("reference", "other")


@pytest.mark.parametrize(
    ("typo", "meant"),
    [
        ("target.images", "targets.images"),
        ("targets.width_m", "targets.widths_m"),
        ("matching.ration", "matching.ratio"),
        ("homography.treshold_px", "homography.threshold_px"),
        ("seeed", "seed"),
        ("demosaic.methode", "demosaic.method"),
        ("raw.blacklevel", "raw.black_level"),
        ("Keypoints.max_count", "keypoints.max_count"),
    ],
)
def test_unknown_names_name_the_nearest(typo, meant):
    for function in (declaration, lambda name: checked_value(name, 1), lambda name: parameters_from({name: 1})):
        with pytest.raises(ParameterError, match=re.escape(f"{typo}: unknown parameter; nearest known: {meant}")):
            function(typo)


@pytest.mark.parametrize("name", ["", ".", "targets", "targets.", "seed.x", "__class__", "raw.__init__", 5, None])
def test_absurd_names_are_refused(name):
    with pytest.raises(ParameterError, match="unknown parameter"):
        parameters_from({name: 1})


def test_numpy_and_other_kinds_of_numbers():
    assert checked_value("seed", np.int32(7)) == 7 and type(checked_value("seed", np.uint8(7))) is int
    assert checked_value("pose.ambiguity_ratio", 1) == 1.0 and type(checked_value("pose.ambiguity_ratio", 1)) is float
    assert type(checked_value("pose.ambiguity_ratio", np.int64(0))) is float
    assert checked_value("pose.ambiguity_ratio", np.float32(0.5)) == 0.5
    assert checked_value("autostart", np.bool_(False)) is False
    assert type(checked_value("demosaic.method", DemosaicMethod.MALVAR)) is str
    assert type(checked_value("demosaic.method", np.str_("malvar"))) is str
    for gains in ([1, 2, 3], (1.0, 2.0, 3.0), np.array([1.0, 2, 3]), array.array("d", [1, 2, 3]), np.array([1, 2, 3])):
        assert checked_value("raw.gains", gains) == (1.0, 2.0, 3.0)
        assert all(type(g) is float for g in checked_value("raw.gains", gains))


@pytest.mark.parametrize(
    "value", [np.array([[1]]), np.zeros((30, 30)), np.array([1, 2]), 10**400, 10**5000, -(10**400)], ids=range(6)
)
@pytest.mark.parametrize("name", ["seed", "pose.ambiguity_ratio", "raw.gains"])
def test_messages_stay_on_one_short_line(name, value):
    wrapped = [value] if name == "raw.gains" else value
    with pytest.raises(ParameterError) as caught:
        checked_value(name, wrapped)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 250


def test_replacing_leaves_the_base_alone():
    base = parameters_from({"seed": 5, "raw.gains": [2, 1, 1.5]})
    changed = parameters_from({"raw.black_level": 64, "demosaic.method": "malvar"}, base)
    assert (base.raw.black_level, base.demosaic.method) == (0.0, "bilinear")
    assert (changed.seed, changed.raw.gains, changed.raw.black_level) == (5, (2.0, 1.0, 1.5), 64.0)
    assert parameters_from({}) == Parameters()
    with pytest.raises(dataclasses.FrozenInstanceError):
        base.seed = 3  # type: ignore[misc]


def test_values_round_trip():
    values = parameter_values(Parameters())
    assert list(values) == [known.name for known in ALL]
    assert values == {known.name: known.default for known in ALL}
    changed = parameters_from({"targets.images": ["a.png", "b.png"], "targets.widths_m": [1, 0], "seed": 3})
    assert parameters_from(parameter_values(changed)) == changed


@given(st.randoms(use_true_random=False))
def test_the_order_of_values_does_not_matter(random):
    values = {"raw.white_level": 1000, "raw.black_level": 900, "targets.names": ["a"], "targets.images": ["x"]}
    names = list(values)
    random.shuffle(names)
    assert parameters_from({name: values[name] for name in names}) == parameters_from(values)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"targets.widths_m": [1.0]}, "targets.widths_m"),
        ({"targets.images": ["a"], "targets.widths_m": [1.0, 2.0]}, "targets.widths_m"),
        ({"targets.images": ["a", "b"], "targets.names": ["one"]}, "targets.names"),
        ({"targets.images": ["a"], "targets.poses": [0.0] * 6}, "targets.poses"),
        ({"targets.images": ["a"], "targets.poses": [0.0] * 8}, "targets.poses"),
        ({"targets.images": ["a", "b"], "targets.poses": [0.0] * 7}, "targets.poses"),
        ({"raw.gains": [1.0, 1.0]}, "raw.gains"),
        ({"raw.gains": []}, "raw.gains"),
        ({"raw.grey_weights": [1.0]}, "raw.grey_weights"),
        ({"raw.grey_weights": [0.0, 0.0, 0.0]}, "raw.grey_weights"),
        ({"raw.white_level": 100, "raw.black_level": 100}, "raw.white_level"),
        ({"raw.white_level": 100, "raw.black_level": 200}, "raw.white_level"),
    ],
)
def test_values_that_contradict_each_other(values, name):
    with pytest.raises(ParameterError, match=rf"^{re.escape(name)}: [^\n]+need[^\n]+$"):
        parameters_from(values)


def test_parallel_lists_that_agree():
    got = parameters_from(
        {"targets.images": ["a", "b"], "targets.widths_m": [0.5, 0], "targets.poses": [0.0] * 14, "targets.names": []}
    )
    assert got.targets.widths_m == (0.5, 0.0) and len(got.targets.poses) == 14
    parameters_from({"raw.black_level": 300})  # white unknown: the frame's data type decides


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"raw.band_mode": "weighted"}, "raw.band_weights: none; need one value for each band"),
        ({"raw.band_mode": "spectral_angle"}, "raw.reference_spectrum: none; need one value for each band"),
        ({"raw.band_mode": "spectral_angle", "raw.reference_spectrum": [1.0]}, "raw.reference_spectrum: 1 value;"),
        ({"raw.band_mode": "spectral_angle", "raw.reference_spectrum": [0.0, 0.0]}, "raw.reference_spectrum: all 0"),
        ({"raw.band_mode": "weighted", "raw.band_weights": [0.0, 0.0]}, "raw.band_weights: all 0"),
        (
            {"raw.band_mode": "weighted", "raw.band_weights": [1.0, 2.0], "raw.bands": [0, 1, 2]},
            "raw.band_weights: 2 values; need 3, one for each of raw.bands",
        ),
        ({"raw.reference_spectrum": [math.nan]}, "raw.reference_spectrum"),
        ({"raw.band_weights": [-1.0]}, "raw.band_weights"),
        ({"raw.band_mode": "median"}, "raw.band_mode: 'median'; need one of mean"),
    ],
)
def test_band_modes_need_what_they_work_with(values, message):
    with pytest.raises(ParameterError) as caught:
        parameters_from(values)
    assert str(caught.value).startswith(message)
    parameters_from({"raw.band_mode": "spectral_angle", "raw.bands": [4, 2], "raw.reference_spectrum": [1, -0.5]})


_DECLARED_OR_CHECKED = {"parameters.py", "checks.py", "values.py"}


def test_every_parameter_is_read_somewhere(repository):
    """An option that nothing reads would be accepted and ignored."""
    files = [path for path in (repository / "imgu_ros").rglob("*.py") if path.name not in _DECLARED_OR_CHECKED]
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in files]
    read = {node.attr for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    rows = (*DETECTORS.values(), *DESCRIPTORS.values(), *ESTIMATORS.values())
    read |= {name.split(".")[-1] for row in rows for name in (row.settings or {}).values()}
    assert {known.name for known in ALL if known.name.split(".")[-1] not in read} == set()


@pytest.mark.parametrize(
    ("name", "choice"),
    [
        ("demosaic.method", DemosaicMethod),
        ("pyramid.kind", PyramidKind),
        ("pyramid.kernel", GaussianKernel),
        ("keypoints.detector", DETECTORS),
        ("descriptor.kind", DESCRIPTORS),
        ("homography.estimator", ESTIMATORS),
        ("matching.metric", Metric),
        ("homography.sampler", Sampler),
        ("raw.band_mode", BandMode),
    ],
)
def test_choices_are_those_of_the_library(name, choice):
    assert set(declaration(name).choices) == {str(member) for member in choice}


def test_names_of_frames_lose_a_leading_slash() -> None:
    """As tf2 has it; ROS 1 wrote them."""
    values = {"frames.camera": "/eye", "frames.map": "//map", "frames.target_prefix": "/a/", "tf.root_frame": "/odom"}
    parameters = parameters_from(values)
    assert parameters.frames == FramesParameters(camera="eye", map="map", target_prefix="a/")
    assert parameters.tf.root_frame == "odom"
    assert checked_value("image_topic", "/camera/image_raw") == "/camera/image_raw"
