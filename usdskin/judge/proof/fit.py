"""How a proof measures and fits its skin."""

from __future__ import annotations

from usdskin.estimate.skin.step import SkinOptions
from usdskin.judge.proof.options import ProofOptions
from usdskin.judge.skin.goniometer import GoniometerSetup, has_opacity
from usdskin.prims.skin import SkinParameters


def goniometer_setup(options: ProofOptions) -> GoniometerSetup:
    """Return how the skin is measured: without polarisers where its lustre is to be found."""
    return GoniometerSetup(polarisers="none" if options.lustre else "crossed", seed=options.seed)


def fit_options(skin: SkinParameters, options: ProofOptions) -> SkinOptions:
    """Return how the skin is fitted: the operator knows polarisers and sheets, not the skin.

    Args:
        skin: The skin; only whether sheets of it were measured counts.
        options: What the proof is told.
    """
    return SkinOptions(
        specular="fit" if options.lustre else "ignore",
        opacity="fit" if has_opacity(skin) else "none",
        device=options.device,
        threads=options.threads,
    )
