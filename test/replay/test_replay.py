# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imgu_ros.bags.messages import make_message
from imgu_ros.bags.reading import open_bag
from imgu_ros.bags.writing import BagWriter
from imgu_ros.config.files import read_parameter_file
from imgu_ros.config.parameters import Parameters
from imgu_ros.config.values import parameters_from
from imgu_ros.errors import BagError, FileError, ParameterError
from imgu_ros.files.frames_csv import COLUMNS
from imgu_ros.image_files.images import write_image
from imgu_ros.reference.templates import TargetImage
from imgu_ros.replay.recording import record_simulation
from imgu_ros.replay.replay import replay
from imgu_ros.result import Stage
from imgu_ros.simulate.sequence import Simulation
from imgu_ros.simulate.texture import procedural_texture
from imgu_ros.simulate.truth import corner_error, read_truth

SIZE = (480, 360)
TEMPLATE = (640, 480)
FRAMES = 5
IMAGE = "/camera/image_raw"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    poster = TargetImage("poster", procedural_texture(*TEMPLATE), 0.5)
    record_simulation(path, Simulation(width=SIZE[0], height=SIZE[1], frames=FRAMES), targets=[poster])
    return path


@pytest.fixture(autouse=True)
def _no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes longer than replaying: only the module's own replay draws its report."""
    monkeypatch.setattr("imgu_ros.replay.reporting.write_report", lambda path, *_: path.touch())


@pytest.fixture(scope="module")
def parameters(bag: Path) -> Parameters:
    return parameters_from(read_parameter_file(bag / "params.yaml"))


@pytest.fixture(scope="module")
def clean(bag: Path, parameters: Parameters, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("clean") / "out"
    replay([bag], out, parameters, truth=bag / "truth.csv", record=["keypoints", "path", "/debug_image"])
    return out


@pytest.fixture
def rewritten(bag: Path, tmp_path: Path) -> Callable[[Callable[[int, Any], Any | None]], Path]:
    """Copy the bag, each message through a function (index of its frame, message) -> message or None."""

    def rewrite(change: Callable[[int, Any], Any | None]) -> Path:
        out = tmp_path / "rewritten"
        count = {"CameraInfo": 0, "Image": 0}
        with open_bag([bag]) as source, BagWriter(out) as writer:
            for message in source.messages():
                kind = message.type_name.rpartition("/")[2]
                changed = change(count[kind], message.message)
                count[kind] += 1
                if changed is not None:
                    writer.write(message.topic, changed, message.time_ns)
        return out

    return rewrite


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "frames.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def untimed(row: dict[str, str]) -> dict[str, str]:
    return {name: value for name, value in row.items() if not name.startswith("t_")}


def with_fields(message: Any, **changed: object) -> Any:
    fields = {name: getattr(message, name) for name in message.__dataclass_fields__ if not name.startswith("__")}
    return type(message)(**{**fields, **changed})


def test_columns_are_those_of_the_interface(clean: Path) -> None:
    h = [f"h{i}{j}" for i in "123" for j in "123"]
    c = [f"c{i}{j}" for i in "123456" for j in "123456"]
    expected = (
        "stamp_ns,frame_id,target,status,pose_status,reason".split(",")
        + "n_keypoints,n_matches,n_inliers,rms_px,confirmed_share".split(",")
        + h
        + "tx,ty,tz,qx,qy,qz,qw".split(",")
        + c
        + ["ambiguity", "t_total_ms"]
        + [f"t_{stage}_ms" for stage in Stage]
    )
    header = (clean / "frames.csv").read_text().splitlines()[0]
    assert header.split(",") == expected == list(COLUMNS)


def test_every_frame_is_found_and_near_the_truth(bag: Path, clean: Path) -> None:
    got = rows(clean)
    assert [int(row["stamp_ns"]) for row in got] == sorted({t.stamp_ns for t in read_truth(bag / "truth.csv")})
    for row, truth in zip(got, read_truth(bag / "truth.csv"), strict=True):
        H = np.array([float(row[f"h{i}{j}"]) for i in "123" for j in "123"]).reshape(3, 3)
        assert row["status"] in ("detected", "tracked")
        assert corner_error(H, truth.H, TEMPLATE, SIZE) < 0.07
        assert np.linalg.norm(H) == pytest.approx(1, abs=1e-12)
        assert float(row["qw"]) >= 0


def test_numbers_round_trip_and_nothing_is_nan(clean: Path) -> None:
    for row in rows(clean):
        for name in COLUMNS[6:]:
            value = row[name]
            assert not value or value == repr(float(value) if "." in value or "e" in value else int(value))
            assert value not in ("nan", "inf")


def test_results_bag_says_the_same_to_the_last_digit(clean: Path) -> None:
    got = rows(clean)
    with open_bag([clean / "results"]) as results:
        topics = {topic.name: topic.count for topic in results.topics}
        poses = [m.message for m in results.messages(["/pose"])]
        images = [m.message for m in results.messages(["/debug_image"])]
    expected = {"homography", "status", "outline", "pose", "odom", "keypoints", "debug_image"}
    expected |= {f"targets/poster/{name}" for name in ("outline", "pose", "odom")}
    expected |= {"annotations", "detections", "markers", "camera_info", "tf"}
    assert {name: count for name, count in topics.items() if "path" not in name} == {f"/{n}": FRAMES for n in expected}
    assert topics["/path"] == topics["/targets/poster/path"] == 1
    for row, message in zip(got, poses, strict=True):
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == int(row["stamp_ns"])
        assert message.header.frame_id == row["frame_id"]
        assert [float(row[n]) for n in ("tx", "ty", "tz")] == [getattr(message.pose.pose.position, a) for a in "xyz"]
        q = message.pose.pose.orientation
        assert [float(row[n]) for n in ("qx", "qy", "qz", "qw")] == [q.x, q.y, q.z, q.w]
        assert [float(row[f"c{i}{j}"]) for i in "123456" for j in "123456"] == list(message.pose.covariance)
    assert (images[0].width, images[0].height, images[0].encoding) == (*SIZE, "rgb8")


def test_trajectory_is_the_camera_before_the_target(bag: Path, clean: Path) -> None:
    lines = [line.split() for line in (clean / "poses_poster.tum").read_text().splitlines()]
    truths = read_truth(bag / "truth.csv")
    assert len(lines) == len(truths)
    for line, truth in zip(lines, truths, strict=True):
        seconds, nanoseconds = line[0].split(".")
        assert int(seconds) * 10**9 + int(nanoseconds) == truth.stamp_ns
        camera = -truth.pose.R.T @ truth.pose.t
        assert np.linalg.norm(np.array(line[1:4], float) - camera) < 0.01 * np.linalg.norm(camera)


def test_twice_the_same(bag: Path, clean: Path, parameters: Parameters, tmp_path: Path) -> None:
    replay([bag], tmp_path / "out", parameters)
    # Keypoints were recorded once: then a tracked frame has some too.
    one, other = ([untimed(row) | {"n_keypoints": ""} for row in rows(path)] for path in (tmp_path / "out", clean))
    assert one == other
    for name in ("poses_poster.tum", "ambiguous.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (clean / name).read_bytes()


def test_summary(clean: Path) -> None:
    summary = json.loads((clean / "summary.json").read_text())
    target = summary["targets"][0]
    assert (summary["frames"], summary["rejected"], target["found"]) == (FRAMES, 0, FRAMES)
    assert target["status"]["detected"] + target["status"]["tracked"] == FRAMES
    assert 0 < target["corner_error_px"]["p50"] <= target["corner_error_px"]["p95"] < 0.07
    assert target["rotation_error_deg"]["p50"] < 0.05
    assert target["translation_error_percent"]["p50"] < 0.02
    assert summary["rate_in_hz"] == pytest.approx(15, rel=1e-6)
    assert set(summary["stage_ms"]) <= {stage.value for stage in Stage}
    assert summary["parameters"]["targets.names"] == ["poster"]
    assert {"imgu_ros", "numpy", "opencv", "rosbags"} <= set(summary["versions"])
    assert summary["source"]["image_topic"] == IMAGE


def test_what_is_odd_about_frames_is_said_once(
    rewritten: Callable[..., Path], clean: Path, parameters: Parameters, tmp_path: Path
) -> None:
    """Rows of another length than `step` says, and bytes behind the last row."""

    def change(index: int, message: Any) -> Any:
        if not hasattr(message, "encoding"):
            return message
        return with_fields(message, data=np.append(message.data, np.zeros(7 + index, np.uint8)))

    said: list[str] = []
    replay([rewritten(change)], tmp_path / "out", parameters, on_warning=said.append)
    remarks = [text for text in said if "more than step x height" in text]
    assert remarks == [f"{IMAGE}: data: 172807 bytes, 7 more than step x height = 480 x 360; these are ignored"]
    assert [row["h11"] for row in rows(tmp_path / "out")] == [row["h11"] for row in rows(clean)]


def test_unreadable_frames_become_rows_beside_the_others(
    rewritten: Callable[..., Path], clean: Path, parameters: Parameters, tmp_path: Path
) -> None:
    damage = {
        1: {"encoding": "no_such_encoding"},
        2: {"data": np.zeros(100, np.uint8)},
        3: {"width": 100_000},
    }

    def change(index: int, message: Any) -> Any:
        return with_fields(message, **damage[index]) if hasattr(message, "encoding") and index in damage else message

    said: list[str] = []
    summary = replay([rewritten(change)], tmp_path / "out", parameters, on_warning=said.append)
    got, before = rows(tmp_path / "out"), rows(clean)
    assert [row["status"] == "rejected" for row in got] == [False, True, True, True, False]
    assert untimed(got[0]) == untimed(before[0])
    # A tracker may remember other frames: the last one is equal to within what it was given.
    H, H_before = (np.array([float(rows_[4][f"h{i}{j}"]) for i in "123" for j in "123"]) for rows_ in (got, before))
    assert np.abs(H - H_before).max() < 1e-4
    for index in damage:
        assert [got[index][n] for n in ("stamp_ns", "frame_id", "target")] == [
            before[index][n] for n in ("stamp_ns", "frame_id", "target")
        ]
        assert got[index]["reason"].startswith("the frame cannot be used (")
        assert not any(got[index][name] for name in COLUMNS[4:] if name != "reason")
    assert summary.rejected == 3
    assert {reason.status for reason in summary.reasons} == {"rejected"}
    assert len([text for text in said if "no_such_encoding" in text]) == 1
    assert any("no_such_encoding" in reason.reason for reason in summary.reasons)


def test_one_reason_is_said_once(rewritten: Callable[..., Path], parameters: Parameters, tmp_path: Path) -> None:
    def change(index: int, message: Any) -> Any:
        is_bad = hasattr(message, "encoding") and index > 0
        return with_fields(message, data=message.data[: 1000 + index]) if is_bad else message

    said: list[str] = []
    summary = replay([rewritten(change)], tmp_path / "out", parameters, on_warning=said.append)
    assert len(said) == 1
    assert [reason.count for reason in summary.reasons] == [FRAMES - 1]


def test_not_one_readable_frame_is_an_error_but_leaves_the_rows(
    rewritten: Callable[..., Path], parameters: Parameters, tmp_path: Path
) -> None:
    def change(_: int, message: Any) -> Any:
        return with_fields(message, width=0) if hasattr(message, "encoding") else message

    with pytest.raises(BagError, match="not one of 5 frames"):
        replay([rewritten(change)], tmp_path / "out", parameters)
    assert [row["status"] for row in rows(tmp_path / "out")] == ["rejected"] * FRAMES
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.parametrize("kind", ["no_camera_info", "zero_K"])
def test_uncalibrated_is_said_once(
    rewritten: Callable[..., Path], clean: Path, parameters: Parameters, tmp_path: Path, kind: str
) -> None:
    def change(_: int, message: Any) -> Any | None:
        if not hasattr(message, "k"):
            return message
        return None if kind == "no_camera_info" else with_fields(message, k=np.zeros(9))

    said: list[str] = []
    replay([rewritten(change)], tmp_path / "out", parameters, on_warning=said.append)
    got = rows(tmp_path / "out")
    assert [row["pose_status"] for row in got] == ["uncalibrated"] * FRAMES
    assert np.allclose([float(row["h13"]) for row in got], [float(row["h13"]) for row in rows(clean)], atol=1e-4)
    assert not any(row["tx"] or row["c11"] for row in got)
    assert len([text for text in said if text.startswith("uncalibrated")]) == 1
    assert (tmp_path / "out" / "poses_poster.tum").read_text() == ""


def with_header(message: Any, stamp_ns: int | None = None, **changed: object) -> Any:
    if stamp_ns is not None:
        stamp = with_fields(message.header.stamp, sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        changed["stamp"] = stamp
    return with_fields(message, header=with_fields(message.header, **changed))


#: Stamps of five frames, s: how many poses rise, and what is said of the others.
STAMPS: dict[str, tuple[list[float], int, str]] = {
    "zero": ([0, 0, 0, 0, 0], 1, "are 0 in 4 of 5 images"),
    "repeated": ([5, 5.1, 5.1, 5.2, 5.2], 3, "are repeated in 2 of 5 images (first at 5100000000 ns)"),
    "falling": ([5, 5.2, 5.1, 5.15, 5.3], 3, "fall in 1 of 5 images (first by 0.1 s at 5100000000 ns)"),
    "set back": ([50, 50.1, 5, 5.1, 5.2], 2, "jump back in 1 of 5 images (first by 45.1 s at 5000000000 ns)"),
    "from zero": ([0, 0.1, 0.2, 0.3, 0.4], 5, ""),
}


@pytest.mark.parametrize("kind", STAMPS)
def test_stamps_that_do_not_rise(
    rewritten: Callable[..., Path], clean: Path, parameters: Parameters, tmp_path: Path, kind: str
) -> None:
    stamps, written, said = STAMPS[kind]
    bag = rewritten(lambda index, message: with_header(message, round(stamps[index] * 10**9)))
    warnings: list[str] = []
    summary = replay([bag], tmp_path / "out", parameters, on_warning=warnings.append)
    got = rows(tmp_path / "out")
    # Every frame has its row and its pose.
    assert [int(row["stamp_ns"]) for row in got] == [round(stamp * 10**9) for stamp in stamps]
    for row, known in zip(got, rows(clean), strict=True):
        assert row["pose_status"] == "metric"
        assert np.allclose([float(row[c]) for c in ("tx", "ty", "tz")],
                           [float(known[c]) for c in ("tx", "ty", "tz")], atol=2e-3)  # fmt: skip
    # A trajectory rises, as its readers need it.
    times = [float(line.split()[0]) for line in (tmp_path / "out" / "poses_poster.tum").read_text().splitlines()]
    assert len(times) == written and (np.diff(times) > 0).all()
    about = [text for text in warnings if text.startswith(f"stamps of {IMAGE} ")]
    assert len(about) == bool(said) and all(said in text for text in about)
    left_out = (
        f"poses_poster.tum: {FRAMES - written} poses left out, whose stamps do not rise; frames.csv has all of them"
    )
    assert (left_out in warnings) == (written < FRAMES)
    assert set(warnings) <= set(summary.warnings)


@pytest.mark.parametrize(("frame_id", "goes_out"), [("/camera/optical", "camera/optical"), ("//eye", "eye"), ("", "")])
def test_names_of_frames(
    rewritten: Callable[..., Path], parameters: Parameters, tmp_path: Path, frame_id: str, goes_out: str
) -> None:
    bag = rewritten(lambda _, message: with_header(message, frame_id=frame_id))
    said: list[str] = []
    replay([bag], tmp_path / "out", parameters, on_warning=said.append)
    assert {row["frame_id"] for row in rows(tmp_path / "out")} == {goes_out}
    with open_bag([tmp_path / "out" / "results"]) as results:
        names = {m.message.header.frame_id for m in results.messages(["/pose", "/homography"])}
        children = {m.message.child_frame_id for m in results.messages(["/odom"])}
    assert names == children == {goes_out}
    (line,) = [text for text in said if text.startswith("frame_id")]
    if frame_id:
        assert line.endswith(f"{frame_id!r}; tf2 refuses a leading slash: {goes_out!r} goes out")
    else:
        assert "is empty" in line and "set frames.camera" in line
    # A name of the user's own stands for all.
    named = parameters_from({"frames.camera": "/mine", "frames.map": "/map"}, parameters)
    said.clear()
    replay([bag], tmp_path / "named", named, on_warning=said.append)
    assert not [text for text in said if text.startswith("frame_id")]
    with open_bag([tmp_path / "named" / "results"]) as results:
        assert {m.message.header.frame_id for m in results.messages(["/pose"])} == {"mine"}


def test_a_camera_info_of_another_frame_is_said_once(
    rewritten: Callable[..., Path], parameters: Parameters, tmp_path: Path
) -> None:
    bag = rewritten(lambda _, message: with_header(message, frame_id="base") if hasattr(message, "k") else message)
    said: list[str] = []
    replay([bag], tmp_path / "out", parameters, on_warning=said.append)
    (line,) = [text for text in said if text.startswith("frame_id")]
    assert "/camera/camera_info: 'base'" in line and "'camera_optical_frame'; the images' goes out" in line


@pytest.mark.parametrize(("width_m", "likely"), [(50.0, "0.5 (50 cm)"), (500.0, "0.5 (500 mm)"), (0.0005, "0.5")])
def test_a_width_of_another_unit_is_said_once(
    bag: Path, parameters: Parameters, tmp_path: Path, width_m: float, likely: str
) -> None:
    wrong = parameters_from({"targets.widths_m": [width_m]}, parameters)
    said: list[str] = []
    summary = replay([bag], tmp_path / "out", wrong, on_warning=said.append)
    (line,) = [text for text in said if text.startswith("targets.widths_m")]
    assert line.startswith(f"targets.widths_m {width_m:g}: poster would be ") and f"did you mean {likely}" in line
    assert line in summary.warnings


def test_a_target_that_looks_the_same_turned_is_said(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    half = procedural_texture(240, 90, seed=4)
    write_image(tmp_path / "card.png", np.vstack((half, half[::-1, ::-1])))
    images = {"targets.images": [*parameters.targets.images, str(tmp_path / "card.png")], "targets.names": []}
    two = parameters_from(images | {"targets.widths_m": [0.5, 0.1]}, parameters)
    said: list[str] = []
    summary = replay([bag], tmp_path / "out", two, on_warning=said.append)
    lines = [line for line in said if line.startswith("target card: looks the same turned by 180 degrees")]
    assert len(lines) == 1
    assert lines[0] in summary.warnings
    assert not any("target poster" in line for line in said)


@pytest.mark.parametrize("field", [{"k": np.full(9, np.nan)}, {"width": 100, "height": 100}])
def test_bad_camera_info_costs_its_frame_the_pose_alone(
    rewritten: Callable[..., Path], parameters: Parameters, tmp_path: Path, field: dict[str, object]
) -> None:
    def change(index: int, message: Any) -> Any:
        return with_fields(message, **field) if hasattr(message, "k") and index == 2 else message

    said: list[str] = []
    summary = replay([rewritten(change)], tmp_path / "out", parameters, on_warning=said.append)
    got = rows(tmp_path / "out")
    assert [row["pose_status"] for row in got] == [*["metric"] * 2, "uncalibrated", *["metric"] * 2]
    assert all(row["h11"] for row in got)
    told = [text for text in said if text.startswith("uncalibrated: camera_info: ")]
    assert len(told) == 1
    assert told[0] in summary.warnings
    assert [(reason.status, reason.count) for reason in summary.reasons] == [("uncalibrated", 1)]
    assert summary.reasons[0].reason in told[0]


def test_a_calibration_file_of_another_size_costs_the_poses_alone(
    bag: Path, parameters: Parameters, tmp_path: Path
) -> None:
    text = "{width: 960, height: 720, k: [816, 0, 480, 0, 816, 360, 0, 0, 1], d: [], distortion_model: ''}"
    (tmp_path / "c.yaml").write_text(text)
    said: list[str] = []
    camera = replace(parameters.camera, info_file=str(tmp_path / "c.yaml"))
    replay([bag], tmp_path / "out", replace(parameters, camera=camera), on_warning=said.append)
    assert {row["pose_status"] for row in rows(tmp_path / "out")} == {"uncalibrated"}
    (told,) = (text for text in said if text.startswith("uncalibrated"))
    assert "c.yaml: size 960 x 720 px, image" in told
    assert "helps" not in told


def test_overwrite_rules(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("kept")
    (out / "poses_old.tum").write_text("mine too")
    with pytest.raises(FileError, match=r"not empty.*--overwrite"):
        replay([bag], out, parameters)
    assert sorted(path.name for path in out.iterdir()) == ["mine.txt", "poses_old.tum"]
    replay([bag], out, parameters, overwrite=True)
    replay([bag], out, parameters, overwrite=True)
    assert (out / "mine.txt").read_text() == "kept"
    assert (out / "poses_old.tum").read_text() == "mine too"


def test_never_removes_what_it_is_to_read(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(bag, out / "results")
    with pytest.raises(FileError, match="to be read"):
        replay([out / "results"], out, parameters, overwrite=True)
    with pytest.raises(FileError, match="it is yours, or of an earlier version"):
        replay([bag], out, parameters, overwrite=True)
    assert sorted(path.name for path in (out / "results").iterdir()) == sorted(path.name for path in bag.iterdir())


def test_failures_leave_no_folder_behind(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for call in (
        lambda: replay([bag], out, Parameters()),
        lambda: replay([tmp_path / "no_such_bag"], out, parameters),
        lambda: replay([bag], out, parameters, truth=tmp_path / "no_truth.csv"),
        lambda: replay([bag], out, parameters, record=["keypoint"]),
    ):
        with pytest.raises((ParameterError, BagError, FileError)):
            call()
    assert not out.exists()


def test_truth_of_another_bag_is_said(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    lines = (bag / "truth.csv").read_text().replace(",poster,", ",other,")
    (tmp_path / "truth.csv").write_text(lines)
    summary = replay([bag], tmp_path / "out", parameters, truth=tmp_path / "truth.csv")
    assert any("its targets: other" in text for text in summary.warnings)
    assert summary.targets[0].corner_error_px is None


def test_chooses_the_first_topic_that_it_can_read(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    mixed = tmp_path / "mixed"
    with open_bag([bag]) as source, BagWriter(mixed) as writer:
        for message in source.messages():
            if message.topic == IMAGE:
                bad = with_fields(message.message, encoding="proprietary")
                writer.write("/a/image", bad, message.time_ns)
            writer.write(message.topic, message.message, message.time_ns)
    summary = replay([mixed], tmp_path / "out", parameters)
    assert summary.source.image_topic == IMAGE
    assert any("several image topics" in text for text in summary.warnings)
    named = parameters_from({"image_topic": "/a/image"}, parameters)
    with pytest.raises(BagError, match="/a/image"):
        replay([mixed], tmp_path / "named", named)


def test_empty_image_topic(parameters: Parameters, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/chatter", make_message("std_msgs/msg/String", data="hello"), 1)
    with pytest.raises(BagError, match="no image topic"):
        replay([tmp_path / "bag"], tmp_path / "out", parameters)


def test_damage_is_said_even_when_nothing_is_left(bag: Path, parameters: Parameters, tmp_path: Path) -> None:
    content = next(bag.glob("*.mcap")).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[:20])
    said: list[str] = []
    with pytest.raises(BagError, match="no image topic"):
        replay([tmp_path / "cut.mcap"], tmp_path / "out", parameters, on_warning=said.append)
    assert any("cut.mcap" in text for text in said)


def test_a_missing_bag_is_said_before_a_missing_target(tmp_path: Path) -> None:
    for values in ({}, {"targets.images": ["absent.png"]}):
        with pytest.raises(BagError, match="absent_bag"):
            replay([tmp_path / "absent_bag"], tmp_path / "out", parameters_from(values))


def test_a_bag_named_twice_is_refused(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(bag)
    (file,) = bag.glob("*.mcap")
    for other in (bag, tmp_path / "link", bag / "metadata.yaml", file):
        for both in ([bag, other], [other, bag]):
            with pytest.raises(BagError, match=r"the same bag as .+; need each bag once$"):
                open_bag(both)
