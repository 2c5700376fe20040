"""How far a picture of a proof is from the true one: the skin alone is judged."""

from __future__ import annotations

from pathlib import Path

from usdskin.judge.comparison.compare import CompareOptions, compare_pictures
from usdskin.judge.comparison.maps import write_maps
from usdskin.judge.proof.place import Place
from usdskin.judge.proof.record import Doing
from usdskin.judge.proof.skin import SHOT_SKIN


def compare_render(truth: Path, picture: Path, maps: Path, observer: str, place: Place) -> Doing:
    """Compare a picture with the truth where it shows skin.

    Args:
        truth: Picture of the true light and skin.
        picture: Picture of the estimates.
        maps: EXR to write; a PNG comes to lie beside it.
        observer: Whose color-matching functions.
        place: The proof's folder, which paths are told from.
    """
    options = CompareOptions(select=(SHOT_SKIN,), observer=observer)  # type: ignore[arg-type]
    found = compare_pictures(truth, picture, options)
    written = write_maps(found, maps)
    result = found.as_json()
    result |= {"truth": place.name_of(truth), "picture": place.name_of(picture)}
    return Doing(writes=list(written), notes=list(found.notes), facts={"result": result})
