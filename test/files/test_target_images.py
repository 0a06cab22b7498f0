"""Target pictures: names, paths, depths, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgu_ros.errors import FileError, ParameterError
from imgu_ros.files.images import write_image
from imgu_ros.files.target_images import load_target_images, name_from_stem
from imgu_ros.params import TargetsParameters

TEXTURE = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)


def test_names_widths_and_pixels(tmp_path):
    write_image(tmp_path / "a poster-1.png", TEXTURE)
    write_image(tmp_path / "grey.pgm", TEXTURE[..., 0])
    paths = (str(tmp_path / "a poster-1.png"), str(tmp_path / "grey.pgm"))
    first, second = load_target_images(TargetsParameters(images=paths, widths_m=(0.3, 0.0)))
    assert (first.name, first.width_m, second.name, second.width_m) == ("a_poster_1", 0.3, "grey", 0.0)
    assert np.array_equal(first.pixels, TEXTURE)
    assert np.array_equal(second.pixels, TEXTURE[..., 0])
    named = load_target_images(TargetsParameters(images=paths, names=("left", "Right_2")))
    assert [(t.name, t.width_m) for t in named] == [("left", 0.0), ("Right_2", 0.0)]
    assert load_target_images(TargetsParameters()) == ()


def test_home_variables_and_relative_paths(tmp_path, monkeypatch):
    write_image(tmp_path / "poster.png", TEXTURE)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("POSTERS", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for text in ("~/poster.png", "$POSTERS/poster.png", "${POSTERS}/poster.png", "poster.png"):
        (target,) = load_target_images(TargetsParameters(images=(text,)))
        assert target.name == "poster"
    with pytest.raises(FileError, match="variable \\$NOT_SET is not set"):
        load_target_images(TargetsParameters(images=("$NOT_SET/poster.png",)))


@given(st.text(max_size=20))
def test_any_stem_becomes_a_ros_name(stem):
    name = name_from_stem(stem)
    assert name.isascii()
    assert name[0].isalpha()
    assert "__" not in name
    assert name.replace("_", "").isalnum()
    assert name_from_stem(name) == name


def test_known_stems():
    stems = {"poster": "poster", "4_up": "target_4_up", "Plakat größe": "Plakat_groe", "__a--b": "a_b", "": "target"}
    for stem, name in stems.items():
        assert name_from_stem(stem) == name


@pytest.mark.parametrize("name", ["", "4a", "a b", "a__b", "a/b", "ä", "_a"])
def test_a_given_name_must_be_a_ros_name(tmp_path, name):
    with pytest.raises(ParameterError, match=r"targets\.names"):
        load_target_images(TargetsParameters(images=("x.png",), names=(name,)))


def test_collisions_are_refused(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_image(tmp_path / folder / "poster.png", TEXTURE)
    paths = tuple(str(tmp_path / folder / "poster.png") for folder in ("a", "b"))
    with pytest.raises(ParameterError, match="'poster' for both"):
        load_target_images(TargetsParameters(images=paths))
    assert len(load_target_images(TargetsParameters(images=paths, names=("one", "two")))) == 2


def test_deep_pictures_keep_their_contrast(tmp_path):
    for bits in (8, 10, 12, 16):
        deep = (TEXTURE.astype(np.uint32) * (2**bits - 1) // 255).astype(np.uint16)
        write_image(tmp_path / "deep.png", deep)
        (target,) = load_target_images(TargetsParameters(images=(str(tmp_path / "deep.png"),)))
        assert target.pixels.dtype == np.uint8
        assert np.abs(target.pixels.astype(int) - TEXTURE).max() <= 1
    write_image(tmp_path / "float.tif", (TEXTURE / 255).astype(np.float32))
    (target,) = load_target_images(TargetsParameters(images=(str(tmp_path / "float.tif"),)))
    assert np.array_equal(target.pixels, TEXTURE)


def test_bad_pictures_are_refused_in_one_line(tmp_path):
    write_image(tmp_path / "blank.png", np.full((40, 40, 3), 200, np.uint8))
    write_image(tmp_path / "tiny.png", TEXTURE[:8, :8])
    (tmp_path / "text.png").write_text("hello")
    cases = {"blank.png": "blank", "tiny.png": "8 x 8 px", "text.png": "not an image", "none.png": "No such file"}
    for name, text in cases.items():
        with pytest.raises(FileError, match=text) as error:
            load_target_images(TargetsParameters(images=(str(tmp_path / name),)))
        assert "\n" not in str(error.value)
        assert name in str(error.value)
    with pytest.raises(FileError, match="empty file name"):
        load_target_images(TargetsParameters(images=("",)))
