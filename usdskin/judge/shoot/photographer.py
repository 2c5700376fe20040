"""A virtual photographer: the brackets and the layer that a real shoot would give, and the truth.

    photograph(environment, output, setup=Setup(), threads=None, progress=..., notes=...) -> Path

``environment`` is a stage with lights or a latlong picture, ``output`` a folder that is new or
empty, ``setup`` a ``Setup`` (camera, lens, views, exposures, sensor, errors, file kind, seed).
``read_truth(output)`` of ``usdskin.judge.shoot.shoot_layers`` gives back what was there.

Reads:  a stage with dome and distant lights, or a latlong picture.
Writes: ``shoot.usda`` with a folder of photographs per view, and ``truth/``: ``truth.exr``, the
        true camera values rho of the whole sphere in the panorama's frame, and ``truth.usda``, the
        true lens and rotations and what else the camera is not told.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.device import Workers
from usdskin.errors import LayerError, UsageError
from usdskin.judge.shoot.environments import panorama, read_environment
from usdskin.judge.shoot.optics import Picture, pixel_angles
from usdskin.judge.shoot.photo_files import ROWS_PER_BLOCK, write_photograph
from usdskin.judge.shoot.sensitivity import read_sensitivity
from usdskin.judge.shoot.setups import Setup, exif, fisheye, photograph_name, view_name
from usdskin.judge.shoot.shoot_layers import Shooting, write_shoot, write_truth
from usdskin.judge.shoot.viewpoints import misread, rotation_of
from usdskin.notes import Note
from usdskin.prims import FisheyeLens
from usdskin.progress import Progress, SilentProgress
from usdskin.replacing import check_place

__all__ = ["Setup", "fisheye", "photograph"]

_LEAST_TRUTH_ROWS = 256

FloatImage = NDArray[np.float32]


def photograph(
    environment: str | Path,
    output: str | Path,
    setup: Setup | None = None,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    notes: list[Note] | None = None,
) -> Path:
    """Photograph an environment.

    Args:
        environment: A stage with dome or distant lights, or a latlong picture.
        output: Folder to write, new or empty.
        setup: How it is photographed.
        threads: Threads to compute with; all cores where None. They change nothing but the time.
        progress: Told how far the work is.
        notes: Takes what could not be honoured.

    Returns:
        ``shoot.usda`` in the folder. The folder is complete or not there.

    Raises:
        LayerError: The stage cannot be read, or the folder cannot be written.
        ImageError: A picture cannot be read or written.
        UsageError: The set-up makes no sense, or the folder holds something.
    """
    setup = setup or Setup()
    setup.check()
    output, environment = Path(output), Path(environment)
    progress = progress or SilentProgress()
    workers = Workers("cpu", threads or os.cpu_count() or 1)
    with new_folder(output) as folder:
        try:
            shooting = plan(environment, setup, [] if notes is None else notes)
            shoot(shooting, setup, folder, output, workers, progress)
        finally:
            progress.done()
    return output / "shoot.usda"


@contextmanager
def new_folder(output: Path) -> Iterator[Path]:
    """Give a folder that takes the name of ``output`` when the block ends well."""
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        raise UsageError(f"{output}: is there already; name a folder that is new or empty")
    check_place(output)
    made: Path | None = None
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{output.name}.", dir=output.parent))
        yield made
        made.chmod(0o755)
        os.replace(made, output)
    except OSError as error:
        raise LayerError(f"{output}: cannot be made ({error.strerror}); choose another") from None
    finally:
        if made is not None:
            shutil.rmtree(made, ignore_errors=True)


def plan(environment: Path, setup: Setup, notes: list[Note]) -> Shooting:
    """Return the light of an environment, and how the camera stands in it.

    Raises:
        LayerError: The stage cannot be read.
        ImageError: A picture cannot be read.
        UsageError: There is no such camera or illuminant.
    """
    camera = read_sensitivity(setup.camera)
    light = read_environment(
        environment, camera, setup.illuminant, setup.mean_luminance, setup.bad_pixels, notes
    )
    exposure = setup.exposures_of(0).exposure
    middle = float(light.mean()[1]) * exposure[exposure.size // 2]
    rotations = tuple(rotation_of(view, light.panorama_from_world) for view in setup.views)
    return Shooting(
        environment=environment,
        light=light,
        camera=camera.name,
        constant=setup.sensor_constant or setup.middle / middle,
        names=tuple(view_name(index) for index in range(len(rotations))),
        rotations=rotations,
        stated_rotations=misread(rotations, setup.rotation_error_deg, setup.seed),
    )


def shoot(
    shooting: Shooting,
    setup: Setup,
    folder: Path,
    final: Path,
    workers: Workers,
    progress: Progress,
) -> None:
    """Write the views of a shoot, its layer and the truth about it.

    Args:
        shooting: What is photographed, as ``plan`` gives it.
        setup: How.
        folder: Folder to write to.
        final: Where the folder is going to lie in the end.
        workers: Threads to compute with.
        progress: Told how far the work is.
    """
    _photograph_views(shooting, setup, folder, workers, progress)
    rows = setup.truth_height or max(shooting.light.rows, _LEAST_TRUTH_ROWS)
    progress.start(rows, "truth")
    seen = panorama(shooting.light, rows, workers, progress.advance)
    values = seen[..., :3] * shooting.constant
    write_truth(folder / "truth", shooting, setup, values, final / "truth")
    write_shoot(folder / "shoot.usda", shooting, setup, final)


def _photograph_views(
    shooting: Shooting, setup: Setup, folder: Path, workers: Workers, progress: Progress
) -> None:
    for view, name in enumerate(shooting.names):
        (folder / name).mkdir()
        progress.start(setup.lens.resolution[1], f"{name}: light")
        picture = Picture(shooting.light, setup.lens, shooting.rotations[view])
        image = picture.draw(workers, progress.advance)
        image *= np.float32(shooting.constant)
        add_glare(image, setup.lens)

        def take(begin: int, end: int, view: int = view, image: FloatImage = image) -> None:
            for shot in range(begin, end):
                path = folder / photograph_name(setup, view, shot)
                take_photograph(image, setup, path, shooting.camera, view, shot)

        count = setup.exposures_of(view).time_s.size
        progress.start(count, f"{name}: photographs")
        workers.run(count, 1, take, progress.advance)


def add_glare(image: FloatImage, lens: FisheyeLens) -> None:
    """Spread the lens's glare over a picture, in place: (1 - g) I + g mean(I).

    The mean goes over the pixels up to the largest angle; what lies beyond is veiled too.

    Args:
        image: I = rho V, shape [height, width, 3].
        lens: Whose glare.
    """
    if lens.glare == 0.0:
        return
    total, count = np.zeros(3), 0
    for begin in range(0, image.shape[0], ROWS_PER_BLOCK):
        block = image[begin : begin + ROWS_PER_BLOCK]
        angle = pixel_angles(lens, begin, begin + block.shape[0])
        held = angle <= np.radians(lens.max_angle_deg)  # NaN is not
        total += block[held].sum(axis=0, dtype=np.float64)
        count += int(held.sum())
    image *= np.float32(1.0 - lens.glare)
    image += (lens.glare * total / max(count, 1)).astype(np.float32)


def take_photograph(
    image: FloatImage, setup: Setup, path: Path, camera: str, view: int, shot: int
) -> None:
    """Write one photograph of a view; its noise depends on seed, view, shot and row alone.

    Args:
        image: rho V with glare, shape [height, width, 3].
        setup: How it is taken.
        path: File to write.
        camera: Make and model.
        view: Index of the view.
        shot: Index of the photograph in its bracket.
    """
    exposure = np.float32(setup.true_exposure(view)[shot])
    iso = float(setup.exposures_of(view).iso[shot])

    def rows(begin: int, end: int) -> NDArray[np.uint16]:
        random = np.random.default_rng([setup.seed, view, shot, begin])
        return setup.sensor.expose(image[begin:end] * exposure, iso, random)

    size = (image.shape[1], image.shape[0])
    write_photograph(path, size, rows, setup.development, exif(setup, camera, view, shot))
