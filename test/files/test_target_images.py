# SPDX-License-Identifier: Apache-2.0
"""Target pictures: names, paths, depths, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow
from PIL import ImageDraw, ImageOps

from imgu_ros.config.parameters import TargetsParameters
from imgu_ros.errors import FileError, ParameterError
from imgu_ros.files.target_images import load_target_images, name_from_stem
from imgu_ros.image_files.formats import is_decoder_safe
from imgu_ros.image_files.images import write_image

WEBP = [".webp"] if is_decoder_safe() else []
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


def loaded(*paths) -> tuple[list[np.ndarray], list[str]]:
    said: list[str] = []
    targets = load_target_images(TargetsParameters(images=tuple(str(path) for path in paths)), said.append)
    return [target.pixels for target in targets], said


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", *WEBP])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_target_is_turned_as_its_tag_says(tmp_path, suffix, orientation):
    """Pillow writes the tag, and shows what the picture looks like."""
    path = tmp_path / f"poster{suffix}"
    exif = Pillow.Exif()
    exif[0x0112] = orientation
    Pillow.fromarray(TEXTURE).save(path, exif=exif, **({"lossless": True} if suffix == ".webp" else {}))
    with Pillow.open(path) as opened:
        shown = np.array(ImageOps.exif_transpose(opened))
    (pixels,), said = loaded(path)
    assert pixels.shape == (TEXTURE.shape if orientation < 5 else (60, 40, 3))
    assert np.abs(pixels.astype(int) - shown).max() <= (2 if suffix == ".jpg" else 0)
    assert said == []


def logo(color: tuple[int, int, int]) -> Pillow.Image:
    """A shape of one colour: its form is in the alpha channel alone, as design tools export logos."""
    image = Pillow.new("RGBA", (80, 60), (*color, 0))
    draw = ImageDraw.Draw(image)
    draw.ellipse((10, 8, 50, 48), fill=(*color, 255))
    draw.rectangle((40, 30, 74, 55), fill=(*color, 120))
    return image


@pytest.mark.parametrize(
    "name", ["logo.png", "logo.tif", *(f"logo{suffix}" for suffix in WEBP), "palette.png", "grey.png"]
)
def test_a_shape_in_alpha_alone_is_a_picture(tmp_path, name):
    image = logo((0, 0, 0))
    paper = Pillow.new("RGBA", image.size, (255, 255, 255, 255))
    paper.alpha_composite(image)
    expected = np.array(paper.convert("L")).astype(int)
    if name == "palette.png":
        image = image.quantize(8, method=Pillow.Quantize.FASTOCTREE)
    (image.convert("LA") if name == "grey.png" else image).save(
        tmp_path / name, **({"lossless": True, "exact": True} if name.endswith("webp") else {})
    )
    (pixels,), said = loaded(tmp_path / name)
    grey = pixels if pixels.ndim == 2 else pixels[..., 0]
    assert np.abs(grey.astype(int) - expected).max() <= (8 if name == "palette.png" else 1)
    assert said == [f"{tmp_path / name}: transparent: composed on white"]


@pytest.mark.parametrize("color", [(255, 255, 255), (250, 252, 251)])
def test_a_white_shape_on_transparency_is_white_on_black(tmp_path, color):
    logo(color).save(tmp_path / "logo.png")
    (pixels,), said = loaded(tmp_path / "logo.png")
    assert np.array_equal(pixels, np.array(logo(color))[..., 3])
    assert said == [f"{tmp_path / 'logo.png'}: a white shape on transparency: taken as white on black"]


def test_a_picture_that_is_all_transparent_is_blank(tmp_path):
    Pillow.new("RGBA", (80, 60), (10, 200, 30, 0)).save(tmp_path / "nothing.png")
    with pytest.raises(FileError, match="blank"):
        loaded(tmp_path / "nothing.png")
