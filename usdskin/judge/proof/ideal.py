"""Camera values without a camera's faults: what recovery alone is judged by.

The panorama holds exactly what the camera's three channels respond to the true light, texel by
texel; the chart holds exactly what they respond to its patches, and the patches' true radiance. No
lens, no glare, no noise, no clipping, no rotation.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from usdskin.device import Workers
from usdskin.images import Part, write_exr
from usdskin.judge.proof.record import Doing
from usdskin.judge.shoot.charts import ChartSetup, photograph_chart, read_chart_truth
from usdskin.judge.shoot.environments import panorama
from usdskin.judge.shoot.photographer import plan
from usdskin.judge.shoot.setups import Setup, fisheye
from usdskin.judge.shoot.shoot_layers import new_stage
from usdskin.layers import record_provenance, write_layer
from usdskin.prims import write_color_chart
from usdskin.prims.writing import write_schema
from usdskin.progress import Progress

# isort: split
# After ours, which register the schemas.
from pxr import UsdGeom

_CHART_PICTURE = 400
"""Pixels of a picture that only says whether the chart fits into it."""


def expose_exactly(
    light: Path, capture: Path, setup: Setup, threads: int | None, progress: Progress, doing: Doing
) -> float:
    """Write a capture whose panorama is the true light as the camera responds to it.

    Args:
        light: The true light.
        capture: Layer to write; ``panorama.exr`` comes to lie beside it.
        setup: Its camera, exposures and height count.
        threads: CPU threads.
        progress: Told how far it is.
        doing: Takes files and notes.

    Returns:
        The camera's constant, c of rho = c integral L s dlambda, for its charts.
    """
    shooting = plan(light, setup, doing.notes)
    rows = setup.truth_height or shooting.light.rows
    progress.start(rows, "panorama")
    seen = panorama(
        shooting.light, rows, Workers("cpu", threads or os.cpu_count() or 1), progress.advance
    )
    progress.done()
    values = (seen[..., :3] * shooting.constant).astype(np.float32)
    capture.parent.mkdir(parents=True, exist_ok=True)
    picture = capture.with_name("panorama.exr")
    channels = {name: values[..., index] for index, name in enumerate("RGB")}
    write_exr(picture, [Part("", channels, {}, "float", "unknown")])
    stage = new_stage(shooting.light.up_axis)
    root = UsdGeom.Xform.Define(stage, "/Capture").GetPrim()
    stage.SetDefaultPrim(root)
    write_schema(
        root,
        "CaptureAPI",
        {
            "capture:panorama:file": Path(picture.name),
            "capture:scale": 1.0,
            "capture:units": "relative",
            "capture:coverage": 1.0,
            "capture:clippedShare": 0.0,
            "capture:device": "virtual camera without faults",
            "capture:settings:model": shooting.camera,
            "capture:settings:lens": setup.lens_name,
            "capture:settings:whiteBalance": "",
            "capture:settings:iso": np.unique(setup.exposures_of(0).iso),
        },
    )
    record_provenance(stage, "photograph", [], {"camera": setup.camera}, capture.parent)
    write_layer(stage, capture)
    doing.writes += [capture, picture]
    doing.facts["sensorConstant"] = shooting.constant
    return shooting.constant


def measure_exactly(
    light: Path,
    output: Path,
    setup: Setup,
    constant: float,
    light_class: str,
    chart: str,
    threads: int | None,
    progress: Progress,
    doing: Doing,
) -> None:
    """Write a chart with its true camera values and radiance, but for the readings' scale.

    Args:
        light: The true light of the class.
        output: Layer to write.
        setup: Its camera and the error of the readings count.
        constant: c of rho = c integral L s dlambda.
        light_class: Name of the class.
        chart: Which chart.
        threads: CPU threads.
        progress: Told how far it is.
        doing: Takes files and notes.
    """
    output.parent.mkdir(parents=True, exist_ok=True)
    exact = replace(setup, lens=fisheye(_CHART_PICTURE), sensor_constant=constant)
    scratch = Path(tempfile.mkdtemp(prefix=".chart.", dir=output.parent))
    try:
        photograph_chart(
            light,
            scratch / "chart",
            exact,
            ChartSetup(chart=chart, light_class=light_class),
            threads=threads,
            progress=progress,
            notes=doing.notes,
        )
        truth = read_chart_truth(scratch / "chart")
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    factor = 1.0 + setup.reading_error
    known, lamp = truth.chart, truth.chart.illuminant
    stated = replace(
        known,
        where="",
        corners=None,
        view=None,
        lens=setup.lens_name,
        reflectances=None,
        signals=factor * truth.signals,
        illuminant=None if lamp is None else replace(lamp, value=factor * lamp.value),
    )
    stage = new_stage("Y")
    prim = UsdGeom.Scope.Define(stage, "/Chart").GetPrim()
    stage.SetDefaultPrim(prim)
    write_color_chart(prim, stated, output.parent)
    record_provenance(stage, "photograph", [], {"camera": setup.camera}, output.parent)
    write_layer(stage, output)
    doing.writes.append(output)
