"""What a proof is told: the faults of the capture, the sizes, the estimator."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from usdskin.errors import UsageError

CaptureFaults = Literal["ideal", "realistic"]
Integrator = Literal["map", "traced"]

PROOF_CAMERA = "Sigma SDMerill (NPL)"
"""The measured camera of proofs: no estimator or prior was made or tuned with it."""


@dataclass(frozen=True, slots=True)
class ProofSize:
    """How much is computed."""

    solve_height: int
    """Rows of the true light."""

    fisheye: int
    """Pixels of the fisheye pictures' width."""

    exposures: int
    """Photographs in a bracket."""

    width: int
    """Pixels of the renders' width."""

    samples: int
    """Samples per pixel of traced renders."""

    @property
    def stops(self) -> float:
        """Stops between exposures, so that every bracket spans sixteen."""
        return 16.0 / (self.exposures - 1)


SIZES = {
    "tiny": ProofSize(solve_height=64, fisheye=256, exposures=5, width=32, samples=16),
    "preview": ProofSize(solve_height=128, fisheye=1000, exposures=9, width=128, samples=256),
    "full": ProofSize(solve_height=256, fisheye=1200, exposures=9, width=384, samples=256),
}


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong on the way from light to camera values."""

    glare: float = 0.0
    """Share of light that the lens spreads and nobody states [1]."""

    vignetting: float = 0.0
    """Error of the stated vignetting at the edge, relative [1]."""

    rotation_deg: float = 0.0
    """Angle between where the camera looks and where it is said to look [deg]."""

    noise: bool = True
    """Whether the sensor has noise."""

    clipping: float = 1.0
    """Radiance at which the shortest exposure saturates, over the brightest there is; 1 or more
    clips nothing."""


REALISTIC = Faults(glare=0.01, vignetting=0.02, rotation_deg=1.0)
"""DESIGN section 7: what the bars are for."""


@dataclass(frozen=True, slots=True)
class ProofOptions:
    """What is proved, and how."""

    capture: CaptureFaults = "realistic"
    """``ideal``: camera values of the true panorama itself; ``realistic``: photographs with the
    faults of real ones."""

    scale_error: float = 0.0
    """Error that all readings of light share, relative [1]."""

    class_captures: bool = False
    """Whether the place is captured in the light of each class alone too, where there are some."""

    estimator: str = "regression"
    """Of the calibration; see ``usdskin.estimate.recovery.ESTIMATORS``."""

    integrators: tuple[Integrator, ...] = ("map", "traced")
    """How pictures are rendered."""

    size: ProofSize = field(default_factory=lambda: SIZES["preview"])
    """How much is computed."""

    subject: str | None = None
    """Variant of the shot's subject; None: the shot's own."""

    tone: str | None = None
    """Variant of the shot's skin; None: the shot's own."""

    tones: bool = False
    """Whether all the tones of the shot's skin are compared too."""

    budget: bool = False
    """Whether single faults are judged too."""

    lustre: bool = False
    """Whether the true skin keeps its lustre, which is then measured without polarisers."""

    light: Path | None = None
    """Light that was solved before, with its classes beside it; None: solved from the set."""

    camera: str = PROOF_CAMERA
    """Measured camera; see ``read_sensitivity``."""

    chart: str = "classic24"
    """Color chart; see ``read_chart``."""

    observer: str = "cie1931_2"
    """Whose color-matching functions judge."""

    seed: int = 0
    """Of everything random."""

    resume: bool = False
    """Whether steps that are done and unchanged are kept."""

    device: str = "auto"
    """``auto``, ``cpu`` or ``cuda:N``."""

    threads: int | None = None
    """CPU threads; all cores when None."""

    @property
    def faults(self) -> Faults:
        """The faults of the capture."""
        return REALISTIC if self.capture == "realistic" else Faults(noise=False)

    def check(self) -> None:
        """Refuse what cannot be proved.

        Raises:
            UsageError: A value is out of range; the message names it.
        """
        if not -0.5 < self.scale_error < 1.0:
            raise UsageError(f"--scale-error {self.scale_error:g}: give a share such as 0.03")
        least = {"solve_height": 8, "fisheye": 64, "exposures": 2, "width": 8, "samples": 1}
        for name, value in least.items():
            if getattr(self.size, name) < value:
                raise UsageError(f"{name.replace('_', ' ')}: give {value} at least")

    def as_json(self) -> dict[str, Any]:
        """Return what ``proof.json`` says of them."""
        return {
            "capture": self.capture,
            "scaleError": self.scale_error,
            "classCaptures": self.class_captures,
            "estimator": self.estimator,
            "integrators": list(self.integrators),
            "subject": self.subject,
            "tone": self.tone,
            "lustre": self.lustre,
            "camera": self.camera,
            "chart": self.chart,
            "observer": self.observer,
            "seed": self.seed,
            "solveHeight": self.size.solve_height,
            "fisheye": self.size.fisheye,
            "exposures": self.size.exposures,
            "width": self.size.width,
            "samples": self.size.samples,
            "glare": self.faults.glare,
            "vignettingError": self.faults.vignetting,
            "rotationError": self.faults.rotation_deg,
            "sensorNoise": self.faults.noise,
        }


def size_of(name: str, **numbers: int | None) -> ProofSize:
    """Return a named size with some of its numbers changed.

    Args:
        name: A key of ``SIZES``.
        **numbers: Fields of ``ProofSize``; None leaves one.
    """
    given = {field: value for field, value in numbers.items() if value is not None}
    return replace(SIZES[name], **given)
