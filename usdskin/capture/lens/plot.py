"""Draw what a calibration left over: in the picture, over the angle, and per photograph."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.lens.fit import Calibration
from usdskin.errors import UsdSkinError
from usdskin.fisheye import angle_to_radius
from usdskin.images import replacing
from usdskin.prims.lenses import FisheyeLens

FloatArray = NDArray[np.float64]

_BIN_DEG = 10.0
_ARROW_SHARE = 0.05
_INK, _FAINT, _ACCENT = "#222222", "#9a9a9a", "#b3261e"


def write_plot(calibration: Calibration, lens: FisheyeLens, path: Path) -> Path:
    """Write a picture of a calibration's residuals.

    Args:
        calibration: What was fitted.
        lens: The lens it became.
        path: PNG to write.

    Returns:
        ``path``, once it is complete on disk.

    Raises:
        UsdSkinError: matplotlib is not installed.
        ImageError: The file cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise UsdSkinError(
            f"{path}: plots need matplotlib; pip install 'usdskin[plot]', or leave --plot out"
        ) from None
    # A figure of its own: pyplot would keep it, and look for a display.
    figure = Figure(figsize=(12.0, 7.0), dpi=110, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    width, height = lens.resolution
    grid = figure.add_gridspec(2, 2, width_ratios=[1.35 * max(width / height, 1.0), 1.25])
    _draw_field(figure.add_subplot(grid[:, 0]), calibration, lens)
    _draw_radial(figure.add_subplot(grid[0, 1]), calibration)
    _draw_views(figure.add_subplot(grid[1, 1]), calibration)
    f, (cx, cy) = lens.focal_length_px, lens.center_px
    figure.suptitle(
        f"rms {calibration.rms_px:.3f} px from {calibration.corner_count} corners in "
        f"{len(calibration.views)} photographs;  f {f:.2f} px, center ({cx:.2f}, {cy:.2f}) px;  "
        f"directions known to {calibration.direction_sigma_deg(calibration.covered_deg):.2g} deg "
        f"at {calibration.covered_deg:.1f} deg",
        fontsize=11,
        color=_INK,
    )
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})
    return path


def _draw_field(axes: Any, calibration: Calibration, lens: FisheyeLens) -> None:
    """Draw the residual of every corner where it is in the picture."""
    pixels = np.concatenate([view.pixel for view in calibration.views])
    residuals = np.concatenate(calibration.solution.residuals_px)
    width, height = lens.resolution
    longest = max(float(np.percentile(np.linalg.norm(residuals, axis=1), 95.0)), 1e-9)
    apart = np.sqrt(np.ptp(pixels[:, 0]) * np.ptp(pixels[:, 1]) / len(pixels))
    gain = _round_down(min(_ARROW_SHARE * width, 2.0 * apart) / longest)
    arrows = axes.quiver(
        *pixels.T,
        *residuals.T,
        np.linalg.norm(residuals, axis=1),
        angles="xy",
        scale_units="xy",
        scale=1.0 / gain,
        cmap="viridis_r",
        width=0.0022,
        clim=(0.0, longest),
    )
    axes.figure.colorbar(
        arrows, ax=axes, location="bottom", shrink=0.6, pad=0.02, label="residual [px]"
    )
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    rings = [(angle, _FAINT) for angle in range(15, 181, 15) if angle < lens.max_angle_deg - 4.0]
    for angle, color in [*rings, (lens.max_angle_deg, _ACCENT)]:
        radius = float(angle_to_radius(lens, np.deg2rad(angle)))
        x = lens.center_px[0] + radius * np.cos(turn)
        y = lens.center_px[1] + radius * np.sin(turn)
        axes.plot(x, y, color=color, linewidth=0.8, zorder=0)
        label = lens.center_px + radius * np.array([np.cos(0.3), np.sin(0.3)])
        if (label > 0.0).all() and (label < [width, height]).all():
            box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
            where = {"ha": "center", "va": "center", "zorder": 9}
            axes.text(*label, f"{angle:.3g}°", color=color, fontsize=8, bbox=box, **where)
    axes.plot(*lens.center_px, "+", color=_ACCENT, markersize=10)
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
    axes.set_title(f"projected minus found corner, {gain:g} times enlarged", fontsize=10)


def _draw_radial(axes: Any, calibration: Calibration) -> None:
    """Draw the part of the residuals that points outward: a bend in it is the model's."""
    center = calibration.solution.center_px
    angles = np.rad2deg(np.concatenate(calibration.solution.angles_rad))
    outward = np.concatenate([view.pixel for view in calibration.views]) - center
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    radial = np.sum(outward * np.concatenate(calibration.solution.residuals_px), axis=1)
    axes.plot(angles, radial, ".", color=_FAINT, markersize=3)
    edges = np.arange(0.0, angles.max() + _BIN_DEG, _BIN_DEG)
    for low, high in itertools.pairwise(edges):
        inside = radial[(angles >= low) & (angles < high)]
        if len(inside) >= 3:
            mean, error = inside.mean(), inside.std(ddof=1) / np.sqrt(len(inside))
            axes.errorbar(0.5 * (low + high), mean, 2.0 * error, color=_ACCENT, marker="o",
                          markersize=4, capsize=3, linewidth=1.2)  # fmt: skip
    axes.axhline(0.0, color=_INK, linewidth=0.8, zorder=0)
    axes.set(xlabel="angle from the axis [deg]", ylabel="outward residual [px]")
    axes.set_title("bias of the image height: means over 10 deg, 2 s.e.", fontsize=10)


def _draw_views(axes: Any, calibration: Calibration) -> None:
    names = [view.path.stem for view in calibration.views]
    order = np.arange(len(names))
    axes.bar(order, calibration.view_rms_px, color="#5b7c99", width=0.75)
    axes.axhline(calibration.rms_px, color=_INK, linewidth=0.8)
    shown = order[:: max(1, len(names) // 25)]
    axes.set_xticks(shown, [names[index][-14:] for index in shown], rotation=90, fontsize=7)
    axes.set(ylabel="rms residual [px]", xlim=(-0.6, len(names) - 0.4))
    rejected = ", ".join(view.path.name for view in calibration.rejected)
    axes.set_title(
        "per photograph" + (f"; left out: {rejected}" if rejected else ""), fontsize=10, wrap=True
    )


def _round_down(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value) * power)
