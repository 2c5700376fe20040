"""The virtual goniometer: closed forms of equation (1), and the fit to its readings."""

from __future__ import annotations

import numpy as np
import pytest

from usdskin.cli import main
from usdskin.errors import UsageError
from usdskin.judge.skin.goniometer import GoniometerSetup, find_skin, measure, reflected, spectra_of
from usdskin.layers import open_stage
from usdskin.prims.skin import SkinParameters, read_skin
from usdskin.spectrum import SpectralQuantity, Spectrum

NM = np.array([450.0, 550.0, 650.0])
LIBRARY = "stages/skin_library/skin_library.usda"


def skin(**given):
    flat = Spectrum(SpectralQuantity.REFLECTANCE, NM, np.full(3, 0.5))
    scatter = Spectrum(SpectralQuantity.SCATTERING, NM, np.full(3, 0.4))
    return SkinParameters(**{"alpha": 0.8, "reflectance": flat, "scattering": scatter, **given})


def test_lamp_above_gives_alpha_s_times_one_plus_ss():
    found = reflected(skin(), np.array([0.0]), np.zeros(1), NM)

    np.testing.assert_allclose(found, 0.8 * 0.5 * (1.0 + 0.4))


def test_at_the_shadow_line_only_the_wrap_is_left():
    found = reflected(skin(wrap=0.25), np.array([90.0]), np.zeros(1), NM)

    np.testing.assert_allclose(found, 0.8 * 0.5 * 0.4 * 0.25 / 1.25)


def test_light_ends_where_the_wrap_does():
    found = reflected(skin(wrap=0.25), np.array([np.degrees(np.arccos(-0.25))]), np.zeros(1), NM)

    np.testing.assert_allclose(found, 0.0, atol=1e-15)


def test_sheet_takes_its_share():
    found = reflected(skin(opacity=700.0), np.array([0.0]), np.array([0.001]), NM)

    np.testing.assert_allclose(found, 0.8 * 0.5 * 1.4 * np.exp(-0.7))


def test_readings_reach_past_the_last_light():
    for wrap, last in ((0.1, 105.74), (0.3, 117.46), (0.7, 144.43), (0.02, 105.0)):
        samples = measure(skin(wrap=wrap), GoniometerSetup())
        assert samples.theta_i is not None
        assert samples.theta_i.max() == pytest.approx(last, abs=0.01)
        assert len(samples.theta_i) == 24
        assert samples.thickness is None


def test_seed_decides_the_noise():
    first, same, other = (measure(skin(), GoniometerSetup(seed=seed)).values for seed in (1, 1, 2))

    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)


def test_command_measures_what_the_fit_finds_again(tmp_path):
    samples, fitted = tmp_path / "samples.usda", tmp_path / "skin.usda"

    assert main(["-q", "goniometer", LIBRARY, "-o", str(samples)]) == 0
    words = ["estimate", "skin", str(samples), "-o", str(fitted), "--specular", "ignore"]
    assert main(["-q", *words, "--opacity", "fit"]) == 0

    stages = open_stage(LIBRARY), open_stage(fitted)
    true, found = (read_skin(find_skin(stage)) for stage in stages)
    assert found.wrap == pytest.approx(true.wrap, abs=0.01)
    grid = np.arange(420.0, 700.0, 5.0)
    a, b = spectra_of(true, grid), spectra_of(found, grid)
    facing = [skin.alpha * s * (1.0 + ss) for skin, (s, ss, _) in ((true, a), (found, b))]
    np.testing.assert_allclose(facing[1], facing[0], rtol=0.03)
    np.testing.assert_allclose(b[2], a[2], rtol=0.06)


def test_lustre_is_there_without_polarisers_alone():
    shiny = skin(specular_weight=1.0, roughness1=0.3)
    crossed, bare = (
        measure(shiny, GoniometerSetup(polarisers=kind, noise=0.0, floor=0.0)).values
        for kind in ("crossed", "none")
    )
    mirror = int(np.argmax((bare - crossed)[:, 0]))

    assert measure(shiny, GoniometerSetup()).theta_i[mirror] == pytest.approx(30.0, abs=6.0)


def test_too_few_readings_are_refused():
    with pytest.raises(UsageError, match="6 at least"):
        GoniometerSetup(readings=3).check()
