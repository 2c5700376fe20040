"""The proof: the loop end to end, and that the estimators see nothing of the truth."""

from __future__ import annotations

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from proof_sets import TINY, write_set

from usdskin.cli import main
from usdskin.colorimetry import color_matching_functions
from usdskin.errors import LayerError, UsageError
from usdskin.images import read_image, read_spectral
from usdskin.judge.proof import prove as proof_module
from usdskin.judge.proof.bars import bars_of, light_bar
from usdskin.judge.proof.budget import clipping_of, glare_of, rotation_of, vignetting_of
from usdskin.judge.proof.options import ProofOptions, size_of
from usdskin.judge.proof.prove import prove
from usdskin.judge.proof.record import JOURNAL_NAME, PROOF_NAME, Journal
from usdskin.judge.proof.shoot import shooting_of, turned_views
from usdskin.judge.shoot.photographer import plan
from usdskin.latlong import texel_solid_angles

ESTIMATORS = ("ingest", "capture", "camera", "light", "skin-fit")


@pytest.fixture(scope="module")
def proved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("proof")
    light = write_set(folder / "set", ("tubes",))
    output = folder / "out"
    done = prove(
        folder / "set",
        output,
        ProofOptions(size=size_of("tiny"), integrators=("map",), light=light),
    )
    return output, json.loads(done.path.read_text())


def steps_of(proof):
    return {step["name"]: step for step in proof["steps"]}


def test_every_step_leaves_what_the_proof_names(proved):
    output, proof = proved
    named = [proof["layers"][name] for name in ("truthLight", "capture", "camera", "light", "skin")]
    named += [proof["layers"]["shoot"], proof["layers"]["charts"]["light"]]
    named += [row[kind] for row in proof["pictures"] for kind in ("beauty", "spectral", "png")]
    named += [row[kind] for row in proof["comparisons"] for kind in ("maps", "png")]

    assert [row["name"] for row in proof["pictures"]] == ["truth", "light", "chain"]
    for name in named:
        assert (output / name).is_file(), name
        assert not Path(name).is_absolute()
        assert proof["files"][name]["bytes"] == (output / name).stat().st_size


def test_the_estimates_are_near_the_truth(proved):
    _, proof = proved
    found = {row["name"]: row["result"]["deltaE2000"] for row in proof["comparisons"]}

    assert 0.0 < found["light"]["mean"] < 1.5
    assert 0.0 < found["chain"]["mean"] < 2.0
    for item in proof["spectra"]["items"]:
        assert len(item["true"]) == len(item["estimated"]) == len(proof["spectra"]["wavelengths"])
    wrap = next(row for row in proof["skin"] if row["name"] == "wrap")
    assert abs(wrap["estimated"] - wrap["true"]) < 4.0 * wrap["stddev"]


def test_an_outside_formula_finds_the_same_difference(proved):
    """By hand: tristimulus values of both spectral files, L*a*b*, and colour-science's dE2000."""
    from colour.difference import delta_E_CIE2000

    output, proof = proved
    row = next(row for row in proof["comparisons"] if row["name"] == "light")
    nm, truth = read_spectral(output / "renders/truth_map.spectral.exr")
    _, found = read_spectral(output / "renders/light_map.spectral.exr")
    shown = read_image(output / "renders/truth_map.exr", channels=("A",)).pixels[..., 0] >= 0.999
    functions = 683.002 * 5.0 * color_matching_functions(nm)
    x, y = row["result"]["white"]
    white = row["result"]["yN"] * np.array([x / y, 1.0, (1.0 - x - y) / y])

    def lab(spectra):
        share = spectra[shown].astype(float) @ functions / white
        root = np.where(share > (6 / 29) ** 3, np.cbrt(share), share / (3 * (6 / 29) ** 2) + 4 / 29)
        fx, fy, fz = root.T
        return np.stack([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)], axis=-1)

    difference = delta_E_CIE2000(lab(found), lab(truth))

    assert row["result"]["mask"]["pixels"] == shown.sum()
    assert difference.mean() == pytest.approx(row["result"]["deltaE2000"]["mean"], abs=2e-3)
    assert np.percentile(difference, 95) == pytest.approx(
        row["result"]["deltaE2000"]["p95"], abs=4e-3
    )


@pytest.fixture(scope="module")
def switched(tmp_path_factory):
    """Prove a set of two kinds of lamps, each captured alone too."""
    folder = tmp_path_factory.mktemp("switched")
    light = write_set(folder / "set")
    options = ProofOptions(
        size=size_of("tiny"), integrators=("map",), light=light, class_captures=True
    )
    done = prove(folder / "set", folder / "out", options)
    return folder / "out", json.loads(done.path.read_text())


@pytest.mark.slow
def test_captures_of_single_classes_take_the_place_of_a_class_map(switched, tmp_path, monkeypatch):
    """Each by the command that stands in the proof, with the camera of the whole shoot."""
    output, proof = switched
    steps = steps_of(proof)
    found = {row["name"]: row["result"]["deltaE2000"]["mean"] for row in proof["comparisons"]}
    assert 0.0 < found["light"] < 1.5
    for name in ("tubes", "window"):
        assert f"--class-capture {name}=captures/{name}/capture.usda" in steps["light"]["command"]
    assert not any("captures-" in note for note in steps["light"]["notes"])
    monkeypatch.chdir(output)
    words, again = shlex.split(steps["photograph-window"]["command"])[1:], tmp_path / "again"
    words[words.index("-o") + 1] = str(again)
    assert main(["-q", *words]) == 0
    pictures = [path for path in sorted(again.glob("view*/*")) if path.suffix == ".tif"]
    assert len(pictures) == 4 * size_of("tiny").exposures
    for picture in pictures:
        kept = Path("shoot/room_window") / picture.relative_to(again)
        assert picture.read_bytes() == kept.read_bytes()


def test_no_estimator_reads_the_truth(proved):
    _, proof = proved
    steps = steps_of(proof)

    for name in ESTIMATORS:
        assert steps[name]["reads"], name
        for file in steps[name]["reads"]:
            assert "truth" not in Path(file).parts, f"{name} reads {file}"


def test_estimators_give_the_same_without_the_truth_on_the_disk(proved, monkeypatch, tmp_path):
    made, proof = proved
    output = tmp_path / "out"
    shutil.copytree(made, output, ignore=shutil.ignore_patterns("truth"))
    monkeypatch.chdir(output)
    assert any(path.is_dir() for path in made.rglob("truth"))
    before = (output / "light.coefficients.exr").read_bytes()
    skin = proof["layers"]["skin"]
    numbers = [line for line in (output / skin).read_text().splitlines() if "double[]" in line]
    for name in ESTIMATORS:
        command = steps_of(proof)[name]["command"]
        words = shlex.split(command)[1:]
        assert main(["-q", *words]) == 0, command

    assert (output / "light.coefficients.exr").read_bytes() == before
    again = [line for line in (output / skin).read_text().splitlines() if "double[]" in line]
    assert again == numbers


@pytest.mark.slow
def test_an_interrupted_proof_goes_on_where_it_ended(tmp_path, monkeypatch):
    light = write_set(tmp_path / "set", ("tubes",))
    output = tmp_path / "out"
    options = dict(size=size_of("tiny"), integrators=("map",), light=light, capture="ideal")

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(proof_module, "render_shot", stop)
        with pytest.raises(KeyboardInterrupt):
            prove(tmp_path / "set", output, ProofOptions(**options))
    assert not (output / PROOF_NAME).exists()

    with pytest.raises(UsageError, match="--resume"):
        prove(tmp_path / "set", output, ProofOptions(**options))
    kept = {}
    done = prove(
        tmp_path / "set",
        output,
        ProofOptions(**options, resume=True),
        tell=lambda step, was_kept: kept.update({step.name: was_kept}),
    )

    assert kept["light"] and kept["skin-fit"] and kept["shots"]
    assert not kept["render-truth-map"]
    first = done.path.read_bytes()
    assert prove(tmp_path / "set", output, ProofOptions(**options, resume=True)).path.exists()
    assert done.path.read_bytes() == first

    (output / "light.coefficients.exr").write_bytes(b"")
    prove(
        tmp_path / "set",
        output,
        ProofOptions(**options, resume=True),
        tell=lambda step, was_kept: kept.update({step.name: was_kept}),
    )
    assert kept["camera"] and not kept["light"]


SUN = """
def Xform "Light"
{
    def DistantLight "Sun" (
        prepend apiSchemas = ["SpectralLightAPI", "SpectralDistributionAPI:emission"]
    )
    {
        float inputs:angle = 0.53
        float inputs:intensity = 1
        uniform token inputs:spectral:source = "tabulated"
        uniform token inputs:spectral:units = "absolute"
        uniform token spectrum:emission:quantity = "irradiance"
        double[] spectrum:emission:values = [%s, %s]
        uniform double[] spectrum:emission:wavelengths = [380, 780]
    }
}
"""


def test_the_shortest_exposure_holds_the_sun_and_a_room_is_exposed_as_usual(tmp_path):
    room = write_set(tmp_path / "set", ("tubes",))
    options = ProofOptions(size=size_of("preview"))
    assert shooting_of(options, options.faults, room).setup.middle == 0.18

    (tmp_path / "sun.usda").write_text("#usda 1.0\n" + SUN % (1.3, 1.3))
    setup = shooting_of(options, options.faults, tmp_path / "sun.usda").setup
    seen = plan(tmp_path / "sun.usda", setup, [])
    (disc,) = seen.light.discs
    shortest = setup.exposures_of(0).exposure.min()
    brightest = seen.constant * shortest * disc.values[:3].max()
    assert brightest == pytest.approx(0.8, rel=0.01)


@pytest.mark.parametrize(
    ("pixels", "full_well", "read_noise"),
    [(1000, 960000.0, 12.0), (4000, 60000.0, 3.0), (6000, 60000.0, 3.0)],
)
def test_small_photographs_have_the_noise_of_a_camera_taken_together(pixels, full_well, read_noise):
    """The sum of n pixels holds n times the electrons, and their noise sqrt(n) times."""
    options = ProofOptions(size=replace(size_of("preview"), fisheye=pixels))
    shooting = shooting_of(options, options.faults)
    sensor = shooting.setup.sensor
    assert (sensor.full_well, sensor.read_noise) == (full_well, read_noise)
    words = dict(zip(shooting.camera_options, shooting.camera_options[1:], strict=False))
    assert float(words["--full-well"]) == full_well
    assert float(words["--read-noise"]) == read_noise


@pytest.mark.parametrize("flag", ["--camera", "--chart", "--light"])
def test_what_is_not_there_is_told_at_once_and_leaves_no_folder(tmp_path, capsys, flag):
    output = tmp_path / "out"
    room = Path(__file__).resolve().parents[1] / "stages" / "room_fluorescent"
    words = ["-q", "prove", str(room), "--subject", "bust", "-o", str(output), flag, "nope"]
    assert main(words) in (2, 3)
    assert "nope" in capsys.readouterr().err
    assert not output.exists()


def test_a_folder_in_which_no_step_was_done_may_be_used_again(tmp_path):
    Journal(tmp_path / "out", resume=False)
    journal = Journal(tmp_path / "out", resume=False)
    journal.step("one", "do it", "", [], lambda doing: None)
    with pytest.raises(UsageError, match="holds a proof already"):
        Journal(tmp_path / "out", resume=False)


def test_command_refuses_what_is_no_set(tmp_path, capsys):
    (tmp_path / "empty").mkdir()

    for name, says in (("empty", "no shot.usda and no set.usda"), ("nowhere", "no such folder")):
        assert main(["prove", str(tmp_path / name), "-o", str(tmp_path / "out")]) == 3
        assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_command_names_the_variants_that_there_are(tmp_path, capsys):
    light = write_set(tmp_path / "set", ("tubes",))
    words = ["prove", str(tmp_path / "set"), "-o", str(tmp_path / "out"), "--light", str(light)]

    assert main([*words, *TINY, "--subject", "horse"]) == 3
    assert "subject=horse; it has ball, missing" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_shot_whose_layers_are_missing_is_refused_before_its_light_is_solved(tmp_path, capsys):
    light = write_set(tmp_path / "set", ("tubes",))
    light.unlink()  # that of the set need not be there yet
    (tmp_path / "set" / "set.usda").write_text("#usda 1.0")

    words = ["prove", str(tmp_path / "set"), "-o", str(tmp_path / "out"), "--subject", "missing"]
    assert main(words) == 3
    said = capsys.readouterr().err
    assert "no_such_head.usda" in said
    assert said.endswith("restore the missing layer, or choose --subject ball\n")
    assert not (tmp_path / "out").exists()


def test_folder_with_something_else_is_left_alone(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")

    with pytest.raises(UsageError, match="new or empty"):
        Journal(tmp_path / "out", resume=True)


def test_damaged_journal_is_refused(tmp_path):
    (tmp_path / JOURNAL_NAME).write_text("{")

    with pytest.raises(LayerError, match="damaged"):
        Journal(tmp_path, resume=True)


def test_views_are_off_by_the_angle_that_was_asked_for():
    for error in (0.0, 1.0, 5.0):
        for true, nominal in zip(turned_views(error, 3), turned_views(0.0, 3), strict=True):
            a, b = (np.radians(view) for view in (true, nominal))
            cosine = np.sin(a[1]) * np.sin(b[1])
            cosine += np.cos(a[1]) * np.cos(b[1]) * np.cos(a[0] - b[0])
            angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
            assert angle == pytest.approx(error, abs=2e-3)


def test_bars_are_those_of_the_condition():
    row = {"name": "light", "integrator": "map", "result": {"deltaE2000": {"mean": 0.35}}}

    assert light_bar(ProofOptions(capture="ideal"), is_mixed=False) == 0.3
    assert light_bar(ProofOptions(capture="ideal"), is_mixed=True) == 0.5
    assert light_bar(ProofOptions(), is_mixed=True) == 0.4
    assert light_bar(ProofOptions(scale_error=0.03), is_mixed=False) == 0.8
    assert [bar["met"] for bar in bars_of([row], ProofOptions(capture="ideal"), True)] == [True]
    assert [bar["met"] for bar in bars_of([row], ProofOptions(capture="ideal"), False)] == [False]
    noisy = {**row, "noise": {"deltaE2000": {"mean": 0.7}}}
    assert [bar["noise"] for bar in bars_of([row, noisy], ProofOptions(), True)] == [0.0, 0.7]


def test_a_real_shoot_is_judged_by_its_charts(proved, tmp_path):
    output, _ = proved
    shoot = tmp_path / "shoot"
    shutil.copytree(output / "shoot", shoot, ignore=shutil.ignore_patterns("truth"))
    told = []
    done = prove(shoot, tmp_path / "out", tell=lambda step, _: told.append(step.name))
    proof = json.loads(done.path.read_text())
    (row,) = proof["patches"]

    assert told == ["capture", "camera", "light"]
    assert row["leaveOneOut"]["deltaE2000"]["mean"] < 5.0
    assert row["relit"]["gfc"] > 0.99
    assert len(row["patches"]) == 24
    assert proof["comparisons"] == [] and proof["bars"] == []
    assert any("true light is not known" in text for text in proof["missing"])


@pytest.mark.slow
def test_a_real_shoot_takes_captures_of_single_classes(switched, tmp_path):
    """Of a folder as a proof leaves it; one class may go without."""
    shoot, options = tmp_path / "shoot", ProofOptions(class_captures=True)
    shutil.copytree(switched[0] / "shoot", shoot, ignore=shutil.ignore_patterns("truth"))
    (shoot / "shoot_tubes.usda").unlink()
    proof = json.loads(prove(shoot, tmp_path / "out", options).path.read_text())
    steps = steps_of(proof)
    assert [*steps] == ["capture", "capture-window", "camera", "light"]
    assert "--class-capture window=captures/window/capture.usda" in steps["light"]["command"]
    assert {row["class"] for row in proof["patches"]} == {"tubes", "window"}
    (shoot / "shoot_window.usda").rename(shoot / "shoot_windows.usda")
    with pytest.raises(UsageError, match="in the light of windows, only of tubes, window"):
        prove(shoot, tmp_path / "again", options)
    (shoot / "shoot_windows.usda").unlink()
    with pytest.raises(UsageError, match=r"has no shoot_tubes\.usda and no shoot_window"):
        prove(shoot, tmp_path / "again", options)
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize(
    "given",
    ["--capture realistic", "--scale-error 0", "--tones", "--budget", "--camera x", "--check"],
)
def test_a_real_shoot_refuses_options_about_the_truth(tmp_path, capsys, given):
    """Even where they say what is the default of a set."""
    (tmp_path / "shoot.usda").write_text("#usda 1.0\n")
    option = given.split()[0]
    assert main(["prove", str(tmp_path), "-o", str(tmp_path / "out"), *given.split()]) == 2
    assert f"{option} is for sets, whose truth is known" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_shoot_without_charts_is_refused(tmp_path, capsys):
    (tmp_path / "shoot.usda").write_text("#usda 1.0\n")

    assert main(["prove", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert "no chart*.usda" in capsys.readouterr().err


def test_faults_do_what_they_are_called():
    values = np.random.default_rng(1).uniform(0.5, 1.5, (16, 32, 3))
    solid = texel_solid_angles(16, 32)[:, None, None]

    np.testing.assert_allclose((glare_of(0.1)(values) * solid).sum(), (values * solid).sum())
    np.testing.assert_allclose(rotation_of(45.0)(values), np.roll(values, 4, axis=1))
    np.testing.assert_allclose(rotation_of(3.0)(values).sum(axis=1), values.sum(axis=1))
    assert clipping_of(0.5)(values).max() == 0.5 * values.max()
    seen = vignetting_of(0.1)(np.ones((64, 128, 3)))
    assert 0.9 < seen.min() < 0.91  # below, a right angle from every view
    assert 0.999 < seen.max() <= 1.0


def test_a_report_shows_every_part_of_the_proof(proved, tmp_path, capsys):
    """Its read-out recomputes colours from the renders, and they are those that were compared."""
    output, proof = proved
    assert main(["report", str(output), "-o", str(tmp_path / "report.html")]) == 0
    text = (tmp_path / "report.html").read_text()
    told = capsys.readouterr().err

    assert "colors-not-shown" not in told
    assert "the proof holds nothing for: Tones of skin, Error budget." in told
    for row in proof["comparisons"]:
        assert f">{row['result']['deltaE2000']['mean']:.2f}<" in text
    for digest in (file["sha256"] for file in proof["files"].values()):
        assert digest in text
