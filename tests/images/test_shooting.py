"""How a photograph was taken: EXIF data in every container, and the angle of view that follows."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from picture_files import chunk, png_of, rgb, write_exr
from torchbrdf.images import Shooting, read_shooting, write_image

TAKEN = {
    0x829A: IFDRational(1, 60),
    0x829D: 8.0,
    0x8827: 200,
    0x920A: 50.0,
    0xA405: 75,
    0xA002: 30,
    0xA003: 20,
    0xA403: 1,
}
EXPECTED = Shooting(1 / 60, 8.0, 200.0, 50.0, 75.0, (20, 30), None, "Maker One", "manual")
PIXELS = np.zeros((20, 30, 3), dtype="u1")


def exif(tags: dict[int, object] = TAKEN, orientation: int = 1) -> Image.Exif:
    block = Image.Exif()
    block[0x010F], block[0x0110], block[0x0112] = "Maker", "Maker One", orientation
    block.get_ifd(0x8769).update(tags)
    return block


def jpeg(path: Path, tags: dict[int, object] = TAKEN, orientation: int = 1) -> Path:
    Image.fromarray(PIXELS).save(path, exif=exif(tags, orientation))
    return path


def write(path: Path) -> Path:
    if path.suffix == ".png":
        path.write_bytes(png_of(PIXELS, chunk(b"eXIf", exif().tobytes().removeprefix(b"Exif\0\0"))))
    elif path.suffix == ".tif":
        path.write_bytes(exif().tobytes().removeprefix(b"Exif\0\0"))  # which is a TIFF file, without pixels
    elif path.suffix == ".exr":
        write_image(path, torch.zeros(3, 20, 30), EXPECTED.attributes())
    else:
        Image.fromarray(PIXELS).save(path, exif=exif())
    return path


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".exr"])
def test_every_container_says_how_a_photograph_was_taken(tmp_path, suffix):
    found = read_shooting(write(tmp_path / f"a{suffix}"))
    assert found.time_s == pytest.approx(1 / 60, rel=1e-6)
    assert found == Shooting(**{**vars(EXPECTED), "time_s": found.time_s})


def test_openimageio_names_are_known(tmp_path):
    names = {"ExposureTime": 0.25, "FNumber": 4.0, "Exif:FocalLength": 35.0, "Make": "M", "Model": "One"}
    write_exr(tmp_path / "a.exr", rgb(np.zeros((3, 4, 4), "f4")), **names)
    assert read_shooting(tmp_path / "a.exr") == Shooting(0.25, 4.0, focal_mm=35.0, camera="M One")


def test_tags_of_the_picture_itself_count(tmp_path):
    """As in camera RAW of the kind of TIFF/EP."""
    tags = [(33434, "2I", 1, (1, 8), True), (34855, "H", 1, 400, True)]
    tifffile.imwrite(tmp_path / "a.dng", PIXELS, photometric="rgb", extratags=tags, metadata=None)
    assert read_shooting(tmp_path / "a.dng") == Shooting(1 / 8, iso=400.0)


def test_nothing_said_is_nothing_known(tmp_path):
    Image.fromarray(PIXELS).save(tmp_path / "a.jpg")
    np.save(tmp_path / "a.npy", np.zeros((4, 4, 3), "f4"))
    assert read_shooting(tmp_path / "a.jpg") == Shooting()
    assert read_shooting(tmp_path / "a.npy") == Shooting()


@pytest.mark.parametrize("length", [30, 60, 100])
def test_damaged_exif_data_say_nothing_or_something(tmp_path, length):
    data = exif().tobytes()
    Image.fromarray(PIXELS).save(tmp_path / "a.jpg", exif=data[:length])
    assert isinstance(read_shooting(tmp_path / "a.jpg"), Shooting)


def test_zero_is_unknown_and_apex_values_serve(tmp_path):
    found = read_shooting(
        jpeg(tmp_path / "a.jpg", {0x9201: 6.0, 0x829D: 0.0, 0xA405: 0, 0x8827: 65535, 0x8831: 102400})
    )
    assert (found.time_s, found.f_number, found.focal_35mm_mm, found.iso) == (1 / 64, None, None, 102400.0)


def test_apex_values_that_stand_for_no_positive_number_are_unknown(tmp_path):
    found = read_shooting(jpeg(tmp_path / "a.jpg", {0x9201: 2000.0, 0x9202: -3000.0}))
    assert (found.time_s, found.f_number) == (None, None)


def test_the_size_is_that_of_the_upright_picture(tmp_path):
    assert read_shooting(jpeg(tmp_path / "a.jpg", orientation=6)).size == (30, 20)


def test_pixels_a_millimetre_give_the_pitch(tmp_path):
    plane = {0xA002: 6000, 0xA003: 4000, 0x920A: 50.0, 0xA20E: 6000 / 36 * 25.4, 0xA210: 2}
    found = read_shooting(jpeg(tmp_path / "a.jpg", plane))
    assert found.pitch_mm == pytest.approx(36 / 6000, rel=1e-4)
    assert found.focal_pixels((4000, 6000)) == pytest.approx(50 * 6000 / 36, rel=1e-4)


def test_a_pitch_that_no_sensor_has_is_not_believed(tmp_path):
    assert (
        read_shooting(jpeg(tmp_path / "a.jpg", {0xA002: 6000, 0xA003: 4000, 0xA20E: 72.0, 0xA210: 2})).pitch_mm is None
    )


def test_focal_lengths_in_35_mm_film_are_for_the_diagonal():
    """A sensor of 4 x 3 whose diagonal is half of a full frame's."""
    focal = Shooting(focal_35mm_mm=50.0, size=(3000, 4000)).focal_pixels((3000, 4000))
    assert focal == pytest.approx(25 / (np.hypot(36, 24) / 2 / 5000))


def test_a_picture_made_smaller_has_the_same_angle():
    taken = Shooting(focal_mm=50.0, pitch_mm=36 / 6000, size=(4000, 6000))
    assert taken.focal_pixels((400, 600)) == pytest.approx(taken.focal_pixels((4000, 6000)) / 10)


@pytest.mark.parametrize(
    ("taken", "message"),
    [
        (Shooting(), "^names no focal length$"),
        (Shooting(focal_mm=50.0), "^does not say how large the sensor is$"),
        (Shooting(focal_35mm_mm=50.0, size=(30, 40)), "^is 400 x 600 and was 30 x 40 when it was taken: it is cropped"),
        (
            Shooting(focal_mm=50.0, pitch_mm=0.006, focal_35mm_mm=75.0, size=(4000, 6000)),
            "contradict one another: a focal length of 8333 pixels by the pixels' pitch, and of 12500",
        ),
    ],
)
def test_angles_that_are_not_known(taken, message):
    with pytest.raises(ValueError, match=message):
        taken.focal_pixels((400, 600))


def test_no_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.jpg: no such file; expected a photograph"):
        read_shooting(tmp_path / "nothing.jpg")


@pytest.mark.parametrize(
    ("original", "size", "doubt"),
    [
        ((480, 720), (480, 720), None),
        (None, (480, 720), None),
        (None, (720, 480), None),
        ((480, 720), (240, 360), "is 240 x 360 and was 480 x 720 when it was taken: it is read as resized"),
        ((480, 400), (480, 400), "is 480 x 400, a shape that no camera takes: it is read as whole all the same"),
    ],
)
def test_what_may_be_a_crop(original, size, doubt):
    assert Shooting(size=original).doubt(size) == doubt
