"""From camera values to spectra: the generalised inverses, and how good they are.

``without_stray_light`` frees a chart of glare, ``estimate_responsivity`` tells what the camera
sees, ``recover`` how its values become spectra in one class of light, by one of these estimators:

``regression``  the chart is the prior: ridge regression of spectra on camera values (default)
``literal``     the paper as printed, two pseudo-inverses: a baseline that noise ruins
``tsvd``        the paper with a truncated singular value decomposition
``pca``         three principal components of the chart's signals
``wiener``      the most probable spectrum; also says how sure it is
``smooth``      the smoothest reflectance in the known light; needs t and no chart

All are linear, so light of one class has three dimensions. All choose their weights by leaving out
each patch in turn.
"""

from usdskin.estimate.recovery.recover import ESTIMATORS, recover
from usdskin.estimate.recovery.responsivity import (
    Responsivity,
    estimate_responsivity,
    in_one_unit,
)
from usdskin.estimate.recovery.stray import without_stray_light
from usdskin.estimate.recovery.training import Training

__all__ = [
    "ESTIMATORS",
    "Responsivity",
    "Training",
    "estimate_responsivity",
    "in_one_unit",
    "recover",
    "without_stray_light",
]
