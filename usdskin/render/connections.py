"""Connections of a shading network, followed to where a value comes from."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.notes import Note

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdShade


def is_node_output(attribute: Usd.Attribute) -> bool:
    """Tell whether a connection ends here: at an output of a shader, whether declared or not."""
    connectable = UsdShade.ConnectableAPI(attribute.GetPrim())
    is_output = attribute.GetName().startswith("outputs:")
    return bool(connectable) and not connectable.IsContainer() and is_output


def shader_name(shader: UsdShade.Shader) -> str:
    """Return what a shader is, as notes name it."""
    return str(shader.GetShaderId() or "without info:id")


class Network:
    """The shaders of a stage at one moment, read input by input."""

    def __init__(
        self,
        stage: Usd.Stage,
        time: Usd.TimeCode | float,
        notes: list[Note],
    ) -> None:
        self.stage = stage
        self.time = time
        self.notes = notes

    def note(self, code: str, subject: Usd.Object, message: str) -> None:
        """Append a note, once."""
        found = Note(code, str(subject.GetPrim().GetPath()), message)
        if found not in self.notes:
            self.notes.append(found)

    def follow(self, attribute: Usd.Attribute) -> Usd.Attribute:
        """Return where a value comes from: an output of a shader, or an attribute that holds it.

        Raises:
            LayerError: The connections lead back to where they started.
        """
        seen: list[Sdf.Path] = []
        while True:
            path = attribute.GetPath()
            if path in seen:
                loop = " -> ".join(str(item) for item in [*seen[seen.index(path) :], path])
                raise LayerError(
                    f"{describe(attribute)}: the connections form a loop ({loop}); remove one"
                )
            seen.append(path)
            targets = attribute.GetConnections()
            if not targets:
                return attribute
            if len(targets) > 1:
                what = f"{attribute.GetName()} has {len(targets)} connections; the first is shown"
                self.note("extra-connections-ignored", attribute, what)
            prim = self.stage.GetPrimAtPath(targets[0].GetPrimPath())
            # An output of a shader need not be declared to be connected to.
            source = prim.GetAttribute(targets[0].name) if prim else None
            if source is not None and is_node_output(source):
                return source
            if not source:
                what = f"{attribute.GetName()} is connected to <{targets[0]}>, which is not there"
                self.note("connection-broken", attribute, f"{what}; its own value is shown")
                return attribute
            attribute = source

    def source(self, shader: UsdShade.Shader, name: str) -> Usd.Attribute | None:
        """Return where the value of an input comes from, or None where nobody has an opinion."""
        shader_input = shader.GetInput(name)
        if not shader_input:
            return None
        source = self.follow(shader_input.GetAttr())
        return source if is_node_output(source) or source.HasAuthoredValue() else None

    def value(self, attribute: Usd.Attribute) -> Any:
        """Return what an attribute holds at this moment."""
        value = attribute.Get(self.time)
        # What has time samples only has no value at the default time.
        return attribute.Get(Usd.TimeCode.EarliestTime()) if value is None else value

    def token(
        self, shader: UsdShade.Shader, name: str, fallback: str, allowed: tuple[str, ...]
    ) -> str:
        """Return an input that is a word.

        Raises:
            LayerError: It is none of the allowed words.
        """
        source = self.source(shader, name)
        value = None if source is None or is_node_output(source) else self.value(source)
        if value is None or source is None:
            return fallback
        if not isinstance(value, str) or (allowed and value not in allowed):
            raise LayerError(
                f'{describe(source)}: {source.GetName()} is "{value}"; use one of '
                f"{', '.join(allowed) or 'its words'}"
            )
        return value

    def numbers(self, attribute: Usd.Attribute, width: int) -> tuple[float, ...]:
        """Return a constant as ``width`` finite numbers."""
        value = self.value(attribute)
        try:
            array = np.asarray(value, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):
            array = np.zeros(0)
        if isinstance(value, (str, type(None))) or len(array) != width:
            wanted = "a number" if width == 1 else f"{width} numbers"
            raise LayerError(
                f"{describe(attribute)}: {attribute.GetName()} is {_shown(value)}, not {wanted}"
            )
        if not all(math.isfinite(item) for item in array):
            raise LayerError(
                f"{describe(attribute)}: {attribute.GetName()} is {_shown(value)}; set it to "
                "finite numbers"
            )
        # float32's nearest to 0.3 was written as 0.3.
        return tuple(float(str(np.float32(item))) for item in array)


def _shown(value: Any) -> str:
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
