"""What ``usdskin validate`` says about a stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pxr import Sdf, Usd

from usdskin.layers import layer_name

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong with a stage."""

    severity: Severity
    """``error``: a render refuses it or gets it wrong. ``warning``: it shows otherwise than meant,
    here or in other tools."""

    code: str
    """Stable name: kebab-case for ours, ``usd:<validator>.<error>`` for USD's."""

    layer: str
    """File name of the layer with the strongest opinion."""

    path: str
    """Prim path; ``/`` for the stage as a whole."""

    message: str
    """What is wrong with which value, and what to do."""

    def __str__(self) -> str:
        """Return the finding as one line."""
        return f"{self.severity} {self.code} {self.layer} <{self.path}>: {self.message}"


def finding(severity: Severity, prim: Usd.Prim, code: str, message: str, name: str = "") -> Finding:
    """Return a finding about a prim, or about one of its properties.

    Args:
        severity: How bad it is.
        prim: Where it is.
        code: Stable name.
        message: What is wrong and what to do; to be read after ``name`` where there is one.
        name: Name of the property, or of the applied schema.
    """
    prop = prim.GetProperty(name) if Sdf.Path.IsValidNamespacedIdentifier(name) else None
    layer = layer_name(prop if prop else prim)
    return Finding(severity, code, layer, str(prim.GetPath()), f"{name} {message}".strip())
