"""``SpectralDistributionAPI:<name>`` <-> ``Spectrum``."""

from __future__ import annotations

from typing import Any

from pxr import Usd, Vt

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.applied import instances
from usdskin.prims.rules import RULES
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.spectrum import SpectralQuantity, Spectrum

_SCHEMA = "SpectralDistributionAPI"


def read_spectrum(
    prim: Usd.Prim,
    name: str,
    time: Usd.TimeCode | float = DEFAULT_TIME,
    quantities: tuple[SpectralQuantity, ...] = (),
) -> Spectrum | None:
    """Return the spectrum a prim carries under a name.

    Args:
        prim: Prim with ``SpectralDistributionAPI:<name>``.
        name: Instance name, such as ``reflectance``.
        time: Time to read at.
        quantities: What the spectrum may measure here; the first stands in where the layer does
            not say. Anything goes if empty.

    Returns:
        The spectrum, or None where the prim has none of this name.

    Raises:
        LayerError: The samples are missing, of unequal number, not ascending, not finite,
            negative or percents where the quantity forbids it, or of another quantity than
            asked for.
    """
    if name not in instances(prim, _SCHEMA):
        return None
    values = read_schema(prim, _SCHEMA, time, name)
    quantity = SpectralQuantity(values["quantity"])
    attribute = prim.GetAttribute(f"spectrum:{name}:quantity")
    if quantities and not attribute.HasAuthoredValue():
        quantity = quantities[0]
        _refuse_as(prim, name, values, quantity)
    elif quantities and quantity not in quantities:
        allowed = " or ".join(item.value for item in quantities)
        text = f'is "{quantity.value}"; it must be {allowed} here'
        raise PrimError(prim, Problem("wrong-quantity", attribute.GetName(), text))
    return Spectrum(quantity, values["wavelengths"], values["values"], values["interpolation"])


def _refuse_as(
    prim: Usd.Prim, name: str, values: dict[str, Any], quantity: SpectralQuantity
) -> None:
    for rule in RULES[_SCHEMA]:
        for complaint in rule({**values, "quantity": quantity.value}):
            full = f"spectrum:{name}:{complaint.name}"
            raise PrimError(prim, Problem(complaint.code, full, complaint.message))


def write_spectrum(prim: Usd.Prim, name: str, spectrum: Spectrum) -> None:
    """Apply ``SpectralDistributionAPI:<name>`` to a prim and author a spectrum.

    Args:
        prim: Prim to write to, at the stage's edit target.
        name: Instance name, such as ``reflectance``.
        spectrum: What to write.

    Raises:
        LayerError: The name is no valid instance name.
    """
    allowed = prim.CanApplyAPI(_SCHEMA, name)
    if not allowed:
        raise LayerError(
            f"{describe(prim)}: a spectrum cannot be named {name!r}; use letters and digits"
        )
    prim.ApplyAPI(_SCHEMA, name)
    prefix = f"spectrum:{name}:"
    prim.GetAttribute(f"{prefix}wavelengths").Set(Vt.DoubleArray.FromNumpy(spectrum.wavelength_nm))
    prim.GetAttribute(f"{prefix}values").Set(Vt.DoubleArray.FromNumpy(spectrum.value))
    prim.GetAttribute(f"{prefix}quantity").Set(spectrum.quantity.value)
    prim.GetAttribute(f"{prefix}interpolation").Set(spectrum.interpolation)
