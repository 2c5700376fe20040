"""Open, check and write USD layers, and record where they come from.

Every step meets the others in layers: it opens them with ``open_stage``, which turns whatever is
wrong with a file into one line, and publishes with ``write_layer``, which leaves either the old
file or the whole new one.
"""

from __future__ import annotations

import hashlib
import math
import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf, Usd, UsdGeom, UsdMedia, UsdUtils, Vt

from usdskin import __version__
from usdskin.errors import LayerError, UsageError
from usdskin.notes import Note
from usdskin.replacing import check_writable
from usdskin.schemas import ensure_registered

_LAYER_SUFFIXES = (".usd", ".usda", ".usdc")
_REMEDY = "export it again from the application it comes from"

SettingValue = bool | int | float | str | Sequence[int] | Sequence[float] | Sequence[str]


@contextmanager
def quiet_diagnostics() -> Iterator[list[str]]:
    """Keep USD's warnings off stderr; the yielded list holds them when the block ends."""
    messages: list[str] = []
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield messages
    finally:
        messages.extend(_one_line(item) for item in delegate.TakeUncoalescedDiagnostics())
        del delegate


@contextmanager
def corruption_as_errors(path: str | Path) -> Iterator[None]:
    """Raise what USD throws on a corrupt file as an error of ours.

    Opening a layer reads little of it: a broken value may show only when an attribute is read.

    Args:
        path: Layer that was opened, to be named in the error.

    Raises:
        LayerError: The block met a ``Tf.ErrorException`` or text that is not UTF-8.
    """
    try:
        yield
    except Tf.ErrorException as error:
        texts = [_one_line(item) for item in error.args]
        reasons = [text for text in texts if text and not text.startswith("Failed to open layer")]
        reason = f": {reasons[0].rstrip('.')}" if reasons else ""
        reason = reason.replace(os.path.abspath(path), Path(path).name)
        raise LayerError(f"{path}: cannot be read as a USD layer{reason}; {_REMEDY}") from None
    except UnicodeDecodeError:
        raise LayerError(f"{path}: holds text that is not UTF-8; {_REMEDY}") from None


def open_stage(
    path: str | Path,
    notes: list[Note] | None = None,
    prepare: Callable[[Usd.Stage], None] | None = None,
) -> Usd.Stage:
    """Open a stage and check what would hang, mislead or crash its readers.

    Args:
        path: Layer to open.
        notes: Takes what did not compose (missing references, cycles), one note each. Without a
            list those are errors.
        prepare: Selects variants and the like before the stage is checked.

    Returns:
        The stage, with all payloads loaded.

    Raises:
        LayerError: The layer is missing or broken, or a layer of the stage has a
            ``timeCodesPerSecond`` that is not a positive number, or the stage's units are unusable.
        SchemaError: The ``usdSkin`` schemas were registered too late.
    """
    ensure_registered()
    stage = _open(str(path))
    if prepare is not None:
        prepare(stage)
    _check_time_codes(stage)
    _check_units(stage)
    problems = [(str(error.rootSite.path), _flat(str(error))) for error in _errors_of(stage)]
    if notes is not None:
        notes.extend(Note("composition-error", where, what) for where, what in problems)
    elif problems:
        where, what = problems[0]
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise LayerError(
            f"{path} <{where}>: {what.rstrip('.')}{more}; restore the missing layer or remove the "
            "arc to it"
        )
    return stage


def _errors_of(stage: Usd.Stage) -> list[Any]:
    with quiet_diagnostics():
        return list(stage.GetCompositionErrors())


def _open(path: str) -> Usd.Stage:
    # "package.usdz[layer.usda]" names a layer inside a file.
    file = Path(path.partition("[")[0]) if path.endswith("]") else Path(path)
    try:
        mode = file.stat().st_mode
    except (OSError, ValueError):
        raise LayerError(f"{path}: no such file; check the name and the folder") from None
    if not stat.S_ISREG(mode):
        raise LayerError(f"{path}: not a file; name the layer itself")
    with quiet_diagnostics(), corruption_as_errors(path):
        stage = Usd.Stage.Open(path)
    if stage is None:
        raise LayerError(f"{path}: cannot be opened as a USD layer; {_REMEDY}")
    return stage


def _one_line(diagnostic: Any) -> str:
    """Return a diagnostic's text, whose bytes may not be UTF-8, as one line."""
    try:
        return _flat(str(diagnostic.commentary))
    except UnicodeDecodeError:
        return "it holds text that is not UTF-8"


def _flat(text: str) -> str:
    return " ".join(text.split())


def _check_time_codes(stage: Usd.Stage) -> None:
    """Refuse time code rates on which usd-core hangs at the first query of time samples."""
    for layer in stage.GetUsedLayers():
        rate = layer.timeCodesPerSecond
        if not (math.isfinite(rate) and rate > 0.0):
            raise LayerError(
                f"{layer.GetDisplayName()}: timeCodesPerSecond is {rate:g}; set it to the number "
                "of time codes in a second, such as 24"
            )


def _check_units(stage: Usd.Stage) -> None:
    name = stage.GetRootLayer().GetDisplayName()
    meters = UsdGeom.GetStageMetersPerUnit(stage)
    if not (math.isfinite(meters) and meters > 0.0):
        raise LayerError(
            f"{name}: metersPerUnit is {meters:g}; set it to the length of a unit in metres, such "
            "as 0.01"
        )
    axis = str(UsdGeom.GetStageUpAxis(stage))
    if axis not in ("Y", "Z"):
        raise LayerError(f'{name}: upAxis is "{axis}"; set it to "Y" or "Z"')


def describe(subject: Usd.Object) -> str:
    """Return where an opinion comes from, as errors name it: ``layer.usda </Prim>``.

    Args:
        subject: A prim, or a property of one.
    """
    return f"{layer_name(subject)} <{subject.GetPrim().GetPath()}>"


def layer_name(subject: Usd.Object) -> str:
    """Return the file name of the layer with the strongest opinion.

    What flags set is in the session layer, which is no file: ``--set``, or the prim's file with it.

    Args:
        subject: A prim, or a property of one; the prim counts where the property has no opinion.
    """
    prim = subject.GetPrim()
    specs = subject.GetPropertyStack() if isinstance(subject, Usd.Property) else []
    if not specs and not prim.IsPseudoRoot():
        specs = prim.GetPrimStack()
    session = prim.GetStage().GetSessionLayer()
    files = [spec for spec in specs if spec.layer != session]
    layer = files[0].layer if files else prim.GetStage().GetRootLayer()
    name = str(layer.GetDisplayName() or layer.identifier)
    if not specs or specs[0].layer != session:
        return name
    if isinstance(subject, Usd.Property) and isinstance(specs[0], Sdf.PropertySpec):
        return "--set"
    return f"{name} with --set" if specs[0].properties else name


def write_layer(source: Sdf.Layer | Usd.Stage, path: str | Path) -> Path:
    """Write a layer so that an interruption leaves the old file or the new, never a part.

    Relative asset paths are written as they are, so they count from the folder of ``path``.

    Args:
        source: Layer to write, or a stage, of which the root layer is written.
        path: File to write, ending in ``.usda``, ``.usdc`` or ``.usd``. Its folder is made where
            it is missing.

    Returns:
        ``path``, once the layer is complete on disk.

    Raises:
        LayerError: The folder cannot be made or written to, or the name is no layer's.
    """
    # A stage stays referenced to the end: its root layer would expire with it.
    layer = source.GetRootLayer() if isinstance(source, Usd.Stage) else source
    path = Path(path)
    if path.suffix not in _LAYER_SUFFIXES:
        raise LayerError(f"{path}: cannot write this kind of file; end its name in .usda")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with quiet_diagnostics():
            _export(layer, temporary, path)
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise LayerError(
            f"{path}: cannot be written ({error.strerror}); check the folder's permissions and "
            "free space"
        ) from None
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    if layer.realPath != str(path.resolve()):
        reload_open_copy(path)
    return path


def check_output(
    output: Path, inputs: Iterable[Path], beside: Iterable[Path] = (), *, step: str
) -> None:
    """Refuse an output that would fail after the work is done, or destroy an input.

    Folders that are missing are made when the files are written.

    Args:
        output: Layer to write.
        inputs: Files the step reads.
        beside: Files that will be written beside the layer.
        step: What the step is called in the message, such as ``capture``.

    Raises:
        UsageError: The name is no layer's; or the layer, or a file beside it, is an input or a
            folder.
        UsdSkinError: The folder cannot be made or written to.
    """
    if output.suffix not in _LAYER_SUFFIXES:
        raise UsageError(f"{output}: cannot write this kind of file; end its name in .usda")
    taken = {path.resolve() for path in inputs}
    for path in (output, *beside):
        if path.resolve() in taken:
            raise UsageError(f"{path}: is an input of this {step}; write to another name or folder")
        check_writable(path)


def used_files(stage: Usd.Stage) -> list[Path]:
    """Return the files of a stage's layers, in memory ones left out."""
    return [Path(layer.realPath) for layer in stage.GetUsedLayers() if layer.realPath]


def named_files(path: Path) -> set[Path]:
    """Return a layer and every file that it names, itself or through other layers."""
    with quiet_diagnostics():
        layers, assets, _ = UsdUtils.ComputeAllDependencies(str(path))
    files = {Path(layer.realPath) for layer in layers if layer.realPath}
    return {file.resolve() for file in files | {Path(asset) for asset in assets}}


def reload_open_copy(path: Path) -> None:
    """Bring a copy of a layer that this process has open up to date with its file."""
    opened = Sdf.Layer.Find(str(path.resolve()))
    if opened is not None:
        opened.Reload(True)


def _export(layer: Sdf.Layer, temporary: Path, path: Path) -> None:
    try:
        written = layer.Export(str(temporary))
    except Tf.ErrorException as error:
        texts = [_one_line(item) for item in error.args]
        raise LayerError(
            f"{path}: cannot be written ({texts[0] if texts else 'USD gave no reason'}); check "
            "the folder's permissions and free space"
        ) from None
    if not written:
        raise LayerError(
            f"{path}: cannot be written; check the folder's permissions and free space"
        )


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal.

    Raises:
        LayerError: The file cannot be read.
    """
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise LayerError(
            f"{path}: cannot be read ({error.strerror}); it is an input of the layer to write"
        ) from None


def record_provenance(
    stage: Usd.Stage,
    step: str,
    inputs: Iterable[str | Path],
    settings: Mapping[str, SettingValue],
    folder: str | Path | None = None,
) -> None:
    """Record in a stage's root layer who made it, from which inputs and how.

    The record is written twice: as ``customLayerData["usdskin"][step]`` of the layer, and, where
    this USD has it, as ``UsdMedia.AuthorshipAPI:<step>`` on its default prim, which composes. It
    holds no absolute path, no user and no machine. ``SOURCE_DATE_EPOCH`` fixes its time, for
    reproducible files.

    Args:
        stage: Stage whose root layer is going to be written; it has a default prim.
        step: Name of the step, an identifier such as ``estimateLight``.
        inputs: Files the layer was made from.
        settings: What the step was told, by name.
        folder: Folder the layer is going to be written to, from which the inputs are named. By
            default that of the root layer; inputs of a stage in memory go by their file names.

    Raises:
        LayerError: The stage has no default prim, or an input cannot be read.
    """
    layer = stage.GetRootLayer()
    prim = stage.GetDefaultPrim()
    if not prim:
        raise LayerError(
            f"{layer.GetDisplayName()}: has no default prim to record its origin on; set "
            "defaultPrim"
        )
    if not Tf.IsValidIdentifier(step):
        raise ValueError(f"the step {step!r} is not an identifier")
    if folder is None and layer.realPath:
        folder = Path(layer.realPath).parent
    files = [Path(item) for item in inputs]
    names = [_relative_name(file, folder) for file in files]
    digests = [sha256(file) for file in files]
    created = _timestamp()

    data = dict(layer.customLayerData)
    record = {
        "created": created,
        "inputs": Vt.StringArray(names),
        "inputsSha256": Vt.StringArray(digests),
        "settings": {name: _setting(value) for name, value in sorted(settings.items())},
        "version": __version__,
    }
    data["usdskin"] = {**data.get("usdskin", {}), step: record}
    layer.customLayerData = data

    if not hasattr(UsdMedia, "AuthorshipAPI"):
        return
    pairs = [text for pair in zip(names, digests, strict=True) for text in pair]
    pairs += [text for name, value in sorted(settings.items()) for text in (name, str(value))]
    with Usd.EditContext(stage, layer):
        authorship = UsdMedia.AuthorshipAPI.Apply(prim, step)
        authorship.CreateSoftwarePackageAttr("usdskin")
        authorship.CreateSoftwareVersionAttr(__version__)
        authorship.CreateCreatedAttr(created)
        authorship.CreateInputsAttr(Vt.StringArray(pairs))


def _relative_name(file: Path, folder: str | Path | None) -> str:
    if folder is None:
        return f"./{file.name}"
    try:
        name = Path(os.path.relpath(file.resolve(), Path(folder).resolve()))
    except ValueError:
        return f"./{file.name}"
    # A way that climbs to the root of the file system is an absolute path in disguise.
    climbs = sum(part == ".." for part in name.parts)
    if climbs >= len(Path(folder).resolve().parts) - 1:
        return f"./{file.name}"
    return name.as_posix() if climbs else f"./{name.as_posix()}"


def _timestamp() -> str:
    seconds = float(os.environ.get("SOURCE_DATE_EPOCH", time.time()))
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(seconds))


def _setting(value: SettingValue) -> Any:
    if isinstance(value, (bool, int, float, str)):
        return value
    items: list[Any] = list(value)
    if all(isinstance(item, str) for item in items):
        return Vt.StringArray(items)
    return Vt.DoubleArray([float(item) for item in items])
