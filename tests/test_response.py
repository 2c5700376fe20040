"""Response curves: recovered from 8-bit brackets of known curves, written and read."""

import numpy as np
import pytest

from usdskin.errors import LayerError
from usdskin.photographs.response import (
    Response,
    read_response,
    recover_response,
    sample_pixels,
    write_response,
)
from usdskin.prims import ExposureBracket, FisheyeLens, View

USABLE = slice(12, 251)
"""Raw values between 5 and 98 % of white: below, noise is as large as the light of some curves."""


def srgb(light):
    """IEC 61966-2-1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def gamma(light):
    return light ** (1 / 2.2)


def filmic(light):
    """Hable's curve with white at 11.2 ("Filmic Tonemapping Operators", 2010)."""

    def curve(x):
        return (x * (0.15 * x + 0.05) + 0.004) / (x * (0.15 * x + 0.5) + 0.06) - 0.02 / 0.3

    return curve(11.2 * light) / curve(11.2)


def s_shaped(light):
    """Naka-Rushton's sigmoid, scaled to reach white."""
    return light**1.1 / (light**1.1 + 0.18) * 1.18


CURVES = {"srgb": srgb, "gamma 2.2": gamma, "filmic": filmic, "s-shaped": s_shaped}


def inverse(curve):
    """Return the true exposure of every 8-bit value, shape [256]."""
    light = np.concatenate([[0.0], np.geomspace(1e-9, 1.0, 400_001)])
    return np.interp(np.arange(256) / 255.0, curve(light), light)


class Picture:
    """Rows of a picture in memory, read as files are: in order."""

    def __init__(self, pixels):
        self.pixels = pixels.astype(np.float32)
        self.height, self.width = pixels.shape[:2]
        self.begin = 0

    def rows(self, begin, end):
        assert self.begin <= begin < end <= self.height
        self.begin = end
        return self.pixels[begin:end]


def scene(height=240, width=320):
    """Return smooth light over five decades with edges and a fine texture."""
    y, x = np.mgrid[0:height, 0:width] / height
    light = np.exp(5.0 * np.sin(4.0 * x + 1.0) * np.cos(5.0 * y))
    light *= np.where((9 * x).astype(int) % 3 == 0, 2.5, 1.0)
    light *= np.exp(0.1 * np.sin(900.0 * x) * (y > 0.7))
    return light[..., None] * np.array([1.0, 0.8, 0.6])


def photograph(curve, times, seed=0, moved=True):
    """Return 8-bit pictures with photon and read noise; somebody walks through one of them."""
    rng = np.random.default_rng(seed)
    light = scene()
    pictures = []
    for index, time in enumerate(times):
        electrons = rng.poisson(np.minimum(light * time, 2.0) * 20_000.0)
        exposed = (electrons + rng.normal(0.0, 2.0, light.shape)) / 20_000.0
        if moved and index == len(times) // 2:
            exposed[60:120, 100:180] = 0.3
        exposed = np.clip(exposed, 0.0, 1.0)
        values = np.stack([curve(exposed[..., c]) for c in range(3)], axis=-1)
        pictures.append(np.rint(255.0 * values))
    return pictures


def a_view(black=0.0, white=None):
    one = np.ones(1)
    bracket = ExposureBracket(
        images=(),
        exposure_time_s=one,
        iso=one,
        f_number=one,
        nd_factor=one,
        black_level=np.array([black]),
        white_level=None if white is None else np.array([white]),
    )
    lens = FisheyeLens("equidistant", 1.0, np.zeros(2), (1, 1))
    return View("view1", "shoot.usda </Shoot/view1>", lens, bracket, np.eye(3))


def recover(pictures, times, view=None, white=255.0, count=1500):
    view = view or a_view()
    black = float(view.bracket.black_level[0])
    samples = sample_pixels([Picture(picture) for picture in pictures], black, white, count)
    return recover_response(view, samples, np.asarray(times), white)


def errors(response, truth):
    """Return the relative error of every level, after the scale no bracket tells is matched."""
    found = response.exposure / response.exposure[128]
    return np.abs(found / np.maximum(truth / truth[128], 1e-12)[:, None] - 1.0)


TWO_STOPS = 4.0 ** np.arange(-4.0, 3.0)


@pytest.mark.parametrize("name", CURVES)
def test_curve_is_recovered_to_2_percent_despite_noise_and_a_moved_object(name):
    response = recover(photograph(CURVES[name], TWO_STOPS), TWO_STOPS)
    assert errors(response, inverse(CURVES[name]))[USABLE].max() < 0.02


@pytest.mark.parametrize("stops", [1.0, 3.0])
def test_curve_is_recovered_from_other_steps(stops):
    times = 2.0 ** np.arange(-8.0, 4.1, stops)
    response = recover(photograph(srgb, times, seed=1), times)
    assert errors(response, inverse(srgb))[USABLE].max() < 0.02


def test_linear_camera_has_a_straight_response():
    """Its photon noise at white is 2 DN, so the upper end is known less well than of a curve."""
    response = recover(photograph(lambda light: light, TWO_STOPS), TWO_STOPS)
    found = errors(response, np.arange(256) / 255.0)
    assert found[12:200].max() < 0.02
    assert found[USABLE].max() < 0.05


def test_one_wrong_value_in_ten_does_not_matter():
    rng = np.random.default_rng(3)
    light = np.exp(rng.uniform(-10.0, 1.0, 3000))
    exact = srgb(np.clip(light * TWO_STOPS[:, None], 0.0, 1.0)) * 255.0
    values = np.rint(np.clip(exact + rng.normal(0.0, 0.5, exact.shape), 0.0, 255.0))
    wrong = rng.random(values.shape) < 0.1
    values[wrong] = rng.integers(0, 256, np.count_nonzero(wrong))
    samples = np.repeat(values[..., None], 3, axis=-1)
    response = recover_response(a_view(), samples, TWO_STOPS)
    assert errors(response, inverse(srgb))[USABLE].max() < 0.02


def test_channels_of_different_curves_are_recovered_apart():
    pictures = [photograph(CURVES[name], TWO_STOPS, seed=4) for name in ("srgb", "filmic")]
    mixed = [
        np.stack([a[..., 0], b[..., 1], a[..., 2]], -1) for a, b in zip(*pictures, strict=True)
    ]
    response = recover(mixed, TWO_STOPS)
    for channel, curve in enumerate((srgb, filmic, srgb)):
        assert errors(response, inverse(curve))[USABLE, channel].max() < 0.02


def test_response_never_falls_and_ends_at_one():
    response = recover(photograph(srgb, TWO_STOPS), TWO_STOPS)
    assert (np.diff(response.exposure, axis=0) > 0.0).all()
    assert response.exposure.max() == 1.0
    assert (response.exposure[0] == 0.0).all()


def test_levels_run_from_black_to_white():
    """A camera that stores video range (16 to 235) has the same curve between them."""
    pictures = [16.0 + 219.0 / 255.0 * p for p in photograph(srgb, TWO_STOPS)]
    response = recover(pictures, TWO_STOPS, a_view(16.0, 235.0), white=235.0)
    np.testing.assert_array_equal(response.level[[0, -1]], (16.0, 235.0))
    share = (response.level - 16.0) / 219.0
    truth = np.interp(share, np.arange(256) / 255.0, inverse(srgb))
    assert errors(response, truth)[USABLE].max() < 0.02


def test_same_pictures_give_the_same_curve_to_the_bit():
    pictures = photograph(srgb, TWO_STOPS)
    first, second = (recover(pictures, TWO_STOPS, count=400) for _ in range(2))
    np.testing.assert_array_equal(first.exposure, second.exposure)


# --- Samples -----------------------------------------------------------------------------------


def test_samples_spread_over_brightness_and_keep_off_edges():
    y, x = np.mgrid[0:120, 0:160]
    ramp = 20.0 + 200.0 * x / 160.0
    ramp[:, 80:] += 10.0 * (y[:, 80:] % 2)  # a texture on one half
    picture = np.repeat(ramp[..., None], 3, axis=-1)
    samples = sample_pixels([Picture(picture), Picture(picture)], 0.0, 255.0, 256)
    assert samples.shape == (2, 256, 3)
    counts, _ = np.histogram(samples[0, :, 0], bins=8, range=(20.0, 220.0))
    assert counts.min() > 16
    flat = picture[:, :80]
    few = sample_pixels([Picture(flat), Picture(flat)], 0.0, 255.0, 128)
    assert few.shape[1] == 128


def test_sample_of_a_patch_with_a_saturated_pixel_is_white():
    picture = np.full((30, 30, 3), 100.0)
    picture[::3, ::3] = 255.0
    samples = sample_pixels([Picture(picture), Picture(picture / 2), Picture(picture / 3)], 0, 255)
    assert (samples[0] == 255.0).all()
    np.testing.assert_allclose(samples[1], (8 * 50.0 + 127.5) / 9.0, rtol=1e-6)


def test_pixels_outside_the_image_circle_are_no_samples():
    picture = np.zeros((90, 90, 3))
    picture[30:60, 30:60] = 100.0
    samples = sample_pixels([Picture(picture), Picture(picture / 2)], 0.0, 255.0)
    assert samples.shape == (2, 100, 3)
    assert (samples[0] == 100.0).all()


# --- What cannot be recovered ------------------------------------------------------------------


def test_single_exposure_is_refused():
    with pytest.raises(LayerError, match=r"</Shoot/view1>: its photographs have a single exposure"):
        recover_response(a_view(), np.full((2, 100, 3), 90.0), np.ones(2))


def test_bracket_without_common_levels_is_refused():
    pictures = [np.full((60, 60, 3), 90.0), np.full((60, 60, 3), 255.0)]
    with pytest.raises(LayerError, match="response of red cannot be recovered; name a curve"):
        recover(pictures, (1.0, 4.0))


def test_exposures_that_contradict_the_pictures_are_refused():
    rng = np.random.default_rng(5)
    noise = rng.integers(10, 240, (5, 400, 3)).astype(np.float64)
    with pytest.raises(LayerError, match="contradict in red the exposures stated for them"):
        recover_response(a_view(), noise, 4.0 ** np.arange(5))


# --- Tables and files --------------------------------------------------------------------------


def test_apply_interpolates_between_levels_and_holds_the_ends():
    response = Response(np.array([10.0, 20.0]), np.array([[0.0, 0.2, 0.4], [1.0, 0.8, 0.4]]))
    dn = np.array([[[0.0, 10.0, 15.0], [15.0, 17.5, 99.0]]])
    expected = [[[0.0, 0.2, 0.4], [0.5, 0.65, 0.4]]]
    np.testing.assert_allclose(response.apply(dn), expected, rtol=1e-6)


def test_written_curve_is_read_back(tmp_path):
    exposure = np.sort(np.random.default_rng(6).random((256, 3)), axis=0)
    response = Response(np.arange(256.0), exposure / exposure.max())
    path = write_response(tmp_path / "response.txt", response)
    again = read_response(path)
    np.testing.assert_array_equal(again.level, response.level)
    np.testing.assert_allclose(again.exposure, response.exposure, rtol=1e-8)


def test_one_exposure_stands_for_all_channels_and_is_scaled_to_one(tmp_path):
    path = tmp_path / "curve.csv"
    path.write_text("# DN, exposure\n0, 0\n\n128, 10  # middle\n255, 40\n")
    response = read_response(path)
    np.testing.assert_allclose(response.exposure, [[0.0] * 3, [0.25] * 3, [1.0] * 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 0\n1 x\n", 'line 2: "1 x" is not a raw value and one or three exposures'),
        ("0 0\n1 nan\n", "line 2: .* is not a raw value"),
        ("0 0 0\n", "line 1: .* is not a raw value and one or three exposures"),
        ("0 0\n1 1\n1 2\n", "line 3: .* does not ascend: the raw value before it is 1"),
        ("0 0\n1 2\n2 1\n", "line 3: .* has less exposure than the line before"),
        ("0 0\n1 1 1 1\n", "line 2: .* has another number of columns"),
        ("0 -1\n", "line 1: .* negative exposure"),
        ("# nothing\n", "is no response curve; give at least two lines"),
        ("0 0\n1 0\n", "is no response curve"),
    ],
)
def test_bad_curve_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "curve.txt"
    path.write_text(text)
    with pytest.raises(LayerError, match=message):
        read_response(path)


def test_missing_curve_is_refused(tmp_path):
    with pytest.raises(LayerError, match=r"none.txt: cannot be read as a response curve \(No such"):
        read_response(tmp_path / "none.txt")
