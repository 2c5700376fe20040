"""The error tree and the exit codes of the command line.

``UsdSkinError``: anything a user can mend; printed as one line, exit code 3.
    ``UsageError``: a wrong option or argument, exit code 2.
    ``LayerError``: a layer or a prim's opinion that cannot be used.
        ``SchemaError``: the ``usdSkin`` schema is not known to this process.
    ``ImageError``: an image that is missing, broken or of the wrong kind.
    ``MeshError``: geometry that cannot be used.
    ``FindingsError``: the command ran and what it checked does not hold, exit code 4.
    ``FramesError``: some frames of a sequence failed, exit code 5.
    ``DeviceError``: no such device, or not enough memory, exit code 6.

A programming mistake raises ``ValueError`` or ``TypeError`` and keeps its traceback (exit code 1).
"""

from __future__ import annotations

EXIT_OK = 0
EXIT_INTERNAL = 1
EXIT_USAGE = 2
EXIT_INPUT = 3
EXIT_FINDINGS = 4
EXIT_FRAMES = 5
EXIT_DEVICE = 6


class UsdSkinError(Exception):
    """Where it is, what is wrong with which value, and what to do, in one line."""

    exit_code = EXIT_INPUT


class UsageError(UsdSkinError):
    """A wrong option or argument."""

    exit_code = EXIT_USAGE


class LayerError(UsdSkinError):
    """A layer, or an opinion in it, that cannot be used."""


class SchemaError(LayerError):
    """The ``usdSkin`` schema is not known to this process."""


class ImageError(UsdSkinError):
    """An image that is missing, broken or of the wrong kind."""


class MeshError(UsdSkinError):
    """Geometry that cannot be used."""


class FindingsError(UsdSkinError):
    """The command ran; what it checked does not hold."""

    exit_code = EXIT_FINDINGS


class FramesError(UsdSkinError):
    """Some frames of a sequence failed."""

    exit_code = EXIT_FRAMES


class DeviceError(UsdSkinError):
    """No such device, or not enough memory."""

    exit_code = EXIT_DEVICE
