"""Frames per second on a GPU, and how near that is to what its memory and arithmetic allow."""

from __future__ import annotations

from statistics import median

from benchmarks import scene
from benchmarks.compare import SUBPIXELS, Bench
from benchmarks.measure import run_job
from benchmarks.report import Row, Section

VERTEX_BYTES = 3 * (12 + 12 + 4)
"""Points, normals and indices of a sample's triangle."""

NODE_BYTES, NODE_COUNT, NODE_FLOPS = 32, 50, 24
"""A ray into 50 000 triangles visits about so many nodes; boxes of six floats and two links."""

TEXEL_BYTES, CORNERS = 16, 4
MAP_FLOPS, POINT_FLOPS, TRIANGLE_FLOPS = 60, 260, 45


def section(bench: Bench, device: str) -> Section:
    """Measure the map at 1920 x 1080 on a device."""
    width, height = (192, 108) if bench.is_quick else (1920, 1080)
    stage = scene.write_stage(bench.folder, "head 50k")
    found = run_job(
        "render_device", bench.folder, stage=str(stage), device=device, width=width,
        height=height, samples=SUBPIXELS, frames=4 if bench.is_quick else 100,
        flop_steps=512 if device == "cpu" else 4096,
    )  # fmt: skip
    bench.raw[f"frames per second, {device}"] = found
    pixels = width * height
    covered = found["covered"]
    nodes = 8 + covered * (NODE_COUNT - 8)  # rays that miss the head's box end early
    kernels = 2
    per_sample = nodes * NODE_BYTES + covered * (
        VERTEX_BYTES + kernels * found["groups"] * CORNERS * TEXEL_BYTES
    )
    moved = pixels * (SUBPIXELS * per_sample + 16 + 2 * 16 * found["rows"] * covered)
    least_moved = pixels * (16 + 2 * 16 * found["rows"] * covered)
    work = pixels * SUBPIXELS * (
        nodes * NODE_FLOPS
        + covered * (POINT_FLOPS + TRIANGLE_FLOPS + kernels * found["groups"] * MAP_FLOPS)
    )  # fmt: skip
    camera, light = median(found["camera"]), median(found["light"])
    roof = max(least_moved / found["bandwidth"], work / found["flops"])
    rows = [
        Row("the camera moves", f"{1.0 / camera:.1f} /s", f"{camera * 1e3:.2f} ms"),
        Row("the light turns, its maps made anew", f"{1.0 / light:.1f} /s",
            f"{light * 1e3:.1f} ms"),
        Row("copying memory, this device's best", f"{found['bandwidth'] / 1e9:.0f} GB/s"),
        Row("multiplying and adding, its best", f"{found['flops'] / 1e12:.2f} TFLOP/s"),
        Row("bytes per pixel, all of them; that reach memory at least", f"{moved / pixels:.0f}",
            f"{least_moved / pixels:.0f}"),
        Row("operations per pixel, estimated", f"{work / pixels:.0f}"),
        Row("bound by memory alone; by arithmetic alone",
            f"{least_moved / found['bandwidth'] * 1e3:.3f} ms",
            f"{work / found['flops'] * 1e3:.3f} ms"),
        Row("share of the roofline reached, camera", f"{roof / camera:.1%}"),
    ]  # fmt: skip
    columns = ("", "this", "other", "", "")
    title = f"Map integrator on {device}, {width} x {height}, {SUBPIXELS} subpixels, 61 bands"
    return Section(title, columns, rows)
