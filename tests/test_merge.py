"""Brackets merged into linear values, against a simulated sensor whose light is known."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from simulated_sensor import Sensor, bracket_view, photograph, write_dng, write_picture

from usdskin.device import Workers, open_workers
from usdskin.errors import ImageError, LayerError, UsageError
from usdskin.photographs import bracket as capture_bracket
from usdskin.photographs import merge_rows
from usdskin.photographs.frames import open_frame
from usdskin.photographs.merge import CLIPPED, DARK, MOVED, merge_bracket
from usdskin.photographs.response import Response

QUARTERS = 4.0 ** -np.arange(9.0)
"""Exposure times of a bracket of nine photographs, two stops apart [s]."""

BIAS = 0.005
NOISE = 1.5
"""Bars of the merge: bias, and noise over the photon limit."""

FLOAT32_RTOL = 2e-6


@pytest.fixture
def merge(tmp_path):
    """Merge a view, with notes in a list."""

    def run(view, workers=None, response=None, notes=None, **given):
        notes = [] if notes is None else notes
        workers = workers or open_workers("cpu", 2)
        return merge_bracket(view, workers, tmp_path, response, notes=notes, **given)

    return run


def patches(levels, rows, columns):
    """Return stripes of grey light, shape [rows, columns * len(levels), 3]."""
    row = np.repeat(np.asarray(levels, float), columns)
    return np.broadcast_to(row[None, :, None], (rows, row.size, 3)).copy()


def split(picture, count, margin=1):
    """Return the insides of stripes, shape [count, rows, columns, 3]."""
    rows, width = picture.shape[:2]
    stripes = picture.reshape(rows, count, width // count, -1)[margin : rows - margin]
    return np.moveaxis(stripes[:, :, margin:-margin].astype(np.float64), 1, 0)


def photon_limit(levels, times, sensor):
    """Return the relative noise of the photons alone that unsaturated photographs count.

    A pixel and its neighbours are unsaturated where noise of 4 standard deviations leaves them so.
    """
    top = 0.97 - 4.0 * np.sqrt(0.97 / sensor.electrons)
    used = np.where(np.multiply.outer(levels, times) < top, times, 0.0)
    return 1.0 / np.sqrt(levels * used.sum(axis=-1) * sensor.electrons)


# --- Accuracy ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_merge_is_unbiased_and_near_the_photon_limit_over_eight_decades(tmp_path, merge):
    """From 20 electrons in the longest exposure to 90 % of the range of the shortest; 10 seeds."""
    sensor, count = Sensor(read_noise=0.75), 30
    levels = np.geomspace(20.0 / sensor.electrons, 0.9 / QUARTERS[-1], count)
    assert levels[-1] / levels[0] > 1e8
    relative, predicted = [], []
    for seed in range(10):
        view = photograph(tmp_path, patches(levels, 60, 22), QUARTERS, sensor, seed)
        merged = merge(view)
        relative.append(split(merged.values, count) / levels[:, None, None, None])
        variance = split(merged.variance, count).mean(axis=(1, 2, 3)) / levels**2
        predicted.append(variance)
        assert not np.any(merged.status & (CLIPPED | MOVED))
        assert merged.report.exposure_error < 0.02
    pixels = np.stack(relative).reshape(10, count, -1)
    bias = pixels.mean(axis=(0, 2)) - 1.0
    noise = pixels.std(axis=(0, 2))

    assert np.abs(bias).max() <= BIAS
    assert (noise / photon_limit(levels, QUARTERS, sensor)).max() <= NOISE
    np.testing.assert_allclose(np.sqrt(np.mean(predicted, axis=0)), noise, rtol=0.05)


@pytest.mark.parametrize("full_well", [8_000, 60_000])
@pytest.mark.parametrize("alone", [False, True], ids=["even", "single pixels"])
def test_saturation_leaves_no_halo(tmp_path, merge, full_well, alone):
    """Light rises through the level at which the longest of three photographs saturates.

    Single bright pixels are the harder case: nothing around them tells that they may saturate.
    """
    sensor = Sensor(gain=full_well / 15871.0)
    times, count = 4.0 ** -np.arange(3.0), 23
    levels = np.linspace(0.8, 1.02, count)
    light = patches(levels, 242, 38)
    inside = np.ones(light.shape[:2], bool)
    if alone:
        inside[...] = False
        inside[1::3, 1::3] = True
        light = np.where(inside[..., None], light, 0.1 * light)
    ratio = np.stack([merge(photograph(tmp_path, light, times, sensor, seed)).values / light
                      for seed in range(2)])  # fmt: skip
    mean, error = [], []
    for stripe in range(count):
        columns = slice(38 * stripe + 1, 38 * stripe + 37)
        kept = ratio[:, 1:-1, columns][:, inside[1:-1, columns]].astype(np.float64)
        mean.append(kept.mean())
        error.append(kept.std() / np.sqrt(kept.size))
    assert np.abs(np.array(mean) - 1.0).max() <= BIAS / 2.0 + 2.0 * max(error)


def test_surroundings_of_a_clipped_lamp_are_unbiased(tmp_path, merge):
    y, x = np.mgrid[:160, :160]
    distance = np.hypot(x - 80, y - 80)
    light = np.where(distance < 20, 1e4, 0.3 + 0.1 * np.sin(x / 7.0))[..., None] * np.ones(3)
    times = 8.0 ** -np.arange(4.0)
    total = np.zeros(light.shape)
    for seed in range(6):
        merged = merge(photograph(tmp_path, light, times, seed=seed))
        total += merged.values
        np.testing.assert_array_equal((merged.status & CLIPPED) != 0, distance < 20)
    ring = (distance >= 20) & (distance < 24)
    assert (total / 6.0 / light)[ring].mean() == pytest.approx(1.0, abs=BIAS)
    assert merged.report.clipped_pixels == np.count_nonzero(distance < 20)
    bound = 0.97 / times[-1]
    assert (merged.values[distance < 20].max(axis=-1) >= bound).all()


def test_darkness_stays_signed_and_averages_to_zero(tmp_path, merge):
    light = patches([0.0, 0.5], 100, 100)
    merged = merge(photograph(tmp_path, light, 4.0 ** -np.arange(5.0)))
    dark = merged.values[:, :99].astype(np.float64)
    assert (dark < 0.0).mean() > 0.4
    assert abs(dark.mean()) < 4.0 * dark.std() / np.sqrt(dark.size)
    assert ((merged.status[:, :99] & DARK) != 0).mean() > 0.999
    assert not np.any(merged.status[:, 101:] & DARK)
    assert merged.report.dark_share == pytest.approx(0.5, abs=0.01)


def test_every_channel_has_its_own_black_level(tmp_path, merge):
    sensor = Sensor(black=np.array([480.0, 512.0, 700.0]))
    light = patches([1e-2, 1e-1], 120, 60)
    merged = merge(photograph(tmp_path, light, 4.0 ** -np.arange(4.0), sensor))
    mean = split(merged.values, 2).mean(axis=(1, 2))
    np.testing.assert_allclose(mean, np.array([[1e-2], [1e-1]]) * np.ones(3), rtol=BIAS)


def test_sensitivity_may_change_within_a_bracket(tmp_path, merge):
    """Gain falls with ISO; the shortest exposures here are at ISO 1600."""
    times = np.array([1.0, 1.0 / 4.0, 1.0 / 16.0, 1.0 / 256.0, 1.0 / 1024.0])
    iso = np.array([100.0, 100.0, 400.0, 1600.0, 1600.0])
    levels = np.geomspace(0.002, 40.0, 20)
    light = patches(levels, 120, 30)
    view = photograph(tmp_path, light, times, Sensor(), iso=iso)
    merged = merge(view)
    np.testing.assert_allclose(split(merged.values, 20).mean(axis=(1, 2, 3)), levels, rtol=BIAS)
    np.testing.assert_allclose(merged.report.noise.gain, 4.0 * 100.0 / iso, rtol=0.05)
    np.testing.assert_allclose(merged.report.noise.read_noise, 3.0, rtol=0.1)


def test_images_may_be_listed_in_any_order(tmp_path, merge):
    light = patches(np.geomspace(0.01, 50.0, 8), 64, 16)
    times = 4.0 ** -np.arange(4.0)
    ordered = merge(photograph(tmp_path, light, times))
    shuffle = [2, 0, 3, 1]
    view = photograph(tmp_path, light, times)
    images = [view.bracket.images[k] for k in shuffle]
    sensor = {"black_level": 512.0, "white_level": 16383.0}
    shuffled = merge(bracket_view(images, times[shuffle], **sensor))
    np.testing.assert_array_equal(shuffled.values, ordered.values)
    np.testing.assert_array_equal(shuffled.report.exposure, times[shuffle])
    assert [(pair.shorter, pair.longer) for pair in shuffled.report.pairs] == [
        (2, 0), (0, 3), (3, 1)
    ]  # fmt: skip


@pytest.mark.slow
def test_merge_is_no_worse_than_colour_hdri(tmp_path, merge):
    """On the same photographs, with the weights its authors recommend for raw files."""
    from colour_hdri import Image, ImageStack, Metadata, image_stack_to_HDRI
    from colour_hdri.generation import double_sigmoid_anchored_function

    sensor = Sensor()
    levels = np.geomspace(0.003, 0.9 / QUARTERS[-1], 40)
    light = patches(levels, 60, 12)
    view = photograph(tmp_path, light, QUARTERS, sensor)
    ours = merge(view).values / light
    stack = ImageStack()  # which takes its first image for the shortest exposure
    for path, time in zip(view.bracket.images[::-1], QUARTERS[::-1], strict=True):
        with open_frame(path, tmp_path) as frame:
            data = (frame.rows(0, frame.height) - sensor.black) / (sensor.white - sensor.black)
        metadata = Metadata(f_number=1.0, exposure_time=time, iso=100.0)
        stack.append(Image(data=np.clip(data, 1e-9, 1.0), metadata=metadata))
    theirs = image_stack_to_HDRI(stack, double_sigmoid_anchored_function) / light
    theirs = theirs * (100.0 / 12.5)  # the unit of colour_hdri.average_luminance
    for quantile in (0.5, 0.95, 1.0):
        our_error, their_error = (np.quantile(abs(x - 1.0), quantile) for x in (ours, theirs))
        assert our_error <= 1.02 * their_error


# --- Noise -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("gain", "read_noise"), [(4.0, 3.0), (0.4, 8.0), (12.0, 1.5)])
def test_noise_is_measured_from_the_bracket_itself(tmp_path, merge, gain, read_noise):
    rng = np.random.default_rng(3)
    light = np.exp(rng.normal(-2.0, 2.5, (20, 30, 3))).repeat(12, axis=0).repeat(12, axis=1)
    sensor = Sensor(gain=gain, read_noise=read_noise)
    noise = merge(photograph(tmp_path, light, 3.0 ** -np.arange(7.0), sensor)).report.noise
    assert (noise.gain_source, noise.read_noise_source) == ("measured", "measured")
    np.testing.assert_allclose(noise.gain, gain, rtol=0.05)
    np.testing.assert_allclose(noise.read_noise, read_noise, rtol=0.05)


def test_noise_is_measured_in_spite_of_motion_and_wrong_exposures(tmp_path, merge):
    rng = np.random.default_rng(4)
    light = np.exp(rng.normal(-2.0, 2.0, (20, 30, 3))).repeat(12, axis=0).repeat(12, axis=1)

    def shake(k, raw):
        raw[60:100, 60:100] = raw[0, 0]
        return np.roll(raw, k % 2, axis=1)

    times = 3.0 ** -np.arange(7.0)
    view = photograph(tmp_path, light, times, change=shake)
    noise = merge(bracket_view(
        view.bracket.images, times * 1.04 ** np.arange(7.0), black_level=512.0, white_level=16383.0
    )).report.noise  # fmt: skip
    np.testing.assert_allclose(noise.gain, 4.0, rtol=0.15)
    np.testing.assert_allclose(noise.read_noise, 3.0, rtol=0.15)


def test_given_noise_is_used_as_it_is(tmp_path, merge):
    light = patches([0.1, 0.5], 40, 40)
    times = [1.0, 0.25]
    given = {"gain": [2.0, 2.0], "read_noise": [5.0, 5.0]}
    merged = merge(photograph(tmp_path, light, times, **given))
    assert merged.report.noise.gain_source == "given"
    signal = np.array([0.1, 0.5])[:, None] * times * 15871.0
    variance = (signal / 2.0 + 25.0 + 1.0 / 12.0) / 15871.0**2
    expected = 1.0 / (np.square(times) / variance).sum(axis=1)
    np.testing.assert_allclose(split(merged.variance, 2).mean(axis=(1, 2, 3)), expected, rtol=0.01)


def test_single_photograph_tells_its_noise_by_its_texture(tmp_path, merge):
    notes = []
    light = patches(np.geomspace(0.01, 0.8, 10), 120, 60)
    merged = merge(photograph(tmp_path, light, [1.0]), notes=notes)
    assert [note.code for note in notes] == ["noise-from-texture"]
    assert merged.report.noise.gain_source == "texture"
    np.testing.assert_allclose(merged.report.noise.gain, 4.0, rtol=0.1)
    np.testing.assert_allclose(split(merged.values, 10).mean(axis=(1, 2, 3)),
                               np.geomspace(0.01, 0.8, 10), rtol=BIAS)  # fmt: skip


# --- The kernels -------------------------------------------------------------------------------


def oracle(raw, exposure, gain, read, black, white):
    """Merge in float64 as ``warp_kernels.bracket`` says, pixel for pixel.

    Returns:
        Value and variance [height, width, 3], and whether it is clipped.
    """
    scale = white - black
    x = (raw - black) / scale
    level = x.max(axis=-1)
    padded = np.pad(level, ((0, 0), (1, 1), (1, 1)), mode="edge")
    height, width = level.shape[1:]
    around = np.max([padded[:, i : i + height, j : j + width]
                     for i in range(3) for j in range(3)], axis=0)  # fmt: skip
    trust = np.clip((0.97 - around) / 0.1, 0.0, 1.0)
    shortest = int(np.argmin(exposure))
    trust[shortest] = level[shortest] < 0.97
    trust = trust[..., None]
    e = np.asarray(exposure)[:, None, None, None]
    clipped = trust.sum(axis=0) == 0.0
    with np.errstate(invalid="ignore"):
        value = (trust * x).sum(axis=0) / (trust * e).sum(axis=0)
        for _ in range(2):
            variance = np.maximum(value, 0.0) * e / gain / scale
            variance = variance + (read**2 + 1.0 / 12.0) / scale**2
            weight = e**2 / variance
            value = (trust * weight * x / e).sum(axis=0) / (trust * weight).sum(axis=0)
        spread = (trust**2 * weight).sum(axis=0) / (trust * weight).sum(axis=0) ** 2
    bound = x[shortest] / exposure[shortest]
    return np.where(clipped, bound, value), spread, clipped[..., 0]


def test_kernels_agree_with_a_float64_oracle(tmp_path, merge, device):
    rng = np.random.default_rng(8)
    light = np.exp(rng.normal(0.0, 3.0, (50, 70, 3)))
    times = 3.0 ** -np.arange(5.0)
    black = np.array([500.0, 512.0, 530.0])
    given = {"gain": np.full(5, 3.0), "read_noise": np.full(5, 4.0)}
    view = photograph(tmp_path, light, times, Sensor(3.0, 4.0, black), **given)
    merged = merge(view, open_workers(device, 2))
    raw = []
    for path in view.bracket.images:
        with open_frame(path, tmp_path) as frame:
            raw.append(frame.rows(0, 50).astype(np.float64))
    value, variance, clipped = oracle(np.stack(raw), times, 3.0, 4.0, black, 16383.0)
    good = ~clipped & ((merged.status & MOVED) == 0)
    assert clipped.any() and good.mean() > 0.8
    np.testing.assert_array_equal((merged.status & CLIPPED) != 0, clipped)
    np.testing.assert_allclose(merged.values, value, rtol=2e-5, atol=1e-6 * np.abs(value).min())
    np.testing.assert_allclose(merged.variance[good], variance[good], rtol=1e-4)


def test_threads_and_blocks_do_not_change_a_byte(tmp_path, merge, monkeypatch):
    rng = np.random.default_rng(5)
    light = np.exp(rng.normal(0.0, 3.0, (100, 40, 3)))
    dark = write_picture(tmp_path / "dark.tif", np.full((100, 40, 3), 530))
    view = photograph(tmp_path, light, 4.0 ** -np.arange(4.0), dark_file=dark)
    whole = merge(view, Workers("cpu", 1))
    monkeypatch.setattr(merge_rows, "_ROW_STEP", 1)
    for rows, threads in ((1, 1), (2, 3), (7, 2), (99, 2)):
        monkeypatch.setattr(merge_rows, "_BLOCK_BYTES", rows * 5 * 40 * 12)
        again = merge(view, Workers("cpu", threads))
        for name in ("values", "variance", "status"):
            np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))


# --- Dark frame, flat field, response ----------------------------------------------------------


def test_dark_frame_is_subtracted_and_flat_field_divided_out(tmp_path, merge):
    rng = np.random.default_rng(6)
    pattern = np.round(rng.uniform(0.0, 60.0, (80, 90, 3)))
    shading = 1.0 - 0.5 * np.linspace(0.0, 1.0, 90)[None, :, None] * np.ones((80, 90, 3))
    shading[..., 1] *= 0.8  # the colour of the flat's light is not the camera's
    light = np.full((80, 90, 3), 0.2)

    def warm(k, raw):
        return raw + pattern

    view = photograph(tmp_path, light * shading, 3.0 ** -np.arange(4.0), change=warm,
        dark_file=write_picture(tmp_path / "dark.tif", 512.0 + pattern),
        flat_file=write_picture(tmp_path / "flat.tif", 512.0 + 9000.0 * shading))  # fmt: skip
    merged = merge(view)
    expected = light * shading.mean(axis=(0, 1))
    relative = merged.values / expected - 1.0
    assert abs(relative.mean()) < BIAS
    assert np.abs(relative.mean(axis=0)).max() < 5.0 * relative.std() / np.sqrt(80)
    scatter = np.sqrt(np.mean((merged.values - expected) ** 2 / merged.variance))
    assert scatter == pytest.approx(1.0, abs=0.05)


def test_flat_field_that_is_saturated_or_black_is_refused(tmp_path, merge):
    light = patches([0.1, 0.5], 20, 20)
    for level, what in ((16383.0, "saturated"), (512.0, "black")):
        flat = write_picture(tmp_path / "flat.tif", np.full(light.shape, level))
        with pytest.raises(ImageError, match=rf"flat.tif: the flat field is {what}"):
            merge(photograph(tmp_path, light, [1.0, 0.5], flat_file=flat))


def test_developed_photographs_are_merged_through_their_response(tmp_path, merge):
    """8 bits and a gamma of 2.2, whose curve is given."""
    sensor = Sensor(black=0.0, white=60000.0, top=60000.0, gain=1.0)
    level = np.arange(256.0)
    curve = Response(level, np.repeat((level[:, None] / 255.0) ** 2.2, 3, axis=1))
    levels = np.geomspace(0.02, 150.0, 24)
    light = patches(levels, 60, 30)
    times = 2.0 ** -np.arange(0.0, 10.0)
    rng = np.random.default_rng(2)
    images = []
    for k, time in enumerate(times):
        linear = sensor.expose(light, time, rng) / 60000.0
        images.append(write_picture(tmp_path / f"{k}.png", np.round(255 * linear ** (1 / 2.2)),
                                    "uint8"))  # fmt: skip
    merged = merge(bracket_view(images, times), response=curve)
    relative = split(merged.values, 24) / levels[:, None, None, None]
    assert np.abs(relative.mean(axis=(1, 2, 3)) - 1.0).max() < 0.01
    assert merged.report.moved_share == 0.0


def test_response_of_other_photographs_is_refused(tmp_path, merge):
    view = photograph(tmp_path, patches([0.1, 0.5], 20, 20), [1.0, 0.5])
    curve = Response(np.array([0.0, 255.0]), np.array([[0.0] * 3, [1.0] * 3]))
    with pytest.raises(LayerError, match=r"up to 255, but .*tif holds 16-bit values"):
        merge(view, response=curve)


# --- What does not fit -------------------------------------------------------------------------


def test_moved_object_is_flagged_and_told(tmp_path, merge):
    light = patches([0.05, 0.4], 200, 150)

    def passer(k, raw):
        if k == 1:
            raw[90:130, 210:260] = 700.0
        return raw

    notes = []
    merged = merge(photograph(tmp_path, light, 2.0 ** -np.arange(5.0), change=passer), notes=notes)
    moved = (merged.status & MOVED) != 0
    assert moved[91:129, 211:259].all()
    moved[89:131, 209:261] = False
    assert not moved.any()
    assert merged.report.moved_share == pytest.approx(2000 / 60000, rel=0.05)
    (note,) = notes
    assert note.code == "moved-object"
    x, y = (int(note.message.split(f" {name} ")[1].split(",")[0]) for name in "xy")
    assert 210 <= x < 260 and 90 <= y < 130
    inside = merged.variance[91:129, 211:259].mean()
    assert inside > 100.0 * merged.variance[:80, 160:].mean()


def test_noise_beside_a_lamp_is_no_motion(tmp_path, merge):
    """Only the shortest exposure counts there, with noise above what saturates the longest."""
    light = np.full((60, 60, 3), 1.1)
    light[20:40, 20:40] = 5e3
    merged = merge(photograph(tmp_path, light, 16.0 ** -np.arange(4.0)))
    beside = merged.values[19, 20:40]
    assert beside.std() > 0.5 and (beside < 0.5).any()
    assert not np.any(merged.status & MOVED)


def test_lamp_that_is_on_in_one_photograph_alone_is_flagged(tmp_path, merge):
    def flash(k, raw):
        if k == 0:
            raw[20:30, 20:30] = 16383.0
        return raw

    view = photograph(tmp_path, patches([0.1, 0.4], 60, 40), [1.0, 0.25, 0.0625], change=flash)
    moved = (merge(view).status & MOVED) != 0
    assert moved[20:30, 20:30].all() and moved.sum() == 100


@pytest.mark.parametrize("liar", [0, 1, 3, 4])
def test_photograph_whose_exposure_is_stated_wrongly_is_named(tmp_path, merge, liar):
    light = patches(np.geomspace(0.005, 50.0, 16), 60, 16)
    times = 4.0 ** -np.arange(5.0)
    view = photograph(tmp_path, light, times)
    stated = times.copy()
    stated[liar] *= 2.0
    with pytest.raises(LayerError, match=rf"</Shoot/north>: \S*/{liar}.tif is stated") as caught:
        merge(bracket_view(view.bracket.images, stated, black_level=512.0, white_level=16383.0))
    assert "\n" not in str(caught.value) and "bracket:exposureTimes" in str(caught.value)


def test_rounded_shutter_times_are_noted_and_mended_when_asked(tmp_path, merge):
    """1/60 s is in truth 1/64 s."""
    true = np.array([1.0 / 16.0, 1.0 / 64.0, 1.0 / 256.0, 1.0 / 1024.0])
    stated = np.array([1.0 / 15.0, 1.0 / 60.0, 1.0 / 250.0, 1.0 / 1000.0])
    stated[2] = 1.0 / 230.0
    levels = np.geomspace(0.3, 500.0, 20)
    light = patches(levels, 60, 16)
    view = photograph(tmp_path, light, true)
    told = bracket_view(view.bracket.images, stated, black_level=512.0, white_level=16383.0)

    notes = []
    plain = merge(told, notes=notes)
    assert [note.code for note in notes] == ["exposure-ratio"]
    assert plain.report.exposure_error == pytest.approx(0.08, abs=0.002)
    np.testing.assert_array_equal(plain.report.exposure, stated)

    mended = merge(told, measured_exposures=True)
    relative = split(mended.values, 20).mean(axis=(1, 2, 3)) / levels
    np.testing.assert_allclose(relative, relative.mean(), rtol=BIAS)
    ratio = mended.report.exposure[:-1] / mended.report.exposure[1:]
    np.testing.assert_allclose(ratio, 4.0, rtol=BIAS)


def test_black_photograph_among_good_ones_is_named(tmp_path, merge):
    light = patches(np.geomspace(0.01, 5.0, 8), 60, 20)
    for black in range(4):

        def cover(k, raw, black=black):
            return np.full(raw.shape, 512.0) if k == black else raw

        view = photograph(tmp_path, light, 4.0 ** -np.arange(4.0), change=cover)
        with pytest.raises(LayerError, match=rf"{black}.tif"):
            merge(view)


def test_gap_between_exposures_is_told(tmp_path, merge):
    notes = []
    given = {"gain": [4.0] * 3, "read_noise": [3.0] * 3}
    times = [1.0, 1.0 / 4.0, 1.0 / 4096.0]
    merged = merge(photograph(tmp_path, patches([0.1, 0.5, 900.0], 40, 20), times, **given),
                   notes=notes)  # fmt: skip
    (gap,) = merged.report.gaps
    assert (gap.shorter, gap.longer) == (2, 1) and gap.overlap < 1.0
    assert [note.code for note in notes] == ["exposure-gap"]
    assert "2.tif and 1.tif" in notes[0].message
    # 100 electrons and some read noise: 100 / 4 / 15871 of the range, and 10 % of them.
    assert merged.report.least == pytest.approx(0.00285, rel=0.05)
    assert merged.report.greatest == pytest.approx(0.97 * 4096.0)


def test_bracket_without_a_picture_is_refused(tmp_path, merge):
    times = [1.0, 0.25]
    with pytest.raises(ImageError, match=r"every photograph is black.*bracket:blackLevel, 512$"):
        merge(photograph(tmp_path, np.zeros((50, 50, 3)), times))
    with pytest.raises(ImageError, match=r"saturated, even in .*1.tif; .*bracket:whiteLevel"):
        merge(photograph(tmp_path, np.full((50, 50, 3), 100.0), times))


def test_sensor_that_saturates_below_the_white_level_is_found(tmp_path, merge):
    light = patches([0.1, 0.5, 30.0], 40, 20)
    view = photograph(tmp_path, light, [1.0, 0.25, 1.0 / 64.0], white_level=None)
    with pytest.raises(LayerError, match=r"both saturate at the raw value 16383, .*65535"):
        merge(view)


def test_white_level_below_black_is_refused(tmp_path, merge):
    view = photograph(tmp_path, patches([0.1, 0.5], 20, 20), [1.0, 0.5], white_level=300.0)
    with pytest.raises(LayerError, match="white level 300 is not above the black level 512"):
        merge(view)


def test_photographs_of_two_sizes_or_kinds_are_refused(tmp_path, merge):
    first = write_picture(tmp_path / "first.tif", np.full((20, 30, 3), 2000))
    for name, shape, kind, what in (
        (
            "wide.tif",
            (20, 31, 3),
            "uint16",
            r"\S*first.tif has 30 x 20 pixels and \S*wide.tif 31 x",
        ),
        (
            "byte.png",
            (20, 30, 3),
            "uint8",
            r"\S*first.tif holds 16-bit values and \S*byte.png 8-bit ones",
        ),
        (
            "float.exr",
            (20, 30, 3),
            "half",
            r"\S*first.tif holds 16-bit values and \S*float.exr floating-point",
        ),
    ):
        other = write_picture(tmp_path / name, np.full(shape, 1), kind)
        with pytest.raises(ImageError, match=rf"shoot.usda </Shoot/north>: {what}"):
            merge(bracket_view([first, other], [1.0, 0.5]))


@pytest.mark.parametrize("suffix", ["tif", "exr", "png", "jpg"])
def test_file_that_is_cut_short_is_named(tmp_path, merge, suffix):
    kind = {"tif": "uint16", "png": "uint16", "exr": "half", "jpg": "uint8"}[suffix]
    rng = np.random.default_rng(1)
    images = []
    for name in ("whole", "cut"):
        pixels = rng.random((200, 200, 3)) * (1.0 if kind == "half" else 200.0)
        images.append(write_picture(tmp_path / f"{name}.{suffix}", pixels, kind))
    images[1].write_bytes(images[1].read_bytes()[: images[1].stat().st_size // 2])
    with pytest.raises(ImageError, match=rf"cut.{suffix}: cannot read") as caught:
        merge(bracket_view(images, [1.0, 0.5]))
    assert "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path, merge):
    with pytest.raises(ImageError, match=r"none.tif: cannot read; no such file"):
        merge(bracket_view([tmp_path / "none.tif"], [1.0]))


def test_pixels_that_are_no_numbers_are_told(tmp_path, merge):
    pixels = np.full((40, 50, 3), 0.2, np.float32)
    good = write_picture(tmp_path / "good.exr", pixels, "float")
    pixels[33, 7, 1] = np.nan
    bad = write_picture(tmp_path / "bad.exr", pixels, "float")
    with pytest.raises(ImageError, match=r"bad.exr: the pixel at x 7, y 33 is nan"):
        merge(bracket_view([good, bad], [1.0, 0.5]))


# --- Frames ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "kind", "full_scale"),
    [
        ("a.tif", "uint16", 65535.0), ("a.png", "uint8", 255.0), ("b.png", "uint16", 65535.0),
        ("a.exr", "float", 1.0), ("b.exr", "half", 1.0),
    ],
)  # fmt: skip
@pytest.mark.parametrize("count", [1, 3, 4])
def test_frame_gives_raw_values_of_red_green_and_blue(tmp_path, name, kind, full_scale, count):
    rng = np.random.default_rng(9)
    top = 1 if full_scale == 1.0 else int(full_scale)
    pixels = np.round(rng.random((30, 20, count)) * top * 64.0) / 64.0
    pixels = np.floor(pixels) if top > 1 else pixels
    path = write_picture(tmp_path / name, pixels, kind)
    with open_frame(path, tmp_path) as frame:
        assert (frame.width, frame.height, frame.full_scale) == (20, 30, full_scale)
        rows = np.concatenate([frame.rows(0, 7), frame.rows(7, 8), frame.rows(8, 30)])
    assert rows.dtype == np.float32
    np.testing.assert_array_equal(rows, pixels[..., :3] if count > 1 else pixels.repeat(3, axis=2))


def test_picture_without_red_green_and_blue_is_refused(tmp_path):
    path = write_picture(tmp_path / "a.tif", np.zeros((4, 4, 2)))
    with pytest.raises(ImageError, match="grey or has R, G and B"):
        open_frame(path, tmp_path)


def mosaic(colors):
    """Return the RGGB mosaic of a picture."""
    cells = np.empty(colors.shape[:2])
    for (i, j), channel in zip(((0, 0), (0, 1), (1, 0), (1, 1)), (0, 1, 1, 2), strict=True):
        cells[i::2, j::2] = colors[i::2, j::2, channel]
    return cells


def test_raw_file_gives_the_values_of_its_photosites(tmp_path):
    pytest.importorskip("rawpy")
    rng = np.random.default_rng(10)
    cells = rng.integers(400, 16000, (40, 60))
    path = write_dng(tmp_path / "a.dng", cells, (500, 512, 514, 530), 16000)
    with open_frame(path, tmp_path) as frame:
        rows = frame.rows(0, 40)
        assert (frame.sample_type, frame.full_scale) == ("raw", 16000.0)
        np.testing.assert_array_equal(frame.black_level, [500.0, 513.0, 530.0])
    for (i, j), channel in zip(((0, 0), (0, 1), (1, 0), (1, 1)), (0, 1, 1, 2), strict=True):
        inside = (slice(i + 2, 38, 2), slice(j + 2, 58, 2))
        np.testing.assert_array_equal(rows[(*inside, channel)], cells[inside])
    np.testing.assert_array_equal(list(tmp_path.iterdir()), [path])  # scratch is gone


def test_raw_bracket_is_merged_with_the_levels_its_files_state(tmp_path, merge):
    pytest.importorskip("rawpy")
    sensor = Sensor()
    light = np.array([0.02, 0.05, 0.01]) * np.ones((60, 80, 3))
    times = 3.0 ** -np.arange(3.0)
    rng = np.random.default_rng(11)
    images = [
        write_dng(tmp_path / f"{k}.dng", mosaic(sensor.expose(light, time, rng)), [512] * 4, 16383)
        for k, time in enumerate(times)
    ]
    merged = merge(bracket_view(images, times))
    np.testing.assert_allclose(merged.values[2:-2, 2:-2].mean(axis=(0, 1)), light[0, 0], rtol=BIAS)


def test_raw_file_that_is_cut_short_is_named(tmp_path):
    pytest.importorskip("rawpy")
    path = write_dng(tmp_path / "a.dng", np.full((40, 60), 900), [512] * 4, 16383)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(ImageError, match=r"a.dng: cannot read; .*restore a good copy"):
        open_frame(path, tmp_path)


def test_raw_files_need_an_extra_that_the_error_names(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    with pytest.raises(UsageError, match=r"pip install 'usdskin\[raw\]'"):
        open_frame(tmp_path / "a.CR3", tmp_path)


def test_samples_are_spread_over_a_large_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(capture_bracket, "_SAMPLED_PIXELS", 16 * 2 * 30)
    rows = np.arange(640.0)[:, None, None] * np.ones((640, 30, 3))
    view = bracket_view([write_picture(tmp_path / "a.tif", rows)], [1.0])
    with capture_bracket.open_bracket(view, tmp_path, None, 100) as opened:
        samples = capture_bracket.draw_samples(opened, Workers("cpu", 1))
    found = np.round(samples.linear[0, :, 0, 0] * 65535.0)
    np.testing.assert_array_equal(found[::2], 20.0 + 40.0 * np.arange(16) - 1.0)
    np.testing.assert_array_equal(np.diff(found)[::2], 1.0)
