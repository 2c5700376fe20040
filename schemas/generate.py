"""Generate generatedSchema.usda and plugInfo.json from schema.usda.

Runs the ``usdGenSchema`` of the usd-core wheel (which needs jinja2), then does what it leaves:
fills the three placeholders of plugInfo.json and copies every ``doc`` (of which the generator
keeps the first sentence) and every ``limits`` back. The same input gives the same bytes.

Usage: ``python -m usdskin.schemas.generate [FOLDER]``; without FOLDER the committed files are
replaced.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
GENERATED_NAMES = ("generatedSchema.usda", "plugInfo.json")

# A codeless plugin: no library, and both files in the folder of the package.
_PLACEHOLDERS = {
    "@PLUG_INFO_LIBRARY_PATH@": "",
    "@PLUG_INFO_RESOURCE_PATH@": ".",
    "@PLUG_INFO_ROOT@": ".",
}


def generate(folder: Path) -> None:
    """Write the generated files into ``folder``.

    Args:
        folder: Existing folder to write to.

    Raises:
        RuntimeError: The generator failed; the message holds what it said.
    """
    source = FOLDER / "schema.usda"
    # In an empty folder, because usdGenSchema merges into a plugInfo.json that it finds.
    with tempfile.TemporaryDirectory() as clean:
        done = subprocess.run(
            [sys.executable, "-m", "pxr.Usd.usdGenSchema", str(source), clean],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise RuntimeError(f"usdGenSchema failed on {source}:\n{done.stdout}{done.stderr}")
        _fill_placeholders(Path(clean, "plugInfo.json"))
        _restore_metadata(source, Path(clean, "generatedSchema.usda"))
        for name in GENERATED_NAMES:
            shutil.copyfile(Path(clean, name), folder / name)


def _fill_placeholders(plug_info: Path) -> None:
    text = plug_info.read_text(encoding="utf-8")
    for placeholder, value in _PLACEHOLDERS.items():
        text = text.replace(placeholder, value)
    plug_info.write_text(text, encoding="utf-8", newline="\n")


def _restore_metadata(source: Path, generated: Path) -> None:
    from pxr import Sdf

    original = Sdf.Layer.OpenAsAnonymous(str(source))
    layer = Sdf.Layer.OpenAsAnonymous(str(generated))
    for target in layer.rootPrims:
        schema = original.GetPrimAtPath(target.path)
        _copy_metadata(schema, target)
        prefix = schema.customData.get("propertyNamespacePrefix")
        template = f"{prefix}:__INSTANCE_NAME__:" if prefix else ""
        for prop in schema.properties:
            _copy_metadata(prop, target.properties[template + prop.name])
    layer.Export(str(generated))


def _copy_metadata(source: Any, target: Any) -> None:
    target.documentation = " ".join(source.documentation.split())
    brief = target.customData.get("userDocBrief")
    if brief is not None:
        target.customData["userDocBrief"] = " ".join(brief.split())
    if source.HasInfo("limits"):
        target.SetInfo("limits", source.GetInfo("limits"))


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
