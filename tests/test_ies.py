"""Photometric files of IES LM-63."""

from __future__ import annotations

import numpy as np
import pytest

from usdskin.errors import UsdSkinError
from usdskin.render.ies import IntensityProfile, read_ies

HEAD = """IESNA:LM-63-2002
[TEST] 1
[MANUFAC] none
TILT=NONE
"""


def text(theta, phi, rows, multiplier=1.0, ballast=1.0, photometry=1, tilt=HEAD):
    lines = [
        f"1 1000 {multiplier} {len(theta)} {len(phi)} {photometry} 2 0 0 0",
        f"{ballast} 1 50",
        " ".join(map(str, theta)),
        " ".join(map(str, phi)),
        *(" ".join(map(str, row)) for row in rows),
    ]
    return tilt + "\n".join(lines) + "\n"


def ies(tmp_path, *arguments, **options):
    path = tmp_path / "lamp.ies"
    path.write_text(text(*arguments, **options))
    return read_ies(path)


def test_a_lamp_that_is_the_same_all_around_needs_one_plane(tmp_path):
    found = ies(tmp_path, [0, 45, 90], [0], [[100, 50, 0]], multiplier=2.0, ballast=0.5)
    assert found.theta_deg.tolist() == [0, 45, 90]
    assert found.phi_deg.tolist() == [0, 360]
    assert found.intensity.tolist() == [[100, 100], [50, 50], [0, 0]]


def test_quadrants_and_halves_are_mirrored(tmp_path):
    quarter = ies(tmp_path, [0, 90], [0, 45, 90], [[1, 2], [3, 4], [5, 6]])
    assert quarter.phi_deg.tolist() == [0, 45, 90, 135, 180, 225, 270, 315, 360]
    assert quarter.intensity[0].tolist() == [1, 3, 5, 3, 1, 3, 5, 3, 1]
    half = ies(tmp_path, [0, 90], [0, 90, 180], [[1, 2], [3, 4], [5, 6]])
    assert half.phi_deg.tolist() == [0, 90, 180, 270, 360]
    assert half.intensity[1].tolist() == [2, 4, 6, 4, 2]


def test_planes_from_90_to_270_are_mirrored_in_their_own_plane(tmp_path):
    found = ies(tmp_path, [0, 90], [90, 135, 180, 225, 270], [[k, k] for k in (1, 2, 3, 4, 5)])
    assert found.phi_deg.tolist() == [0, 45, 90, 135, 180, 225, 270, 315, 360]
    assert found.intensity[0].tolist() == [3, 2, 1, 2, 3, 4, 5, 4, 3]


def test_a_turn_that_is_not_closed_is_closed(tmp_path):
    found = ies(tmp_path, [0, 90], [0, 90, 180, 270], [[1, 1], [2, 2], [3, 3], [4, 4]])
    assert found.phi_deg.tolist() == [0, 90, 180, 270, 360]
    assert found.intensity[0].tolist() == [1, 2, 3, 4, 1]


def test_numbers_may_be_broken_into_lines_anywhere(tmp_path):
    path = tmp_path / "lamp.ies"
    flat = text([0, 45, 90], [0], [[100, 50, 0]])
    path.write_text(HEAD + flat[len(HEAD) :].replace(" ", "\r\n"))
    assert read_ies(path).intensity[:, 0].tolist() == [100, 50, 0]


def test_tilt_tables_are_passed_over(tmp_path):
    head = HEAD.replace("NONE", "INCLUDE") + "1\n3\n0 45 90\n1 0.9 0.8\n"
    found = ies(tmp_path, [0, 90], [0], [[7, 8]], tilt=head)
    assert found.intensity[:, 0].tolist() == [7, 8]


def test_files_of_1986_have_no_version_line(tmp_path):
    found = ies(tmp_path, [0, 90], [0], [[7, 8]], tilt="A LAMP\nTILT=NONE\n")
    assert found.intensity[:, 0].tolist() == [7, 8]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda t: t.replace("TILT=NONE", ""), r":1: no line TILT="),
        (lambda t: t.replace("TILT=NONE", "TILT=lamp.tlt"), r":4: TILT=LAMP.TLT"),
        (lambda t: t.replace("1 2 0 0 0", "2 2 0 0 0"), r":5: photometric type B"),
        (lambda t: t.replace("100 50 0", "100 x 0"), r":9: 'x' stands where candela values"),
        (lambda t: t.replace("100 50 0", "100 50"), r":10: the file has 2 numbers where 3"),
        (lambda t: t.replace("0 45 90", "0 90 45"), r":7: the vertical angles"),
        (lambda t: t.replace("0 45 90", "0 45 190"), r":7: the vertical angles .* to 190"),
        (lambda t: t.replace("100 50 0", "-1 50 0"), r":9: its intensity is negative"),
        (lambda t: t.replace(" 3 1 1 2", " 3 0 1 2"), r":5: the number of horizontal angles is 0"),
        (lambda t: t[: t.index("1 1000")], r"ends before the number of lamps"),
        (lambda t: t.replace("100 50 0", "nan 50 0"), r":9: 'nan' stands"),
    ],
)
def test_errors_name_the_line(tmp_path, damage, said):
    path = tmp_path / "lamp.ies"
    path.write_text(damage(text([0, 45, 90], [0], [[100, 50, 0]])))
    with pytest.raises(UsdSkinError, match=said):
        read_ies(path)


def test_planes_of_no_known_symmetry_are_refused(tmp_path):
    with pytest.raises(UsdSkinError, match=r":8: horizontal angles from 0 to 45"):
        ies(tmp_path, [0, 90], [0, 45], [[1, 2], [3, 4]])


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UsdSkinError, match=r"no\.ies: No such file"):
        read_ies(tmp_path / "no.ies")


def test_the_mean_is_over_the_sphere_or_the_hemisphere():
    phi = np.array([0.0, 360.0])
    whole = IntensityProfile(np.array([0.0, 90.0, 180.0]), phi, np.full((3, 2), 5.0))
    assert whole.mean() == pytest.approx(5.0)
    below = IntensityProfile(np.array([0.0, 90.0]), phi, np.full((2, 2), 5.0))
    assert below.mean() == pytest.approx(5.0)
    # Linear from 1 at nadir to 0 at the horizon: int (1 - 2 t / pi) sin t dt = 1 - 2 / pi.
    ramp = IntensityProfile(np.array([0.0, 90.0]), phi, np.array([[1.0, 1.0], [0.0, 0.0]]))
    assert ramp.mean() == pytest.approx(1.0 - 2.0 / np.pi)


def test_the_even_grid_holds_all_samples():
    theta = np.array([0.0, 2.5, 10.0, 60.0])
    phi = np.array([0.0, 22.5, 90.0, 360.0])
    table = np.random.default_rng(4).random((4, 4))
    grid = IntensityProfile(theta, phi, table).grid()
    assert np.degrees([grid.theta_step, grid.phi_step]) == pytest.approx([2.5, 22.5])
    rows, columns = (theta / 2.5).astype(int), (phi / 22.5).astype(int)
    assert grid.value[np.ix_(rows, columns)] == pytest.approx(table)
    assert not grid.value[25:].any()
