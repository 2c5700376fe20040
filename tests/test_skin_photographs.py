"""Skin from photographs by a virtual photographer, against the material that was photographed."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skin_subjects import skin, write_lamp, write_subject

from usdskin.cli import main
from usdskin.colorimetry import xyz_weights
from usdskin.device import Workers
from usdskin.differences import delta_e_of_signals
from usdskin.errors import ImageError, LayerError, UsageError
from usdskin.estimate.skin.fit import FitOptions, fit_skin
from usdskin.estimate.skin.geometry import read_geometry
from usdskin.estimate.skin.photographs import sample_photographs
from usdskin.estimate.skin.picking import is_glossy, pick_evenly
from usdskin.estimate.skin.recovered import skin_from_camera
from usdskin.estimate.skin.scatter import find_odd, standard_deviations
from usdskin.estimate.skin.spectra_of_channels import spectra_of_channels
from usdskin.illuminants import illuminant
from usdskin.images import Part, read_headers, read_image, write_exr
from usdskin.judge.shoot.chart_layers import read_chart_truth
from usdskin.judge.shoot.charts import ChartSetup, photograph_chart
from usdskin.judge.shoot.sensor import Sensor, exposure_series
from usdskin.judge.shoot.setups import Setup, fisheye
from usdskin.judge.skin.photographs import (
    SubjectSetup,
    lamps,
    photograph_subject,
    read_subject_truth,
)
from usdskin.judge.skin.scenes import direction_of, facing
from usdskin.layers import open_stage
from usdskin.prims.samples import read_skin_samples
from usdskin.prims.skin import read_skin
from usdskin.spectrum import SpectralQuantity, Spectrum
from usdskin.validate import validate

ALONE = Workers("cpu", 1)
LAMPS = ("A", "D65", "FL2", "FL11", "LED-B3")
NOISY = Sensor(full_well=15000.0)  # 1 % of what white is at the shorter exposure


def sampled(samples, tmp_path, notes=None, **options):
    return sample_photographs(samples, ALONE, tmp_path, None, notes, **options)


def samples_in(folder: Path):
    return read_skin_samples(open_stage(folder / "samples.usda"))


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """Return a folder with a camera that was calibrated by a chart, and its sensor constant."""
    folder = tmp_path_factory.mktemp("studio")
    write_lamp(folder / "lamp.usda")
    setup = Setup(lens=fisheye(400), exposures=exposure_series(4, 2.0, middle_s=1.0 / 30.0))
    chart = photograph_chart(
        folder / "lamp.usda", folder / "chart", setup, ChartSetup(light_class="lamp"), threads=1
    )
    assert main(["-q", "calibrate", "camera", str(chart), "-o", str(folder / "camera.usda")]) == 0
    return folder, read_chart_truth(folder / "chart").constants["sensorConstant"]


def photographed(studio, folder: Path, material, *, head=False, up="Y", **changes):
    """Photograph a subject with the calibrated camera; return its folder and samples."""
    place, constant = studio
    stage = write_subject(folder / "subject.usda", material, head=head, up=up)
    shoot = SubjectSetup(
        calibration=place / "camera.usda", states_white=False, **{"size": 48} | changes
    )
    setup = Setup(sensor_constant=constant, sensor=NOISY, states_noise=True)
    photograph_subject(stage, folder / "shoot", setup, shoot, threads=os.cpu_count())
    return folder / "shoot", samples_in(folder / "shoot")


@pytest.fixture(scope="module")
def ball(studio, tmp_path_factory):
    return photographed(studio, tmp_path_factory.mktemp("ball"), skin(), samples_per_pixel=9)


def color_errors(fit, samples, truth) -> np.ndarray:
    """Return CIEDE2000 of S, in the same convention, in the taking light and in five others."""
    camera = samples.camera
    nm, light = camera.wavelength_nm, camera.recoveries[0].illuminant

    def prior(values, covariance):
        found = skin_from_camera(values[None], camera.responsivity, light, wavelength_nm=nm)
        return found.reflectance[0], found.stddev[0]

    spectra = spectra_of_channels(
        fit.lambert,
        fit.wrapped,
        fit.covariance,
        wavelength_nm=nm,
        responsivity=camera.responsivity,
        illuminant=light,
        reflectance_of=prior,
    )
    return reflectance_errors(spectra.reflectance, samples, truth)


def reflectance_errors(reflectance, samples, truth) -> np.ndarray:
    """Return CIEDE2000 of S on the camera's grid, in the taking light and in five others."""
    nm, light = samples.camera.wavelength_nm, samples.camera.recoveries[0].illuminant
    luminous = xyz_weights(nm)[:, 1] / xyz_weights(nm)[:, 1].sum()
    scattering = truth.skin.scattering.resample(nm)
    true = truth.skin.alpha * truth.skin.reflectance.resample(nm) * (1.0 + luminous @ scattering)
    lights = [light, *(illuminant(name, nm) for name in LAMPS)]
    return np.array([delta_e_of_signals(reflectance * e, true * e, e, nm) for e in lights])


def true_channels(samples, truth):
    """Return A and B as the calibrated camera sees them."""
    camera = samples.camera
    rows = camera.responsivity * camera.recoveries[0].illuminant[:, None]
    rows = rows / rows.sum(axis=0)
    reflectance = truth.skin.alpha * truth.skin.reflectance.resample(camera.wavelength_nm)
    scattering = truth.skin.scattering.resample(camera.wavelength_nm)
    return reflectance @ rows, (reflectance * scattering) @ rows


# --- The bars ------------------------------------------------------------------------------------


def test_a_ball_photographed_in_24_lights_gives_back_its_skin(ball, tmp_path):
    folder, samples = ball
    truth = read_subject_truth(folder)
    found = sampled(samples, tmp_path)
    fit = fit_skin(found.readings)
    lambert, wrapped = true_channels(samples, truth)
    assert abs(fit.wrap - truth.skin.wrap) <= 0.01
    assert np.allclose(fit.lambert + fit.wrapped, lambert + wrapped, rtol=0.01)
    # The stated deviations are what the readings scatter by, but for what pixels share.
    assert found.shared > 3.0 and 0.7 <= fit.noise * found.shared <= 1.4
    assert 2e-4 <= fit.stddev[0] <= 3e-3 and abs(fit.wrap - truth.skin.wrap) <= 3.0 * fit.stddev[0]
    errors = color_errors(fit, samples, truth)
    assert errors.mean() <= 1.0 and errors[0] <= 1.0


def test_the_command_writes_the_skin_of_the_ball(ball, tmp_path):
    folder, samples = ball
    truth, output = read_subject_truth(folder), tmp_path / "skin.usda"
    command = ["-q", "estimate", "skin", str(folder / "samples.usda"), "-o", str(output)]
    assert main(command) == 0
    stage = open_stage(output)
    found = read_skin(stage.GetDefaultPrim())
    assert abs(found.wrap - truth.skin.wrap) <= 0.01
    reflectance = found.reflectance.resample(samples.camera.wavelength_nm)
    assert reflectance_errors(reflectance, samples, truth).mean() <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("wrap", [0.1, 0.6])
def test_a_head_gives_back_its_skin_whatever_its_wrap(studio, tmp_path, wrap):
    folder, samples = photographed(studio, tmp_path, skin(wrap=wrap), head=True, up="Z", size=72)
    truth = read_subject_truth(folder)
    fit = fit_skin(sampled(samples, tmp_path).readings)
    assert abs(fit.wrap - wrap) <= 0.03
    assert color_errors(fit, samples, truth).mean() <= 1.0


@pytest.mark.slow
def test_a_glossy_ball_is_masked_or_fitted_with_its_gloss(studio, tmp_path):
    folder, samples = photographed(studio, tmp_path, skin(specular=1.0), size=72)
    truth = read_subject_truth(folder)
    matt = fit_skin(sampled(samples, tmp_path).readings)
    whole = fit_skin(sampled(samples, tmp_path, gloss="keep").readings, FitOptions(specular="fit"))
    assert abs(matt.wrap - truth.skin.wrap) <= 0.03
    assert abs(whole.wrap - truth.skin.wrap) <= 0.03
    assert color_errors(whole, samples, truth).mean() <= 1.0
    with pytest.raises(LayerError, match="specular reflection"):
        fit_skin(sampled(samples, tmp_path, gloss="keep").readings)


@pytest.mark.slow
@pytest.mark.realdata
def test_a_scanned_head_gives_back_its_skin(studio, realdata, tmp_path):
    mesh = realdata / "heads" / "leeperrysmith" / "LeePerrySmith.obj"
    assert main(["-q", "import", str(mesh), "-o", str(tmp_path / "head.usda")]) == 0
    place, constant = studio
    stage = write_subject(tmp_path / "subject.usda", skin(), mesh=tmp_path / "head.usda")
    shoot = SubjectSetup(
        size=96, material="/Skin", calibration=place / "camera.usda", states_white=False
    )
    setup = Setup(sensor_constant=constant, sensor=NOISY, states_noise=True)
    photograph_subject(stage, tmp_path / "shoot", setup, shoot, threads=os.cpu_count())
    samples = samples_in(tmp_path / "shoot")
    truth = read_subject_truth(tmp_path / "shoot")
    fit = fit_skin(sampled(samples, tmp_path).readings)
    assert abs(fit.wrap - truth.skin.wrap) <= 0.03
    assert color_errors(fit, samples, truth).mean() <= 1.0


def test_pictures_in_camera_values_do_as_well_as_brackets(studio, tmp_path):
    folder, samples = photographed(
        studio, tmp_path, skin(), as_images=True, size=48, lights=lamps(6), samples_per_pixel=4
    )
    assert len(samples.images) == 12 and not samples.views
    fit = fit_skin(sampled(samples, tmp_path).readings)
    assert abs(fit.wrap - read_subject_truth(folder).skin.wrap) <= 0.03


# --- What pixels are ------------------------------------------------------------------------------


def test_the_header_of_every_part_tells_where_the_camera_was(ball):
    file = ball[1].geometry_files[0]
    position = read_image(file, part="P").pixels.reshape(-1, 3).astype(np.float64)
    normal = read_image(file, part="N").pixels.reshape(-1, 3)
    seen = position[np.linalg.norm(normal, axis=1) > 0.5]
    for header in read_headers(file):
        matrix = np.array(header.attributes["worldToCamera"]).reshape(4, 4)
        place = np.column_stack([seen, np.ones(len(seen))]) @ matrix  # row vectors
        assert header.attributes["usdskin/projection"] == "perspective"
    # The ball's middle is 6 radii of 9 cm before the camera, which looks along -Z.
    radius = np.linalg.norm(place[:, :3] - [0.0, 0.0, -0.54], axis=1)
    assert np.allclose(radius, 0.09, atol=2e-4)


def test_readings_lie_on_the_ball_and_look_at_the_camera(ball, tmp_path):
    found = sampled(ball[1], tmp_path)
    readings, middle = found.readings, np.array([0.03, -0.04, 0.05])
    camera = middle + 0.54 * direction_of((45.0, 10.0), "Y")
    second = found.photograph >= 24
    point = middle + 0.09 * readings.normal[second]
    view = camera - point
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    # Faces of the tessellated ball lie within it, and normals are interpolated.
    assert np.abs(readings.view[second] - view).max() < 2e-3
    assert readings.view_cosine.min() > 0.2
    light = direction_of(lamps()[3], "Y")
    assert np.allclose(readings.light[found.photograph == 27], light, atol=1e-6)


def test_all_angles_to_the_light_are_there_alike(ball, tmp_path):
    theta = sampled(ball[1], tmp_path, gloss="keep").readings.theta_deg
    counts, _ = np.histogram(theta, np.arange(40.0, 131.0, 10.0))
    assert counts.min() > 0.5 * counts.max()


def test_pixels_are_picked_evenly_and_always_the_same():
    random = np.random.default_rng(5)
    cosine = np.cos(np.radians(np.concatenate([random.uniform(0, 20, 5000), np.arange(20, 180)])))
    first, again = (pick_evenly(cosine, 200, 3) for _ in range(2))
    assert np.array_equal(first, again) and not np.array_equal(first, pick_evenly(cosine, 200, 4))
    assert len(np.unique(first)) == len(first) and 150 <= len(first) <= 200
    assert np.count_nonzero(first < 5000) < 60


def test_edges_and_creases_give_no_readings(tmp_path):
    size = 40
    y, x = np.mgrid[:size, :size].astype(np.float32)
    normal = np.zeros((size, size, 3), np.float32)
    normal[..., 2] = 1.0
    normal[:, 30:] = [1.0, 0.0, 0.0]  # a crease, and beyond it hardly facing
    position = np.stack([0.01 * x, -0.01 * y, np.where(x < 15, 0.0, 0.2)], -1)  # a step
    write_geometry(tmp_path / "g.exr", normal, position, [0.15, -0.2, 3.0])
    inside = read_geometry(tmp_path / "g.exr").inside
    assert inside[10, 5:12].all() and inside[10, 19:26].all()
    assert not inside[:, 13:17].any() and not inside[:, 28:].any() and not inside[:2].any()


def write_geometry(path, normal, position, camera, **attributes):
    matrix = np.eye(4)
    matrix[3, :3] = -np.array(camera)
    given = {"worldToCamera": matrix} | attributes
    parts = [Part("N", {"N": normal}, given), Part("P", {"P": np.float32(position)}, given)]
    write_exr(path, parts)


def test_an_orthographic_camera_sees_along_its_axis(tmp_path):
    normal = np.zeros((9, 9, 3), np.float32)
    normal[..., 2] = 1.0
    y, x = np.mgrid[:9, :9].astype(np.float32)
    position = np.stack([x, -y, 0.0 * x], -1)
    header = {"usdskin/projection": "orthographic"}
    write_geometry(tmp_path / "g.exr", normal, position, [100.0, 0.0, 5.0], **header)
    assert np.allclose(read_geometry(tmp_path / "g.exr").view, [0.0, 0.0, 1.0])


def test_the_mirror_direction_is_glossy_and_what_lies_off_it_is_not():
    up = np.array([0.0, 0.0, 1.0])

    def at(theta):
        return np.array([np.sin(np.radians(theta)), 0.0, np.cos(np.radians(theta))])

    view = np.stack([at(-40.0), at(40.0), at(-85.0)])
    assert is_glossy(at(40.0), view, np.tile(up, (3, 1))).tolist() == [True, False, True]
    assert not is_glossy(at(120.0), view, np.tile(up, (3, 1))).any()


def test_shadows_and_highlights_stand_out_from_other_photographs():
    random = np.random.default_rng(2)
    cosine = random.uniform(-1.0, 1.0, 4000)
    lit = 0.4 * np.maximum(cosine, 0.0) + 0.1 * np.maximum((cosine + 0.3) / 1.3, 0.0)
    values = lit[:, None] * (1.0 + 0.03 * random.normal(size=(4000, 3)))
    clean = find_odd(cosine, values)
    assert not clean.shadowed.any() and not clean.highlight.any()
    dark = (cosine > 0.2) & (random.uniform(size=4000) < 0.2)
    bright = (cosine > 0.2) & ~dark & (random.uniform(size=4000) < 0.05)
    values[dark] *= 0.1
    values[bright] += 0.6
    odd = find_odd(cosine, values)
    assert np.array_equal(odd.shadowed, dark) and np.array_equal(odd.highlight, bright)


def test_stated_deviations_are_what_readings_scatter_by():
    random = np.random.default_rng(3)
    cosine = random.uniform(-1.0, 1.0, 6000)
    turn = random.uniform(0.01, 0.1, 6000)
    lit = 0.4 * np.maximum(cosine, 0.0)[:, None] * np.ones(3)
    slope = 0.4 * (cosine > 0.0)
    true = np.sqrt((0.2 * turn * slope) ** 2 + (0.01 * lit[:, 0]) ** 2 + 0.002**2)
    values = lit + true[:, None] * random.normal(size=(6000, 3))
    matt = np.ones(6000, bool)
    found = standard_deviations(cosine, values, turn, np.full((6000, 3), 0.002**2), matt)
    for part in (cosine < -0.1, (cosine > 0.1) & (turn > 0.07), (cosine > 0.7) & (turn < 0.03)):
        assert np.median(found[part, 0] / true[part]) == pytest.approx(1.0, abs=0.15)
    assert standard_deviations(cosine[:5], values[:5], turn[:5], None, matt[:5]) is None


def test_a_mask_chooses_pixels_and_shadows_are_told(ball, tmp_path):
    _, samples = ball
    size = read_geometry(samples.geometry_files[0]).size
    mask = np.zeros(size, np.float32)
    mask[:, : size[1] // 2] = 1.0
    write_exr(tmp_path / "mask.exr", [Part("", {"R": mask, "G": mask, "B": mask})])
    found = sampled(replace(samples, mask_files=(tmp_path / "mask.exr",)), tmp_path)
    assert found.pixel[:, 0].max() < size[1] // 2
    assert found.readings.values.shape[0] == sum(report.used for report in found.reports)


def test_the_white_scales_the_readings_and_needs_no_camera(ball, tmp_path):
    folder, samples = ball
    computed = sampled(samples, tmp_path)
    white = read_subject_truth(folder).white
    assert np.allclose(computed.white, white, rtol=0.01)  # of a chart with noise
    stated = sampled(replace(samples, white=2.0 * white, camera=None), tmp_path)
    ratio = computed.readings.values.sum(0) / stated.readings.values.sum(0)
    assert np.allclose(ratio, 2.0, rtol=0.02)


# --- What a lab gets wrong ------------------------------------------------------------------------


def test_bad_samples_are_refused_in_one_line_that_says_what_to_do(ball, tmp_path):
    _, samples = ball
    black = np.zeros((48, 48), np.float32)
    write_exr(tmp_path / "black.exr", [Part("", {"R": black, "G": black, "B": black})])
    write_exr(tmp_path / "small.exr", [Part("", {c: black[:9, :9] + 1.0 for c in "RGB"})])
    bad = {
        "nothing": ({"mask_files": (tmp_path / "black.exr",)}, "the mask leaves nothing"),
        "small": ({"mask_files": (tmp_path / "small.exr",)}, "9 x 9 pixels, but its geometry"),
        "lights": ({"lights": samples.lights[:5]}, "samples:lights has 5 entries"),
        "order": ({"lights": samples.lights[::-1]}, "in the order"),
        "white": ({"white": None, "camera": None}, "neither samples:white nor samples:camera"),
        "dark": ({"white": np.array([1.0, 0.0, 1.0])}, "not above 0"),
        "none": ({"views": ()}, "names no photographs"),
        "both": ({"images": (tmp_path / "black.exr",)}, "both samples:images and samples:views"),
        "part": ({"geometry_files": (tmp_path / "black.exr",)}, "has no part N"),
        "fisheye": (
            {"views": tuple(replace(view, lens=fisheye(48)) for view in samples.views)},
            "FisheyeCameraAPI",
        ),
        "thick": ({"thickness": np.ones(4)}, "one for all"),
        "tiff": (
            {"views": (), "images": samples.views[0].bracket.images[:1] * 48},
            "depends on an exposure|depend on an exposure",
        ),
    }
    for given, message in bad.values():
        with pytest.raises((LayerError, ImageError), match=message) as caught:
            sampled(replace(samples, **given), tmp_path)
        assert "\n" not in str(caught.value)


def test_geometry_without_a_camera_is_refused(tmp_path):
    normal = np.zeros((9, 9, 3), np.float32)
    normal[..., 2] = 1.0
    parts = [Part("N", {"N": normal}), Part("P", {"P": normal})]
    write_exr(tmp_path / "g.exr", parts)
    with pytest.raises(ImageError, match="no worldToCamera"):
        read_geometry(tmp_path / "g.exr")
    write_geometry(tmp_path / "empty.exr", 0.0 * normal, normal, [0.0, 0.0, 1.0])
    with pytest.raises(ImageError, match="no pixel has a unit normal"):
        read_geometry(tmp_path / "empty.exr")


def test_a_light_in_other_units_than_the_camera_is_refused(ball, tmp_path):
    _, samples = ball
    first = samples.lights[0]
    relative = replace(first, spectral=replace(first.spectral, units="relative"))
    radiance = Spectrum(SpectralQuantity.RADIANCE, np.array([400.0, 700.0]), np.ones(2))
    other = replace(first, spectral=replace(first.spectral, emission=radiance))
    for light, message in ((relative, "same units"), (other, "quantity irradiance")):
        with pytest.raises(LayerError, match=message):
            sampled(replace(samples, lights=(light,)), tmp_path)


def test_photographs_depend_on_the_seed_alone(tmp_path):
    stage = write_subject(tmp_path / "subject.usda", skin())
    shoot = SubjectSetup(size=16, lights=lamps(2), views=((0.0, 0.0),), samples_per_pixel=1)
    for name, seed, threads in (("a", 1, 1), ("b", 1, 2), ("c", 2, 2)):
        setup = Setup(seed=seed)
        photograph_subject(stage, tmp_path / name, setup, shoot, threads=threads)
    files = [path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.tif")]
    first, again, other = (
        [(tmp_path / name / file).read_bytes() for file in files] for name in "abc"
    )
    assert len(files) == 4 and first == again and first != other
    assert not validate(tmp_path / "a" / "samples.usda")


def test_the_photographer_refuses_what_it_cannot_photograph(tmp_path):
    with pytest.raises(UsageError, match="size is 2"):
        photograph_subject(tmp_path / "a.usda", tmp_path / "out", None, SubjectSetup(size=2))
    write_lamp(tmp_path / "lamp.usda")
    with pytest.raises(LayerError, match="has a shape"):
        photograph_subject(tmp_path / "lamp.usda", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_lamps_and_cameras_look_at_the_subject():
    for up in "YZ":
        direction = direction_of((30.0, 20.0), up)
        rotation = facing(direction, up)
        assert np.allclose(rotation @ [0.0, 0.0, 1.0], direction)
        assert np.allclose(rotation.T @ rotation, np.eye(3)) and np.linalg.det(rotation) > 0.0
    assert np.allclose(direction_of((0.0, 0.0), "Z"), [0.0, -1.0, 0.0])
    assert np.allclose(direction_of((90.0, 0.0), "Y"), [1.0, 0.0, 0.0])


def test_the_command_photographs_a_session(tmp_path, capsys):
    stage = write_subject(tmp_path / "subject.usda", skin())
    arguments = ["-q", "photograph-skin", str(stage), "-o", str(tmp_path / "session"), "--images"]
    arguments += ["--size", "24", "--lights", "4"]
    assert main(arguments) == 0
    samples = samples_in(tmp_path / "session")
    assert len(samples.images) == len(samples.lights) == 8
    assert main(arguments) == 2
    assert "session" in capsys.readouterr().err
