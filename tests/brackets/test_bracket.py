"""From files to radiance: what is found, what is marked, what is said, what is refused."""

import warnings

import numpy as np
import pytest
import torch

from merge_cases import Camera, bracket, moved, texture
from torchbrdf.brackets import merge
from torchbrdf.images import write_image

TIMES = [0.01, 0.04, 0.16, 0.64]
SCENE = texture()


def errors(image: torch.Tensor, scene: np.ndarray = SCENE, scaled: bool = False) -> np.ndarray:
    """Relative, of pixels that some exposure shows well."""
    values = image.permute(1, 2, 0).numpy()
    shown = np.isfinite(values) & (scene > 0.03) & (scene < 60)
    ratio = values[shown] / scene[shown]
    return np.abs(ratio / (np.median(ratio) if scaled else 1) - 1)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_srgb_to_one_percent(tmp_path, suffix):
    found = merge(bracket(tmp_path, SCENE, TIMES, Camera(suffix=suffix)))
    assert np.median(errors(found.image)) < 0.01
    assert found.calibration.unit == "1/s"


def test_a_curve_that_no_file_names_is_estimated(tmp_path):
    found = merge(bracket(tmp_path, SCENE, TIMES, Camera("s-shaped")))
    assert "response estimated from the brackets: under sRGB the radiance of the same patches" in found.about[0]
    assert np.median(errors(found.image, scaled=True)) < 0.015


def test_integers_without_a_profile_are_linear_where_exposures_say_so(tmp_path):
    found = merge(bracket(tmp_path, SCENE, TIMES, Camera("linear", ".tif", bits=16)))
    assert "response linear, as the exposures agree" in found.about[0]
    assert np.median(errors(found.image)) < 0.01


def test_floating_point_is_linear(tmp_path):
    files = []
    for time in TIMES:
        clipped = torch.from_numpy((SCENE * time).clip(0, 1)).permute(2, 0, 1)
        write_image(tmp_path / f"{time}.exr", clipped, {"expTime": time})
        files.append(tmp_path / f"{time}.exr")
    found = merge(files)
    assert errors(found.image).max() < 1e-5


def test_what_no_file_recorded_is_counted_apart(tmp_path):
    files = []
    for time in TIMES:
        clipped = torch.from_numpy((SCENE * time).clip(0, 1)).permute(2, 0, 1).clone()
        clipped[:, :10, :20] = torch.nan
        write_image(tmp_path / f"{time}.exr", clipped, {"expTime": time})
        files.append(tmp_path / f"{time}.exr")
    found = merge(files)
    assert found.about[3].endswith("0 too bright, 0 too dark, 0 between exposures, 200 recorded by no file")


def test_frames_are_laid_over_one_another(tmp_path):
    motions = [(3.3, -2.1, 0.2), (0.0, 0.0, 0.0), (-4.6, 1.7, 0.0), (1.5, 5.2, -0.3)]
    found = merge(bracket(tmp_path, SCENE, TIMES, Camera(), motions))
    reference = next(k for k in range(4) if f"IMG_{k}" in found.about[2])
    truth = moved(SCENE, *motions[reference])
    assert np.median(errors(found.image, truth)) < 0.012
    assert np.percentile(errors(found.image, truth), 95) < 0.1


def with_lamp() -> np.ndarray:
    scene = SCENE.copy()
    scene[40:46, 50:56] = 5e4
    return scene


def test_a_lamp_that_only_the_shortest_holds_is_not_lost_to_a_hand_that_hardly_moved(tmp_path):
    motions = [(0.0, 0.0, 0.0), (0.12, 0.08, 0.0), (0.0, 0.0, 0.0), (-0.1, 0.15, 0.0), (0.1, 0.0, 0.0)]
    found = merge(bracket(tmp_path, with_lamp(), [1e-5, *TIMES], Camera(), motions))
    assert float(found.image[1, 42:44, 52:54].mean()) == pytest.approx(5e4, rel=0.05)


def test_a_frame_that_cannot_be_laid_over_others_that_moved_is_left_out(tmp_path):
    motions = [(0.0, 0.0, 0.0), (3.3, -2.1, 0.2), (0.0, 0.0, 0.0), (-4.6, 1.7, 0.0), (1.5, 5.2, -0.3)]
    with pytest.warns(UserWarning, match=r"IMG_0\.jpg: has too little in common .* which moved: left out"):
        merge(bracket(tmp_path, with_lamp(), [1e-5, *TIMES], Camera(), motions))


def test_files_that_did_not_move_are_not_resampled(tmp_path):
    found = merge(bracket(tmp_path, SCENE, TIMES, Camera()))
    assert found.about[2].startswith("the camera did not move")


def test_the_order_of_files_does_not_matter(tmp_path):
    files = bracket(tmp_path, SCENE, TIMES, Camera())
    assert torch.equal(merge(files).image.nan_to_num(), merge(files[::-1]).image.nan_to_num())


def test_what_no_exposure_holds_is_infinite_or_nan_and_counted(tmp_path):
    scene = SCENE.clip(0.1, 50).copy()
    scene[20:40, 30:60] = 1e4
    scene[100:110, 80:100] = 1e-6
    with pytest.warns(UserWarning, match=r"IMG_0\.png, the shortest: add a shorter one"):
        found = merge(bracket(tmp_path, scene, TIMES, Camera(suffix=".png", noise=0)))
    bright, dark = (each(found.image).all(0).numpy() for each in (torch.isposinf, torch.isnan))
    assert bright[20:40, 30:60].all()
    assert bright.sum() == 600
    assert dark[100:110, 80:100].all()
    assert dark.sum() == 200
    told = "600 too bright (600 infinite, the others beside them), 200 too dark, 0 between exposures"
    assert found.about[3].endswith(f"which are infinite or NaN: {told}")


def test_infinite_pixels_of_floating_point_files_are_too_bright(tmp_path):
    files = []
    for time in TIMES:
        values = torch.from_numpy(SCENE * time).permute(2, 0, 1).clone()
        values[:, 10:13, 20:22] = torch.inf
        write_image(tmp_path / f"{time}.exr", values, {"expTime": time})
        files.append(tmp_path / f"{time}.exr")
    found = merge(files)
    assert torch.isposinf(found.image).all(0).nonzero().tolist() == [[y, x] for y in (10, 11, 12) for x in (20, 21)]
    assert "6 too bright" in found.about[3]


def test_colours_of_what_is_too_bright_stay_infinite(tmp_path):
    scene = with_lamp()
    image = merge(bracket(tmp_path, scene, TIMES, Camera()), primaries="rec2020").image
    assert torch.isposinf(image[:, 42:44, 52:54]).all()


def test_a_gap_between_exposures_is_counted_apart(tmp_path):
    scene = np.full((40, 60, 3), 1.0, np.float32)
    scene[:, 30:] = 2000.0
    scene[:2, 58:] = 0.02  # else the longer exposure is white throughout, and refused
    with pytest.warns(UserWarning, match="clipped in one exposure and black in the next"):
        found = merge(bracket(tmp_path, scene, [1e-4, 5.0], Camera(suffix=".png", noise=0)), still=True)
    assert "1200 between exposures" in found.about[3]


def test_two_sets_of_one_camera_have_one_scale(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one = merge(bracket(tmp_path / "a", SCENE, [0.02, 0.08, 0.32], Camera()))
    exif = {0x829D: 4.0, 0x8827: 400}
    other = merge(bracket(tmp_path / "b", SCENE, [0.01, 0.05, 0.25], Camera(exif=exif)))
    ratio = (other.image / one.image / 4).nan_to_num(1)  # ISO 400 at f/4 counts 4 x 1/16
    assert float(ratio.median()) == pytest.approx(1, abs=0.005)


def test_times_are_taken_at_the_stops_that_fit(tmp_path):
    files = [
        path
        for k, shown in enumerate([1 / 125, 1 / 60, 1 / 15, 1 / 8])
        for path in [tmp_path / f"IMG_{k}.jpg"]
        if not Camera().save(path, Camera().expose(SCENE, 2.0 ** [-7, -6, -4, -3][k], np.random.default_rng(k)), shown)
    ]
    found = merge(files)
    assert found.calibration.stops
    ratio = found.image.permute(1, 2, 0).numpy() / SCENE
    assert np.median(ratio[(SCENE > 0.3) & (SCENE < 30)]) == pytest.approx(1, abs=0.003)


@pytest.mark.parametrize("camera", [Camera("s-shaped"), Camera()])
def test_another_set_takes_the_same_response(tmp_path, camera):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    probe = merge(bracket(tmp_path / "a", SCENE, TIMES, camera))
    write_image(tmp_path / "probe.exr", probe.image, probe.attributes)
    found = merge(bracket(tmp_path / "b", SCENE, [0.02, 0.05, 0.1], camera, seed=3), like=tmp_path / "probe.exr")
    both = torch.isfinite(found.image) & torch.isfinite(probe.image)
    ratio = (found.image / probe.image)[both & (probe.image > 0.3) & (probe.image < 5)]
    assert float(ratio.median()) == pytest.approx(1, abs=0.003)
    assert float((ratio - 1).abs().median()) < 0.02


def test_a_focal_length_goes_on(tmp_path):
    from torchbrdf.images import read_shooting

    found = merge(bracket(tmp_path, SCENE, TIMES, Camera(exif={0x920A: 50.0, 0xA405: 75})))
    write_image(tmp_path / "a.exr", found.image, found.attributes)
    taken = read_shooting(tmp_path / "a.exr")
    assert (taken.focal_mm, taken.focal_35mm_mm, taken.size, taken.time_s) == (50.0, 75.0, (160, 240), None)


class TestRefused:
    @pytest.fixture
    def files(self, tmp_path):
        return bracket(tmp_path, SCENE, TIMES, Camera())

    def test_one_file(self, files):
        with pytest.raises(ValueError, match=r"^merge needs two exposures or more, got 1"):
            merge(files[:1])
        with pytest.raises(FileNotFoundError, match=r"IMG_\*\.jpg: no such file .*; expected an exposure"):
            merge([files[0].with_name("IMG_*.jpg")])  # as a shell passes it on where nothing matches

    def test_sizes(self, tmp_path, files):
        Camera().take(tmp_path / "other", SCENE[:100], 0.3, np.random.default_rng(0))
        with pytest.raises(
            ValueError, match=r"IMG_\d\.jpg: is 160 x 240, and .*other\.jpg is 100 x 240|give exposures of one"
        ):
            merge([*files, tmp_path / "other.jpg"])

    def test_cameras(self, tmp_path, files):
        Camera(suffix=".jpg", exif={}).save(files[2], np.zeros((160, 240, 3), "u1"), 0.16)
        other = [0x0110, "Model Two"]
        from PIL import Image

        with Image.open(files[1]) as image:
            exif = image.getexif()
            exif[other[0]] = other[1]
            image.save(files[1], exif=exif, quality=95)
        with pytest.raises(
            ValueError, match=r"was taken with Maker Model Two, and .* with Maker Model One: use one camera"
        ):
            merge(files)

    def test_white_balance(self, tmp_path, files):
        Camera(exif={0xA403: 1}).take(tmp_path / "other", SCENE, 0.3, np.random.default_rng(0))
        with pytest.raises(ValueError, match=r"its white balance is .*: use one setting for all"):
            merge([*files, tmp_path / "other.jpg"])

    def test_times_in_the_wrong_order(self, files):
        with pytest.raises(ValueError, match=r"times the exposure of .* by its time and is darker: are --times right"):
            merge(files, TIMES[::-1])

    def test_the_same_picture_with_other_times(self, tmp_path):
        codes = Camera().expose(SCENE, 0.1, np.random.default_rng(0))
        for k, time in enumerate((0.1, 0.4)):
            Camera().save(tmp_path / f"{k}.jpg", codes, time)
        with pytest.raises(ValueError, match="and is as bright: are --times right"):
            merge([tmp_path / "0.jpg", tmp_path / "1.jpg"])

    def test_another_scene(self, tmp_path, files):
        Camera().take(tmp_path / "IMG_1", texture(seed=9), TIMES[1], np.random.default_rng(0))
        with pytest.raises(ValueError, match=r"cannot be laid over .*: it moved too far.*or they are not of one"):
            merge(files)

    def test_a_picture_that_was_not_merged(self, tmp_path, files):
        write_image(tmp_path / "probe.exr", torch.ones(3, 4, 8))
        with pytest.raises(
            ValueError, match=r"probe\.exr: does not say how it was merged; --like takes an \.exr file of"
        ):
            merge(files, like=tmp_path / "probe.exr")

    def test_kinds(self, tmp_path, files):
        Camera(suffix=".png").take(tmp_path / "other", SCENE, 0.3, np.random.default_rng(0))
        with pytest.raises(ValueError, match=r"is 8-bit (PNG|JPEG), and .*: give files of one kind"):
            merge([*files, tmp_path / "other.png"])

    def test_a_white_one(self, tmp_path, files):
        Camera().take(tmp_path / "white", np.full_like(SCENE, 1e6), 1.0, np.random.default_rng(0))
        with pytest.raises(ValueError, match=r"white\.jpg: is white throughout, clipped; leave it out"):
            merge([*files, tmp_path / "white.jpg"])

    def test_no_response_explains_them(self, files):
        differs = r"the radiance of the same patches differs by \d+% from one exposure to another"
        with pytest.raises(ValueError, match=f"no response explains these exposures: {differs}; the times are wrong"):
            merge(files, [0.01, 0.011, 0.6, 0.61])


class TestWarned:
    def test_a_wrong_time(self, tmp_path):
        files = bracket(tmp_path, SCENE, TIMES, Camera())
        with pytest.warns(UserWarning, match=r"IMG_2\.jpg: is \d+% darker than its exposure says"):
            merge(files, [0.01, 0.04, 0.2, 0.64], response="srgb")

    @pytest.mark.parametrize("power", [0.5, 2])
    def test_times_whose_ratios_are_wrong_throughout(self, tmp_path, power):
        files = bracket(tmp_path, SCENE, TIMES, Camera(suffix=".png"))
        with pytest.warns(UserWarning, match=r"sRGB's to the power \d.*: their ratios are wrong.*are --times right\?"):
            merge(files, [time**power for time in TIMES])

    def test_colours_that_change(self, tmp_path):
        files = bracket(tmp_path, SCENE, TIMES, Camera())
        Camera().take(tmp_path / "IMG_1", SCENE * np.array([1.25, 1, 0.8], "f4"), TIMES[1], np.random.default_rng(0))
        with pytest.warns(UserWarning, match=r"colours differ by \d+% between exposures"):
            merge(files)

    def test_another_response_than_given(self, tmp_path):
        files = bracket(tmp_path, SCENE, TIMES, Camera("s-shaped"))
        with pytest.warns(UserWarning, match=r"under this response the radiance of .* leave --response and --like out"):
            merge(files, response="srgb")

    def test_what_took_another_s_place(self, tmp_path):
        other = SCENE.copy()
        other[30:70, 40:80] *= 4
        files = bracket(tmp_path, SCENE, TIMES, Camera())
        (tmp_path / "other").mkdir()
        strange = bracket(tmp_path / "other", other, TIMES, Camera())
        with pytest.warns(UserWarning, match=r"% of the picture differs by more than 30%: something moved, or they"):
            merge([*files[:2], *strange[2:]], still=True)

    def test_sound_brackets_warn_of_nothing(self, tmp_path):
        files = bracket(tmp_path, SCENE.clip(0.02, 60), TIMES, Camera())
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            merge(files)
        assert [str(one.message) for one in caught] == []
