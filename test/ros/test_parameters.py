# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs the ros extra")

import rclpy
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from imgu_ros.config.components import ReadingParameters
from imgu_ros.config.files import GivenParameters, read_parameter_file
from imgu_ros.config.parameters import Declaration, Parameters, declarations
from imgu_ros.config.values import parameter_values, parameters_from
from imgu_ros.errors import ParameterError
from imgu_ros.files.camera_info_file import camera_info_text
from imgu_ros.files.frame_reading import frame_reading
from imgu_ros.ros.parameters import ParameterServer
from imgu_ros.vision.camera.intrinsics import make_camera as camera_of

REPOSITORY = Path(__file__).resolve().parents[2]


class ServedNode(Node):
    def __init__(self, context: Context, arguments: list[str]) -> None:
        super().__init__("perception", context=context, cli_args=arguments, enable_rosout=False)
        self.server = ParameterServer(self)

    def set_parameters_atomically(self, parameter_list):
        return self.server.set_atomically(parameter_list, super().set_parameters_atomically)

    def set(self, **values: object):
        return self.set_parameters_atomically(
            [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        )


@pytest.fixture
def make_node(ros_domain: int) -> Iterator[Callable[..., ServedNode]]:
    context = Context()
    rclpy.init(args=[], context=context, domain_id=ros_domain)
    nodes: list[ServedNode] = []

    def make(*overrides: str, arguments: Sequence[str] = ()) -> ServedNode:
        given = [*arguments, *(word for text in overrides for word in ("-p", text))]
        nodes.append(ServedNode(context, ["--ros-args", *given] if given else []))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def test_every_declaration_is_described(make_node):
    node = make_node()
    types = {
        "bool": 1, "integer": 2, "double": 3, "string": 4, "integer_array": 7, "double_array": 8, "string_array": 9,
    }  # fmt: skip
    for known in declarations():
        described = node.describe_parameter(known.name)
        value = node.get_parameter(known.name).value
        assert described.type == types[known.type_name], known.name
        assert described.read_only == known.read_only
        assert known.description in described.description
        assert known.unit in described.description
        assert (tuple(value) if isinstance(known.default, tuple) else value) == known.default
        for choice in known.choices:
            assert choice in described.additional_constraints
        if known.bounds and known.type_name in ("double", "integer"):
            (given,) = described.floating_point_range or described.integer_range
            assert (given.from_value, given.to_value) == known.bounds
            assert given.step == (known.type_name == "integer")
    # None but these and rclpy's own.
    names = {d.name for d in declarations()}
    assert {n for n in node._parameters if n not in names} <= {"use_sim_time", "start_type_description_service"}


def test_overrides_are_taken_and_converted(make_node):
    node = make_node(
        "homography.threshold_px:=5", "targets.images:=[]", "raw.gains:=[2, 1, 3]", "seed:=7", "autostart:=false"
    )
    got = node.server.parameters
    assert got.homography.threshold_px == 5.0
    assert got.targets.images == ()
    assert got.raw.gains == (2.0, 1.0, 3.0)
    assert got.seed == 7
    assert got.autostart is False
    assert node.get_parameter("homography.threshold_px").value == 5.0
    assert node.get_parameter("targets.images").value == []


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "homography.treshold_px:=5.0",
            "homography.treshold_px: unknown parameter; nearest known: homography.threshold_px",
        ),
        ("seed:=many", "seed: 'many' (str); need an integer"),
        ("keypoints.max_count:=2", "keypoints.max_count: 2; need 8 to 100000"),
        ("targets.widths_m:=[0.1, 0.2]", "targets.widths_m: 2 values; need none, or 0"),
        ("reference:=keyframe", "reserved"),
    ],
)
def test_a_bad_override_is_refused(make_node, override, said):
    with pytest.raises(ParameterError) as caught:
        make_node(override)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"sed": 1}, "nearest known: seed"),
        ({"homography__threshold_px": 1e6}, "need 0.1 to 100 px"),
        ({"homography__threshold_px": float("nan")}, "need 0.1 to 100 px"),
        ({"keypoints__detector": "orbb"}, "orb"),
        ({"pyramid__levels": "4"}, "need an integer"),
        ({"image_transport": "compressed"}, "read-only"),
        ({"raw__white_level": 5.0, "raw__black_level": 6.0}, "raw.white_level: 5; need more than raw.black_level"),
        ({"targets__images": ["a.png"], "targets__widths_m": [1.0, 2.0]}, "targets.widths_m: 2 values"),
        ({"seed": 5, "keypoints__max_count": 1}, "keypoints.max_count"),
    ],
)
def test_a_bad_set_is_refused_whole(make_node, values, said):
    node = make_node()
    before = node.server.parameters
    result = node.set(**values)
    assert not result.successful
    assert said in result.reason
    assert node.server.parameters is before
    assert node.get_parameter("seed").value == 0


def test_values_that_depend_on_each_other_go_together(make_node):
    node = make_node("raw.black_level:=100.0", "raw.white_level:=200.0")
    alone = node.set(raw__black_level=300.0)
    assert not alone.successful
    assert "set_parameters_atomically" in alone.reason
    assert node.set(raw__black_level=300.0, raw__white_level=400.0).successful
    assert node.server.parameters.raw.black_level == 300.0


def test_an_integer_serves_as_a_double_and_a_change_makes_a_new_object(make_node):
    node = make_node()
    before = node.server.parameters
    assert node.set(homography__threshold_px=4).successful
    assert node.server.parameters is not before
    assert node.server.parameters.homography.threshold_px == 4.0
    assert node.get_parameter("homography.threshold_px").type_ is Parameter.Type.DOUBLE
    assert node.set(use_sim_time=False).successful


def test_targets_wait_for_reload(make_node):
    node = make_node()
    # One by one, as the parameter service does.
    assert node.set(targets__images=["a.png", "b.png"]).successful
    assert node.set(targets__widths_m=[0.5]).successful
    assert node.server.parameters == Parameters()
    with pytest.raises(ParameterError):
        node.server.reload()
    assert node.set(targets__widths_m=[0.5, 0.0]).successful
    assert node.server.reload().targets.widths_m == (0.5, 0.0)
    assert node.set(seed=3).successful
    assert node.server.parameters.targets.images == ("a.png", "b.png")


def test_what_is_staged_comes_in_force_as_it_was_loaded(make_node):
    node = make_node()
    assert node.set(targets__images=["a.png"]).successful
    assert node.set(targets__widths_m=[0.5]).successful
    staged = node.server.staged()
    assert staged.targets.images == ("a.png",)
    assert node.server.parameters == Parameters(), "nothing is in force until it is loaded"
    assert node.set(seed=3, targets__widths_m=[0.7]).successful
    node.server.reload(staged)
    assert (node.server.parameters.seed, node.server.parameters.targets.widths_m) == (3, (0.5,))
    staged = node.server.staged()
    assert node.server.reload(staged) is staged
    assert staged.targets.widths_m == (0.7,)


def test_an_encoding_is_set_although_the_camera_file_has_vanished(make_node, tmp_path):
    file = tmp_path / "camera.yaml"
    file.write_text(camera_info_text(camera_of(np.array([[500.0, 0, 240], [0, 500, 180], [0, 0, 1]]), (),
                                               "plumb_bob", 480, 360)))  # fmt: skip
    node = make_node()
    assert node.set(camera__info_file=str(file)).successful
    before = frame_reading(ReadingParameters.of(node.server.parameters))
    file.unlink()
    assert node.set(raw__encoding="bayer_rggb8").successful
    reading = frame_reading(ReadingParameters.of(node.server.parameters), before)
    assert (reading.encoding, reading.file_camera) == ("bayer_rggb8", before.file_camera)
    assert "bayer_rggb8" in node.set(raw__encoding="bayer_rgbg8").reason
    assert "camera.yaml" in node.set(camera__rectified=True).reason


#: Each list parameter with one value, as people write it, and what the list is then; values that it needs beside it.
ONE_VALUE = [
    ("targets.images", "poster.png", ("poster.png",), ()),
    ("targets.names", "poster", ("poster",), ("targets.images:=[a.png]",)),
    ("targets.widths_m", "0.42", (0.42,), ("targets.images:=a.png",)),
    ("targets.widths_m", "1", (1.0,), ("targets.images:=a.png",)),
    ("raw.bands", "3", (3,), ()),
    ("raw.band_weights", "2", (2.0,), ()),
    ("raw.reference_spectrum", "-0.5", (-0.5,), ()),
]
#: Lists of which one value is too few.
TOO_FEW = [
    ("targets.poses", "0.5", "targets.poses: 1 values; need none, or 7: seven for each of targets.images"),
    ("raw.gains", "2", "raw.gains: 1 values; need 3 (red, green, blue)"),
    ("raw.grey_weights", "0.5", "raw.grey_weights: 1 values; need 3 (red, green, blue)"),
    ("camera.covariance", "4.0", "camera.covariance: 1 values; need 16"),
]


def test_every_list_is_tried_with_one_value():
    lists = {known.name for known in declarations() if known.type_name.endswith("_array")}
    assert {name for name, *_ in ONE_VALUE + TOO_FEW} == lists


def offline(*overrides: str, files: Sequence[Path] = ()) -> Parameters:
    """Return what commands without ROS make of files and overrides."""
    given = GivenParameters()
    for file in files:
        given.add_file(file)
    for override in overrides:
        given.add_override(override)
    return parameters_from(given.values())


def value_of(parameters: Parameters, name: str) -> object:
    return parameter_values(parameters)[name]


@pytest.mark.parametrize(("name", "text", "expected", "beside"), ONE_VALUE)
def test_one_value_serves_as_a_list_of_one(make_node, tmp_path, name, text, expected, beside):
    """In an override, in a file, and in a set of the running node, which shows a list in each case."""
    override = f"{name}:={text}"
    file = tmp_path / "p.yaml"
    file.write_text(f"/**:\n  ros__parameters:\n    {name}: {text}\n")
    for node in (make_node(*beside, override), make_node(*beside, arguments=["--params-file", str(file)])):
        assert value_of(node.server.parameters, name) == expected
        assert tuple(node.get_parameter(name).value) == expected
        assert node.get_parameter(name).type_.name.endswith("_ARRAY")
    node = make_node(*beside)
    given = type(expected[0])(text)
    assert node.set(**{name.replace(".", "__"): given}).successful
    assert tuple(node.get_parameter(name).value) == expected
    assert value_of(node.server.reload(), name) == expected
    # Offline it is the same.
    for parameters in (offline(*beside, files=[file]), offline(*beside, override)):
        assert value_of(parameters, name) == expected


@pytest.mark.parametrize(("name", "text", "said"), TOO_FEW)
def test_one_value_where_more_are_needed(make_node, name, text, said):
    with pytest.raises(ParameterError) as caught:
        make_node("targets.images:=a.png", f"{name}:={text}")
    assert str(caught.value).startswith(said)
    node = make_node("targets.images:=a.png")
    result = node.set(**{name.replace(".", "__"): float(text)})
    if name.startswith("targets."):  # wait for `~/reload`
        with pytest.raises(ParameterError) as caught:
            node.server.reload()
    assert said in (str(caught.value) if result.successful else result.reason)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("targets.images:=007", "targets.images[0]: 7 (int); need a string, in quotes"),
        ("targets.names:=on", "targets.names[0]: True (bool); need a string, in quotes"),
        ("targets.widths_m:=wide", "targets.widths_m[0]: 'wide' (str); need a number"),
        ("raw.bands:=0.5", "raw.bands[0]: 0.5 (float); need an integer"),
    ],
)
def test_one_value_of_another_type(make_node, override, said):
    with pytest.raises(ParameterError) as caught:
        make_node(override)
    assert str(caught.value) == said
    with pytest.raises(ParameterError) as caught:
        offline(override)
    assert str(caught.value) == said


def test_ros2_param_set_of_one_value(make_node):
    """Through the node's services, as `ros2 param set` and `ros2 param get` use them."""
    served = make_node("targets.images:=[a.png, b.png]")
    peer = Node("peer", context=served.context, enable_rosout=False, start_parameter_services=False)
    executor = SingleThreadedExecutor(context=served.context)
    for node in (served, peer):
        executor.add_node(node)
    set_them = peer.create_client(SetParameters, "/perception/set_parameters")
    get_them = peer.create_client(GetParameters, "/perception/get_parameters")
    assert set_them.wait_for_service(20.0) and get_them.wait_for_service(20.0)

    def call(client, request):
        future = client.call_async(request)
        executor.spin_until_future_complete(future, 20.0)
        return future.result()

    one = Parameter("targets.images", value="poster.png").to_parameter_msg()
    (result,) = call(set_them, SetParameters.Request(parameters=[one])).results
    assert result.successful, result.reason
    (value,) = call(get_them, GetParameters.Request(names=["targets.images"])).values
    assert (value.type, list(value.string_array_value)) == (9, ["poster.png"])
    (result,) = call(
        set_them, SetParameters.Request(parameters=[Parameter("targets.names", value=5).to_parameter_msg()])
    ).results
    assert (result.successful, result.reason) == (False, "targets.names[0]: 5 (int); need a string, in quotes")
    executor.shutdown()
    peer.destroy_node()


def test_qos_overrides_of_unknown_topics_are_named(make_node, tmp_path):
    """As in a dump of the node under other remaps, or a file for several nodes: rclpy says nothing of them."""
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**: {ros__parameters: {qos_overrides: {/imag: {subscription: {depth: 2, reliability: reliable}}}}}\n"
    )
    node = make_node(arguments=["--params-file", str(file)])
    (line,) = node.server.unknown_qos_overrides(["qos_overrides./image.subscription.depth"])
    assert line.endswith("unknown parameter; nearest known: qos_overrides./image.subscription.depth")
    assert line.startswith("qos_overrides./imag.subscription.")
    known = [f"qos_overrides./imag.subscription.{policy}" for policy in ("depth", "reliability")]
    assert node.server.unknown_qos_overrides(known) == []


def test_fixed_parameters_may_be_set_to_what_they_are(make_node):
    """As `ros2 param load` does with a dump of the node, parameter by parameter."""
    node = make_node("targets.images:=[a.png]")
    names = [known.name for known in declarations()]
    for parameter in [node.get_parameter(name) for name in [*names, "use_sim_time", "start_type_description_service"]]:
        # A list without values is dumped as `[]`, which has no type.
        given = Parameter(parameter.name, value=list(parameter.value)) if parameter.value == [] else parameter
        assert node.set_parameters_atomically([given]).successful, parameter.name
    fixed = [known.name for known in declarations() if known.read_only]
    assert "image_transport" in fixed
    refused = node.set(image_transport="compressed")
    assert not refused.successful
    assert "read-only" in refused.reason
    refused = node.set(image_transport="raw", seed=-1)
    assert not refused.successful
    assert node.set(image_transport="raw", seed=5).successful
    assert node.server.parameters.seed == 5


def test_a_dump_of_the_node_is_read_again(make_node):
    """As `ros2 param dump` wrote it: fixed parameters, QoS overrides, lists without values, a text `on`."""
    dump = REPOSITORY / "test" / "launch_files" / "dump.yaml"
    parameters = make_node(arguments=["--params-file", str(dump)]).server.parameters
    assert parameters.targets.images == ("poster.png",)
    assert parameters.targets.names == ()
    assert parameters.targets.widths_m == (0.594,)
    assert parameters.frames.map == "on"
    # Offline it is the same.
    assert parameters == parameters_from(read_parameter_file(dump))


def test_a_parameter_file_is_read_and_checked(make_node, tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text("perception: {ros__parameters: {targets: {images: []}, homography: {threshold_px: 2}}}\n")
    assert make_node(arguments=["--params-file", str(file)]).server.parameters.homography.threshold_px == 2.0
    file.write_text("/**: {ros__parameters: {homography: {treshold_px: 2.0}}}\n")
    with pytest.raises(ParameterError, match="nearest known: homography.threshold_px"):
        make_node(arguments=["--params-file", str(file)])


def test_the_parameter_file_of_the_package_holds_the_defaults_for_ros_too(make_node, repository):
    """Its own parser reads other YAML than ROS does, which knows no empty list without a type."""
    served = make_node(arguments=["--params-file", str(repository / "config" / "perception.yaml")]).server
    assert parameter_values(served.parameters) == parameter_values(Parameters())


def test_the_state_is_always_one_of_the_accepted_sets(make_node):
    """Random sets, right and wrong, one or several values at a time, against a model."""
    node = make_node()
    rng = random.Random(5)
    # Names of a file and of an encoding are looked up as well: see test_camera_file.
    elsewhere = ("camera.info_file", "raw.encoding")
    known = [d for d in declarations() if not d.read_only and not d.name.startswith(("targets.", *elsewhere))]
    model, accepted = Parameters(), 0
    for _ in range(600):
        values = {d.name: drawn(d, rng) for d in rng.sample(known, rng.choice((1, 1, 2, 3)))}
        before = node.server.parameters
        result = node.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])
        try:
            model = parameters_from(values, model)
        except ParameterError as error:
            assert not result.successful
            assert str(error).partition(":")[0] in result.reason  # noqa: PT017
            assert node.server.parameters is before
        else:
            assert result.successful, result.reason
            accepted += 1
            assert (node.server.parameters is before) == (model == before)
        assert node.server.parameters == model
    assert 150 < accepted < 450
    for name, value in parameter_values(model).items():
        held = node.get_parameter(name).value
        assert (tuple(held) if isinstance(value, tuple) else held) == value, name


def drawn(known: Declaration, rng: random.Random) -> Any:
    """Return a value for a parameter: often right, sometimes too large or of a wrong type."""
    kind = rng.random()
    if kind < 0.1:
        return rng.choice(("no such thing", 2.5, -(2**40), True))
    element = known.type_name.removesuffix("_array")
    low, high = known.bounds or (-300, 300)

    def one() -> Any:
        if known.choices:
            return rng.choice(known.choices)
        if element in ("bool", "string"):
            return rng.random() < 0.5 if element == "bool" else rng.choice(("", "map"))
        value = rng.uniform(low, high if kind < 0.8 else 3 * high + 10)
        return round(value) if element == "integer" else value

    return [one() for _ in range(rng.choice((0, 1, 3)))] if element != known.type_name else one()
