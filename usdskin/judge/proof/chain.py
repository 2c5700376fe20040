"""From the truth to the estimates: the steps that users run, on photographs of the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from usdskin.capture.step import CaptureOptions, capture_shoot
from usdskin.estimate.camera.step import CalibrationOptions, calibrate_camera
from usdskin.estimate.light.step import estimate_light
from usdskin.estimate.skin.step import estimate_skin
from usdskin.judge.proof.fit import fit_options, goniometer_setup
from usdskin.judge.proof.ideal import expose_exactly, measure_exactly
from usdskin.judge.proof.light import (
    adopt_light,
    classes_beside,
    estimate_options,
    light_files,
    solve_light,
    true_light,
)
from usdskin.judge.proof.record import Doing
from usdskin.judge.proof.shoot import (
    Shooting,
    chart_seed,
    class_seed,
    ingest_options,
    ingest_photographs,
    shooting_of,
    take_chart,
    take_photographs,
)
from usdskin.judge.proof.shots import subject_and_tone, write_base
from usdskin.judge.proof.skin import even_skin, write_true_skin
from usdskin.judge.proof.spectra import read_material
from usdskin.judge.proof.steps import Steps
from usdskin.judge.skin.goniometer import read_goniometer
from usdskin.layers import open_stage, used_files


class Chain(Steps):
    """The truth, the shoot and the estimates: methods in the order they are done."""

    # --- The truth ----------------------------------------------------------------------------

    def _true_light(self) -> None:
        place, given = self.place, self.options.light
        height = self.options.size.solve_height
        if given is not None:
            layers = [given, *classes_beside(given).values()]
            record = self._step(
                "solve",
                "take the light that was solved before",
                "",
                [file for layer in layers for file in light_files(layer)],
                lambda doing: adopt_light(given, place, doing),
                clears=[place["truth"]],
            )
        else:
            record = self._step(
                "solve",
                "solve the true light of the set",
                place.command(
                    "solve", self.set_layer, "-o", place.truth_light, "--height", str(height)
                ),
                used_files(open_stage(self.set_layer)),
                lambda doing: solve_light(self.set_layer, place, height, self.progress, doing),
                clears=[place["truth"]],
            )
        self.truth = true_light(place, record.facts["classes"])

    def _base_shot(self) -> None:
        variants = subject_and_tone(self.options.subject, self.options.tone)
        self._step(
            "shot",
            "take the shot of the set",
            "",
            [self.shot, self.truth.light],
            lambda doing: doing.writes.append(
                write_base(self.shot, self.truth.light, variants, self.base)
            ),
            {f"{path}{{{name}}}": chosen for (path, name), chosen in variants.items()},
        )

    def _true_skin(self) -> None:
        lustre, place = self.options.lustre, self.place

        def run(doing: Doing) -> None:
            skin = even_skin(self.base, lustre)
            doing.writes.append(write_true_skin(skin, self.base, place.truth_skin))

        self._step(
            "skin",
            "take the skin of the shot, the same everywhere",
            "",
            used_files(open_stage(self.base)),
            run,
            {"lustre": lustre},
        )

    # --- The shoot ----------------------------------------------------------------------------

    def _alone(self) -> dict[str, Path]:
        """Return the lights that the place is captured in beside the whole one, by class."""
        is_asked = self.options.class_captures and len(self.truth.classes) > 1
        return self.truth.classes if is_asked else {}

    def _photograph(self) -> None:
        shooting = shooting_of(self.options, self.options.faults, self.truth.light)
        self._photograph_place("", self.truth.light, shooting)
        for name, layer in self.truth.classes.items():
            self._photograph_chart(name, layer, shooting)
        for name, layer in self._alone().items():
            self._photograph_place(name, layer, shooting)

    def _photograph_chart(self, name: str, layer: Path, shooting: Shooting) -> None:
        place, options = self.place, self.options
        words: list[Any] = ["-o", place.chart(name).parent, "--camera", options.camera]
        words += ["--same-camera", place.room(), "--chart", options.chart, "--chart-only"]
        words += ["--light-class", name, "--exposures", str(options.size.exposures)]
        words += ["--stops", options.size.stops, "--stated-glare", "0"]
        words += ["--vignetting-error", options.faults.vignetting]
        words += ["--reading-error", options.scale_error]
        words += ["--seed", str(chart_seed(options.seed, name))]
        self._step(
            f"chart-{name}",
            f"photograph and measure a chart in the light of {name}",
            place.command("photograph", layer, *words),
            [*light_files(layer), place.room() / "truth" / "truth.usda"],
            lambda doing: take_chart(
                layer, name, place, shooting, options.chart, options.threads, self.progress, doing
            ),
            clears=[place.chart(name).parent],
        )

    def _photograph_place(self, name: str, light: Path, shooting: Shooting) -> None:
        """Photograph and capture the place in the whole light, or in that of a class alone."""
        place, options, progress = self.place, self.options, self.progress
        room, shoot, capture = place.room(name), place.shoot(name), place.capture(name)
        suffix, where = (f"-{name}", f" in the light of {name} alone") if name else ("", "")
        words: list[Any] = ["-o", room, *shooting.options]
        reads = light_files(light)
        if name:
            words += ["--same-camera", place.room(), "--seed"]
            words.append(str(class_seed(options.seed, name)))
            reads.append(place.room() / "truth" / "truth.usda")
        else:
            words += [*shooting.camera_options, "--seed", str(options.seed)]
        self._step(
            f"photograph{suffix}",
            f"photograph the place{where}",
            place.command("photograph", light, *words),
            reads,
            lambda doing: take_photographs(
                light, name, place, shooting, options.threads, progress, doing
            ),
            clears=[room],
        )
        told, words = ingest_options(place, name, shooting)
        photographs = [path for path in sorted(room.glob("view*/*")) if path.is_file()]
        self._step(
            f"ingest{suffix}",
            f"describe the photographs{where} as a shoot",
            place.command("ingest", room, "-o", shoot, *words),
            [*photographs, place["shoot/lens.usda"]],
            lambda doing: ingest_photographs(place, name, told, progress, doing),
        )
        self._step(
            f"capture{suffix}",
            f"merge the photographs{where} to a panorama",
            place.command("capture", shoot, "-o", capture, "--refine-rotations"),
            [shoot, place["shoot/lens.usda"], *photographs],
            lambda doing: self._capture(shoot, capture, doing),
        )

    def _capture(self, shoot: Path, capture: Path, doing: Doing) -> None:
        given = CaptureOptions(
            refine_rotations=True, device=self.options.device, threads=self.options.threads
        )
        result = capture_shoot(shoot, capture, given, self.progress)
        doing.writes += result.paths
        doing.notes += result.notes
        doing.facts.update(result.report.as_dict())

    def _expose_exactly(self) -> None:
        place, options, progress = self.place, self.options, self.progress
        setup = shooting_of(options, options.faults).setup
        settings = {
            "camera": options.camera,
            "height": options.size.solve_height,
            "scaleError": options.scale_error,
            "chart": options.chart,
        }
        light = self.truth.light
        exposed = self._step(
            "capture",
            "take the camera values of the true panorama",
            "",
            light_files(light),
            lambda doing: _ignore(
                expose_exactly(light, place.capture(), setup, options.threads, progress, doing)
            ),
            settings,
        )
        constant = exposed.facts["sensorConstant"]
        same = replace(setup, sensor_constant=constant)
        for name, layer in self._alone().items():
            self._step(
                f"capture-{name}",
                f"take the camera values of the true panorama in the light of {name} alone",
                "",
                light_files(layer),
                lambda doing, name=name, layer=layer: _ignore(  # type: ignore[misc]
                    expose_exactly(
                        layer, place.capture(name), same, options.threads, progress, doing
                    )
                ),
                {**settings, "constant": constant},
            )
        for name, layer in self.truth.classes.items():
            self._step(
                f"chart-{name}",
                f"take the camera values and the radiance of a chart in the light of {name}",
                "",
                light_files(layer),
                lambda doing, name=name, layer=layer: measure_exactly(  # type: ignore[misc]
                    layer,
                    place.chart(name),
                    setup,
                    constant,
                    name,
                    options.chart,
                    options.threads,
                    progress,
                    doing,
                ),
                {**settings, "constant": constant},
            )

    # --- The estimates ------------------------------------------------------------------------

    def _calibrate(self) -> None:
        place, options = self.place, self.options
        charts = [place.chart(name) for name in self.truth.classes]
        output = place["camera.usda"]

        def run(doing: Doing) -> None:
            given = CalibrationOptions(
                estimator=options.estimator, device=options.device, threads=options.threads
            )
            result = calibrate_camera(charts, output, given, self.progress)
            doing.writes.append(result.path)
            doing.notes += result.notes
            doing.facts["recoveries"] = [
                {
                    "class": recovery.light_class,
                    "condition": recovery.condition,
                    "identityError": recovery.identity_error,
                    "looGfc": recovery.loo_gfc,
                    "looDeltaE2000": recovery.loo_delta_e_2000,
                }
                for recovery in result.camera.recoveries
            ]

        pictures = [file for chart in charts for file in sorted(chart.parent.glob("chart/*"))]
        self._step(
            "camera",
            "calibrate the camera against the charts",
            place.command(
                "calibrate", "camera", *charts, "-o", output, "--estimator", options.estimator
            ),
            [*charts, *pictures],
            run,
        )

    def _estimate_light(self) -> None:
        place = self.place
        capture, camera, output = place.capture(), place["camera.usda"], place["light.usda"]
        given, words, reads = estimate_options(place, self._alone())

        def run(doing: Doing) -> None:
            result = estimate_light(capture, camera, output, given, self.progress)
            doing.writes += result.paths
            doing.notes += result.notes

        self._step(
            "light",
            "estimate the light",
            place.command("estimate", "light", capture, "--camera", camera, "-o", output, *words),
            [*reads, camera],
            run,
        )

    def _measure_skin(self) -> None:
        place, options = self.place, self.options
        samples, output = place["samples.usda"], place["skin.usda"]
        setup = goniometer_setup(options)
        words = ["--polarisers", setup.polarisers, "--seed", str(options.seed)]
        self._step(
            "goniometer",
            "measure the skin with a goniometer",
            place.command("goniometer", place.truth_skin, "-o", samples, *words),
            [place.truth_skin],
            lambda doing: doing.writes.append(read_goniometer(place.truth_skin, samples, setup)),
        )
        given = fit_options(read_material(place.truth_skin)[0], options)

        def run(doing: Doing) -> None:
            result = estimate_skin(samples, output, given, self.progress)
            doing.writes.append(result.path)
            doing.notes += result.notes

        words = ["--specular", given.specular, "--opacity", given.opacity]
        self._step(
            "skin-fit",
            "estimate the skin",
            place.command("estimate", "skin", samples, "-o", output, *words),
            [samples],
            run,
        )


def _ignore(_value: object) -> None:
    """Take a value that nobody asked for."""
