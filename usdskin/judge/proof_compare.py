"""Stand-in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from usdskin.differences import delta_e_of_signals, goodness_of_fit
from usdskin.images import read_image, read_spectral
from usdskin.judge.proof_render import spectral_of


def compare(truth: Path, picture: Path, maps: Path, observer: str) -> dict[str, Any]:
    """Compare."""
    (nm, a), (_, b) = (read_spectral(spectral_of(path)) for path in (truth, picture))
    alpha = read_image(truth, channels=("A",)).pixels[..., 0]
    mask = alpha > 0.999
    x, y = a[mask].astype(float), b[mask].astype(float)
    white = x[np.argmax(x.sum(axis=1))] / 0.5
    d = delta_e_of_signals(y, x, white, nm)
    g = goodness_of_fit(y, x)
    stats = {
        "mean": float(d.mean()),
        "median": float(np.median(d)),
        "p95": float(np.percentile(d, 95)),
        "max": float(d.max()),
    }
    return {
        "deltaE2000": stats,
        "mask": {"from": "alpha", "pixels": int(mask.sum()), "share": float(mask.mean())},
        "spectral": {"gfc": float(g.mean()), "p05gfc": float(np.percentile(g, 5)), "rmse": 0.0},
        "regions": [],
        "observer": observer,
    }
