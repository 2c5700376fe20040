"""Cycles' part of the comparison, run by the Python that has bpy: ``render_cycles.py JOB.json``.

RGB, direct light alone, no denoiser, no adaptive sampling. It needs bpy and NumPy, nothing else.
"""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np


def run(job: dict[str, Any]) -> dict[str, Any]:
    """Render ``repeats`` + 1 times, a seed each; save all pictures."""
    given = np.load(job["arrays"])
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _body(scene, given)
    _room(scene, given["room"])
    _camera(scene, job)
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = job["samples"]
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.max_bounces = 0
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 1.0
    render = scene.render
    render.resolution_x = render.resolution_y = job["size"]
    render.resolution_percentage = 100
    render.film_transparent = True
    render.use_persistent_data = True
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    render.filepath = job["out"]
    laps, pictures = [], []
    for seed in range(job["repeats"] + 1):
        cycles.seed = seed
        begun = time.perf_counter()
        bpy.ops.render.render(write_still=True)
        laps.append({"pixels": time.perf_counter() - begun})
        image = bpy.data.images.load(job["out"])
        image.colorspace_settings.name = "Non-Color"
        pixels = np.empty(job["size"] ** 2 * 4, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        pictures.append(pixels.reshape(job["size"], job["size"], 4)[::-1])
    np.save(job["picture"], np.stack(pictures))
    return {"first": laps[0], "laps": laps[1:]}


def _body(scene: Any, given: Any) -> None:
    mesh = bpy.data.meshes.new("body")
    # Blender stands along +Z: (x, y, z) of the stage is (x, -z, y) here.
    points, normals = (given[name][:, [0, 2, 1]] * [1, -1, 1] for name in ("points", "normals"))
    faces = given["faces"]
    flat = (points[faces[:, 0]] == points[faces[:, 1]]).all(axis=1)
    flat |= (points[faces[:, 1]] == points[faces[:, 2]]).all(axis=1)
    mesh.from_pydata(points.tolist(), [], faces[~flat].tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    mesh.normals_split_custom_set_from_vertices(normals.tolist())
    material = bpy.data.materials.new("skin")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (*given["color"].tolist(), 1.0)
    material.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("body", mesh))


def _room(scene: Any, room: Any) -> None:
    height, width = room.shape
    image = bpy.data.images.new("room", width, height, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.ones((height, width, 4), np.float32)
    # Its middle column is +X in Blender; ours looks along +Z, which is -Y there.
    pixels[..., :3] = np.roll(room, width // 4, axis=1)[::-1, :, None]
    image.pixels.foreach_set(np.ascontiguousarray(pixels).ravel())
    image.pack()
    world = bpy.data.worlds.new("world")
    scene.world = world
    world.use_nodes = True
    nodes = world.node_tree.nodes
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    texture.interpolation = "Closest"
    world.node_tree.links.new(texture.outputs["Color"], nodes["Background"].inputs["Color"])
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = width


def _camera(scene: Any, job: dict[str, Any]) -> None:
    data = bpy.data.cameras.new("camera")
    data.angle = math.radians(job["fov"])
    camera = bpy.data.objects.new("camera", data)
    camera.location = (0.0, -job["distance"], 0.0)
    camera.rotation_euler = (math.pi / 2.0, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera


if __name__ == "__main__":
    print(json.dumps(run(json.loads(Path(sys.argv[1]).read_text()))))
