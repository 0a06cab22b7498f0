# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import ParameterError
from imgu_ros.messages.pairing import Pairing

FRAME_NS = 33_000_000


def run(events: str, **options) -> list[tuple[int, int | None]]:
    """Feed "i3 c3 ..." (image or camera_info with stamp 3 frames) and return (image, camera_info) stamps."""
    pairing: Pairing[int, int] = Pairing(**options)
    pairs = []
    for event in events.split():
        number = int(event[1:])
        add = pairing.add_image if event[0] == "i" else pairing.add_camera_info
        pairs += add(number * FRAME_NS, number)
    pairs += pairing.flush()
    return [(pair.image, pair.camera_info) for pair in pairs]


@pytest.mark.parametrize("events", ["i1 c1 i2 c2 i3 c3", "c1 i1 c2 i2 c3 i3", "c1 c2 c3 i1 i2 i3", "i1 i2 c1 i3 c2 c3"])
def test_equal_stamps_meet_in_any_interleaving(events):
    assert run(events) == [(1, 1), (2, 2), (3, 3)]


@pytest.mark.parametrize("events", ["c1 i1 i2 c3 i3", "i1 c1 i2 i3 c3", "i1 i2 c1 c3 i3"])
def test_a_lost_camera_info_falls_back_to_the_latest_earlier(events):
    assert run(events) == [(1, 1), (2, 1), (3, 3)]


def test_a_match_leaves_at_once():
    pairing: Pairing[str, str] = Pairing()
    assert pairing.add_image(5, "image") == []
    (pair,) = pairing.add_camera_info(5, "info")
    assert (pair.image, pair.camera_info, pair.matched, pair.stamp_ns) == ("image", "info", True, 5)
    assert pairing.add_camera_info(6, "info 6") == []
    (pair,) = pairing.add_image(6, "image 6")
    assert pair.camera_info == "info 6"
    assert (pairing.matched, pairing.unmatched) == (2, 0)


def test_an_image_waits_for_two_more_and_no_longer():
    pairing: Pairing[int, int] = Pairing(hold=2)
    assert pairing.add_image(10, 10) == []
    assert pairing.add_image(20, 20) == []
    assert [p.image for p in pairing.add_image(30, 30)] == [10]
    assert [p.image for p in pairing.add_image(40, 40)] == [20]
    assert pairing.unmatched == 2


def test_a_later_camera_info_ends_the_wait():
    pairing: Pairing[int, int] = Pairing()
    assert pairing.add_image(10, 10) == []
    (pair,) = pairing.add_camera_info(11, 11)
    assert pair.camera_info == 11, "nothing earlier: the first after it"
    assert not pair.matched


def test_images_without_stamps_get_a_camera_info():
    pairing: Pairing[int, int] = Pairing()
    pairs = [pair for n in range(1, 30) for pair in (*pairing.add_camera_info(n, n), *pairing.add_image(0, n))]
    assert len(pairs) == 29
    assert {pair.camera_info for pair in pairs} == {1}


def test_a_camera_info_that_is_sent_once_survives_a_jump_of_the_stamps():
    """A stamp of 0 among others, a clock that is set back: nothing newer comes."""
    second = 10**9
    pairing: Pairing[int, int] = Pairing()
    pairing.add_camera_info(50 * second, 1)
    pairs = [pair for n in (50, 51, 0, 52, 5, 6, 7, 8, 9) for pair in pairing.add_image(n * second, n)]
    pairs += pairing.flush()
    assert [pair.image for pair in pairs] == [50, 51, 0, 52, 5, 6, 7, 8, 9]
    assert {pair.camera_info for pair in pairs} == {1}


def test_no_camera_info_at_all():
    assert run("i1 i2 i3 i4") == [(1, None), (2, None), (3, None), (4, None)]


def test_camera_info_published_once():
    images = " ".join(f"i{n}" for n in range(2, 40))
    assert run(f"c1 {images}") == [(n, 1) for n in range(2, 40)]


def test_images_stop_waiting_when_no_camera_info_ever_matches():
    pairing: Pairing[int, int] = Pairing()
    pairing.add_camera_info(0, 0)
    late = [n - pair.image for n in range(1, 30) for pair in pairing.add_image(n * FRAME_NS, n)]
    assert late[:9] == [2] * 9
    assert late[-15:] == [0] * 15
    # A camera_info that comes just after its image shows that waiting is worth it again.
    pairing.add_camera_info(29 * FRAME_NS, 29)
    assert pairing.add_image(30 * FRAME_NS, 30) == []
    assert [p.camera_info for p in pairing.add_camera_info(30 * FRAME_NS, 30)] == [30]


def test_images_pass_alone_when_no_camera_info_is_expected():
    pairing: Pairing[str, str] = Pairing(expects_camera_info=False)
    (pair,) = pairing.add_image(1, "a")
    assert pair.camera_info is None
    assert pairing.add_camera_info(1, "b") == []
    assert (pairing.matched, pairing.unmatched) == (0, 0)
    assert pairing.flush() == []


def test_repeated_stamps_pair_with_the_last_camera_info():
    assert run("c0 i0 c0 i0 i0") == [(0, 0)] * 3
    pairing: Pairing[str, str] = Pairing()
    pairing.add_camera_info(0, "old")
    pairing.add_camera_info(0, "new")
    assert pairing.add_image(0, "image")[0].camera_info == "new"


def test_camera_info_out_of_order():
    assert run("i1 i2 c2 c1 i3 c3") == [(1, 2), (2, 2), (3, 3)]
    assert run("c2 c1 i1 i2 c3 i3") == [(1, 1), (2, 2), (3, 3)]


def test_a_bag_in_a_loop():
    once = " ".join(f"i{n} c{n}" for n in range(1000))
    other_order = " ".join(f"c{n} i{n}" for n in range(1000))
    for second in (once, other_order):
        assert run(f"{once} {second}") == [(n, n) for n in range(1000)] * 2


def test_memory_is_bounded():
    pairing: Pairing[int, int] = Pairing()
    for n in range(5000):
        pairing.add_camera_info(n, n)
    assert [len(infos.by_stamp) for infos in pairing._infos.values()] == [256]
    for n in range(5000, 10000):
        pairing.add_image(n, n)
    assert [len(camera.waiting) for camera in pairing._cameras.values()] == [0]
    for n in range(5000):
        pairing.add_camera_info(n, n, f"camera {n}")
        pairing.add_image(n, n, f"image {n}")
    assert len(pairing._infos) <= 8 and len(pairing._cameras) <= 8


def test_a_strange_camera_info_costs_no_cameras_own():
    """Eight cameras, and camera_info of a ninth name."""
    pairing: Pairing[str, str] = Pairing()
    for n in range(1, 4):
        for name in "ABCDEFGH":
            pairing.add_image(n * FRAME_NS, name, name)
            (pair,) = pairing.add_camera_info(n * FRAME_NS, name, name)
            assert pair.image == pair.camera_info
    assert pairing.add_camera_info(FRAME_NS, "strange", "strange") == []
    assert len(pairing._infos) == 8


def run_cameras(events: str) -> list[tuple[str, str | None]]:
    """Feed "iA3 cA3 ..." (image or camera_info, frame_id, stamp); return the pairs, as written in the events."""
    pairing: Pairing[str, str] = Pairing()
    pairs = []
    for event in events.split():
        add = pairing.add_image if event[0] == "i" else pairing.add_camera_info
        pairs += add(int(event[2:]) * FRAME_NS, event[1:], event[1])
    pairs += pairing.flush()
    return [(pair.image, pair.camera_info) for pair in pairs]


@given(st.permutations(("iA", "iB", "cA", "cB")), st.permutations(("iA", "iB", "cA", "cB")))
def test_two_cameras_on_the_same_topics_get_their_own_camera_info(first, others):
    """Equal stamps, in every order, from the first frame on."""
    events = [f"{event}{n}" for n, order in enumerate([first, *[others] * 5]) for event in order]
    pairs = run_cameras(" ".join(events))
    assert sorted(pairs) == sorted((f"{name}{n}", f"{name}{n}") for name in "AB" for n in range(6))


def test_a_camera_without_camera_info_of_its_own_gets_nobody_elses():
    events = " ".join(f"cA{n} iA{n} iB{n}" for n in range(40))
    pairs = dict(run_cameras(events))
    assert all(info == (image if image[0] == "A" else None) for image, info in pairs.items())
    assert len(pairs) == 80


def test_a_strange_image_does_not_hold_up_a_camera():
    pairing: Pairing[str, str] = Pairing()
    for n in range(1, 20):
        pairing.add_image(n * FRAME_NS, "strange", f"strange {n}")
        assert pairing.add_image(n * FRAME_NS, "image", "A") == []
        (pair,) = pairing.add_camera_info(n * FRAME_NS, "info", "A")
        assert (pair.image, pair.camera_info) == ("image", "info")


@pytest.mark.parametrize("repeats", [1, 3])
def test_a_flood_of_frame_ids_costs_a_camera_nothing(repeats):
    """Between any two of its messages come more other names than are kept apart."""
    pairing: Pairing[str, str] = Pairing()
    strange = (f"strange {n}" for n in range(100_000))

    def flood() -> None:
        for name in [next(strange) for _ in range(40)]:
            for _ in range(repeats):
                pairing.add_image(n * FRAME_NS, "strange", name)
            pairing.add_camera_info(n * FRAME_NS + 1, "strange", f"{name} of another camera")

    for n in range(30):
        assert pairing.add_image(n * FRAME_NS, "image", "A") == [], "it waits for its own"
        if n:  # once it has been matched
            flood()
        pairs = pairing.add_camera_info(n * FRAME_NS, "info", "A")
        assert [(pair.image, pair.camera_info) for pair in pairs] == [("image", "info")]
        flood()
    assert len(pairing._cameras) <= 8 and len(pairing._infos) <= 8


def test_a_camera_info_of_the_far_future_ends_no_wait():
    pairing: Pairing[int, int] = Pairing()
    pairing.add_camera_info(2**31 * 10**9, -1)
    assert pairing.add_image(10, 10) == []
    assert [p.camera_info for p in pairing.add_camera_info(10, 10)] == [10]


@pytest.mark.parametrize("events", ["cx{0} iy{0}", "iy{0} cx{0}"])
def test_a_driver_that_names_camera_info_otherwise(events):
    """Its images take the camera_info that is no other camera's, whatever else comes later under that name."""
    assert run_cameras(" ".join(events.format(n) for n in range(9))) == [(f"y{n}", f"x{n}") for n in range(9)]
    pairing: Pairing[str, str] = Pairing()
    for n in range(5):
        pairing.add_camera_info(n * FRAME_NS, "info", "x")
        pairing.add_image(n * FRAME_NS, "image", "y")
    pairing.add_camera_info(5 * FRAME_NS, "info", "x")
    pairing.add_image(5 * FRAME_NS, "strange", "x")
    (pair,) = pairing.add_image(5 * FRAME_NS, "image", "y")
    assert pair.camera_info == "info"


def test_only_the_first_image_waits_where_names_differ():
    pairing: Pairing[int, int] = Pairing()
    left = []
    for n in range(8):
        pairs = pairing.add_camera_info(n * FRAME_NS, n, "x") + pairing.add_image(n * FRAME_NS, n, "y")
        left.append([pair.image for pair in pairs])
    assert left == [[], [], [0, 1, 2], [3], [4], [5], [6], [7]]


def test_a_camera_that_changes_its_name_gets_what_was_sent_once():
    pairing: Pairing[int, int] = Pairing()
    pairing.add_camera_info(0, 1, "old")
    for n in range(50):
        pairing.add_image(n * FRAME_NS, n, "old")
    infos = [pair.camera_info for n in range(50, 300) for pair in pairing.add_image(n * FRAME_NS, n, "new")]
    assert set(infos[-140:]) == {1}


def test_negative_hold_is_refused():
    with pytest.raises(ParameterError, match="hold: -1"):
        Pairing(hold=-1)


@st.composite
def interleavings(draw):
    """Images 0 ... n-1, some camera_info lost, the rest arriving from two images early to just before two late."""
    count = draw(st.integers(1, 25))
    # At least every eighth is there: longer gaps are `test_images_stop_waiting...`.
    present = [n for n in range(count) if n % 8 == 0 or draw(st.booleans())]
    slots: list[list[int]] = [[] for _ in range(count + 3)]
    earliest = 0
    for n in present:
        earliest = draw(st.integers(max(earliest, n - 2), n + 2))
        slots[earliest].append(n)
    events = []
    for n in range(count + 3):
        events += [f"c{k}" for k in slots[n]] + ([f"i{n}"] if n < count else [])
    return count, present, " ".join(events)


@given(interleavings())
def test_pairs_do_not_depend_on_the_interleaving(case):
    count, present, events = case
    expected = [(n, max((k for k in present if k <= n), default=None)) for n in range(count)]
    assert run(events) == expected
